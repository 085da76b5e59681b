"""From the curvature at the optimum to standard deviations and intervals, and to what the data leave open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from greybox.estimation.sandwich import (
    estimate_kernel_score_covariance,
    estimate_residual_colour,
    estimate_score_covariance,
)
from greybox.transcription import DecisionVector, Evaluation

# A direction of the scaled constants with less than this share of the largest curvature is not determined.
UNDETERMINED = 1e-12

GAUSS_NEWTON, SANDWICH = "gauss_newton", "sandwich"
Rows = Sequence[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class ParameterCovariance:
    """``covariance`` (nf, nf) of the free constants, and directions that the data do not determine: names with weights.

    ``kind``: ``gauss_newton`` (white residual) or ``sandwich`` (coloured residual); ``inflation`` (nf,): standard deviation over
    the one that a white residual of the same size would give; ``degrees`` of freedom of the variance behind it, infinite where
    the noise was given and not exceeded. ``information`` and ``scores`` (nf, nf), both in ``z`` and with the initial states estimated
    as well: curvature of half the data's cost, and the covariance of its slope; NaN for a constant at its bound.
    """

    covariance: np.ndarray
    open_directions: tuple[dict[str, float], ...]
    kind: str = GAUSS_NEWTON
    inflation: np.ndarray | None = None
    degrees: float = np.inf
    information: np.ndarray | None = None
    scores: np.ndarray | None = None


def estimate_covariance(
    variables: DecisionVector, evaluation: Evaluation, noise_given: bool, rows: Rows | None = None, unknowns: int | None = None,
    least: np.ndarray | None = None,
) -> ParameterCovariance:  # fmt: skip
    """Covariance of the constants, initial states projected out; constants at a bound count as fixed there.

    With the Jacobian ``J`` of the residual, its covariance ``R`` and the precision ``P`` of the priors it is the sandwich
    ``A^-1 (J'R J + P) A^-1`` with ``A = J'J + P``. Where the residual is white, ``R`` is ``s^2``, the residual variance over the noise
    variance, and at least one where the noise was given: without priors that is ``s^2 (J'J)^-1``, the Gauss-Newton covariance, and
    with them, at ``s^2 = 1``, the posterior covariance ``A^-1``. With ``rows``, the residuals and Jacobians of each record, each output
    has an ``s^2`` of its own and the residual may be coloured (`greybox.estimation.sandwich`); without them it is taken to be white.
    Constants along an undetermined direction get an infinite variance. ``unknowns``: how many numbers were estimated.
    ``least`` (ny,): see `estimate_residual_colour`.
    """
    n = len(variables.which)
    covariance = np.full((n, n), np.nan)
    if n == 0 or not np.isfinite(evaluation.cost):
        return ParameterCovariance(covariance, ())
    unknowns = variables.size if unknowns is None else unknowns
    prior = variables.penalty(np.zeros(variables.size))[2] / 2
    known = np.diag(np.pad(prior, (0, variables.size - n)))
    data = evaluation.hessian / 2 - known if rows is None else compute_information(variables, rows)
    inside = np.flatnonzero(~variables.active)
    block = np.ix_(inside, inside)
    projector = _projector(data + known, n)
    information = (projector @ data[:, :n])[block]
    information = (information + information.T) / 2
    held = np.diag(prior[inside])
    inverse, weak, scale = invert_information(information + held)
    degrees = float(max(evaluation.count - unknowns + int(variables.held.sum()), 1))
    variance = float(evaluation.squares.sum()) / degrees
    if noise_given:
        degrees = np.inf if variance <= 1 or least is not None else degrees
        variance = max(variance, 1.0)
    scores, kind, inflation = variance * information, GAUSS_NEWTON, np.ones(n)
    if rows is not None:
        colour = estimate_residual_colour(rows, unknowns, noise_given, least)
        scores = (projector @ estimate_score_covariance(variables, rows, colour.white) @ projector.T)[block]
    spread = inverse @ (scores + held) @ inverse
    if rows is not None and colour.coloured:
        white = np.diag(spread)
        scores = (projector @ estimate_score_covariance(variables, rows, colour) @ projector.T)[block]
        other = estimate_kernel_score_covariance(variables, rows, colour, projector)[block]
        spread = raise_to_larger(*(inverse @ (middle + held) @ inverse for middle in (scores, other)))
        with np.errstate(divide="ignore", invalid="ignore"):
            inflation[inside] = np.sqrt(np.diag(spread) / white)
        kind, degrees = SANDWICH, colour.degrees
    spread[np.diag_indices_from(spread)] = np.where(is_in_open_direction(weak), np.inf, np.diag(spread))
    slopes = variables.spans[inside]
    covariance[block] = spread * np.outer(slopes, slopes)
    names = [variables.names[k] for k in inside]
    directions = tuple(to_direction(names, weak[:, k] / scale) for k in range(weak.shape[1]))
    return ParameterCovariance(
        covariance, directions, kind, inflation, degrees, _placed(information, inside, n), _placed(scores, inside, n)
    )


def compute_information(variables: DecisionVector, rows: Rows) -> np.ndarray:
    """``J'J`` (size, size) of the residuals that were measured."""
    total = np.zeros((variables.size, variables.size))
    for e, (r, jacobian) in enumerate(rows):
        slopes, columns = jacobian[np.isfinite(r)], variables.columns(e)
        total[np.ix_(columns, columns)] += slopes.T @ slopes
    return total


def invert_information(information: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The inverse, zero along directions without information; these directions (n, k), scaled; and the scale (n,) of each entry."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    told = (
        np.diag(information) > 0
    )  # a run that has left all bounds may say less than nothing of a constant, by rounding
    values, vectors = np.linalg.eigh(
        np.divide(information, np.outer(scale, scale), where=np.outer(told, told), out=np.zeros_like(information))
    )
    weak = values <= UNDETERMINED * max(values.max(initial=0.0), 1.0)
    inverse = (vectors[:, ~weak] / values[~weak]) @ vectors[:, ~weak].T / np.outer(scale, scale)
    return inverse, vectors[:, weak], scale


def _placed(matrix: np.ndarray, inside: np.ndarray, n: int) -> np.ndarray:
    whole = np.full((n, n), np.nan)
    whole[np.ix_(inside, inside)] = matrix
    return whole


def compute_quantile(degrees: float) -> float:
    """Two-sided 95 % point of Student's distribution, of the normal one for infinite ``degrees``."""
    return float(stdtrit(degrees, 0.975)) if np.isfinite(degrees) else float(ndtri(0.975))


def compute_interval(value: float, reach: float, positive: bool, bounds: tuple[float, float]) -> tuple[float, float]:
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


def raise_to_larger(covariance: np.ndarray, other: np.ndarray) -> np.ndarray:
    """``covariance`` with each standard deviation raised to that of the other."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.sqrt(np.diag(other) / np.diag(covariance))
    factor = np.where(np.isfinite(ratio), np.maximum(ratio, 1.0), 1.0)
    return covariance * np.outer(factor, factor)


def is_in_open_direction(weak: np.ndarray) -> np.ndarray:
    """Which constants a set of undetermined directions touches."""
    return np.any(np.abs(weak) > 1e-3, axis=1)


def to_direction(names: list[str], vector: np.ndarray) -> dict[str, float]:
    """A direction of constants as names with weights, the largest of them one."""
    largest = np.abs(vector).max()
    share = vector / (largest * np.sign(vector[np.argmax(np.abs(vector))]))
    return {name: float(w) for name, w in zip(names, share, strict=True) if abs(w) > 1e-2}
