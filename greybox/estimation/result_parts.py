"""What a fit consists of: parameters with intervals, misfit, runs, noise, and what is needed to repeat it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from importlib.util import find_spec
from typing import Any, ClassVar

import numpy as np
from scipy.special import ndtri

from greybox.base import Finding
from greybox.base.frames import make_frame
from greybox.base.json_shape import Finite, FiniteArray, Interval, Matrix, Unbounded
from greybox.base.values import Printable, ReadOnly
from greybox.data.experiment import Experiment
from greybox.data.input_course import Holds
from greybox.data.noise import BoundDirection, GrowingNoise, NoiseBound, NoiseSource


class IntervalKind(StrEnum):
    """Which covariance stands behind the intervals of a fit."""

    GAUSS_NEWTON = "gauss_newton"
    """Curvature of the cost, for a white residual."""

    SANDWICH = "sandwich"
    """Allows for a coloured residual."""

    OBSERVED_INFORMATION = "observed_information"
    """Curvature of the likelihood of a model with process noise."""

    EXPECTED_INFORMATION = "expected_information"
    """The same where the observed one is not positive definite."""


@dataclass(frozen=True)
class Estimate:
    """One constant.

    Attributes
    ----------
    value, unit
        The estimate and its unit.
    std, interval
        Standard deviation and 95 % interval; None for a fixed constant, and where the data do not determine it. Of a constant at its bound
        the interval goes from there to the limit that the data set, and there is no deviation. Where the likelihood is no parabola
        (`greybox.estimation.exchange`) the deviation stands for the interval.
    fixed
        Not fitted.
    at_bound
        The value was stopped by its bounds.
    """

    value: Finite
    unit: str
    std: float | None = None
    interval: Interval | None = None
    fixed: bool = False
    at_bound: bool = False

    WIDE: ClassVar[float] = 0.5
    """An interval that reaches further than this share of the value determines nothing."""

    @property
    def determined(self) -> bool:
        """Whether it is known, or its 95 % interval stays within 50 % of the value."""
        if self.interval is None:
            return self.fixed
        low, high = self.interval
        return max(high - self.value, self.value - low) <= self.WIDE * abs(self.value)


class Estimates(Mapping[str, Estimate]):
    """Parameters by name, read-only.

    Parameters
    ----------
    values
        Name -> estimate.
    """

    def __init__(self, values: Mapping[str, Estimate]) -> None:
        self._values = dict(values)

    def __getitem__(self, name: str) -> Estimate:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return repr(self._values)

    def to_frame(self) -> Any:
        """A pandas data frame with a row for each parameter: value, standard deviation, 95 % interval, unit, and how it is known.

        Raises ModuleNotFoundError without pandas (``pip install 'greybox-sysid[frames]'``).
        """
        intervals = [e.interval or (None, None) for e in self.values()]
        columns: dict[str, Any] = {
            "value": np.array([e.value for e in self.values()], float),
            "std": np.array([e.std for e in self.values()], float),
            "low": np.array([low for low, _ in intervals], float),
            "high": np.array([high for _, high in intervals], float),
        }
        columns |= {n: [getattr(e, n) for e in self.values()] for n in ("unit", "fixed", "at_bound", "determined")}
        return make_frame("parameter", list(self), columns)

    def _repr_html_(self) -> str | None:
        """What a notebook shows; the plain text where there is no pandas."""
        return None if find_spec("pandas") is None else str(self.to_frame()._repr_html_())


@dataclass(frozen=True)
class PriorCheck:
    """What became of the prior of one constant.

    Attributes
    ----------
    mean, std
        The prior, in the unit of the constant.
    shift
        How far the data took the constant from the mean, in standard deviations of the prior.
    variance_reduction
        Share of the prior's variance that the data took away, 0 where the prior says all that is known.
    conflict
        By how many standard deviations the prior and the data by themselves disagree (standard normal where both are right); None
        where the data say nothing.
    factor, factor_std
        What the data by themselves say over the mean of the prior, and its standard deviation; None where they say nothing, or where
        the prior's mean is zero.
    """

    mean: Finite
    std: Finite
    shift: float
    variance_reduction: Finite
    conflict: float | None
    factor: float | None = None
    factor_std: float | None = None

    KEYS: ClassVar[str] = "mean std moved=shift learnt=variance_reduction conflict factor? factor_std?"


@dataclass(frozen=True)
class Misfit:
    """Free-run error of one output over the records, and over its noise. `greybox.estimation.errors` makes it; everything else prints it.

    Attributes
    ----------
    rmse, unit
        Root mean square of the error, and the unit of the output.
    best_fit_percent
        ``100 (1 - ||y - yhat|| / ||y - mean(y)||)``, without the outliers of a robust fit.
    noise_ratio
        ``error`` over ``noise``: 1 means that only noise is left.
    samples
        How many went into it.
    noise
        The standard deviation that the error is divided by; None of a file that does not hold it. Where it differs from row to row, each
        row is divided by its own, and this is the error over that ratio.
    source
        Where that noise is known from.
    direction
        Whether the noise is about as large, at most or at least: then the error is at least, or at most, so many times the noise.
    without_outliers
        Whether the samples that a robust loss takes for outliers are left out of ``error``.
    """

    rmse: float
    unit: str
    best_fit_percent: float
    noise_ratio: float
    samples: int
    noise: float | None = None
    source: NoiseSource | None = None
    direction: BoundDirection | None = None
    without_outliers: bool = False

    KEYS: ClassVar[str] = (
        "rmse unit best_fit_percent noise_ratio samples error? noise? source? direction? without_outliers?"
    )

    @property
    def error(self) -> float | None:
        """What is held against the noise: ``rmse``, without the outliers of a robust fit; None where the noise is not held."""
        return None if self.noise is None else self.noise_ratio * self.noise

    def over(self, noise: FitNoise, output: str) -> Misfit:
        """The same error over the noise of ``output`` as a fit knows it."""
        bound = noise.level(output)
        if bound is None:
            return self
        known = replace(self, source=bound.source, direction=bound.direction)
        if output in noise.growth or not bound.level > 0 or not self.error:  # each row over its own
            return known
        return replace(known, noise_ratio=self.error / bound.level, noise=bound.level)


@dataclass(frozen=True)
class Trace(ReadOnly):
    """One record and the model's run over it; `experiment` is the record again.

    Attributes
    ----------
    name, fingerprint
        The record, and 16 hex digits of the SHA-256 of its data.
    time
        Seconds (N,), increasing.
    measured, simulated
        Outputs by name (N,).
    initial_state
        Where the run began, by state.
    inputs, hold
        Inputs by name (N,), and how they move between samples.
    conditions
        What stayed the same while it was taken.
    noise
        Standard deviation of each row (N,), of the outputs whose noise the record tells row by row.
    before, before_ages
        Inputs by name (K,) before the first row, and how long before it (K,) in s.
    """

    name: str
    fingerprint: str
    time: FiniteArray
    measured: Mapping[str, np.ndarray]
    simulated: Mapping[str, np.ndarray]
    initial_state: Mapping[str, Finite]
    inputs: Mapping[str, np.ndarray] = field(default_factory=dict)
    hold: Holds = "zero"
    conditions: Mapping[str, Finite] = field(default_factory=dict)
    noise: Mapping[str, np.ndarray] = field(default_factory=dict)
    before: Mapping[str, np.ndarray] = field(default_factory=dict)
    before_ages: np.ndarray = field(default_factory=lambda: np.zeros(0))

    KEYS: ClassVar[str] = (
        "name fingerprint time measured simulated initial_state inputs hold conditions noise? before? before_ages?"
    )

    @property
    def experiment(self) -> Experiment:
        """The record without the model's run."""
        return Experiment(
            self.name,
            self.time,
            self.inputs,
            self.measured,
            self.hold,
            conditions=self.conditions,
            noise=self.noise,
            before=self.before,
            before_ages=self.before_ages,
        )

    def residual(self, output: str) -> np.ndarray:
        """Measured minus simulated (N,), NaN in gaps."""
        return self.measured[output] - self.simulated[output]


