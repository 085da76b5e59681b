"""A search for a point where the gradient misleads, because the cost has a kink there."""

from __future__ import annotations

from typing import Any

import numpy as np

from greybox.optim.minimisation import Minimisation
from greybox.optim.status import TerminationStatus

# Gradients are sampled where a smooth cost would rise by these shares of itself; a round must gain so much, or the next share comes.
AROUND, GAIN, ROUNDS = (1e-2, 1e-3, 1e-4), 1e-4, 6
LONGER, SHORTER = (2.0, 4.0, 8.0), (0.5, 0.25, 0.1)
HEAVY = 1e3  # how strictly weights add up to one


def run_gradient_sampling(search: Minimisation, low: np.ndarray, high: np.ndarray) -> TerminationStatus:
    """Gradient sampling (Burke, Lewis, Overton 2005) from the best point, in the metric of its Gauss-Newton matrix.

    The gradients on both sides of a kink cancel across it; the shortest convex combination of them points along it, downhill.
    `TerminationStatus.KINK` where neither that direction nor any sampled point gains anything any more.
    """
    gained = True
    for share in AROUND:
        for _ in range(ROUNDS):
            before = search.best_cost
            axes = _axes(search.best_value, share)
            direction = _downhill(search, axes, low, high)
            _along(search, direction @ axes, low, high)
            if search.stop:
                return TerminationStatus.INTERRUPTED
            gained = search.best_cost < before * (1 - GAIN)
            if not gained:
                break
    return TerminationStatus.ACCEPTABLE if gained else TerminationStatus.KINK


def _ask(search: Minimisation, z: np.ndarray, low: np.ndarray, high: np.ndarray) -> Any:
    search.shortenings = 0
    return search(np.clip(z, low, high))


def _downhill(search: Minimisation, axes: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Minus the shortest convex combination of the gradients around the best point, along the axes, of length one."""
    from scipy.optimize import nnls  # slow to import, and a smooth cost does not need it

    centre = search.best
    gradients = [axes @ search.best_value.gradient]  # type: ignore[union-attr]
    for step in (*axes, *-axes):
        value = _ask(search, centre + step, low, high)
        if np.isfinite(value.cost):
            gradients.append(axes @ value.gradient)
    sampled = np.array(gradients).T / max(np.abs(gradients).max(), 1e-300)
    weights, _ = nnls(np.vstack([sampled, np.full(sampled.shape[1], HEAVY)]), np.append(np.zeros(len(axes)), HEAVY))
    shortest = sampled @ weights
    return -shortest / max(float(np.linalg.norm(shortest)), 1e-300)


def _along(search: Minimisation, step: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
    """Lengthen a step while that helps, or shorten it until it does."""
    begin, before = search.best, search.best_cost
    for factor in (1.0, *LONGER):
        if not _ask(search, begin + factor * step, low, high).cost <= search.best_cost:
            break
    if search.best_cost < before:
        return
    for factor in SHORTER:
        if _ask(search, begin + factor * step, low, high).cost < before:
            return


def _axes(value: Any, share: float) -> np.ndarray:
    """Steps (k, n), one in each row, along which the quadratic part of the cost is ``share`` of the cost."""
    scale = np.sqrt(np.maximum(np.diag(value.hessian), 1e-300))
    curvature, vectors = np.linalg.eigh(value.hessian / np.outer(scale, scale))
    usable = curvature > 1e-12 * curvature.max()
    return (vectors[:, usable] / np.sqrt(0.5 * curvature[usable])).T / scale * np.sqrt(share * value.cost)
