"""What a command shows, as values; `greybox.show.sentences.shell` writes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NotRequired, TypedDict

from greybox.base.findings import Finding
from greybox.base.json_shape import FileKind, Interval
from greybox.base.values import Printable
from greybox.comparison.result import Comparison
from greybox.estimation.linear.linearisation import Linearisation
from greybox.estimation.linear.model_family import ModelFamily
from greybox.estimation.residuals import PredictionScores, ResidualTests
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Estimate, Misfit
from greybox.estimation.uncertainty import Bootstrap, Profile
from greybox.simulation.simulate import Simulation


@dataclass(frozen=True)
class RecordMisfit:
    """Free-run error of one output in one record.

    Attributes
    ----------
    record, output
        Their names.
    misfit
        The error there.
    """

    record: str
    output: str
    misfit: Misfit

    KEYS: ClassVar[str] = "record output misfit.*"


@dataclass(frozen=True)
class FitAnswer(Printable):
    """A fit, with what was asked for beside it: what ``fit.json`` holds in the end.

    Attributes
    ----------
    fit
        The fit.
    remedies
        What would determine the parameters that the records left open.
    profiles, bootstrap
        The intervals that were asked for.
    zero_noise
        Parameters of process noise that are zero: each has a limit only, and no profile.
    refusal
        Why there are no intervals, where they were asked for.
    scores, validation_scores
        Errors of the free run and of predictions on the fitted and on the validation records.
    tests
        The tests of the residual.
    misfits, validation_misfits
        Misfit of each output of each record, where there are several.
    """

    fit: Fit
    remedies: tuple[Finding, ...] = ()
    profiles: tuple[Profile, ...] = ()
    zero_noise: tuple[str, ...] = ()
    bootstrap: Bootstrap | None = None
    refusal: str = ""
    scores: PredictionScores | None = None
    validation_scores: PredictionScores | None = None
    tests: ResidualTests | None = None
    misfits: Sequence[RecordMisfit] = ()
    validation_misfits: Sequence[RecordMisfit] = ()

    FILE: ClassVar[FileKind] = Fit.FILE
    KEYS: ClassVar[str] = """
        fit.* profiles? zero_noise? bootstrap? refusal? remedies? tests?=tests.tests scores?=scores.outputs
        validation_scores?=validation_scores.outputs record_misfits?=misfits validation_record_misfits?=validation_misfits
        """


@dataclass(frozen=True)
class SimulationAnswer(Printable):
    """A run and the record that was written from it."""

    run: Simulation
    file: Path


@dataclass(frozen=True)
class LinearAnswer(Printable):
    """A linear model that was written, with a family drawn from the covariance where one was asked for."""

    linear: Linearisation
    family: ModelFamily | None
    files: tuple[Path, ...]


@dataclass(frozen=True)
class CodeAnswer(Printable):
    """A nonlinear model that was written as ``kind``, with its ``step`` in seconds where the format has one."""

    title: str
    kind: str
    step: float | None
    step_name: str
    files: tuple[Path, ...]


# What commands print with --json, where that is no result.


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


class ModelOutline(TypedDict):
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
JsonSchema.__doc__ = """A JSON Schema of draft 2020-12: what ``greybox schema`` prints."""


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
