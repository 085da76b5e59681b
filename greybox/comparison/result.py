"""Models side by side on the same records, as values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from greybox.experiment import Experiment

BoxKind = Literal["grey", "black"]


class BlackBoxModel(Protocol):
    """What a black-box model of one output offers: `greybox.blackbox.arx` and its kin give such values."""

    @property
    def kind(self) -> str:
        """``arx``, ``armax`` ..."""

    @property
    def label(self) -> str:
        """Kind and orders."""

    @property
    def output(self) -> str:
        """Name of the output."""

    @property
    def sampling_time(self) -> float:
        """Seconds from sample to sample."""

    @property
    def parameters(self) -> int:
        """Number of fitted coefficients."""

    @property
    def stable(self) -> bool:
        """Whether every pole lies inside the unit circle."""

    @property
    def feedthrough(self) -> Mapping[str, float]:
        """Direct share of each input in the output of the same row."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What one should know before trusting it."""

    def simulate(self, experiment: Experiment, *, initial: Any = ..., rows: int | None = ...) -> dict[str, np.ndarray]:
        """Free run ``{output: (N,)}``."""

    def predict(
        self, experiment: Experiment, steps: int = ..., *, initial: Any = ..., rows: int | None = ...
    ) -> dict[str, np.ndarray]:
        """Prediction ``{output: (N,)}``."""


@dataclass(frozen=True, eq=False)
class ComparisonRun:
    """One output of one record beside a model's free run and one-step prediction: ``time``, ``measured``, ``simulated``,
    ``predicted`` (N,); the first ``skip`` rows do not count. ``predicted`` is NaN where nothing is predicted. ``ahead``: further
    predictions (N,) by the number of samples ahead."""

    record: str
    output: str
    time: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    predicted: np.ndarray
    skip: int = 0
    ahead: Mapping[int, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class ComparisonScore:
    """Errors of one output over one or more records, in ``unit``.

    ``rmse`` of the free run, ``best_fit_percent = 100 (1 - ||y - yhat|| / ||y - mean(y)||)`` with each record's own mean,
    ``one_step_rmse`` of the prediction one sample ahead, ``ahead_rmse`` of those further ahead by the number of samples; infinite
    where a run leaves all bounds. ``samples`` went into it.
    """

    rmse: float
    best_fit_percent: float
    one_step_rmse: float
    samples: int
    unit: str = ""
    ahead_rmse: Mapping[int, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ComparisonEntry:
    """One model of a comparison.

    ``kind`` is ``grey`` or ``black``; ``structure`` says which one for each output; ``parameters`` is the number of fitted constants
    or coefficients, without initial states. ``training`` and ``validation``: output -> `Score` over all records of that group,
    ``records``: record -> output -> `Score`. ``bic = sum N ln(mean square free-run error) + p ln(sum N)`` on the training records,
    summed over the outputs. ``stable``: every pole of a black box lies inside the unit circle; a linear grey box has no pole in the
    right half plane, the runs of a nonlinear one stay bounded. ``feedthrough``: ``output/input`` -> direct share within the same
    row, where there is one. ``seconds`` it took to fit (a black box: with its scan).
    """

    name: str
    kind: BoxKind
    structure: Mapping[str, str]
    parameters: int
    training: Mapping[str, ComparisonScore]
    validation: Mapping[str, ComparisonScore]
    records: Mapping[str, Mapping[str, ComparisonScore]]
    bic: float
    stable: bool
    feedthrough: Mapping[str, float]
    seconds: float = 0.0
    notes: tuple[str, ...] = ()
    training_runs: tuple[ComparisonRun, ...] = ()
    validation_runs: tuple[ComparisonRun, ...] = ()


@dataclass(frozen=True, eq=False)
class Comparison:
    """Models judged on the same rows of the same records.

    ``entries`` in the order they were given, ``outputs`` by name with their units, names of the ``training`` and ``validation``
    records, ``skip`` rows left out at the start of the latter, ``notes`` what could not be compared.
    """

    entries: tuple[ComparisonEntry, ...]
    outputs: Mapping[str, str]
    training: tuple[str, ...]
    validation: tuple[str, ...]
    skip: int = 0
    notes: tuple[str, ...] = field(default=())

    def __getitem__(self, name: str) -> ComparisonEntry:
        return next(e for e in self.entries if e.name == name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the models."""
        return tuple(e.name for e in self.entries)

    @cached_property
    def verdict(self) -> tuple[str, ...]:
        """Which is best where, and by how much, in plain sentences."""
        from greybox.comparison.verdict import judge_comparison

        return judge_comparison(self)

    def judged(self, entry: ComparisonEntry) -> Mapping[str, ComparisonScore]:
        """The scores that decide: on the validation records, or on the training records where there are no others."""
        return entry.validation if self.validation else entry.training

    def __str__(self) -> str:
        from greybox.comparison.text import format_comparison

        return format_comparison(self)

    def save(self, path: str | Path, further: Mapping[str, Any] | None = None) -> Path:
        """Write the comparison as JSON, with ``further`` entries beside it; numbers that are not finite become null."""
        from greybox.comparison.store import save

        return save(self, path, further or {})


def compute_score(runs: Sequence[ComparisonRun], unit: str) -> ComparisonScore:
    """Errors of one output over its ``runs``."""
    squares = movement = 0.0
    count = 0
    for run in runs:
        y, yhat = (values[run.skip :] for values in (run.measured, run.simulated))
        there = np.isfinite(y)
        if not there.any():
            continue
        squares += _square(y[there] - yhat[there])
        movement += _square(y[there] - y[there].mean())
        count += int(there.sum())
    if not count:
        return ComparisonScore(np.nan, np.nan, np.nan, 0, unit)
    fit = 100 * (1 - np.sqrt(squares / movement)) if movement > 0 else np.nan
    one_step = _foreseen([(run, run.predicted) for run in runs])
    further = dict.fromkeys(steps for run in runs for steps in run.ahead)
    ahead = {k: _foreseen([(run, run.ahead[k]) for run in runs if k in run.ahead]) for k in further}
    return ComparisonScore(float(np.sqrt(squares / count)), float(fit), one_step, count, unit, ahead)


def _foreseen(predictions: Sequence[tuple[ComparisonRun, np.ndarray]]) -> float:
    """Root mean square error of predictions (N,), where there are any."""
    squares, count = 0.0, 0
    for run, ahead in predictions:
        y, yhat = run.measured[run.skip :], ahead[run.skip :]
        known = np.isfinite(y) & ~np.isnan(yhat)
        squares += _square(y[known] - yhat[known])
        count += int(known.sum())
    return float(np.sqrt(squares / count)) if count else np.nan


def _square(error: np.ndarray) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        found = float(error @ error)
    return found if np.isfinite(found) else np.inf