@dataclass(frozen=True)
class StartResult(ReadOnly):
    """Where one of several starts ended.

    Attributes
    ----------
    start, values
        By name what it began with, and what it ended with: nothing where it led nowhere.
    noise_ratio
        Misfit over noise, infinite where it led nowhere.
    status
        How it ended; the reason where it led nowhere.
    seconds
        Time it took.
    """

    start: Mapping[str, Finite]
    values: Mapping[str, Finite]
    noise_ratio: Unbounded
    status: str
    seconds: Finite = 0.0


@dataclass(frozen=True)
class Validation(ReadOnly):
    """A model on records that its parameters have not seen. Empty where there were none.

    Attributes
    ----------
    misfit
        On the validation records, by output.
    traces
        The validation records with the model's runs over them.
    """

    misfit: Mapping[str, Misfit] = field(default_factory=dict)
    traces: Sequence[Trace] = ()

    def __bool__(self) -> bool:
        return bool(self.misfit)

    def over(self, noise: FitNoise) -> Validation:
        """The same runs, their errors over the noise as the fit knows it."""
        return replace(self, misfit={name: m.over(noise, name) for name, m in self.misfit.items()})

    @property
    def noise_ratio(self) -> float:
        """Rms error over noise, all outputs together."""
        return float(np.sqrt(np.mean([m.noise_ratio**2 for m in self.misfit.values()])))


