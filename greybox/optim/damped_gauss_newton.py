"""Damped Gauss-Newton steps from the best point, where an interior-point search has lost its way."""

from __future__ import annotations

import numpy as np

from greybox.optim.minimisation import Minimisation
from greybox.optim.status import TerminationStatus

# Damping begins at this share of the curvature; it falls after a step that gains nearly what its quadratic model says, and grows after
# one that gains little of it or nothing.
DAMPING, EASIER, HARDER = 1e-6, 0.1, 10.0
NEARLY, LITTLE = 0.75, 0.25
STEPS, REFUSED = 50, 8
# Along a kink even a short step gains much less than it promises: so many such steps in a row are enough.
POOR, POORLY = 0.1, 6
# A step that promises to lower the cost by less than this share of it is lost in rounding errors.
NOTHING = 1e-13


def run_damped_gauss_newton(search: Minimisation, low: np.ndarray, high: np.ndarray) -> bool:
    """Levenberg and Marquardt's steps from the best point, until the rule of ``search`` ends it; whether it did.

    An interior-point method that begins close to the optimum may follow its barrier away from it for many iterations, and one that
    begins far away on a nearly singular curvature may find no step at all: both look like steps that are shortened for nothing.
    Where the gradient is right, a damped step gains at once. False where none does, or several gain little: the cost has a kink there.
    """
    damping, refused, poor = DAMPING, 0, 0
    for _ in range(STEPS):
        if not np.isfinite(search.best_value.hessian).all():  # type: ignore[union-attr]
            return False  # sensitivities overflow: there is no direction to go
        before, step = search.best_cost, _step(search, damping, low, high)
        promised = _promised(search, step)
        if promised <= NOTHING * before:
            search.done = TerminationStatus.CONVERGED
            return True
        search.shortenings = 0
        search(np.clip(search.best + step, low, high))
        share = (before - search.best_cost) / promised
        if share > NEARLY:
            damping *= EASIER
        elif share < LITTLE:
            damping = max(damping, DAMPING) * HARDER
        if search.best_cost < before:
            refused, poor = 0, 0 if share > POOR else poor + 1
            if search.iterated():
                return search.done is not None or search.stop
            if poor == POORLY:
                return False
        else:
            refused += 1
            if refused == REFUSED:
                return False
    return False


def _promised(search: Minimisation, step: np.ndarray) -> float:
    """By how much the quadratic model at the best point falls along ``step``."""
    value = search.best_value
    assert value is not None  # a search keeps its start
    return -float(value.gradient @ step) - 0.5 * float(step @ value.hessian @ step)


def _step(search: Minimisation, damping: float, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """``-(H + damping diag H)^-1 g`` over what is not held at a bound."""
    z, value = search.best, search.best_value
    assert value is not None  # a search keeps its start
    inside = ~((z <= low) & (value.gradient > 0) | (z >= high) & (value.gradient < 0))
    curvature = value.hessian[np.ix_(inside, inside)]
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    scaled = curvature / np.outer(scale, scale) + damping * np.eye(int(inside.sum()))
    step = np.zeros(len(z))
    step[inside] = -np.linalg.lstsq(scaled, value.gradient[inside] / scale, rcond=1e-13)[0] / scale
    return step
