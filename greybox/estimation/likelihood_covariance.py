"""Intervals of a prediction-error fit: from the observed information, or the sandwich where the innovations are not white."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from greybox.estimation.covariance import (
    SANDWICH,
    ParameterCovariance,
    invert_information,
    is_in_open_direction,
    raise_to_larger,
    to_direction,
)
from greybox.estimation.likelihood_search import LikelihoodOptimum
from greybox.estimation.sandwich import estimate_kernel_score_covariance, estimate_residual_colour

OBSERVED, EXPECTED = "observed_information", "expected_information"
# The gradient is differenced over this share of a standard deviation either way, and not further than so much in ``z``.
SHARE, LONGEST = 1e-2, 1e-2


@dataclass(frozen=True)
class LikelihoodCovariance:
    """``constants`` as `ParameterCovariance` has them; ``noise`` (ny,): standard deviation of the logarithm of each output's
    estimated noise,
    NaN where it was given.
    """

    constants: ParameterCovariance
    noise: np.ndarray


def estimate_likelihood_covariance(found: LikelihoodOptimum) -> LikelihoodCovariance:
    """Covariance of the constants and of the noise levels at the optimum, the first states estimated as well.

    The observed information is half the Hessian of ``-2 log L``, by central differences of its exact gradient; where it is not positive
    definite, the expected one. Where the innovations are correlated from sample to sample the model lacks something: then it is the
    sandwich ``A^-1 B A^-1`` with Newey and West's covariance ``B`` of the scores, which for a model that lacks nothing are martingale
    differences, but no standard deviation gets smaller by that. Constants at a bound count as fixed there.
    """
    u = found.cost.unknowns
    n, ny = len(u.variables.which), len(u.level)
    if not u.size or not found.status.success:
        return LikelihoodCovariance(ParameterCovariance(np.full((n, n), np.nan), ()), np.full(ny, np.nan))
    inside = np.flatnonzero(~u.variables.active)
    k = len(inside)
    wanted = np.concatenate([inside, np.arange(u.variables.size, u.size)])
    first_states = np.arange(n, u.variables.size)
    kind, whole = OBSERVED, compute_observed_information(found)
    expected = found.evaluation.hessian / 2
    projector = _projector(expected, wanted, first_states)
    inverse, weak, scale = invert_information(_both_ways(projector @ expected[:, wanted]))
    observed = _within(_reduced(whole, wanted, first_states), weak, scale)
    if observed is None:
        kind, whole = EXPECTED, expected
    else:
        inverse, projector = observed, _projector(whole, wanted, first_states)
    covariance, inflation = inverse.copy(), np.ones(n)
    innovations = found.cost.innovations()
    colour = estimate_residual_colour([(r, r) for r in innovations], 0, True)
    if colour.coloured:
        rows = [(np.ones((len(s), 1)), s[:, None, :]) for s in found.cost.scores()]
        covariance = raise_to_larger(
            inverse, inverse @ estimate_kernel_score_covariance(u, rows, colour, projector) @ inverse
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            inflation[inside] = np.sqrt(np.diag(covariance) / np.diag(inverse))[:k]
        kind = SANDWICH
    covariance[np.diag_indices_from(covariance)] = np.where(is_in_open_direction(weak), np.inf, np.diag(covariance))
    result, information = np.full((n, n), np.nan), np.full((n, n), np.nan)
    block, spans = np.ix_(inside, inside), u.variables.spans[inside]
    result[block] = covariance[:k, :k] * np.outer(spans, spans)
    data = whole - np.diag(np.pad(u.variables.penalty(np.zeros(u.variables.size))[2] / 2, (0, u.size - n)))
    information[block] = _reduced(data, inside, np.arange(n, u.size))
    names = [u.variables.names[j] for j in inside] + [""] * (len(wanted) - k)
    directions = tuple(to_direction(names, weak[:, j] / scale) for j in range(weak.shape[1]))
    noise = np.full(ny, np.nan)
    noise[u.estimated] = np.sqrt(np.diag(covariance)[k:])
    return LikelihoodCovariance(
        ParameterCovariance(result, directions, kind, inflation, np.inf, information, information), noise
    )


def compute_observed_information(found: LikelihoodOptimum) -> np.ndarray:
    """Half the Hessian (size, size) of ``-2 log L`` at the optimum; an experiment's first states concern it alone."""
    cost, u = found.cost, found.cost.unknowns
    expected = np.diag(found.evaluation.hessian) / 2
    steps = np.where(expected > 0, SHARE / np.sqrt(np.maximum(expected, 1e-300)), 0.0)
    whole = np.zeros((u.size, u.size))
    each, n = len(u.variables.free_states), len(u.variables.which)
    for k in np.flatnonzero(steps):
        step = np.zeros(u.size)
        step[k] = min(steps[k], LONGEST)
        own = [int(k - n) // each] if n <= k < u.variables.size else None
        whole[k] = (cost.gradient(step, own) - cost.gradient(-step, own)) / (4 * step[k])
    places = np.arange(n)
    whole[places, places] += u.variables.penalty(np.zeros(u.variables.size))[2] / 2
    return _both_ways(whole)


def _projector(information: np.ndarray, wanted: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Takes scores (size,) to those of the ``wanted`` unknowns with the ``others`` estimated as well: ``[I, -B C^-1]``."""
    result = np.zeros((len(wanted), len(information)))
    result[np.arange(len(wanted)), wanted] = 1.0
    if len(others):
        inverse = invert_information(information[np.ix_(others, others)])[0]
        result[:, others] = -information[np.ix_(wanted, others)] @ inverse
    return result


def _reduced(information: np.ndarray, wanted: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Information on the ``wanted`` unknowns with the ``others`` estimated as well; what is not finite stays so."""
    if not np.isfinite(information).all():
        return np.full((len(wanted), len(wanted)), np.nan)
    return _both_ways(_projector(information, wanted, others) @ information[:, wanted])


def _within(information: np.ndarray, weak: np.ndarray, scale: np.ndarray) -> np.ndarray | None:
    """The inverse of an information but for its ``weak`` directions, along which it is zero; None where it is not positive definite.

    Differences leave a little curvature along directions that have none: which these are, the exact expected information says.
    """
    if not np.isfinite(information).all():
        return None
    basis = np.linalg.svd(weak, full_matrices=True)[0][:, weak.shape[1] :] if weak.size else np.eye(len(scale))
    values, vectors = np.linalg.eigh(_both_ways(basis.T @ (information / np.outer(scale, scale)) @ basis))
    if values.min(initial=1.0) <= 0:
        return None
    strong = basis @ vectors
    return (strong / values) @ strong.T / np.outer(scale, scale)


def _both_ways(matrix: np.ndarray) -> np.ndarray:
    """The symmetric part."""
    return (matrix + matrix.T) / 2
