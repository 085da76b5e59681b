"""From the curvature at the optimum to standard deviations and intervals, and to what the data leave open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from greybox.result import Estimate
from greybox.transcription import Evaluation, Variables

# A direction of the scaled constants with less than this share of the largest curvature is not determined.
UNDETERMINED = 1e-12
Z95 = float(ndtri(0.975))


@dataclass(frozen=True)
class Uncertainty:
    """``covariance`` (nf, nf) of the free constants, and directions that the data do not determine: names with weights."""

    covariance: np.ndarray
    open_directions: tuple[dict[str, float], ...]


def uncertainty(variables: Variables, evaluation: Evaluation, noise_given: bool) -> Uncertainty:
    """Gauss-Newton covariance ``s^2 (J'J)^-1``, initial states projected out; constants at a bound count as fixed there.

    ``s^2`` is the residual variance over the noise variance, and at least one where the noise was given. It assumes white
    residuals. Constants along an undetermined direction get an infinite variance.
    """
    n = len(variables.which)
    covariance = np.full((n, n), np.nan)
    if n == 0 or not np.isfinite(evaluation.cost):
        return Uncertainty(covariance, ())
    inside = np.flatnonzero(~variables.active(variables.fixed))
    information = _projected(evaluation.hessian / 2, n)[np.ix_(inside, inside)]
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    weak = values <= UNDETERMINED * max(values.max(initial=0.0), 1.0)
    inverse = (vectors[:, ~weak] / values[~weak]) @ vectors[:, ~weak].T / np.outer(scale, scale)
    inverse[np.diag_indices_from(inverse)] = np.where(_takes_part(vectors[:, weak]), np.inf, np.diag(inverse))
    degrees = max(evaluation.count - variables.size, 1)
    variance = evaluation.cost / degrees
    if noise_given:
        variance = max(variance, 1.0)
    slopes = variables.slopes(variables.fixed)[inside]
    covariance[np.ix_(inside, inside)] = variance * inverse * np.outer(slopes, slopes)
    names = [variables.names[k] for k in inside]
    directions = tuple(_direction(names, vectors[:, k] / scale) for k in np.flatnonzero(weak))
    return Uncertainty(covariance, directions)


def estimates(variables: Variables, found: Uncertainty) -> dict[str, Estimate]:
    """Every parameter of the model with its interval; of a positive constant the interval is multiplicative."""
    p = variables.fixed
    result = {q.name: Estimate(float(p[k]), q.unit, fixed=True) for k, q in enumerate(variables.model.all_parameters)}
    active = variables.active(p)
    for k, name in enumerate(variables.names):
        q = variables.model.parameter(name)
        value, variance = float(p[variables.which[k]]), found.covariance[k, k]
        std = float(np.sqrt(variance)) if np.isfinite(variance) else None
        interval = None if std is None else _interval(value, std, q.positive, q.bounds)
        result[name] = Estimate(value, q.unit, std, interval, False, bool(active[k]))
    return result


def _projected(information: np.ndarray, n: int) -> np.ndarray:
    """Information on the first ``n`` entries with the others (initial states) estimated as well (Schur complement)."""
    a, b, c = information[:n, :n], information[:n, n:], information[n:, n:]
    return a - b @ np.linalg.pinv(c, rcond=1e-12, hermitian=True) @ b.T if c.size else a


def _takes_part(weak: np.ndarray) -> np.ndarray:
    """Which constants a set of undetermined directions touches."""
    return np.any(np.abs(weak) > 1e-3, axis=1)


def _direction(names: list[str], vector: np.ndarray) -> dict[str, float]:
    largest = np.abs(vector).max()
    share = vector / (largest * np.sign(vector[np.argmax(np.abs(vector))]))
    return {name: float(w) for name, w in zip(names, share, strict=True) if abs(w) > 1e-2}


def _interval(value: float, std: float, positive: bool, bounds: tuple[float, float]) -> tuple[float, float]:
    if positive:
        factor = float(np.exp(min(Z95 * std / value, 700.0)))
        low, high = value / factor, value * factor
    else:
        low, high = value - Z95 * std, value + Z95 * std
    return max(low, bounds[0]), min(high, bounds[1])
