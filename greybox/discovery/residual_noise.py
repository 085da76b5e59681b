"""What a selection weighs the residual with where the noise is not known from outside, and structure left in a residual.

The residual of a candidate is never taken for the noise: it holds what the candidate lacks. The records bound the noise
(`greybox.data.noise`), and a sensor bounds how long it remembers; within these bounds the weights follow the residual of the best model
found, because a correlated residual makes every likelihood ratio of white noise too large.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from greybox.data.noise import AutoRegression, BoundDirection, NoiseModel, NoiseSource, fit_autoregression, join_series
from greybox.data.sensor_faults import find_rounding_share
from greybox.discovery.problem import FittedCandidate
from greybox.discovery.surrogate_effects import CURVE, LINEAR_DYNAMICS, TONE
from greybox.model.effect import Effect

# Sources of a noise level that do not depend on the records that are fitted.
INDEPENDENT_SOURCES = (NoiseSource.GIVEN, NoiseSource.QUIET_RECORD)


def is_level_known(noise: NoiseModel) -> bool:
    """Whether the level of every output is known, and not bounded only."""
    return noise.is_level_known


def estimate_residual_noise(candidate: FittedCandidate) -> NoiseModel:
    """The weights of a selection: no larger than the noise can be, and no longer remembered than a sensor remembers.

    A level that is known stays. One that is only bounded becomes what the model leaves where that is less; what it leaves beyond the
    bound, or remembers for longer than a sensor, is the model's error and shows as such. The colour follows the residual up to there,
    unless the records show it themselves.
    """
    noise = candidate.problem.noise
    std, colour = noise.std.copy(), list(noise.colour)
    for j, series in _normalised_residuals(candidate):
        name = candidate.problem.model.outputs[j].name
        bound = noise.bound(name)
        left = noise.std[j] * float(np.sqrt(np.nanmean(series**2)))
        if bound is None:
            std[j] = left
        elif bound.direction is BoundDirection.AT_MOST:
            std[j] = min(left, bound.level)
        elif bound.direction is BoundDirection.AT_LEAST:
            std[j] = max(left, bound.level)
        if bound is None or bound.correlation_time is None:
            fitted = fit_autoregression(series, max_order=1, policy=candidate.problem.policy.noise)
            colour[j] = _limit_memory(fitted)
    return replace(noise, std=std, colour=tuple(colour))


# Correlation from sample to sample below which a residual counts as white.
WHITE_CORRELATION = 0.1
# Largest correlation from sample to sample of a sensor's noise, as in `greybox.data.noise.NoisePolicy`: a residual that remembers for
# longer is a model's error.
RESIDUAL_NOISE_LONGEST_CORRELATION = 0.95


def _limit_memory(fitted: AutoRegression) -> AutoRegression:
    """Noise of first order that a sensor can have; white where it hardly remembers."""
    if not fitted.order or abs(fitted.reflection[0]) <= WHITE_CORRELATION:
        return AutoRegression()
    return AutoRegression((min(fitted.reflection[0], RESIDUAL_NOISE_LONGEST_CORRELATION),))


def excess_autocorrelation(candidate: FittedCandidate, lags: int) -> float:
    """Sum of squared autocorrelations of the whitened residual over ``lags``, beyond chance, of the worst output: zero for noise."""
    worst = 0.0
    for j, series in _normalised_residuals(candidate):
        if _is_of_steps(candidate, j, series):
            continue
        white = candidate.problem.noise.colour[j].whiten(series)
        values = white[np.isfinite(white)]
        values = values - values.mean()
        energy = float(values @ values)
        # A run that went astray has no correlations: its energy is beyond all numbers.
        lagged = range(1, lags + 1) if 0 < energy < math.inf else ()
        correlations = [float(values[k:] @ values[:-k]) / energy for k in lagged]
        worst = max(worst, sum(r * r for r in correlations) - 2 * lags / max(len(values), 1))
    return worst


# Share of a residual's mean square from which the steps of the reading are all that is left: what correlates there is their error.
ALL_STEPS = 0.9


def _is_of_steps(candidate: FittedCandidate, output: int, series: np.ndarray) -> bool:
    """Whether the residual of an output (N,), over its noise, is what the steps of its readings make: it goes on while a reading does."""
    problem = candidate.problem
    name = problem.model.outputs[output].name
    readings = [e.outputs[name] for e in problem.experiments if name in e.outputs]
    _, share = find_rounding_share(readings, float(np.nanmean(series**2)) * problem.noise.std[output] ** 2)
    return share >= ALL_STEPS


def _normalised_residuals(candidate: FittedCandidate) -> list[tuple[int, np.ndarray]]:
    """Residual over noise of each measured output, the records one after the other with a gap between."""
    problem = candidate.problem
    shooting = problem.with_plain_squares().shooting(candidate.variables)
    simulated = shooting.simulate(candidate.variables.here)
    runs = [
        (record.samples(y), record.samples(record.y))
        for (y, _), record in zip(simulated, shooting.records, strict=True)
    ]
    series = []
    for j in range(len(problem.noise.std)):
        parts = [(measured[:, j] - y[:, j]) / problem.noise.std[j] for y, measured in runs]
        if any(np.isfinite(part).any() for part in parts):
            series.append((j, join_series(parts)))
    return series


# What has no name.

# Appended to the name of an effect for a second branch of it.
SECOND_BRANCH = "_second_branch"


def is_shape_correction(name: str) -> bool:
    """Whether an effect of this name has none of its own: a curve, a tone, a second branch of another one, linear dynamics."""
    return name in (CURVE, TONE) or name.endswith(SECOND_BRANCH) or name.startswith(LINEAR_DYNAMICS)


def has_memory(effect: Effect) -> bool:
    """Whether an effect is no function of what is there at the moment: it has states, delays a signal or moves it between samples."""
    return bool(effect.states or effect.delay or effect.is_of_record)