@dataclass(frozen=True)
class FitNoise(Printable, ReadOnly):
    """Measurement noise that a fit weighed its outputs with; ``str`` says in one line where it is known from.

    Attributes
    ----------
    std
        Standard deviation of each output in its unit.
    sources
        Where each is known from.
    colour
        Reflection coefficients of each output's autoregression (none: white, or not known).
    log_std
        Standard deviation of the logarithm of each level that a likelihood estimated.
    units
        Unit of each of these.
    bounds
        What is known of each level: about as large, at most or at least, and for how long it remembers.
    growth
        How the noise grows with the signal, of the outputs of which this is so; ``std`` is then its rms over the records.
    named
        The name of the level that an output has, in common with all others that have it.
    """

    std: Mapping[str, float]
    sources: Mapping[str, NoiseSource] = field(default_factory=dict)
    colour: Mapping[str, tuple[Finite, ...]] = field(default_factory=dict)
    log_std: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    bounds: Mapping[str, NoiseBound] = field(default_factory=dict)
    growth: Mapping[str, GrowingNoise] = field(default_factory=dict)
    named: Mapping[str, str] = field(default_factory=dict)

    @property
    def given(self) -> dict[str, float | GrowingNoise]:
        """The noise of each output as a fit takes it: its level, or how it grows with the signal."""
        growing = {name: replace(noise, estimated=()) for name, noise in self.growth.items() if not noise.unknown}
        return {**self.std, **growing}

    def bound(self, output: str) -> NoiseBound | None:
        """What is known of the noise of an output: as it was found, or what its source says in general; None without a source."""
        source = self.sources.get(output)
        if output in self.growth and source is not None:  # of each row, and not of the rms of all rows
            return NoiseBound(self.std[output], BoundDirection.ABOUT, source)
        if output in self.bounds or source is None:
            return self.bounds.get(output)
        return NoiseBound(self.std.get(output, float("nan")), source.direction, source)

    def level(self, output: str) -> NoiseBound | None:
        """What an error of an output is held against: the level that it was weighed with, or the ceiling where only that is known."""
        bound = self.bound(output)
        if bound is None or bound.direction is BoundDirection.AT_MOST:
            return bound
        return replace(bound, level=self.std.get(output, bound.level))

    @property
    def levels(self) -> dict[str, float]:
        """Standard deviation of each output whose noise is known; one that is only bounded is not among them."""
        bounds = {name: self.bound(name) for name in self.std}
        return {name: self.std[name] for name, b in bounds.items() if b is not None and b.floor is not None}

    def interval(self, output: str) -> tuple[float, float]:
        """The 95 % interval of a level that a likelihood estimated, by a factor either way."""
        factor = float(np.exp(min(ndtri(0.975) * self.log_std[output], 700.0)))
        return self.std[output] / factor, self.std[output] * factor

    @property
    def source(self) -> str:
        """Where the noise is known from, in one line."""
        return str(self)


@dataclass(frozen=True)
class SolverReport(Printable, ReadOnly):
    """How the search ended.

    Attributes
    ----------
    status
        How it ended, in a word (`greybox.estimation.optim.minimisation.TerminationStatus`).
    success
        Whether the parameters can be used.
    cost
        Sum of squared residuals over the noise at the end; minus twice the logarithm of the likelihood for a model with process noise.
    statistics
        Iterations, passes, seconds, the transcription, the method.
    strategy
        How the search went, and why so.
    details
        Why a run broke off, or the largest misfit over noise.
    """

    status: str
    success: bool
    cost: float
    statistics: Mapping[str, Any] = field(default_factory=dict)
    strategy: Finding | None = None
    details: tuple[Finding, ...] = ()

    @property
    def figures(self) -> Mapping[str, Any]:
        """Iterations, passes, seconds, the transcription, and how the search went in a sentence."""
        return {**self.statistics, "strategy": "" if self.strategy is None else str(self.strategy)}

    @property
    def status_message(self) -> str:
        """How the search ended, in a sentence."""
        return str(self)


