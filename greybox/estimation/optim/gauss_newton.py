"""Damped Gauss-Newton steps: the method where the quadratic model predicts well, and where an interior-point search has lost its way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from greybox.base.numerics import LOST_IN_ROUNDING, SUM_TO_ONE_WEIGHT, TINY
from greybox.estimation.optim.minimisation import (
    GaussNewtonPolicy,
    GradientSamplingPolicy,
    Minimisation,
    TerminationStatus,
)
from greybox.estimation.optim.quadratic_model import QuadraticModel

# Least factor on the damping after a step that gains what its quadratic model predicts (Nielsen 1999).
LARGEST_DECREASE: float = 1 / 3
# Share of the predicted decrease below which a step counts as badly predicted (Fletcher's lower ratio).
POOR_SHARE = 0.25
# Along a kink even a short step gains less than this share of what is predicted, because the gradient is that of one side.
KINK_SHARE = 0.1


def run_gauss_newton(
    search: Minimisation,
    low: np.ndarray,
    high: np.ndarray,
    policy: GaussNewtonPolicy,
    *,
    steps: int,
    project: Callable[[np.ndarray], np.ndarray] | None = None,
    while_predicted: bool = False,
    reach: np.ndarray | float = np.inf,
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
    reach
        The longest change of each unknown (n,) in one step.
    """
    damping, growth, last = policy.initial_damping, policy.damping_growth, search.steps + steps
    rejections = kink_steps = 0
    while search.steps < last:
        model, before = search.best_value, search.best_cost
        assert model is not None  # a search keeps its start
        if not model.is_finite:
            return False  # sensitivities overflow: there is no direction to go
        # (H + damping I) d = -g in scaled unknowns, within the bounds.
        room = np.maximum(low - search.best, -reach), np.minimum(high - search.best, reach)
        step = model.bounded_step(*room, damping)
        predicted = model.decrease_along(step)
        if predicted <= LOST_IN_ROUNDING * abs(before):
            search.status = TerminationStatus.CONVERGED
            return True
        search.shortenings = 0
        trial = np.clip(search.best + step, low, high)
        search.compare(trial if project is None else project(trial))
        # rho = actual over predicted decrease
        share = (before - search.best_cost) / predicted
        if share > 0:
            search.steps += 1
            # mu <- mu max(1/3, 1 - (2 rho - 1)^3) (Nielsen 1999); more than predicted counts as predicted.
            damping *= max(LARGEST_DECREASE, 1 - (2 * min(share, 1.0) - 1) ** 3)
            rejections, growth = 0, policy.damping_growth
            kink_steps = 0 if share > KINK_SHARE else kink_steps + 1
            if search.finish_iteration():
                return search.status is not None or search.stop
        else:
            # mu <- nu mu, nu <- 2 nu: each refusal in a row damps more, so that a wrong curvature is left behind
            # after few.
            damping, growth = damping * growth, 2 * growth
            rejections += 1
        if rejections == policy.max_rejections or kink_steps == policy.max_kink_steps:
            return False
        if while_predicted and share < POOR_SHARE:
            return False
    search.status = TerminationStatus.ITERATION_LIMIT
    return True


# Gradient sampling: a descent direction at a point where the gradient misleads, because the cost has a kink there.


# Share of the cost that a round has to gain; otherwise the next radius follows.
LEAST_GAIN = 0.0001
# Rounds at each radius; every round evaluates twice as many points as there are unknowns.
MAX_ROUNDS = 6


