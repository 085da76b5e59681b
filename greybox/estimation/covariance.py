"""From the curvature at the optimum to standard deviations and intervals, and to what the data leave open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from greybox.estimation.likelihood_search import LikelihoodOptimum
from greybox.estimation.policy import DEFAULT_POLICY, IntervalPolicy
from greybox.estimation.sandwich import (
    estimate_kernel_score_covariance,
    estimate_residual_colour,
    estimate_score_covariance,
)
from greybox.linear_algebra import SymmetricDecomposition, decompose_symmetric, eliminate
from greybox.noise import NoisePolicy
from greybox.numerics import TINY
from greybox.result import IntervalKind
from greybox.transcription import DecisionVector, Evaluation
from greybox.transcription.solution import Runs


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
    kind: IntervalKind = IntervalKind.GAUSS_NEWTON
    inflation: np.ndarray | None = None
    degrees: float = np.inf
    information: np.ndarray | None = None
    scores: np.ndarray | None = None


def estimate_covariance(
    variables: DecisionVector,
    evaluation: Evaluation,
    noise_given: bool,
    rows: Runs | None = None,
    unknowns: int | None = None,
    variance_floor: np.ndarray | None = None,
    policy: IntervalPolicy = DEFAULT_POLICY.intervals,
    noise_policy: NoisePolicy = DEFAULT_POLICY.noise,
) -> ParameterCovariance:
    """Covariance of the constants, initial states projected out; constants at a bound count as fixed there.

    With the Jacobian ``J`` of the residual, its covariance ``R`` and the precision ``P`` of the priors it is the sandwich
    ``A^-1 (J'R J + P) A^-1`` with ``A = J'J + P``. Where the residual is white, ``R`` is ``s^2``, the residual variance over the noise
    variance, and at least one where the noise was given: without priors that is ``s^2 (J'J)^-1``, the Gauss-Newton covariance, and
    with them, at ``s^2 = 1``, the posterior covariance ``A^-1``. With ``rows``, the residuals and Jacobians of each record, each output
    has an ``s^2`` of its own and the residual may be coloured (`greybox.estimation.sandwich`); without them it is taken to be white.
    Constants along an undetermined direction get an infinite variance. ``unknowns``: how many numbers were estimated.
    ``variance_floor`` (ny,): see `estimate_residual_colour`.
    ``noise_policy``: how the colour of the residual is estimated.
    """
    n = len(variables.which)
    covariance = np.full((n, n), np.nan)
    if n == 0 or not np.isfinite(evaluation.cost):
        return ParameterCovariance(covariance, ())
    unknowns = variables.size if unknowns is None else unknowns
    prior = variables.penalty(variables.here)[2] / 2
    known = np.diag(np.pad(prior, (0, variables.size - n)))
    data = evaluation.hessian / 2 - known if rows is None else compute_information(variables, rows)
    inside = np.flatnonzero(~variables.active)
    block = np.ix_(inside, inside)
    projector = eliminate(data + known, np.arange(n), np.arange(n, variables.size))
    information = (projector @ data[:, :n])[block]
    information = (information + information.T) / 2
    held = np.diag(prior[inside])
    inside_information = decompose_symmetric(information + held)
    inverse = inside_information.pseudo_inverse
    degrees = float(max(evaluation.count - unknowns + int(variables.has_prior.sum()), 1))
    variance = float(evaluation.squares.sum()) / degrees
    if noise_given:
        degrees = np.inf if variance <= 1 or variance_floor is not None else degrees
        variance = max(variance, 1.0)
    scores, kind, inflation = variance * information, IntervalKind.GAUSS_NEWTON, np.ones(n)
    if rows is not None:
        colour = estimate_residual_colour(rows, unknowns, noise_given, variance_floor, policy, noise_policy)
        scores = (projector @ estimate_score_covariance(variables, rows, colour.white) @ projector.T)[block]
    spread = inverse @ (scores + held) @ inverse
    if rows is not None and colour.coloured:
        white = np.diag(spread)
        scores = (projector @ estimate_score_covariance(variables, rows, colour) @ projector.T)[block]
        other = estimate_kernel_score_covariance(variables, rows, colour, projector, policy)[block]
        spread = raise_to_larger(*(inverse @ (middle + held) @ inverse for middle in (scores, other)))
        with np.errstate(divide="ignore", invalid="ignore"):
            inflation[inside] = np.sqrt(np.diag(spread) / white)
        kind, degrees = IntervalKind.SANDWICH, colour.degrees
    spread[np.diag_indices_from(spread)] = np.where(inside_information.is_open, np.inf, np.diag(spread))
    slopes = variables.spans[inside]
    covariance[block] = spread * np.outer(slopes, slopes)
    names = [variables.names[k] for k in inside]
    directions = list_open_directions(names, inside_information)
    return ParameterCovariance(
        covariance, directions, kind, inflation, degrees, _placed(information, inside, n), _placed(scores, inside, n)
    )


def compute_information(variables: DecisionVector, rows: Runs) -> np.ndarray:
    """``J'J`` (size, size) of the residuals that were measured."""
    total = np.zeros((variables.size, variables.size))
    for e, (r, jacobian) in enumerate(rows):
        slopes, columns = jacobian[np.isfinite(r)], variables.columns(e)
        total[np.ix_(columns, columns)] += slopes.T @ slopes
    return total


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


def raise_to_larger(covariance: np.ndarray, other: np.ndarray) -> np.ndarray:
    """``covariance`` with each standard deviation raised to that of the other."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.sqrt(np.diag(other) / np.diag(covariance))
    factor = np.where(np.isfinite(ratio), np.maximum(ratio, 1.0), 1.0)
    return covariance * np.outer(factor, factor)


def list_open_directions(names: list[str], information: SymmetricDecomposition) -> tuple[dict[str, float], ...]:
    """Directions that hold no information as names with weights, the largest of them one."""
    result = []
    for vector in (information.weak / information.scale[:, None]).T:
        shares = vector / vector[np.argmax(np.abs(vector))]
        result.append({name: float(w) for name, w in zip(names, shares, strict=True) if abs(w) > 1e-2})
    return tuple(result)


@dataclass(frozen=True)
class LikelihoodCovariance:
    """``constants`` as `ParameterCovariance` has them; ``noise`` (ny,): standard deviation of the logarithm of each output's
    estimated noise,
    NaN where it was given.
    """

    constants: ParameterCovariance
    noise: np.ndarray


def estimate_likelihood_covariance(
    optimum: LikelihoodOptimum,
    policy: IntervalPolicy = DEFAULT_POLICY.intervals,
    noise_policy: NoisePolicy = DEFAULT_POLICY.noise,
) -> LikelihoodCovariance:
    """Covariance of the constants and of the noise levels at the optimum, the first states estimated as well.

    The observed information is half the Hessian of ``-2 log L``, by central differences of its exact gradient; where it is not positive
    definite, the expected one. Where the innovations are correlated from sample to sample the model lacks something: then it is the
    sandwich ``A^-1 B A^-1`` with Newey and West's covariance ``B`` of the scores, which for a model that lacks nothing are martingale
    differences, but no standard deviation gets smaller by that. Constants at a bound count as fixed there.
    """
    u = optimum.cost.unknowns
    n, ny = len(u.variables.which), len(u.level)
    if not u.size or not optimum.status.success:
        return LikelihoodCovariance(ParameterCovariance(np.full((n, n), np.nan), ()), np.full(ny, np.nan))
    inside = np.flatnonzero(~u.variables.active)
    k = len(inside)
    wanted = np.concatenate([inside, np.arange(u.variables.size, u.size)])
    first_states = np.arange(n, u.variables.size)
    kind, whole = IntervalKind.OBSERVED_INFORMATION, compute_observed_information(optimum, policy)
    expected = optimum.evaluation.hessian / 2
    projector = eliminate(expected, wanted, first_states)
    expected_information = decompose_symmetric(_symmetrise(projector @ expected[:, wanted]))
    inverse = expected_information.pseudo_inverse
    observed = _invert_within(_reduce_information(whole, wanted, first_states), expected_information)
    if observed is None:
        kind, whole = IntervalKind.EXPECTED_INFORMATION, expected
    else:
        inverse, projector = observed, eliminate(whole, wanted, first_states)
    covariance, inflation = inverse.copy(), np.ones(n)
    innovations = optimum.cost.innovations()
    colour = estimate_residual_colour([(r, r) for r in innovations], 0, True, policy=policy, noise_policy=noise_policy)
    if colour.coloured:
        rows = [(np.ones((len(s), 1)), s[:, None, :]) for s in optimum.cost.scores()]
        covariance = raise_to_larger(
            inverse, inverse @ estimate_kernel_score_covariance(u, rows, colour, projector, policy) @ inverse
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            inflation[inside] = np.sqrt(np.diag(covariance) / np.diag(inverse))[:k]
        kind = IntervalKind.SANDWICH
    open_variance = np.where(expected_information.is_open, np.inf, np.diag(covariance))
    covariance[np.diag_indices_from(covariance)] = open_variance
    result, information = np.full((n, n), np.nan), np.full((n, n), np.nan)
    block, spans = np.ix_(inside, inside), u.variables.spans[inside]
    result[block] = covariance[:k, :k] * np.outer(spans, spans)
    data = whole - np.diag(np.pad(u.variables.penalty(u.variables.here)[2] / 2, (0, u.size - n)))
    information[block] = _reduce_information(data, inside, np.arange(n, u.size))
    names = [u.variables.names[j] for j in inside] + [""] * (len(wanted) - k)
    directions = list_open_directions(names, expected_information)
    noise = np.full(ny, np.nan)
    noise[u.estimated] = np.sqrt(np.diag(covariance)[k:])
    return LikelihoodCovariance(
        ParameterCovariance(result, directions, kind, inflation, np.inf, information, information), noise
    )


def compute_observed_information(optimum: LikelihoodOptimum, policy: IntervalPolicy) -> np.ndarray:
    """Half the Hessian (size, size) of ``-2 log L`` at the optimum; an experiment's first states concern it alone."""
    cost, u = optimum.cost, optimum.cost.unknowns
    expected = np.diag(optimum.evaluation.hessian) / 2
    steps = np.where(expected > 0, policy.difference_share / np.sqrt(np.maximum(expected, TINY)), 0.0)
    whole = np.zeros((u.size, u.size))
    each, n = len(u.variables.free_states), len(u.variables.which)
    for k in np.flatnonzero(steps):
        step = np.zeros(u.size)
        step[k] = min(steps[k], policy.longest_difference)
        concerned = [int(k - n) // each] if n <= k < u.variables.size else None
        whole[k] = (cost.gradient(step, concerned) - cost.gradient(-step, concerned)) / (4 * step[k])
    places = np.arange(n)
    whole[places, places] += u.variables.penalty(u.variables.here)[2] / 2
    return _symmetrise(whole)


def _reduce_information(information: np.ndarray, wanted: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Information on the ``wanted`` unknowns with the ``others`` estimated as well; what is not finite stays so."""
    if not np.isfinite(information).all():
        return np.full((len(wanted), len(wanted)), np.nan)
    return _symmetrise(eliminate(information, wanted, others) @ information[:, wanted])


def _invert_within(information: np.ndarray, expected: SymmetricDecomposition) -> np.ndarray | None:
    """The inverse of an information, zero along the weak directions of the expected one; None where it is not positive definite.

    Differences leave a little curvature along directions that have none: which these are, the exact expected information says.
    """
    if not np.isfinite(information).all():
        return None
    basis = expected.strong / expected.scale[:, None]
    values, vectors = np.linalg.eigh(_symmetrise(basis.T @ information @ basis))
    if values.min(initial=1.0) <= 0:
        return None
    strong = basis @ vectors
    return (strong / values) @ strong.T


def _symmetrise(matrix: np.ndarray) -> np.ndarray:
    """The symmetric part."""
    return (matrix + matrix.T) / 2
