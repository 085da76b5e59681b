"""What commands print with ``--json``: the types of it, from which ``greybox schema`` makes the schema."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pkgutil import resolve_name
from typing import Any, ClassVar, NotRequired, TypedDict

from greybox.base import GreyboxError, nearest
from greybox.base.extensions import ExtensionKind, list_extensions
from greybox.base.json_shape import DRAFT, FileKind, Interval, make_definitions
from greybox.comparison.result import Comparison
from greybox.estimation.result_parts import Estimate

# Command -> types of what it prints with ``--json``; several where it depends on what was given. The module of a command or a plant of an
# extension has a table of this name for its own.
PRINTS: Mapping[str, tuple[str, ...]] = {
    "fit": ("greybox.shell.answers:FitAnswer",),
    "compare": ("greybox.shell.printed:ComparisonAnswer",),
    "discover": ("greybox.discovery.result:Discovery",),
    "check": (
        "greybox.estimation.check:ModelCheck",
        "greybox.data.survey:FileSurvey",
        "greybox.data.survey:FileSurveys",
    ),
    "simulate": ("greybox.shell.printed:PrintedSimulation",),
    "models": ("greybox.shell.printed:ModelList", "greybox.shell.printed:PrintedModel"),
    "effects": ("greybox.shell.printed:EffectList",),
    "init": ("greybox.shell.printed:PrintedProject",),
    "extensions": ("greybox.shell.printed:ExtensionList",),
    "demo": ("greybox.discovery.result:Discovery",),
    "schema": ("greybox.shell.printed:JsonSchema",),
}


def list_printed() -> dict[str, tuple[str, ...]]:
    """Command -> types of what it prints, those of extensions included."""
    printed = dict(PRINTS)
    for kind in (ExtensionKind.COMMANDS, ExtensionKind.PLANTS):
        for entry in list_extensions(kind):
            if not entry.failure:
                module = import_module(entry.place.partition(":")[0])
                for command, places in getattr(module, "PRINTS", {}).items():
                    known = printed.get(command, ())
                    printed[command] = (*known, *(place for place in places if place not in known))
    return printed


def schema_of_command(command: str) -> dict[str, Any]:
    """The JSON Schema of what ``greybox COMMAND --json`` prints, whole in itself.

    Parameters
    ----------
    command
        ``fit``, ``discover``, ``changed`` ...

    Returns
    -------
    dict
        A schema of draft 2020-12 that refers to nothing outside itself.

    Raises
    ------
    GreyboxError
        For a command that does not exist.
    """
    printed = list_printed()
    if command not in printed:
        raise GreyboxError(f"no command {command!r}; {nearest(command, list(printed))}")
    references, definitions = make_definitions(*map(resolve_name, printed[command]))
    # What may be null is described in place: the definition that it was taken from is left out unless something else refers to it.
    needed, pending = set[str](), [repr(references)]
    while pending:
        names = set(re.findall(r"'#/\$defs/(\w+)'", pending.pop())) - needed
        needed |= names
        pending += (repr(definitions[name]) for name in names)
    return {
        "$schema": DRAFT,
        "$id": f"urn:greybox:command:{command}:1",
        "title": f"What greybox {command} --json prints",
        **(references[0] if len(references) == 1 else {"anyOf": references}),
        "$defs": {name: each for name, each in definitions.items() if name in needed},
    }


class PrintedSimulation(TypedDict):
    """The record that ``greybox simulate`` has written.

    Attributes
    ----------
    file, rows
        The record, and its rows.
    inputs, outputs
        Columns that drive the model, and those that it answers with.
    discretisation
        How the model was integrated.
    report
        The page; null where none was asked for.
    """

    file: str
    rows: int
    inputs: list[str]
    outputs: list[str]
    discretisation: str
    report: str | None


class ListedModel(TypedDict):
    """One model that a name finds here.

    Attributes
    ----------
    name, title
        The name that finds it, and that with the effects that are added to it.
    description, where
        What it is, in a line, and where it is written.
    """

    name: str
    title: str
    description: str
    where: str


class ModelList(TypedDict):
    """Every model that a name finds here: ``greybox models``.

    Attributes
    ----------
    models
        The models.
    problems
        Model files that could not be read, with the reason.
    """

    models: list[ListedModel]
    problems: list[str]


class OutlinedParameter(TypedDict):
    """One parameter of a model.

    Attributes
    ----------
    value, unit
        Its value, and the unit.
    bounds
        Smallest and largest value; null where it is open.
    fixed
        Not fitted.
    description, source
        What it is, and where its value is from.
    """

    value: float
    unit: str
    bounds: Interval
    fixed: bool
    description: str
    source: str


class PrintedModel(TypedDict):
    """One model: ``greybox models MODEL``.

    Attributes
    ----------
    name, title
        Its name, and that with the effects that are added to it.
    description
        What it is.
    equations
        Its balances as text.
    states, inputs, outputs
        Unit of each.
    parameters
        What is known of each.
    """

    name: str
    title: str
    description: str
    equations: str
    states: Mapping[str, str]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    parameters: Mapping[str, OutlinedParameter]


class ListedEffect(TypedDict):
    """One effect of the catalogue, or where it finds a place in a model.

    Attributes
    ----------
    name
        Of the catalogue.
    site
        Where it acts; empty where it has no place.
    equation
        What it adds.
    parameters
        Parameter -> unit.
    reason
        Why it has no place; empty where it has one.
    """

    name: str
    site: str
    equation: str
    parameters: Mapping[str, str]
    reason: NotRequired[str]


EffectList = list[ListedEffect]
"""What ``greybox effects`` lists."""


class PrintedProject(TypedDict):
    """What ``greybox init`` has written.

    Attributes
    ----------
    folder, files
        The project, and what was written.
    next
        The command to go on with.
    """

    folder: str
    files: list[str]
    next: str


class ListedExtension(TypedDict):
    """One entry of what this package and others add to the core.

    Attributes
    ----------
    kind, name
        Readers, exports, plants, commands or effects, and the name of its entry point.
    place
        Module and value.
    distribution, version
        Which package brought it.
    failure
        Why it could not be loaded; empty where it could.
    """

    kind: str
    name: str
    place: str
    distribution: str
    version: str
    failure: str


class ExtensionList(TypedDict):
    """What this package and others add to the core: ``greybox extensions``.

    Attributes
    ----------
    extensions
        Each entry.
    """

    extensions: list[ListedExtension]


JsonSchema = TypedDict("JsonSchema", {"$schema": str, "$id": str, "title": str, "$defs": Mapping[str, Any]})
JsonSchema.__doc__ = """A JSON Schema of draft 2020-12: what ``greybox schema`` prints.

Attributes
----------
$schema, $id, title
    The draft, its name, and what it describes.
$defs
    All that it refers to.
"""


@dataclass(frozen=True)
class ComparisonAnswer:
    """A comparison with what the command knows beside it: what ``compare.json`` holds.

    Attributes
    ----------
    comparison
        The comparison.
    data
        Record -> fingerprint.
    remarks
        About the records.
    constants
        Physical model -> its constants.
    versions
        Program -> version.
    """

    comparison: Comparison
    data: Mapping[str, str]
    remarks: Sequence[str]
    constants: Mapping[str, Mapping[str, Estimate]]
    versions: Mapping[str, str]

    FILE: ClassVar[FileKind] = Comparison.FILE
    KEYS: ClassVar[str] = "comparison.* data remarks constants versions"
