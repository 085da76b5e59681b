"""What change detection gives back, as a value and as ``changed.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar, TypedDict

from greybox.base.json_file import StoredResult, read_json
from greybox.base.json_shape import FileKind, Interval
from greybox.base.values import Check, Finding, Printable
from greybox.discovery.decision import Grade
from greybox.discovery.result import Discovery
from greybox.estimation.result import Fit

# What change detection has to say beside its numbers.


class ChangeCode(StrEnum):
    """Codes of the findings."""

    # The answer.
    NOTHING_CHANGED = "change_nothing_changed"
    CONSTANT_MOVED = "change_constant_moved"
    COMBINATION_MOVED = "change_combination_moved"
    EFFECT_APPEARED = "change_effect_appeared"
    NOISE_GREW = "change_noise_grew"
    UNEXPLAINED = "change_unexplained"
    DIFFERENT_INPUT = "change_different_input"
    CANNOT_TELL = "change_cannot_tell"
    FIT_FAILED = "change_fit_failed"
    # What a reader should know.
    CONSTANT_NOT_SEEN = "change_constant_not_seen"
    CONSTANT_AT_BOUND = "change_constant_at_bound"
    MODEL_LACKS_SOMETHING = "change_model_lacks_something"
    SCATTER_ALLOWED = "change_scatter_allowed"
    BEYOND_MISSING_PART = "change_beyond_missing_part"
    SPLIT_FOR_VALIDATION = "change_split_for_validation"
    SAME_RECORD = "change_same_record"
    # Several machines.
    MACHINE_FALLS_OUT = "change_machine_falls_out"
    MACHINE_NOT_FITTED = "change_machine_not_fitted"
    MACHINES_ALIKE = "change_machines_alike"
    # Over time.
    CHANGE_POINT = "change_point"
    RECORD_NOT_FITTED = "change_record_not_fitted"
    NO_CHANGE_POINT = "change_no_change_point"


class ChangeRule(StrEnum):
    """Rules that decide, as `Check.rule` names them: each is a p-value that must not fall below its limit."""

    CONSTANTS_AS_BEFORE = "change_constants_as_before"
    RESIDUAL_AS_LARGE = "change_residual_as_large"
    RESIDUAL_AS_WHITE = "change_residual_as_white"


class ChangeVerdict(StrEnum):
    """What may be said of a machine today."""

    UNCHANGED = "unchanged"
    CHANGED = "changed"
    CANNOT_TELL = "cannot tell"


@dataclass(frozen=True)
class ConstantChange:
    """One constant before and after.

    Parameters
    ----------
    before, after, unit
        The estimates.
    interval
        95 % interval of ``after`` less ``before``, in the unit; the intervals of all constants hold together. None where one is open.
    p
        How often chance alone makes a difference as large, corrected for looking at all constants; None where nothing can be said.
    moved
        Whether it has changed at the false-alarm rate of the policy.
    smallest
        The change that would be seen in 19 of 20 cases, in the unit; None where none would.
    """

    before: float
    after: float
    unit: str
    interval: Interval | None
    p: float | None
    moved: bool
    smallest: float | None


class MachineConstant(TypedDict):
    """One constant of one machine; all are None where the records leave it open.

    Attributes
    ----------
    value, std, unit
        The estimate, and the standard deviation that the records leave.
    p
        How often a machine of this kind lies as far from the others, corrected for all looks.
    """

    value: float | None
    std: float | None
    unit: str
    p: float | None


@dataclass(frozen=True, eq=False)
class MachineReport:
    """One machine of a population: its constants, and those that fall out.

    Parameters
    ----------
    name
        The machine.
    constants
        Constant -> value, standard deviation and p-value of its distance from the other machines, corrected for all looks.
    outlying
        Constants in which it falls out.
    """

    name: str
    constants: Mapping[str, MachineConstant]
    outlying: tuple[str, ...]


@dataclass(frozen=True)
class PopulationConstant:
    """One constant over machines of a kind.

    Parameters
    ----------
    mean, interval, unit
        Of the machines that belong together, with the 95 % interval of the mean.
    spread
        Standard deviation from machine to machine, beyond what the records leave open: a share of the value where ``relative``.
    relative
        Whether the spread is one of the logarithm.
    """

    mean: float
    interval: Interval
    unit: str
    spread: float
    relative: bool


class ChartedConstant(TypedDict):
    """One constant in one record.

    Attributes
    ----------
    value, interval
        The estimate with its 95 % interval; None where the record leaves it open.
    """

    value: float
    interval: Interval | None


@dataclass(frozen=True)
class ChartedRecord:
    """One record of a course.

    Parameters
    ----------
    name
        The record.
    constants
        Constant -> value and 95 % interval (None where the record leaves it open).
    status
        How its fit ended.
    """

    name: str
    constants: Mapping[str, tuple[float, Interval | None]]
    status: str

    KEYS: ClassVar[str] = "name status constants!=charted"

    @property
    def charted(self) -> dict[str, ChartedConstant]:
        """Constant -> its estimate."""
        return {name: {"value": value, "interval": interval} for name, (value, interval) in self.constants.items()}


@dataclass(frozen=True)
class ChangePoint:
    """A jump of one constant between two records.

    Parameters
    ----------
    constant, unit
        Which one.
    record, number
        The first record after the jump, and its place, counted from 1 (the fit is 0).
    before, after
        Its mean before and after, up to the neighbouring change points.
    p
        How often chance alone makes a jump as large somewhere, corrected for all constants.
    """

    constant: str
    unit: str
    record: str
    number: int
    before: float
    after: float
    p: float


@dataclass(frozen=True, eq=False)
class ChangeDetection(Printable, StoredResult):
    """What has changed since a fit.

    Parameters
    ----------
    verdict
        The answer.
    reference
        The fit that today is compared with.
    today
        The fit of today's records, with the effect that has appeared, if one has; None for several machines and for a course.
    constants
        Of each constant its change.
    conclusion, findings
        The answer in findings, and what a reader should know.
    checks
        The decisions behind it.
    discovery
        The search for an effect, where the residual asked for one.
    machines, population
        Machines of a kind, and what they have in common.
    records, change_points
        A course over records in the order of time.
    p_value
        How often a machine without a change gives constants as far apart; None where they were not compared.
    seconds
        Time that it took.
    """

    verdict: ChangeVerdict
    reference: Fit
    today: Fit | None = None
    constants: Mapping[str, ConstantChange] = field(default_factory=dict)
    conclusion: tuple[Finding, ...] = ()
    findings: tuple[Finding, ...] = ()
    checks: tuple[Check, ...] = ()
    discovery: Discovery | None = None
    machines: Sequence[MachineReport] = ()
    population: Mapping[str, PopulationConstant] = field(default_factory=dict)
    records: Sequence[ChartedRecord] = ()
    change_points: Sequence[ChangePoint] = ()
    p_value: float | None = None
    seconds: float = 0.0

    FILE: ClassVar[FileKind] = FileKind("a change detection", "changed.json that greybox changed has written")
    KEYS: ClassVar[str] = """
        verdict model=reference.model.name constants! effects! machines! population records change_points p=p_value story
        notes=str(findings) findings=all_findings checks seconds
        """

    @property
    def story(self) -> str:
        """The answer in sentences."""
        return " ".join(map(str, self.conclusion))

    @property
    def all_findings(self) -> tuple[Finding, ...]:
        """The answer in findings, and what a reader should know."""
        return (*self.conclusion, *self.findings)

    @property
    def moved(self) -> tuple[str, ...]:
        """Constants that have changed."""
        return tuple(name for name, change in self.constants.items() if change.moved)

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Effects that have appeared, as in ``discovery.json``; none where all that was found stands in for something else."""
        return list_appeared_effects(self.discovery)


def list_appeared_effects(discovery: Discovery | None) -> list[dict[str, Any]]:
    """Effects that a search has found, without those that stand in for something else."""
    effects = [] if discovery is None else discovery.effects
    return [dict(effect) for effect in effects if effect["grade"] != Grade.STAND_IN]


def load_changes(path: str | Path) -> dict[str, Any]:
    """What ``changed.json`` holds, checked.

    Parameters
    ----------
    path
        The file that `ChangeDetection.save` or ``greybox changed`` has written.

    Returns
    -------
    dict
        ``verdict``, ``constants``, ``effects``, ``machines`` and more, as ``docs/result_files.md`` lists them.

    Raises
    ------
    DataError
        If it cannot be read, or is not such a file, with the first offence.

    Examples
    --------
    >>> gb.changes.load_changes("results/changed.json")["verdict"]  # doctest: +SKIP
    """
    return read_json(path, ChangeDetection)
