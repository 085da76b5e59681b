"""What a fit consists of: parameters with intervals, misfit, runs, noise, and what is needed to repeat it."""

from __future__ import annotations

import json
import math
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from types import NoneType
from typing import Any, ClassVar

import numpy as np
from scipy.special import ndtri

from greybox.base.findings import Finding
from greybox.base.numerics import ROWS_AT_A_TIME
from greybox.base.values import Printable, ReadOnly
from greybox.data.experiment import Experiment, Hold
from greybox.data.noise.growing import GrowingNoise
from greybox.data.noise.noise_model import BoundDirection, NoiseBound, NoiseSource


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
    """One constant: value, standard deviation and 95 % interval in ``unit``.

    ``std`` and ``interval`` are None for a fixed constant, and where the data do not determine it. ``at_bound`` marks a value that
    was stopped by its bounds.
    """

    value: float
    unit: str
    std: float | None = None
    interval: tuple[float, float] | None = None
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


@dataclass(frozen=True)
class PriorCheck:
    """What became of the prior of one constant, ``mean`` and ``std`` in its unit.

    ``shift``: how far the data took the constant from the mean, in standard deviations of the prior. ``variance_reduction``: share of
    the prior's variance that the data took away, 0 where the prior says all that is known. ``conflict``: by how many standard
    deviations the prior and the data by themselves disagree (standard normal where both are right); None where the data say nothing.
    """

    mean: float
    std: float
    shift: float
    variance_reduction: float
    conflict: float | None


@dataclass(frozen=True)
class Misfit:
    """Free-run error of one output over the records.

    ``rmse`` in ``unit``; ``best_fit_percent`` is ``100 (1 - ||y - yhat|| / ||y - mean(y)||)``; ``noise_ratio`` is rmse over the noise
    standard deviation: 1 means that only noise is left. ``samples`` went into it.
    """

    rmse: float
    unit: str
    best_fit_percent: float
    noise_ratio: float
    samples: int


@dataclass(frozen=True)
class Trace(ReadOnly):
    """One record and the model's run over it: ``time`` (N,), measured and simulated outputs by name (N,), its initial state.

    ``inputs`` by name (N,), ``hold`` how they move between samples, and ``conditions`` make it a whole
    record again, see `experiment`.
    """

    name: str
    fingerprint: str
    time: np.ndarray
    measured: Mapping[str, np.ndarray]
    simulated: Mapping[str, np.ndarray]
    initial_state: Mapping[str, float]
    inputs: Mapping[str, np.ndarray] = field(default_factory=dict)
    hold: Hold = "zero"
    conditions: Mapping[str, float] = field(default_factory=dict)
    noise: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Standard deviation of each row (N,) of the outputs whose noise the record tells row by row."""

    @property
    def experiment(self) -> Experiment:
        """The record without the model's run."""
        given = {"conditions": self.conditions, "noise": self.noise}
        return Experiment(self.name, self.time, self.inputs, self.measured, self.hold, **given)  # type: ignore[arg-type]

    def residual(self, output: str) -> np.ndarray:
        """Measured minus simulated (N,), NaN in gaps."""
        return self.measured[output] - self.simulated[output]


@dataclass(frozen=True)
class StartResult(ReadOnly):
    """Where one of several starts ended: the values it began with and those it ended with, misfit over noise, how it ended.

    ``values`` is empty and ``noise_ratio`` infinite where it led nowhere; ``status`` is then the reason.
    """

    start: Mapping[str, float]
    values: Mapping[str, float]
    noise_ratio: float
    status: str
    seconds: float = 0.0


