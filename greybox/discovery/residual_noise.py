"""What is noise and what is missing physics, where nobody has said: the colour of the best model's residual.

A correlated residual makes every likelihood ratio of white noise too large, and an estimated level too small. Where neither
the user nor a quiet record tells the colour, it is read from the residual of the best model found, as noise of first order
(one time constant): what a sensor, a filter or a drift leaves behind. A missing effect leaves more than that, and shows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from greybox.discovery.problem import CandidateFit
from greybox.estimation.problem import EstimationProblem
from greybox.noise import NoiseModel, NoiseSource, fit_autoregression, join_series
from greybox.transcription import SingleShooting

# Correlation from sample to sample below which a residual counts as white.
WHITE = 0.1
# Autocorrelations looked at after first-order whitening; the sum of their squares may exceed chance by this much.
LAGS, LEFT_OVER = 30, 0.03
KNOWN = (NoiseSource.GIVEN, NoiseSource.QUIET_RECORD)


def is_noise_known(noise: NoiseModel, quiet: bool) -> bool:
    """Whether level and colour of the noise come from outside the records that are fitted."""
    return quiet and all(source in KNOWN for source in noise.sources.values())


def estimate_residual_noise(trial: CandidateFit) -> NoiseModel:
    """The noise as the residual of ``trial`` shows it: first-order colour, and the level of every output whose level was not given."""
    noise = trial.problem.noise
    std, colour = noise.std.copy(), list(noise.colour)
    for j, series in _residuals(trial):
        name = trial.problem.model.outputs[j].name
        if noise.sources.get(name) not in KNOWN:
            std[j] = noise.std[j] * float(np.sqrt(np.nanmean(series**2)))
        found = fit_autoregression(series, max_order=1)
        colour[j] = found if found.order and abs(found.reflection[0]) > WHITE else type(found)()
    return replace(noise, std=std, colour=tuple(colour))


def excess_autocorrelation(trial: CandidateFit) -> float:
    """Sum of squared autocorrelations of the whitened residual beyond what chance gives, of the worst output: zero for noise."""
    worst = 0.0
    for j, series in _residuals(trial):
        white = trial.problem.noise.colour[j].whiten(series)
        values = white[np.isfinite(white)]
        values = values - values.mean()
        energy = float(values @ values)
        lags = [float(values[k:] @ values[:-k]) / energy for k in range(1, LAGS + 1)] if energy > 0 else []
        worst = max(worst, sum(r * r for r in lags) - 2 * LAGS / max(len(values), 1))
    return worst


def _residuals(trial: CandidateFit) -> list[tuple[int, np.ndarray]]:
    """Residual over noise of each measured output, the records one after the other with a gap between."""
    problem: EstimationProblem = trial.problem
    z = np.zeros(trial.variables.size)
    shooting = SingleShooting(trial.variables, problem.step, problem.kernel, problem.records, 1 / problem.noise.std)
    runs = [
        (record.samples(y), record.samples(record.y))
        for (y, _), record in zip(shooting.simulate(z), shooting.records, strict=True)
    ]
    result = []
    for j in range(len(problem.noise.std)):
        parts = [(seen[:, j] - y[:, j]) / problem.noise.std[j] for y, seen in runs]
        if any(np.isfinite(part).any() for part in parts):
            result.append((j, join_series(parts)))
    return result
