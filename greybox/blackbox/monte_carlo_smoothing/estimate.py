"""Monte-Carlo smoothing of a step response (Wang, Micro motion actuator of compliant mechanism, section 4.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.blackbox.monte_carlo_smoothing.grid_search import DrawCounts, StepResponseConstants, draw_and_search
from greybox.blackbox.monte_carlo_smoothing.intervals import AXES, DrawIntervals, estimate_intervals
from greybox.blackbox.monte_carlo_smoothing.result import MonteCarloSmoothing, SmoothingRound
from greybox.blackbox.policy import DEFAULT_SMOOTHING, SmoothingPolicy
from greybox.blackbox.sampled_data import to_sampled_data
from greybox.errors import DataError
from greybox.experiment import Experiment


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
    policy: SmoothingPolicy = DEFAULT_SMOOTHING,
) -> MonteCarloSmoothing:
    """Fit ``yhat(t) = A {1 - r e^(-sigma t) sin(w t + theta)}`` (equation 17) to a step response by random search.

    Each evaluation draws values on every axis, uniformly in its interval, and tries all their combinations; the best of
    ``evaluations`` by the mean square error (equation 1) counts. Then the loop of figure 1: while that error exceeds the
    ``specification``, the intervals are put around the best values, narrower where those lay well inside, and it is done again.

    This is least squares by random search: maximum likelihood for white Gaussian noise, and blind to a delay, which it takes for
    a feed-through (`MonteCarloSmoothing.delay`). Prefer `output_error`, or a physical model with a delay; use it to repeat
    published results.

    Parameters
    ----------
    experiment
        A record whose input steps once, from zero, at any row.
    seed
        A number or a generator: the same seed draws the same.
    output, input
        Names of the signals; needed where the record has several.
    intervals
        All of them, or some by axis (``amplitude, ratio, phase, frequency, decay``); the others come from the data, the frequency
        from the power spectral density of ``spectrum_points`` points.
    draws
        Number of values on each axis; None: 20 frequencies, 10 phases, 10 ratios, 50 amplitudes, 20 decays, two million
        combinations in all.
    evaluations
        Number of evaluations between two adjustments of the intervals.
    specification
        Mean square error to reach, in the output's unit squared; None: adjust while it still falls by 2 %.
    adjustments
        How often the intervals are adjusted at most (0: never).
    spectrum_points
        Points of the power spectral density.
    units
        Name of a signal -> unit.
    report
        Called with a `SmoothingProgress` after every evaluation.
    policy
        How the intervals are estimated and adjusted.

    Returns
    -------
    MonteCarloSmoothing
        The five constants, and the difference equation behind them.

    Raises
    ------
    DataError
        For an input that is no single step from zero, gaps, fewer than 32 rows after the step, and a response without a resonance.

    Examples
    --------
    >>> smoothing = gb.blackbox.monte_carlo_smoothing(record, seed=1)  # doctest: +SKIP
    """
    if evaluations < 1 or adjustments < 0:
        raise DataError(f"{evaluations} evaluations, {adjustments} adjustments; give at least 1 and 0")
    generator, counts = np.random.default_rng(seed), draws or DrawCounts()
    step = _extract_step(experiment, output, input, policy)
    time, y = step.time, step.y
    chosen = intervals if isinstance(intervals, DrawIntervals) else None
    if chosen is None:
        chosen = estimate_intervals(time, y, step.sampling_time, spectrum_points, policy).with_some(intervals or {})  # type: ignore[arg-type]
    rounds: list[SmoothingRound] = []
    while True:
        evaluated: list[StepResponseConstants] = []
        for k in range(evaluations):
            evaluated.append(draw_and_search(time, y, chosen, counts, generator))
            if report is not None:
                best = min(c.error for c in [*evaluated, *(r.best for r in rounds)])
                report(SmoothingProgress(len(rounds) + 1, adjustments + 1, k + 1, evaluations, best))
        rounds.append(SmoothingRound(chosen, tuple(evaluated)))
        if len(rounds) > adjustments or _is_good_enough(rounds, specification, policy):
            break
        best_yet = min((r.best for r in rounds), key=lambda c: c.error)
        chosen = chosen.around({axis: getattr(best_yet, axis) for axis in AXES}, policy)
    best_of_all = min((r.best for r in rounds), key=lambda c: c.error)
    return MonteCarloSmoothing(
        step.output,
        step.input,
        step.sampling_time,
        step.height,
        best_of_all,
        len(y),
        tuple(rounds),
        counts,
        specification,
        dict(units or {}),
    )


def _is_good_enough(rounds: Sequence[SmoothingRound], specification: float | None, policy: SmoothingPolicy) -> bool:
    errors = [r.best.error for r in rounds]
    if specification is not None:
        return min(errors) <= specification
    return len(errors) > 1 and errors[-1] > (1 - policy.improvement) * min(errors[:-1])


@dataclass(frozen=True, eq=False)
class _Step:
    """The response from the step on: ``time`` (N,) in seconds after it, ``y`` (N,), ``height`` of the step."""

    output: str
    input: str
    sampling_time: float
    height: float
    time: np.ndarray
    y: np.ndarray


def _extract_step(experiment: Experiment, output: str | None, input: str | None, policy: SmoothingPolicy) -> _Step:
    data = to_sampled_data(experiment, output, input)
    (record,) = data.records
    if len(data.inputs) > 1:
        raise DataError(
            f"experiment {experiment.name!r}: several inputs; name the one that steps with input=...; known: {', '.join(data.inputs)}"
        )
    u, name = record.u[:, 0], data.inputs[0]
    changes = np.flatnonzero(np.diff(u, prepend=0.0))
    if len(changes) != 1:
        movement = (
            "never moves"
            if not len(changes)
            else f"changes at {len(changes)} rows ({', '.join(map(str, changes[:3]))} ...)"
        )
        raise DataError(
            f"experiment {experiment.name!r}: input {name!r} {movement}, but Monte-Carlo smoothing needs one step from zero;"
            " cut the record there, or use output_error, which takes any input"
        )
    edge = int(changes[0])
    y = record.y[edge:]
    if np.isnan(y).any():
        raise DataError(
            f"experiment {experiment.name!r}: {int(np.isnan(y).sum())} of {len(y)} rows after the step lack {data.output!r};"
            " smoothing needs them all: cut the record, or use output_error"
        )
    if len(y) < policy.fewest_rows:
        raise DataError(
            f"experiment {experiment.name!r}: {len(y)} rows after the step; smoothing needs {policy.fewest_rows} and a final value"
        )
    return _Step(data.output, name, record.sampling_time, float(u[edge]), record.sampling_time * np.arange(len(y)), y)