def run_gradient_sampling(
    search: Minimisation, low: np.ndarray, high: np.ndarray, policy: GradientSamplingPolicy
) -> TerminationStatus:
    """Gradient sampling (Burke, Lewis, Overton 2005) from the best point, in the metric of its Gauss-Newton matrix.

    The gradients on both sides of a kink cancel across it; their shortest convex combination points along it, downhill.
    `TerminationStatus.KINK` where neither that direction nor any sampled point gains anything any more.
    """
    gained = True
    for radius in policy.radii:
        for _ in range(MAX_ROUNDS):
            before = search.best_cost
            value = search.best_value
            assert value is not None  # a search keeps its start
            if not value.is_finite:
                return TerminationStatus.STUCK  # sensitivities overflow: there are no axes to sample along
            directions, curvature = value.principal_axes()
            # d'Hd / 2 = radius cost along each axis: one step in each row, in the units of the unknowns.
            axes = (directions / np.sqrt(0.5 * curvature)).T / value.scale * np.sqrt(radius * value.cost)
            direction = _find_descent_direction(search, axes, low, high)
            if direction is not None:
                _search_line(search, direction @ axes, low, high)
            if search.stop:
                return TerminationStatus.INTERRUPTED
            # The radius is kept while it gains: a smaller one sees only one side of the kink.
            gained = search.best_cost < before * (1 - LEAST_GAIN)
            if not gained:
                break
    return TerminationStatus.ACCEPTABLE if gained else TerminationStatus.KINK


def _evaluate(search: Minimisation, z: np.ndarray, low: np.ndarray, high: np.ndarray) -> QuadraticModel:
    search.shortenings = 0
    value = search(np.clip(z, low, high))
    # A round has twice as many points as there are unknowns: of a stiff model with many they take minutes.
    search.report_progress()
    return value


# The largest gradient has size one. A convex combination as short as this is rounding, whose direction says nothing and is another one
# in each version of SciPy.
CANCELLED_GRADIENTS = 1e-6


def _find_descent_direction(
    search: Minimisation, axes: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray | None:
    """Minus the shortest convex combination of the gradients around the best point, along the axes, of length one.

    None where the gradients cancel: within this radius no direction leads downhill. And where the search is to stop.
    """
    from scipy.optimize import lsq_linear, nnls  # slow to import, and a smooth cost does not need it

    centre = search.best
    # Gradients along the axes, where the cost has the same curvature in every direction: the shortest combination
    # depends on the metric.
    gradients = [axes @ search.best_value.gradient]  # type: ignore[union-attr]
    for step in (*axes, *-axes):
        if search.stop:
            return None
        value = _evaluate(search, centre + step, low, high)
        with np.errstate(over="ignore", invalid="ignore"):  # of a run about to overflow
            slope = axes @ value.gradient
        if np.isfinite(value.cost) and np.isfinite(slope).all():
            gradients.append(slope)
    sampled = np.array(gradients).T / max(np.abs(gradients).max(), TINY)
    sum_to_one = np.full(sampled.shape[1], SUM_TO_ONE_WEIGHT)
    # min |G w| with w >= 0, sum w = 1: the sum as one heavily weighted row of the least squares.
    rows, target = np.vstack([sampled, sum_to_one]), np.append(np.zeros(len(axes)), SUM_TO_ONE_WEIGHT)
    try:
        weights, _ = nnls(rows, target)
    # SciPy 1.12 to 1.14, where gradients are nearly alike: its active set goes round in circles, or its equations are singular.
    except (RuntimeError, np.linalg.LinAlgError):
        weights = lsq_linear(rows, target, bounds=(0, np.inf), method="bvls").x
    shortest = sampled @ weights
    length = float(np.linalg.norm(shortest))
    return None if length < CANCELLED_GRADIENTS else -shortest / length


# Factors by which a step that gains is lengthened while that helps.
GRADIENT_SAMPLING_LONGER: tuple[float, ...] = (2.0, 4.0, 8.0)
# Factors by which a step that gains nothing is shortened until it gains.
GRADIENT_SAMPLING_SHORTER: tuple[float, ...] = (0.5, 0.25, 0.1)


def _search_line(search: Minimisation, step: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
    """Lengthen a step while that helps, or shorten it until it does."""
    start, before = search.best, search.best_cost
    for factor in (1.0, *GRADIENT_SAMPLING_LONGER):
        if not _evaluate(search, start + factor * step, low, high).cost <= search.best_cost:
            break
    if search.best_cost < before:
        return
    for factor in GRADIENT_SAMPLING_SHORTER:
        if _evaluate(search, start + factor * step, low, high).cost < before:
            return
