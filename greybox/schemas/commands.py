"""Which JSON a command prints with ``--json``, and the schema of that alone."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from greybox.errors import GreyboxError, nearest
from greybox.schemas.json_file import ResultKind, read_schema

PRINTED: Mapping[str, tuple[str, ...]] = {
    "fit": (ResultKind.FIT, ResultKind.FMU_FIT),
    "compare": (ResultKind.COMPARISON,),
    "discover": (ResultKind.DISCOVERY,),
    "app": ("app_address",),
    "changed": (ResultKind.CHANGE,),
    "design": (ResultKind.DESIGN,),
    "campaign": (ResultKind.CAMPAIGN,),
    "check": (ResultKind.MODEL_CHECK, "file_survey", "file_surveys"),
    "export": ("export",),
    "simulate": ("simulation",),
    "models": ("model_list", "model_outline"),
    "effects": ("effect_list",),
    "init": ("project",),
    "demo": (ResultKind.DISCOVERY,),
    "schema": ("json_schema",),
}
"""Command -> kinds of what it prints, by their names in the schema; several where it depends on what was given."""


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
    if command not in PRINTED:
        raise GreyboxError(f"no command {command!r}; {nearest(command, list(PRINTED))}")
    everything, kinds = read_schema()["$defs"], [str(kind) for kind in PRINTED[command]]
    references = [{"$ref": f"#/$defs/{kind}"} for kind in kinds]
    return {
        "$schema": read_schema()["$schema"],
        "$id": f"urn:greybox:command:{command}:1",
        "title": f"What greybox {command} --json prints",
        **(references[0] if len(references) == 1 else {"anyOf": references}),
        "$defs": {name: everything[name] for name in _collect_definitions(kinds, everything)},
    }


def _collect_definitions(kinds: list[str], everything: Mapping[str, Any]) -> list[str]:
    """Names of these definitions and of all that they refer to, in the order of the file."""
    needed, pending = set[str](), list(kinds)
    while pending:
        name = pending.pop()
        if name not in needed:
            needed.add(name)
            pending += re.findall(r"'#/\$defs/(\w+)'", repr(everything[name]))
    return [name for name in everything if name in needed]