@dataclass(frozen=True)
class Validation(ReadOnly):
    """A model on records that its parameters have not seen: free-run misfit by output, and the runs. Empty where there were none."""

    misfit: Mapping[str, Misfit] = field(default_factory=dict)
    traces: Sequence[Trace] = ()

    def __bool__(self) -> bool:
        return bool(self.misfit)


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
    """

    std: Mapping[str, float]
    sources: Mapping[str, NoiseSource] = field(default_factory=dict)
    colour: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    log_std: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    bounds: Mapping[str, NoiseBound] = field(default_factory=dict)
    growth: Mapping[str, GrowingNoise] = field(default_factory=dict)

    @property
    def given(self) -> dict[str, float | GrowingNoise]:
        """The noise of each output as a fit takes it: its level, or how it grows with the signal."""
        told = {name: replace(noise, estimated=()) for name, noise in self.growth.items() if not noise.unknown}
        return {**self.std, **told}

    def bound(self, output: str) -> NoiseBound | None:
        """What is known of the noise of an output: as it was found, or what its source says in general; None without a source."""
        source = self.sources.get(output)
        if output in self.growth and source is not None:  # of each row, and not of the rms of all rows
            return NoiseBound(self.std[output], BoundDirection.ABOUT, source)
        if output in self.bounds or source is None:
            return self.bounds.get(output)
        return NoiseBound(self.std.get(output, float("nan")), source.direction, source)

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
        How it ended, in a word (`greybox.estimation.optim.TerminationStatus`).
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
    def status_message(self) -> str:
        """How the search ended, in a sentence."""
        return str(self)


@dataclass(frozen=True)
class FitUncertainty(ReadOnly):
    """How well the free parameters are known.

    ``free`` their names and ``covariance`` (nf, nf) in that order; ``kind`` says whether it is the ``gauss_newton`` covariance (white
    residual), the ``sandwich`` that allows for a coloured one, or the ``observed_information`` of a likelihood; ``inflation`` the factor
    by which the sandwich widens each standard deviation.
    """

    free: tuple[str, ...]
    covariance: np.ndarray
    kind: IntervalKind = IntervalKind.GAUSS_NEWTON
    inflation: Mapping[str, float] = field(default_factory=dict)

    @property
    def largest_inflation(self) -> float:
        """The largest factor of those that are known: none is of a constant that the data leave open. One where no factor is known."""
        return max((factor for factor in self.inflation.values() if np.isfinite(factor)), default=1.0)


@dataclass(frozen=True)
class FitDiscretisation(ReadOnly):
    """How the model was integrated, and what that costs in accuracy.

    ``label`` method and substeps; ``error`` rms change of each output over its noise when the step is halved; ``shift`` change of each
    parameter when the step is halved, in its standard deviations.
    """

    label: str
    error: Mapping[str, float] = field(default_factory=dict)
    shift: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FitConstraints(ReadOnly):
    """What was known of the parameters besides their values.

    ``ties`` parameters that others give, by formula, and ``tied`` their values; ``per_experiment`` the values of parameters that each
    experiment has for itself, parameter -> experiment -> value (`Fit.parameters` holds their mean); ``priors`` what became of each.
    """

    ties: Mapping[str, str] = field(default_factory=dict)
    tied: Mapping[str, Estimate] = field(default_factory=dict)
    per_experiment: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)
    priors: Mapping[str, PriorCheck] = field(default_factory=dict)


@dataclass(frozen=True)
class RobustReport(ReadOnly):
    """The robust loss of a fit: its ``name`` ("" for least squares), its ``scale`` for each output over the noise, and the share of each
    output's samples that count as ``outliers``."""

    name: str = ""
    scale: Mapping[str, float] = field(default_factory=dict)
    outliers: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class PredictionReport(ReadOnly):
    """What a fit with process noise adds: the ``process_noise`` intensity on each state, in its unit over sqrt(s), the ``one_step``
    error, and the ``log_likelihood`` of the innovations. Empty for a free-run fit."""

    process_noise: Mapping[str, float] = field(default_factory=dict)
    one_step: Mapping[str, Misfit] = field(default_factory=dict)
    log_likelihood: float | None = None


@dataclass(frozen=True)
class Provenance(ReadOnly):
    """What repeats a fit: its ``options``, the model's ``equations`` and the ``versions`` of what computed it."""

    options: Mapping[str, Any] = field(default_factory=dict)
    equations: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)


# Results as JSON: readable, and without loss but for infinities and NaN, which become null.


def format_json(data: Mapping[str, Any]) -> str:
    """JSON with a line for each entry of the two outer levels: readable, and long arrays stay on one line."""
    rows = []
    for key, value in data.items():
        if isinstance(value, dict) and value:
            inner = ",\n".join(f"  {json.dumps(k)}: {json.dumps(v, allow_nan=False)}" for k, v in value.items())
            rows.append(f" {json.dumps(key)}: {{\n{inner}\n }}")
        else:
            rows.append(f" {json.dumps(key)}: {json.dumps(value, allow_nan=False)}")
    return "{\n" + ",\n".join(rows) + "\n}"


def iterate_json(data: Mapping[str, Any]) -> Iterator[str]:
    """The text of ``format_json(to_json_data(data))`` in parts, so that long arrays need not be in memory as text."""
    mark, arrays = secrets.token_hex(16), list[np.ndarray]()

    def put_aside(array: np.ndarray) -> Any:
        if array.ndim != 1 or len(array) <= ROWS_AT_A_TIME:
            return to_json_data(array.tolist())
        arrays.append(array)
        return mark

    between, *others = (format_json(to_json_data(data, put_aside)) + "\n").split(f'"{mark}"')
    yield between
    for array, text in zip(arrays, others, strict=True):
        for first in range(0, len(array), ROWS_AT_A_TIME):
            part = to_json_data(array[first : first + ROWS_AT_A_TIME].tolist())
            yield f"{', ' if first else '['}{json.dumps(part, allow_nan=False)[1:-1]}"
        yield f"]{text}"


def to_json_data(value: Any, convert_array: Callable[[np.ndarray], Any] | None = None) -> Any:
    """``value`` as JSON data: arrays become lists, dataclasses dictionaries, NaN and infinities None.

    ``convert_array``: what becomes of arrays instead.
    """
    kind = type(value)
    if kind in (str, bool, int, NoneType):  # most values: asking for abstract classes is slow
        return value
    if kind is float:
        return value if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        return convert_array(value) if convert_array else to_json_data(value.tolist())
    if isinstance(value, Mapping):
        return {str(k): to_json_data(v, convert_array) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_json_data(v, convert_array) for v in value]
    if isinstance(value, (bool, str)) or value is None:
        return value
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return to_json_data({f.name: getattr(value, f.name) for f in fields(value)}, convert_array)