@dataclass(frozen=True)
class FitUncertainty(ReadOnly):
    """How well the free parameters are known.

    Attributes
    ----------
    free
        Their names.
    covariance
        Of these (nf, nf), in that order.
    kind
        Whether it is the ``gauss_newton`` covariance (white residual), the ``sandwich`` that allows for a coloured one, or the
        ``observed_information`` of a likelihood.
    inflation
        The factor by which the sandwich widens each standard deviation, by name.
    reach
        Standard deviations from a value to either end of its 95 % interval: 1.96, and more where few independent readings tell the
        noise (Student's distribution). None in files of before.
    """

    free: tuple[str, ...]
    covariance: Matrix
    kind: IntervalKind = IntervalKind.GAUSS_NEWTON
    inflation: Mapping[str, float] = field(default_factory=dict)
    reach: float | None = None

    @property
    def largest_inflation(self) -> float:
        """The largest factor of those that are known: none is of a constant that the data leave open. One where no factor is known."""
        return max((factor for factor in self.inflation.values() if np.isfinite(factor)), default=1.0)


@dataclass(frozen=True)
class FitDiscretisation(ReadOnly):
    """How the model was integrated, and what that costs in accuracy.

    Attributes
    ----------
    label
        Method and substeps.
    error
        Rms change of each output over its noise when the step is halved.
    shift
        Change of each parameter when the step is halved, in its standard deviations.
    """

    label: str
    error: Mapping[str, float] = field(default_factory=dict)
    shift: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FitConstraints(ReadOnly):
    """What was known of the parameters besides their values.

    Attributes
    ----------
    ties, tied
        Parameters that others give: their formulas, and their values.
    per_experiment
        The values of parameters that each experiment has for itself, parameter -> experiment -> value (`Fit.parameters` holds their
        mean).
    priors
        What became of each, by parameter.
    """

    ties: Mapping[str, str] = field(default_factory=dict)
    tied: Mapping[str, Estimate] = field(default_factory=dict)
    per_experiment: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)
    priors: Mapping[str, PriorCheck] = field(default_factory=dict)


@dataclass(frozen=True)
class RobustReport(ReadOnly):
    """The robust loss of a fit.

    Attributes
    ----------
    name
        Which one; empty for least squares.
    scale
        Of each output over its noise.
    outliers
        Share of each output's samples that count as such.
    """

    name: str = ""
    scale: Mapping[str, float] = field(default_factory=dict)
    outliers: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class PredictionReport(ReadOnly):
    """What a fit with process noise adds. Empty for a free-run fit.

    Attributes
    ----------
    process_noise
        Intensity on each state, in its unit over sqrt(s).
    one_step
        Error one sample ahead, by output.
    log_likelihood
        Of the innovations.
    """

    process_noise: Mapping[str, float] = field(default_factory=dict)
    one_step: Mapping[str, Misfit] = field(default_factory=dict)
    log_likelihood: float | None = None


@dataclass(frozen=True)
class Provenance(ReadOnly):
    """What repeats a fit.

    Attributes
    ----------
    options
        Options of the estimation, by name.
    equations
        Those of the model.
    declared
        What else its model stated (`greybox.model.equations.declare`): constants with units and bounds, starts of states, the plant.
    versions
        Program -> version of what computed it.
    start
        Values that the free constants began with.
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    equations: str = ""
    declared: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    start: Mapping[str, Finite] = field(default_factory=dict)

    @property
    def stored_options(self) -> Mapping[str, Any]:
        """Options of the estimation, under the names that they have in a file."""
        return {_OPTION_KEYS.get(name, name): value for name, value in self.options.items()}


# Names of options whose key in a file is older.
_OPTION_KEYS = {"per_experiment": "own"}


def restore_options(stored: Mapping[str, Any]) -> dict[str, Any]:
    """The options of a fit from those of its file."""
    names = {key: name for name, key in _OPTION_KEYS.items()}
    return {names.get(key, key): value for key, value in stored.items()}
