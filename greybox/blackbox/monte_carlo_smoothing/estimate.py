"""Monte-Carlo smoothing of a step response (Wang, Micro motion actuator of compliant mechanism, section 4.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.blackbox.monte_carlo_smoothing.grid_search import DrawCounts, StepResponseConstants, draw_and_search
from greybox.blackbox.monte_carlo_smoothing.intervals import AXES, DrawIntervals, estimate_intervals
from greybox.blackbox.monte_carlo_smoothing.result import MonteCarloSmoothing, SmoothingRound
from greybox.blackbox.sampled_data import to_sampled_data
from greybox.errors import DataError
from greybox.experiment import Experiment

LEAST_ROWS = 32
SETTLED = 0.02  # share by which another adjustment of the intervals must lower the error


@dataclass(frozen=True)
class SmoothingProgress:
    """Where a smoothing is: evaluation ``evaluation`` of ``evaluations`` in round ``round`` of at most ``rounds``; best so far."""

    round: int
    rounds: int
    evaluation: int
    evaluations: int
    error: float


def monte_carlo_smoothing(
    experiment: Experiment,
    *,
    seed: int | np.random.Generator,
    output: str | None = None,
    input: str | None = None,
    intervals: DrawIntervals | Mapping[str, tuple[float, float]] | None = None,
    draws: DrawCounts | None = None,
    evaluations: int = 20,
    specification: float | None = None,
    adjustments: int = 5,
    spectrum_points: int = 1024,
    units: Mapping[str, str] | None = None,
    report: Callable[[SmoothingProgress], None] | None = None,
) -> MonteCarloSmoothing:
    """Fit ``yhat(t) = A {1 - r e^(-sigma t) sin(w t + theta)}`` (equation 17) to a step response by random jumping.

    The input steps once, from zero, at any row. Each evaluation draws values on every axis, uniformly in its interval, and tries
    all their combinations (``draws``: 20 frequencies, 10 phases, 10 ratios, 50 amplitudes, 20 decays, two million in all); the
    best of ``evaluations`` by the mean square error (equation 1) counts. Then the loop of figure 1: while that error exceeds the
    ``specification`` (in the output's unit squared; None: while it still falls by 2 %), the intervals are put around the best
    values, narrower where those lay well inside, and it is done again, ``adjustments`` times at most (0: never).

    ``intervals``: all of them, or some by axis (``amplitude, ratio, phase, frequency, decay``); the others come from the data, the
    frequency from the power spectral density of ``spectrum_points`` points. ``seed``: a number or a generator. ``report`` is called
    after every evaluation.

    This is least squares by random search: maximum likelihood for white Gaussian noise, and blind to a delay, which it takes for
    a feed-through (`MonteCarloSmoothing.delay`). Prefer `output_error`, or a physical model with a delay; use it to repeat
    published results.

    Raises DataError for an input that is no single step from zero, gaps, fewer than 32 rows after the step, and a response
    without a resonance.
    """
    if evaluations < 1 or adjustments < 0:
        raise DataError(f"{evaluations} evaluations, {adjustments} adjustments; give at least 1 and 0")
    generator, tried = np.random.default_rng(seed), draws or DrawCounts()
    step = _step_of(experiment, output, input)
    time, y = step.time, step.y
    chosen = intervals if isinstance(intervals, DrawIntervals) else None
    if chosen is None:
        chosen = estimate_intervals(time, y, step.sampling_time, spectrum_points).with_some(intervals or {})  # type: ignore[arg-type]
    rounds: list[SmoothingRound] = []
    while True:
        found: list[StepResponseConstants] = []
        for k in range(evaluations):
            found.append(draw_and_search(time, y, chosen, tried, generator))
            if report is not None:
                best = min(c.error for c in [*found, *(r.best for r in rounds)])
                report(SmoothingProgress(len(rounds) + 1, adjustments + 1, k + 1, evaluations, best))
        rounds.append(SmoothingRound(chosen, tuple(found)))
        if len(rounds) > adjustments or _good_enough(rounds, specification):
            break
        best_yet = min((r.best for r in rounds), key=lambda c: c.error)
        chosen = chosen.around({axis: getattr(best_yet, axis) for axis in AXES})
    best_of_all = min((r.best for r in rounds), key=lambda c: c.error)
    return MonteCarloSmoothing(
        step.output, step.input, step.sampling_time, step.height, best_of_all, len(y), tuple(rounds), tried, specification,
        dict(units or {}),
    )  # fmt: skip


def _good_enough(rounds: Sequence[SmoothingRound], specification: float | None) -> bool:
    errors = [r.best.error for r in rounds]
    if specification is not None:
        return min(errors) <= specification
    return len(errors) > 1 and errors[-1] > (1 - SETTLED) * min(errors[:-1])


@dataclass(frozen=True, eq=False)
class _Step:
    """The response from the step on: ``time`` (N,) in seconds after it, ``y`` (N,), ``height`` of the step."""

    output: str
    input: str
    sampling_time: float
    height: float
    time: np.ndarray
    y: np.ndarray


def _step_of(experiment: Experiment, output: str | None, input: str | None) -> _Step:
    data = to_sampled_data(experiment, output, input)
    (series,) = data.series
    if len(data.inputs) > 1:
        raise DataError(
            f"experiment {experiment.name!r}: which input steps? Say input=...; known: {', '.join(data.inputs)}"
        )
    u, name = series.u[:, 0], data.inputs[0]
    changes = np.flatnonzero(np.diff(u, prepend=0.0))
    if len(changes) != 1:
        said = (
            "never moves"
            if not len(changes)
            else f"changes at {len(changes)} rows ({', '.join(map(str, changes[:3]))} ...)"
        )
        raise DataError(
            f"experiment {experiment.name!r}: input {name!r} {said}, but Monte-Carlo smoothing needs one step from zero;"
            " cut the record there, or use output_error, which takes any input"
        )
    edge = int(changes[0])
    y = series.y[edge:]
    if np.isnan(y).any():
        raise DataError(
            f"experiment {experiment.name!r}: {int(np.isnan(y).sum())} of {len(y)} rows after the step lack {data.output!r};"
            " smoothing needs them all: cut the record, or use output_error"
        )
    if len(y) < LEAST_ROWS:
        raise DataError(
            f"experiment {experiment.name!r}: {len(y)} rows after the step; smoothing needs {LEAST_ROWS} and a final value"
        )
    return _Step(data.output, name, series.sampling_time, float(u[edge]), series.sampling_time * np.arange(len(y)), y)
