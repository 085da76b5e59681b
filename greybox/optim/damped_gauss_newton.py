"""Damped Gauss-Newton steps from the best point, where an interior-point search has lost its way."""

from __future__ import annotations

import numpy as np

from greybox.numerics import LOST_IN_ROUNDING, SINGULAR_CURVATURE, TINY
from greybox.optim.minimisation import Minimisation
from greybox.optim.policy import DampedGaussNewtonPolicy
from greybox.optim.status import TerminationStatus


def run_damped_gauss_newton(
    search: Minimisation, low: np.ndarray, high: np.ndarray, policy: DampedGaussNewtonPolicy
) -> bool:
    """Levenberg and Marquardt's steps from the best point, until the termination test of ``search`` ends it; whether it did.

    An interior-point method that begins close to the optimum may follow its barrier away from it for many iterations, and one that
    begins far away on a nearly singular curvature may find no step at all: both look like steps that are shortened for nothing.
    Where the gradient is right, a damped step gains at once. False where none does, or several gain little: the cost has a kink there.
    """
    damping, rejections, kink_steps = policy.initial_damping, 0, 0
    for _ in range(policy.max_steps):
        if not np.isfinite(search.best_value.hessian).all():  # type: ignore[union-attr]
            return False  # sensitivities overflow: there is no direction to go
        before, step = search.best_cost, _damped_step(search, damping, low, high)
        predicted = _predict_decrease(search, step)
        if predicted <= LOST_IN_ROUNDING * before:
            search.status = TerminationStatus.CONVERGED
            return True
        search.shortenings = 0
        search(np.clip(search.best + step, low, high))
        share = (before - search.best_cost) / predicted
        if share > policy.good_share:
            damping *= policy.decrease
        elif share < policy.poor_share:
            damping = max(damping, policy.initial_damping) * policy.increase
        is_accepted = search.best_cost < before
        if is_accepted:
            rejections, kink_steps = 0, 0 if share > policy.kink_share else kink_steps + 1
            if search.finish_iteration():
                return search.status is not None or search.stop
            if kink_steps == policy.max_kink_steps:
                return False
        else:
            rejections += 1
            if rejections == policy.max_rejections:
                return False
    return False


def _predict_decrease(search: Minimisation, step: np.ndarray) -> float:
    """By how much the quadratic model at the best point falls along ``step``."""
    value = search.best_value
    assert value is not None  # a search keeps its start
    return -float(value.gradient @ step) - 0.5 * float(step @ value.hessian @ step)


def _damped_step(search: Minimisation, damping: float, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """``-(H + damping diag H)^-1 g`` over the unknowns that are not held at a bound."""
    z, value = search.best, search.best_value
    assert value is not None  # a search keeps its start
    free = ~((z <= low) & (value.gradient > 0) | (z >= high) & (value.gradient < 0))
    curvature = value.hessian[np.ix_(free, free)]
    scale = np.sqrt(np.maximum(np.diag(curvature), TINY))
    damped = curvature / np.outer(scale, scale) + damping * np.eye(int(free.sum()))
    step = np.zeros(len(z))
    step[free] = -np.linalg.lstsq(damped, value.gradient[free] / scale, rcond=SINGULAR_CURVATURE)[0] / scale
    return step
