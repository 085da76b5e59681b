"""From the curvature at the optimum to standard deviations and intervals, and to what the data leave open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from greybox.fitting.sandwich import colour_of, kernel_score_covariance, score_covariance
from greybox.result import Estimate
from greybox.transcription import Evaluation, Variables

# A direction of the scaled constants with less than this share of the largest curvature is not determined.
UNDETERMINED = 1e-12

GAUSS_NEWTON, SANDWICH = "gauss_newton", "sandwich"
Rows = Sequence[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Uncertainty:
    """``covariance`` (nf, nf) of the free constants, and directions that the data do not determine: names with weights.

    ``kind``: ``gauss_newton`` (white residual) or ``sandwich`` (coloured residual); ``inflation`` (nf,): standard deviation over
    the one that a white residual of the same size would give; ``degrees`` of freedom of the variance behind it, infinite where
    the noise was given and not exceeded.
    """

    covariance: np.ndarray
    open_directions: tuple[dict[str, float], ...]
    kind: str = GAUSS_NEWTON
    inflation: np.ndarray | None = None
    degrees: float = np.inf


def uncertainty(
    variables: Variables, evaluation: Evaluation, noise_given: bool, rows: Rows | None = None
) -> Uncertainty:
    """Covariance of the constants, initial states projected out; constants at a bound count as fixed there.

    Where the residual is white it is the Gauss-Newton covariance ``s^2 (J'J)^-1``, ``s^2`` being the residual variance over the noise
    variance, and at least one where the noise was given; with ``rows`` each output has an ``s^2`` of its own. Where it is coloured
    it is the sandwich ``(J'J)^-1 J' R J (J'J)^-1`` with the covariance ``R`` of the residual (`greybox.fitting.sandwich`). That
    needs ``rows``, the residuals and Jacobians of each record; without them the residual is taken to be white. Constants along an
    undetermined direction get an infinite variance.
    """
    n = len(variables.which)
    covariance = np.full((n, n), np.nan)
    if n == 0 or not np.isfinite(evaluation.cost):
        return Uncertainty(covariance, ())
    inside = np.flatnonzero(~variables.active(variables.fixed))
    projector = _projector(evaluation.hessian / 2, n)
    information = (projector @ evaluation.hessian[:, :n] / 2)[np.ix_(inside, inside)]
    information = (information + information.T) / 2
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    weak = values <= UNDETERMINED * max(values.max(initial=0.0), 1.0)
    inverse = (vectors[:, ~weak] / values[~weak]) @ vectors[:, ~weak].T / np.outer(scale, scale)
    degrees = float(max(evaluation.count - variables.size, 1))
    variance = evaluation.cost / degrees
    if noise_given:
        degrees = np.inf if variance <= 1 else degrees
        variance = max(variance, 1.0)
    plain, kind, inflation = variance * inverse, GAUSS_NEWTON, np.ones(n)
    if rows is not None:
        block, colour = np.ix_(inside, inside), colour_of(rows, variables.size, noise_given)

        def between(scores: np.ndarray) -> np.ndarray:
            return inverse @ scores[block] @ inverse

        plain = between(projector @ score_covariance(variables, rows, colour.white) @ projector.T)
        if colour.coloured:
            robust = between(projector @ score_covariance(variables, rows, colour) @ projector.T)
            robust = _larger(robust, between(kernel_score_covariance(variables, rows, colour, projector)))
            with np.errstate(divide="ignore", invalid="ignore"):
                inflation[inside] = np.sqrt(np.diag(robust) / np.diag(plain))
            plain, kind, degrees = robust, SANDWICH, colour.degrees
    plain[np.diag_indices_from(plain)] = np.where(_takes_part(vectors[:, weak]), np.inf, np.diag(plain))
    slopes = variables.slopes(variables.fixed)[inside]
    covariance[np.ix_(inside, inside)] = plain * np.outer(slopes, slopes)
    names = [variables.names[k] for k in inside]
    directions = tuple(_direction(names, vectors[:, k] / scale) for k in np.flatnonzero(weak))
    return Uncertainty(covariance, directions, kind, inflation, degrees)


def estimates(variables: Variables, found: Uncertainty) -> dict[str, Estimate]:
    """Every parameter of the model with its interval; of a positive constant the interval is multiplicative."""
    p = variables.fixed
    result = {q.name: Estimate(float(p[k]), q.unit, fixed=True) for k, q in enumerate(variables.model.all_parameters)}
    active = variables.active(p)
    for k, name in enumerate(variables.names):
        q = variables.model.parameter(name)
        value, variance = float(p[variables.which[k]]), found.covariance[k, k]
        std = float(np.sqrt(variance)) if np.isfinite(variance) else None
        reach = quantile(found.degrees) * (std or 0.0)
        limits = None if std is None else interval(value, reach, q.positive, q.bounds)
        result[name] = Estimate(value, q.unit, std, limits, False, bool(active[k]))
    return result


def quantile(degrees: float) -> float:
    """Two-sided 95 % point of Student's distribution, of the normal one for infinite ``degrees``."""
    return float(stdtrit(degrees, 0.975)) if np.isfinite(degrees) else float(ndtri(0.975))


def interval(value: float, reach: float, positive: bool, bounds: tuple[float, float]) -> tuple[float, float]:
    """``value`` less and more ``reach``, by a factor where the constant is positive, within its bounds."""
    if positive:
        factor = float(np.exp(min(reach / value, 700.0)))
        low, high = value / factor, value * factor
    else:
        low, high = value - reach, value + reach
    return max(low, bounds[0]), min(high, bounds[1])


def _projector(information: np.ndarray, n: int) -> np.ndarray:
    """``[I, -B C^-1]`` (n, size): takes scores to those of the first ``n`` entries with the others estimated as well.

    Applied to the information it leaves the Schur complement ``A - B C^-1 B'``.
    """
    b, c = information[:n, n:], information[n:, n:]
    return np.hstack([np.eye(n), -b @ np.linalg.pinv(c, rcond=1e-12, hermitian=True)]) if c.size else np.eye(n)


def _larger(covariance: np.ndarray, other: np.ndarray) -> np.ndarray:
    """``covariance`` with each standard deviation raised to that of the other."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.sqrt(np.diag(other) / np.diag(covariance))
    factor = np.where(np.isfinite(ratio), np.maximum(ratio, 1.0), 1.0)
    return covariance * np.outer(factor, factor)


def _takes_part(weak: np.ndarray) -> np.ndarray:
    """Which constants a set of undetermined directions touches."""
    return np.any(np.abs(weak) > 1e-3, axis=1)


def _direction(names: list[str], vector: np.ndarray) -> dict[str, float]:
    largest = np.abs(vector).max()
    share = vector / (largest * np.sign(vector[np.argmax(np.abs(vector))]))
    return {name: float(w) for name, w in zip(names, share, strict=True) if abs(w) > 1e-2}
