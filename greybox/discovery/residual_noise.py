"""Noise or missing effect, if the noise was not given: the colour of the best model's residual.

A correlated residual makes every likelihood ratio of white noise too large, and an estimated level too small. Where neither
the user nor a quiet record gives the colour, it is read from the residual of the best model found, as noise of first order
(one time constant): what a sensor, a filter or a drift leaves behind. A missing effect leaves more than that, and shows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from greybox.discovery.policy import ResidualNoisePolicy
from greybox.discovery.problem import CandidateFit
from greybox.noise import NoiseModel, NoiseSource, fit_autoregression, join_series
from greybox.transcription import SingleShooting

# Sources of a noise level that do not depend on the records that are fitted.
INDEPENDENT_SOURCES = (NoiseSource.GIVEN, NoiseSource.QUIET_RECORD)


def is_noise_known(noise: NoiseModel, quiet: bool) -> bool:
    """Whether level and colour of the noise come from outside the records that are fitted."""
    return quiet and is_level_known(noise)


def is_level_known(noise: NoiseModel) -> bool:
    """Whether the level of every output comes from outside the records that are fitted."""
    return all(source in INDEPENDENT_SOURCES for source in noise.sources.values())


def estimate_residual_noise(candidate: CandidateFit, policy: ResidualNoisePolicy) -> NoiseModel:
    """The noise as the residual shows it: first-order colour, and the level of every output whose level was not given."""
    noise = candidate.problem.noise
    std, colour = noise.std.copy(), list(noise.colour)
    for j, series in _normalised_residuals(candidate):
        name = candidate.problem.model.outputs[j].name
        if noise.sources.get(name) not in INDEPENDENT_SOURCES:
            std[j] = noise.std[j] * float(np.sqrt(np.nanmean(series**2)))
        fitted = fit_autoregression(series, max_order=1, policy=candidate.problem.policy.noise)
        coloured = fitted.order and abs(fitted.reflection[0]) > policy.white_correlation
        colour[j] = fitted if coloured else type(fitted)()
    return replace(noise, std=std, colour=tuple(colour))


def is_same_noise(noise: NoiseModel, before: NoiseModel, policy: ResidualNoisePolicy) -> bool:
    """Whether reading the noise again changes nothing: the same colour, and the same level."""
    same_level = np.allclose(noise.std, before.std, rtol=policy.level_tolerance)
    return same_level and all(a.reflection == b.reflection for a, b in zip(noise.colour, before.colour, strict=True))


def excess_autocorrelation(candidate: CandidateFit, lags: int) -> float:
    """Sum of squared autocorrelations of the whitened residual over ``lags``, beyond chance, of the worst output: zero for noise."""
    worst = 0.0
    for j, series in _normalised_residuals(candidate):
        white = candidate.problem.noise.colour[j].whiten(series)
        values = white[np.isfinite(white)]
        values = values - values.mean()
        energy = float(values @ values)
        correlations = [float(values[k:] @ values[:-k]) / energy for k in range(1, lags + 1)] if energy > 0 else []
        worst = max(worst, sum(r * r for r in correlations) - 2 * lags / max(len(values), 1))
    return worst


def _normalised_residuals(candidate: CandidateFit) -> list[tuple[int, np.ndarray]]:
    """Residual over noise of each measured output, the records one after the other with a gap between."""
    problem = candidate.problem
    shooting = SingleShooting(candidate.variables, problem.step, problem.kernel, problem.records, 1 / problem.noise.std)
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
