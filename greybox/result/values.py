"""What a fit gives back: constants with intervals, misfit, and what is needed to repeat it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from greybox.experiment import Experiment
from greybox.experiment.experiment import Hold
from greybox.model import Model
from greybox.values import ReadOnly

# An interval that reaches further than this share of the value determines nothing.
WIDE = 0.5


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

    @property
    def determined(self) -> bool:
        """Whether it is known, or its 95 % interval stays within 50 % of the value."""
        if self.interval is None:
            return self.fixed
        low, high = self.interval
        return max(high - self.value, self.value - low) <= WIDE * abs(self.value)


@dataclass(frozen=True)
class PriorCheck:
    """What became of the prior of one constant, ``mean`` and ``std`` in its unit.

    ``moved``: how far the data took the constant from the mean, in standard deviations of the prior. ``learnt``: share of the prior's
    variance that the data took away, 0 where the prior says all that is known. ``conflict``: by how many standard deviations the
    prior and the data by themselves disagree (standard normal where both are right); None where the data say nothing.
    """

    mean: float
    std: float
    moved: float
    learnt: float
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

    @property
    def experiment(self) -> Experiment:
        """The record without the model's run."""
        return Experiment(self.name, self.time, self.inputs, self.measured, self.hold, conditions=self.conditions)

    def residual(self, output: str) -> np.ndarray:
        """Measured minus simulated (N,), NaN in gaps."""
        return self.measured[output] - self.simulated[output]


@dataclass(frozen=True)
class End(ReadOnly):
    """Where one of several starts ended: the values it began with and those it ended with, misfit over noise, how it ended.

    ``values`` is empty and ``noise_ratio`` infinite where it led nowhere; ``status`` is then the reason.
    """

    start: Mapping[str, float]
    values: Mapping[str, float]
    noise_ratio: float
    status: str
    seconds: float = 0.0


@dataclass(frozen=True)
class Fit(ReadOnly):
    """A fitted model, read-only throughout.

    ``model`` carries the fitted values; ``parameters`` name -> `Estimate`; ``status`` and ``meaning`` how it ended, in a word and in
    plain words; ``covariance`` (nf, nf) of the free constants in the order of ``free``; ``interval_kind``
    says whether it is the ``gauss_newton`` covariance (white residual) or the ``sandwich`` that allows for a coloured one, and
    ``inflation`` by which factor that widens each standard deviation; ``noise`` standard deviation of each output, ``noise_sources``
    where each comes from (``noise_source`` in one line), ``noise_colour`` the reflection coefficients of its autoregression (none:
    white, or not known); ``integration_error`` rms change of each output when the step is halved, over the noise;
    ``discretisation_shift`` change of each constant when the step is halved, in its standard deviations; ``validation`` misfit
    on records not used for the fit; ``tied`` the constants that others give (``ties``: by which formula); ``own`` the values of constants
    that each experiment has for itself, constant -> experiment -> value (in ``parameters`` stands their mean); ``priors`` what became of
    each prior; ``loss`` the robust loss, "" for least squares, with the ``loss_scale`` of each output over its noise and the share of
    its samples that count as ``outliers``; ``ends`` where each of several starts ended, best first
    (`greybox.multistart`); ``notes`` what a reader should know before trusting a number; ``solver`` statistics;
    for a model with process noise ``process_noise`` the intensity on each state, in its unit over sqrt(s), ``prediction`` the
    error one step ahead, and ``log_likelihood``; its intervals are from the ``observed_information`` where the innovations are white;
    ``options``, ``equations`` and ``versions`` for repeating it.
    """

    model: Model
    status: str
    success: bool
    meaning: str
    parameters: Mapping[str, Estimate]
    misfit: Mapping[str, Misfit]
    traces: Sequence[Trace]
    free: tuple[str, ...]
    covariance: np.ndarray
    noise: Mapping[str, float]
    noise_source: str
    discretisation: str
    integration_error: Mapping[str, float]
    cost: float
    solver: Mapping[str, Any]
    options: Mapping[str, Any]
    equations: str
    versions: Mapping[str, str]
    notes: tuple[str, ...] = ()
    validation: Mapping[str, Misfit] = field(default_factory=dict)
    validation_traces: Sequence[Trace] = ()
    noise_sources: Mapping[str, str] = field(default_factory=dict)
    noise_colour: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    interval_kind: str = "gauss_newton"
    inflation: Mapping[str, float] = field(default_factory=dict)
    discretisation_shift: Mapping[str, float] = field(default_factory=dict)
    tied: Mapping[str, Estimate] = field(default_factory=dict)
    ties: Mapping[str, str] = field(default_factory=dict)
    own: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)
    priors: Mapping[str, PriorCheck] = field(default_factory=dict)
    loss: str = ""
    loss_scale: Mapping[str, float] = field(default_factory=dict)
    outliers: Mapping[str, float] = field(default_factory=dict)
    ends: Sequence[End] = ()
    process_noise: Mapping[str, float] = field(default_factory=dict)
    prediction: Mapping[str, Misfit] = field(default_factory=dict)
    log_likelihood: float | None = None

    def __str__(self) -> str:
        from greybox.result.summary import summary

        return summary(self)

    def save(self, path: str | Path) -> Path:
        """Write ``fit.json``; `greybox.load_fit` reads it back without loss."""
        from greybox.result.store import save_fit

        return save_fit(self, path)
