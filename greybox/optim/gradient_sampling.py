"""Gradient sampling: a descent direction at a point where the gradient misleads, because the cost has a kink there."""

from __future__ import annotations

import numpy as np

from greybox.numerics import SUM_TO_ONE_WEIGHT, TINY
from greybox.optim.minimisation import Minimisation
from greybox.optim.policy import GradientSamplingPolicy
from greybox.optim.quadratic_model import QuadraticModel
from greybox.optim.status import TerminationStatus


def run_gradient_sampling(
    search: Minimisation, low: np.ndarray, high: np.ndarray, policy: GradientSamplingPolicy
) -> TerminationStatus:
    """Gradient sampling (Burke, Lewis, Overton 2005) from the best point, in the metric of its Gauss-Newton matrix.

    The gradients on both sides of a kink cancel across it; their shortest convex combination points along it, downhill.
    `TerminationStatus.KINK` where neither that direction nor any sampled point gains anything any more.
    """
    gained = True
    for radius in policy.radii:
        for _ in range(policy.max_rounds):
            before = search.best_cost
            axes = _sampling_axes(search.best_value, radius)  # type: ignore[arg-type]
            direction = _find_descent_direction(search, axes, low, high)
            _search_line(search, direction @ axes, low, high, policy)
            if search.stop:
                return TerminationStatus.INTERRUPTED
            gained = search.best_cost < before * (1 - policy.least_gain)
            if not gained:
                break
    return TerminationStatus.ACCEPTABLE if gained else TerminationStatus.KINK


def _evaluate(search: Minimisation, z: np.ndarray, low: np.ndarray, high: np.ndarray) -> QuadraticModel:
    search.shortenings = 0
    return search(np.clip(z, low, high))


def _find_descent_direction(search: Minimisation, axes: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Minus the shortest convex combination of the gradients around the best point, along the axes, of length one."""
    from scipy.optimize import nnls  # slow to import, and a smooth cost does not need it

    centre = search.best
    gradients = [axes @ search.best_value.gradient]  # type: ignore[union-attr]
    for step in (*axes, *-axes):
        value = _evaluate(search, centre + step, low, high)
        if np.isfinite(value.cost):
            gradients.append(axes @ value.gradient)
    sampled = np.array(gradients).T / max(np.abs(gradients).max(), TINY)
    sum_to_one = np.full(sampled.shape[1], SUM_TO_ONE_WEIGHT)
    weights, _ = nnls(np.vstack([sampled, sum_to_one]), np.append(np.zeros(len(axes)), SUM_TO_ONE_WEIGHT))
    shortest = sampled @ weights
    return -shortest / max(float(np.linalg.norm(shortest)), TINY)


def _search_line(
    search: Minimisation, step: np.ndarray, low: np.ndarray, high: np.ndarray, policy: GradientSamplingPolicy
) -> None:
    """Lengthen a step while that helps, or shorten it until it does."""
    start, before = search.best, search.best_cost
    for factor in (1.0, *policy.longer):
        if not _evaluate(search, start + factor * step, low, high).cost <= search.best_cost:
            break
    if search.best_cost < before:
        return
    for factor in policy.shorter:
        if _evaluate(search, start + factor * step, low, high).cost < before:
            return


def _sampling_axes(value: QuadraticModel, radius: float) -> np.ndarray:
    """Steps (k, n), one in each row, along which the quadratic part of the cost is ``radius`` times the cost."""
    axes, curvature = value.principal_axes()
    return np.asarray((axes / np.sqrt(0.5 * curvature)).T / value.scale * np.sqrt(radius * value.cost))
