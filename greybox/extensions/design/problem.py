"""A design as two values: what it is asked (models, records already taken, what the rig allows), and what it answers, also as files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import ClassVar

import numpy as np

from greybox.base import DataError, FileKind, Finding, ModelError, nearest, write_json
from greybox.base.values import Printable, ReadOnly
from greybox.data.experiment import Experiment
from greybox.data.input_course import Hold
from greybox.data.noise.noise_model import AutoRegression, NoiseModel, NoiseSource
from greybox.data.signals import SignalLimit
from greybox.estimation.options import FitOptions
from greybox.model import Model
from greybox.show.sentences.wording import limit_text
from greybox.simulation.simulate import declared_initial_state, write_csv

# What a design and a campaign have to say beside their numbers.


class DesignCode(StrEnum):
    """Codes of the findings of a design."""

    CONSTANT_NOT_DETERMINED = "design_constant_not_determined"
    WOULD_NOT_DECIDE = "design_would_not_decide"
    NO_EARLIER_RECORD = "design_no_earlier_record"
    LIMIT_RULES = "design_limit_rules"
    RANGE_FROM_RECORDS = "design_range_from_records"
    MODEL_FALLS_SHORT = "design_model_falls_short"


class CampaignCode(StrEnum):
    """How a campaign stands."""

    MEASURE = "campaign_measure"
    ONE_LEFT = "campaign_one_left"
    BUDGET_SPENT = "campaign_budget_spent"
    LIMIT_BROKEN = "campaign_limit_broken"


# The numbers that steer the design of an experiment.


@dataclass(frozen=True)
class DesignPolicy:
    """The numbers behind a design.

    Parameters
    ----------
    soft_start
        Share of the duration in which an input rises from rest at the start, and falls back at the end: a step into a plant at rest
        excites every resonance, and a rig wants to end where it began.
    rest_share
        Share of the duration at the end in which the input is at rest: the plant settles, and the noise shows.
    least_rows
        Rows below which there is nothing to design.
    scenarios
        Constants drawn from what is known of them, beside the best ones: each must keep the limits.
    bands
        Upper ends of the band of sweeps and multisines that are tried, evenly on a logarithmic scale.
    crest_iterations
        Steps in which the phases of a multisine are improved.
    starts
        Inputs, the best of their kinds, that are refined: each ends at a best input of its own, by up to a factor of two apart.
    rounds
        Rounds of the refinement, one where only the ranges of the inputs are limited.
    iterations
        Most iterations of L-BFGS-B in a round.
    refined_scenarios
        Drawn constants that the refinement looks at beside the best ones: with two it made inputs for these two.
    """

    soft_start: float = 0.04
    rest_share: float = 0.02
    least_rows: int = 40
    scenarios: int = 4
    bands: int = 4
    crest_iterations: int = 400
    starts: int = 6
    rounds: int = 4
    iterations: int = 120
    refined_scenarios: int = 4


DESIGN_POLICY = DesignPolicy()


@dataclass(frozen=True)
class CampaignPolicy:
    """How a campaign goes on and when it ends.

    Parameters
    ----------
    experiments
        Records that may be taken.
    contradiction
        Misfit over noise from which the best explanation is contradicted: what it predicts far from where the rig has been says
        little.
    rig_timeout
        Seconds after which a rig program that has not ended is stopped, beyond the duration of the record.
    """

    experiments: int = 3
    contradiction: float = 3.0
    rig_timeout: float = 600.0


CAMPAIGN_POLICY = CampaignPolicy()


class GoalName(StrEnum):
    """What a record is to bring."""

    PRECISION = "precision"
    """Narrow intervals of the constants."""
    DISCRIMINATION = "discrimination"
    """Which of several explanations is right."""
    DETECTION = "detection"
    """Effects that may still hide."""


class CriterionName(StrEnum):
    """What of the covariance is made small, for precision."""

    D = "D"
    """The volume of the confidence region."""
    A = "A"
    """The mean variance."""
    E = "E"
    """The variance of the worst combination."""


# Rows of a designed record: its runs must fit into the memory several times.
DESIGN_MOST_ROWS = 200000


@dataclass(frozen=True)
class DesignProblem(ReadOnly):
    """The question of a design, read-only throughout.

    Parameters
    ----------
    models
        The explanations in the running, each with its fitted values; the first is the best one.
    limits
        Signal (input, output or state) -> what the rig allows. Every input that is to move needs a range.
    duration, sampling_time
        Of the record, in seconds.
    noise
        Standard deviation of each sensor that is installed, by output.
    earlier
        Records that were taken already: their information is added.
    goal, criterion
        What the record is to bring.
    constants
        For precision: those whose intervals count; all free ones where empty.
    effects
        For detection: names of the effects that may hide.
    sensors
        Standard deviation of sensors that could be added, by output of the model.
    stds
        Constant -> its standard deviation, as a fit to the earlier records found it.
    shares
        Signal -> share of the way from rest to its limit that this record may use; all of it where left out.
    hold
        What the generator does between samples.
    options
        How records are fitted, for instance ``at_rest``.
    policy
        The decision numbers.

    Raises
    ------
    DataError, ModelError
        For a question that cannot be answered, with what is missing.
    """

    models: tuple[Model, ...]
    limits: Mapping[str, SignalLimit]
    duration: float
    sampling_time: float
    noise: Mapping[str, float]
    earlier: tuple[Experiment, ...] = ()
    goal: GoalName = GoalName.PRECISION
    criterion: CriterionName = CriterionName.D
    constants: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()
    sensors: Mapping[str, float] = field(default_factory=dict)
    stds: Mapping[str, float] = field(default_factory=dict)
    shares: Mapping[str, float] = field(default_factory=dict)
    hold: Hold = "zero"
    options: FitOptions = field(default_factory=FitOptions)
    policy: DesignPolicy = DESIGN_POLICY

    def __post_init__(self) -> None:
        model, policy = self.model, self.policy
        inputs, outputs = [i.name for i in model.inputs], [o.name for o in model.outputs]
        states = [s.name for s in model.all_states]
        if not inputs:
            raise ModelError(f"{model.title}: the model has no input; there is nothing to design")
        for name in self.limits:
            if name not in (*inputs, *outputs, *states):
                raise ModelError(
                    f"limit of {name!r}: no such signal in {model.title}; {nearest(name, [*inputs, *outputs, *states])}"
                )
            if name not in inputs and math.isfinite(self.limits[name].rate):
                raise ModelError(
                    f"rate of {name!r}: only an input has a rate that can be kept; give --limit {name}=LOW:HIGH"
                )
        for name in inputs:
            limit = self.limits.get(name, SignalLimit())
            if not (math.isfinite(limit.low) and math.isfinite(limit.high)):
                raise DataError(f"input {name!r} has no limits; give both, as in --limit {name}=-1:1")
        if not self.driven:
            raise DataError("no input may move: each limit has one value only; give one input a range")
        if not (self.sampling_time > 0 and math.isfinite(self.duration)):
            raise DataError(
                "a design needs a duration and a sampling time, both above 0 seconds; give them, as in --duration 1 --sampling-time 1e-3"
            )
        if not policy.least_rows <= self.rows <= DESIGN_MOST_ROWS:
            raise DataError(
                f"{self.duration:g} s every {self.sampling_time:g} s are {self.rows} rows; give"
                f" {policy.least_rows} to {DESIGN_MOST_ROWS}"
            )
        for group, what in ((self.noise, "noise"), (self.sensors, "sensor")):
            for name, std in group.items():
                if name not in outputs:
                    raise ModelError(f"{what} of {name!r}: {model.title} has no such output; {nearest(name, outputs)}")
                if not (math.isfinite(std) and std > 0):
                    raise DataError(f"{what} of {name!r}: {std:g} is no standard deviation; give a number above 0")
        if not self.noise:
            raise DataError(
                f"the noise of no output is known; give the standard deviation of each sensor, as in --noise {outputs[0]}=1e-3"
            )
        if not any(not q.fixed for q in model.all_parameters):
            raise ModelError(f"{model.title}: every constant is fixed; free what is to be determined")
        free = [q.name for q in model.free_parameters]
        for name in self.constants:
            if name not in free:
                raise ModelError(f"constant {name!r}: not among the free ones of {model.title}; {nearest(name, free)}")
        if self.goal is GoalName.DISCRIMINATION and len(self.models) < 2:
            raise DataError(
                "discrimination needs two explanations or more; name rivals, as in --rival coulomb_friction"
            )
        for other in self.models[1:]:
            if [i.name for i in other.inputs] != inputs or [o.name for o in other.outputs] != outputs:
                raise ModelError(
                    f"{other.title} has other inputs or outputs than {model.title}; rivals describe one rig"
                )
        # Every record begins where the plant rests: a limit that leaves it out is broken before anything moves.
        start = dict(zip(states, declared_initial_state(model), strict=True))
        for name, limit in self.limits.items():
            if name in start and not limit.low <= start[name] <= limit.high:
                raise DataError(
                    f"limit of {name!r}: the plant starts at {start[name]:g}, outside {limit_text(limit.low, limit.high, digits=6)};"
                    " no input keeps it"
                )
        super().__post_init__()

    @property
    def model(self) -> Model:
        """The best explanation."""
        return self.models[0]

    @property
    def rows(self) -> int:
        """Samples of the record."""
        return round(self.duration / self.sampling_time)

    @property
    def time(self) -> np.ndarray:
        """Times (N,) of the record."""
        return self.sampling_time * np.arange(self.rows)

    @property
    def driven(self) -> tuple[str, ...]:
        """The inputs that may move."""
        return tuple(i.name for i in self.model.inputs if self.limits[i.name].low < self.limits[i.name].high)

    def share(self, name: str) -> float:
        """Share of the way to the limit of a signal that may be used."""
        return self.shares.get(name, 1.0)

    def rest(self, name: str) -> float:
        """Where an input is at rest: zero, or the end of its range next to it."""
        limit = self.limits[name]
        return min(max(0.0, limit.low), limit.high)

    def span(self, name: str) -> tuple[float, float, float]:
        """The range of an input as its middle, its half width, and where it is at rest."""
        limit = self.limits[name]
        return (limit.low + limit.high) / 2, (limit.high - limit.low) / 2, self.rest(name)

    def noise_model(self, more: Mapping[str, float] | None = None) -> NoiseModel:
        """White noise of the sensors, and of ``more`` of them."""
        std = {**self.noise, **(more or {})}
        names = tuple(o.name for o in self.model.outputs)
        # NaN: no sensor, hence no row that counts.
        levels = np.array([std.get(name, np.nan) for name in names])
        sources = dict.fromkeys(std, NoiseSource.GIVEN)
        # White: what a coloured residual adds comes in by ``stds``, afterwards.
        return NoiseModel(names, levels, sources, tuple(AutoRegression() for _ in names), True)


def range_of_inputs(model: Model, earlier: Sequence[Experiment]) -> dict[str, SignalLimit]:
    """The range of each input over the records that were taken: what the rig is known to stand."""
    ranges = {}
    for i in model.inputs:
        values = [e.inputs[i.name] for e in earlier if i.name in e.inputs]
        if values:
            ranges[i.name] = SignalLimit(
                min(float(v.min()) for v in values), max(float(v.max()) for v in values), math.inf
            )
    return ranges


# The answer.


@dataclass(frozen=True)
class LimitPrediction:
    """One limit and what is predicted: the range over every explanation and every draw of its constants, with its margin.

    Parameters
    ----------
    low, high, unit
        The limit.
    predicted_low, predicted_high
        The predicted range.
    rate, predicted_rate
        Of an input: the largest change in a second that is allowed, and that occurs.
    usage
        Share of the way from rest to the limit that is used; above one it is broken.
    """

    low: float
    high: float
    unit: str
    predicted_low: float
    predicted_high: float
    rate: float
    predicted_rate: float
    usage: float


INPUT_FILE = "input.csv"
"""The record to drive the rig with."""


@dataclass(frozen=True)
class PredictedConstant:
    """What the record should make of one constant.

    Parameters
    ----------
    value, unit
        The present value.
    std_before, std_after
        Standard deviation from the earlier records, and with this one; None where the constant is not determined.
    """

    value: float
    std_before: float | None
    std_after: float | None
    unit: str


@dataclass(frozen=True)
class PredictedDetection:
    """The smallest amount of an effect that would be seen.

    Parameters
    ----------
    parameter, unit
        The amplitude of the effect.
    before, after
        From the earlier records, and with this one; None where no amount would show.
    """

    parameter: str
    before: float | None
    after: float | None
    unit: str


class AlternativeKind(StrEnum):
    """What could be done instead of, or beside, the designed record."""

    INPUT = "input"
    REPEAT = "repeat"
    LONGER = "longer"
    SAMPLE_FASTER = "sample_faster"
    SENSOR = "sensor"


@dataclass(frozen=True)
class Alternative:
    """Another way, on the same scale.

    Parameters
    ----------
    kind, name
        What it is: a kind of input, two records, twice the duration, half the sampling time, or a sensor more.
    gain
        Factor on what the designed record brings: on one over the width of intervals, on distances between rivals, or on one over the
        smallest amount. Above one it brings more.
    """

    kind: AlternativeKind
    name: str
    gain: float


@dataclass(frozen=True, eq=False)
class Design(Printable):
    """The next record, and what it should bring.

    Parameters
    ----------
    goal, criterion
        What was asked.
    models
        The explanations in the running, the best one first.
    experiment
        The input, a record without outputs.
    kind
        What the input is called.
    predicted
        For every free constant of the best explanation its standard deviation before and after.
    separation
        For each pair of explanations the cost by which the wrong one would lose, after a refit.
    detection
        For each effect that may hide the smallest amount that would be seen.
    limits
        For each limited signal what is predicted.
    alternatives
        Other inputs, repetition, duration, sampling time and sensors on the same scale.
    findings
        What to know before the record is taken.
    policy
        The decision numbers.
    seconds
        Time that it took.
    """

    goal: GoalName
    criterion: CriterionName
    models: tuple[Model, ...]
    experiment: Experiment
    kind: str
    predicted: Mapping[str, PredictedConstant]
    separation: Mapping[str, float]
    detection: Mapping[str, PredictedDetection]
    limits: Mapping[str, LimitPrediction]
    alternatives: tuple[Alternative, ...]
    findings: tuple[Finding, ...] = ()
    policy: DesignPolicy = field(default_factory=DesignPolicy)
    seconds: float = 0.0

    FILE: ClassVar[FileKind] = FileKind("a design", "design.json that greybox design has written")
    KEYS: ClassVar[str] = """
        goal criterion models=titles input!=input_file kind rows=experiment.rows sampling_time=experiment.sampling_time
        hold=experiment.hold predicted separation detection limits alternatives findings notes=str(findings) policy seconds
        """

    @property
    def titles(self) -> tuple[str, ...]:
        """The explanations in the running, the best one first."""
        return tuple(model.title for model in self.models)

    @property
    def input_file(self) -> str:
        """The file with the input, beside this one."""
        return INPUT_FILE

    @property
    def model(self) -> Model:
        """The best explanation."""
        return self.models[0]

    def save(self, folder: str | Path) -> Path:
        """Write ``design.json`` and ``input.csv`` into a folder.

        Parameters
        ----------
        folder
            Where to; it is made.

        Returns
        -------
        Path
            ``design.json``.
        """
        write_csv(self.experiment, self.model, Path(folder) / self.input_file)
        return write_json(Path(folder) / "design.json", self)
