"""What change detection gives back, as a value and as ``changed.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from greybox.base.files import write_file
from greybox.base.findings import Check, Finding
from greybox.base.json_file import ResultKind, read_json
from greybox.base.json_shape import format_json, to_json_data
from greybox.base.values import Printable
from greybox.discovery.certainty import Grade
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


FORMAT = 1
"""Version of ``changed.json``."""


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
    interval: tuple[float, float] | None
    p: float | None
    moved: bool
    smallest: float | None


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
    constants: Mapping[str, Mapping[str, Any]]
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
    interval: tuple[float, float]
    unit: str
    spread: float
    relative: bool


@dataclass(frozen=True)
class ChartedRecord:
    """One record of a course: constant -> value and 95 % interval (None where the record leaves it open)."""

    name: str
    constants: Mapping[str, tuple[float, tuple[float, float] | None]]
    status: str


@dataclass(frozen=True)
class ChangePoint:
    """A jump of one constant between two records.

    Parameters
    ----------
    constant, unit
        Which one.
    record
        The first record after the jump, and ``number`` its place, counted from 1 (the fit is 0).
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
class ChangeDetection(Printable):
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

    @property
    def moved(self) -> tuple[str, ...]:
        """Constants that have changed."""
        return tuple(name for name, change in self.constants.items() if change.moved)

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Effects that have appeared, as in ``discovery.json``; none where all that was found stands in for something else."""
        return list_appeared_effects(self.discovery)

    def save(self, path: str | Path) -> Path:
        """Write ``changed.json``.

        Parameters
        ----------
        path
            Where to; folders are made.

        Returns
        -------
        Path
            The file that was written.
        """
        return write_file(path, format_json(to_json_data(change_data(self))) + "\n")


def list_appeared_effects(discovery: Discovery | None) -> list[dict[str, Any]]:
    """Effects that a search has found, without those that stand in for something else."""
    effects = [] if discovery is None else discovery.effects
    return [effect for effect in effects if effect["grade"] != Grade.STAND_IN]


def change_data(change: ChangeDetection) -> dict[str, Any]:
    """A change detection under the keys of ``changed.json``."""
    return {
        "format": FORMAT,
        "verdict": change.verdict,
        "model": change.reference.model.name,
        "constants": change.constants,
        "effects": change.effects,
        "machines": change.machines,
        "population": change.population,
        "records": [
            {
                "name": r.name,
                "status": r.status,
                "constants": {
                    name: {"value": value, "interval": interval} for name, (value, interval) in r.constants.items()
                },
            }
            for r in change.records
        ],
        "change_points": change.change_points,
        "p": change.p_value,
        "story": " ".join(map(str, change.conclusion)),
        "notes": list(map(str, change.findings)),
        "findings": (*change.conclusion, *change.findings),
        "checks": change.checks,
        "seconds": change.seconds,
    }


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
    >>> gb.change_detection.load_changes("results/changed.json")["verdict"]  # doctest: +SKIP
    """
    return read_json(path, ResultKind.CHANGE)
