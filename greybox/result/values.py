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
class Trace:
    """One record and the model's run over it: ``time`` (N,), measured and simulated outputs by name (N,), its initial state.

    ``inputs`` by name (N,), ``hold`` how they move between samples (``zero`` or ``first``), and ``conditions`` make it a whole
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
class Fit:
    """A fitted model.

    ``model`` carries the fitted values; ``parameters`` name -> `Estimate`; ``status`` and ``meaning`` how it ended, in a word and in
    plain words; ``covariance`` (nf, nf) of the free constants in the order of ``free``; ``interval_kind``
    says whether it is the ``gauss_newton`` covariance (white residual) or the ``sandwich`` that allows for a coloured one, and
    ``inflation`` by which factor that widens each standard deviation; ``noise`` standard deviation of each output, ``noise_sources``
    where each comes from (``noise_source`` in one line), ``noise_colour`` the reflection coefficients of its autoregression (none:
    white, or not known); ``integration_error`` rms change of each output when the step is halved, over the noise;
    ``discretisation_shift`` change of each constant when the step is halved, in its standard deviations; ``validation`` misfit
    on records not used for the fit; ``notes`` what a reader should know before trusting a number; ``solver`` statistics;
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

    def __str__(self) -> str:
        from greybox.result.summary import summary

        return summary(self)

    def save(self, path: str | Path) -> Path:
        """Write ``fit.json``; `greybox.load_fit` reads it back without loss."""
        from greybox.result.store import save_fit

        return save_fit(self, path)
