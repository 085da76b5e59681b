"""Damped Gauss-Newton steps: the method where the quadratic model predicts well, and where an interior-point search has lost its way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from greybox.numerics import LOST_IN_ROUNDING
from greybox.optim.minimisation import Minimisation
from greybox.optim.policy import GaussNewtonPolicy
from greybox.optim.status import TerminationStatus


def run_gauss_newton(
    search: Minimisation,
    low: np.ndarray,
    high: np.ndarray,
    policy: GaussNewtonPolicy,
    *,
    steps: int,
    project: Callable[[np.ndarray], np.ndarray] | None = None,
    while_predicted: bool = False,
) -> bool:
    """Levenberg and Marquardt's steps from the best point, damped after Nielsen (1999) by the actual over the predicted decrease, until
    the termination test of ``search`` ends it; whether it did.

    An interior-point method that begins close to the optimum may follow its barrier away from it for many iterations, and one that
    begins far away on a nearly singular curvature may find no step at all: both look like steps that are shortened for nothing.
    Where the gradient is right, a damped step gains at once. False where none does, or several gain little: the cost has a kink there.

    Parameters
    ----------
    search
        The minimisation: its best point, and when it ends.
    low, high
        Bounds (n,).
    policy
        How the damping adapts, and when the steps give up.
    steps
        The most steps that gain; a search that takes them all ends at its iteration limit.
    project
        Maps a point (n,) to the nearest allowed one, where bounds do not say what is allowed.
    while_predicted
        Give up at the first step that gains little of what is predicted.
    """
    damping, growth, last = policy.initial_damping, policy.damping_growth, search.steps + steps
    rejections = kink_steps = 0
    while search.steps < last:
        model, before = search.best_value, search.best_cost
        assert model is not None  # a search keeps its start
        if not model.is_finite:
            return False  # sensitivities overflow: there is no direction to go
        step = model.bounded_step(low - search.best, high - search.best, damping)
        predicted = model.decrease_along(step)
        if predicted <= LOST_IN_ROUNDING * abs(before):
            search.status = TerminationStatus.CONVERGED
            return True
        search.shortenings = 0
        trial = np.clip(search.best + step, low, high)
        search.compare(trial if project is None else project(trial))
        share = (before - search.best_cost) / predicted
        if share > 0:
            search.steps += 1
            damping *= max(policy.largest_decrease, 1 - (2 * min(share, 1.0) - 1) ** 3)
            rejections, growth = 0, policy.damping_growth
            kink_steps = 0 if share > policy.kink_share else kink_steps + 1
            if search.finish_iteration():
                return search.status is not None or search.stop
        else:
            damping, growth = damping * growth, 2 * growth
            rejections += 1
        if rejections == policy.max_rejections or kink_steps == policy.max_kink_steps:
            return False
        if while_predicted and share < policy.poor_share:
            return False
    search.status = TerminationStatus.ITERATION_LIMIT
    return True
