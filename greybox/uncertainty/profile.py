"""Profile likelihood: how much worse the best fit becomes when one constant is held elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from greybox.errors import ModelError, nearest
from greybox.estimation.covariance import compute_quantile, estimate_covariance
from greybox.estimation.restore import restore_options, restore_problem
from greybox.estimation.restore_likelihood import restore_likelihood
from greybox.estimation.solve import Solution, solve
from greybox.result import Fit
from greybox.transcription import DecisionVector
from greybox.transcription.decision_vector import SHARED
from greybox.uncertainty.likelihood_profile import HeldLikelihood

# First step in standard deviations, growth of the following ones, at most so many to a side.
FIRST, GROWTH, STEPS = 1.0, 1.6, 9
# The crossing is found to this share of the threshold, with at most so many refits.
CLOSE, REFITS = 0.01, 8


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile of one constant.

    ``values`` (k,), increasing, in ``unit``, and ``increase`` (k,): the rise of the minimal cost over its scale, which for a
    well-determined constant is ``((value - best) / std)^2``. ``interval``: where it stays below ``threshold`` (the squared 95 % point);
    an end is the constant's bound, or infinite, where the rise never reaches it: the data leave that side open.
    """

    name: str
    unit: str
    best: float
    values: np.ndarray
    increase: np.ndarray
    threshold: float
    interval: tuple[float, float]

    @property
    def open_sides(self) -> tuple[bool, bool]:
        """Whether the rise stays below the threshold downwards and upwards as far as it was followed."""
        return bool(self.increase[0] < self.threshold), bool(self.increase[-1] < self.threshold)

    def __str__(self) -> str:
        sides = [f"{v:.5g}{' (open)' if o else ''}" for v, o in zip(self.interval, self.open_sides, strict=True)]
        return f"{self.name}: {self.best:.5g} {self.unit}, 95 % by profile likelihood [{sides[0]}, {sides[1]}]"


def profile(fit: Fit, name: str) -> Profile:
    """Profile likelihood interval of the free constant ``name``, by refits of everything else from the neighbouring point.

    ``2 log(L max / L(value)) = (cost(value) - cost min) / s^2`` stays below the 95 % point of chi-square with one degree of freedom
    (of F, where ``s^2`` was estimated). ``s^2`` is the one with which curvature and variance agree at the optimum: the variance of the
    residual where that is white, and as much more as the stated variance is larger where it is coloured, the loss is robust, or
    the constant has a prior (Chandler and Bate, Biometrika 94, 2007). Of a fit with process noise it is the likelihood of its
    predictions. Of a constant that experiments have for themselves each value has a profile of its own, ``profile(fit, "B (day 1)")``.
    Some 10 to 20 refits.

    Raises ModelError for a constant that was not fitted, FitError for a fit that did not succeed.
    """
    if fit.prediction.process_noise:
        return _of_predictions(fit, name)
    problem = restore_problem(fit)
    v = problem.variables
    _check(name, v)
    shooting = problem.shooting(v)
    z = np.zeros(v.size)
    evaluation = shooting.evaluate(z)
    found = estimate_covariance(v, evaluation, problem.noise.known, shooting.residuals(z), least=problem.least)
    k = v.names.index(name)
    variance = found.covariance[k, k]
    std = float(np.sqrt(variance)) if np.isfinite(variance) else None
    scale = evaluation.cost / max(evaluation.count - v.size, 1)
    scale = max(scale, 1.0) if problem.noise.known else scale
    if std is not None and found.information is not None:
        inside = np.flatnonzero(~v.active)
        whole = found.information[np.ix_(inside, inside)] + np.diag(v.penalty(z)[2][inside] / 2)
        place = int(np.searchsorted(inside, k))
        scale = float(variance / v.spans[k] ** 2 / np.linalg.pinv(whole, hermitian=True)[place, place])
    search = _Search(fit, v, k, evaluation.cost, scale)
    return _followed(search, v, name, std, compute_quantile(found.degrees) ** 2)


def _of_predictions(fit: Fit, name: str) -> Profile:
    """The profile of a constant of a fit with process noise; ``s`` is what coloured innovations widen its standard deviation by."""
    if name in fit.model.noise_parameters and fit.model.values[name] == 0:
        raise ModelError(
            f"profile of {name!r}: its most likely value is zero, and its interval in the fit is its profile's limit already"
        )
    cost = restore_likelihood(fit)
    v = cost.unknowns.variables
    _check(name, v)
    k = v.names.index(name)
    owner = name[len(v.quantities[k].name) + 2 : -1]
    stated = fit.constraints.per_experiment[v.quantities[k].name][owner] if owner else fit.parameters[name]
    widened = fit.uncertainty.inflation.get(name, 1.0)
    scale = widened**2 if np.isfinite(widened) else 1.0
    return _followed(HeldLikelihood(cost, k, cost.cost(), scale), v, name, stated.std, compute_quantile(np.inf) ** 2)


def _check(name: str, v: DecisionVector) -> None:
    if name not in v.names:
        raise ModelError(f"profile of {name!r}: not a fitted constant; {nearest(name, v.names)}")


class _Refits(Protocol):
    """Refits with one constant held."""

    def rise(self, value: float, near: DecisionVector | None) -> tuple[float, DecisionVector]:
        """Rise of the minimal cost with the constant at ``value``, and where; begun at ``near``."""


def _followed(search: _Refits, v: DecisionVector, name: str, std: float | None, threshold: float) -> Profile:
    k = v.names.index(name)
    quantity, best = v.quantities[k], float(v.base[k])
    low, points_low = _side(search, best, std, quantity.positive, quantity.bounds[0], -1, threshold)
    high, points_high = _side(search, best, std, quantity.positive, quantity.bounds[1], +1, threshold)
    points = sorted([*points_low, (best, 0.0), *points_high])
    values, increase = np.array(points).T
    return Profile(name, quantity.unit, best, values, increase, threshold, (low, high))


class _Search:
    """Refits with one constant held, each begun at the last."""

    def __init__(self, fit: Fit, variables: DecisionVector, k: int, least: float, scale: float) -> None:
        self.fit, self.name, self.least, self.scale = fit, variables.quantities[k].name, least, scale
        self.owner, (self.mean, self.std) = int(variables.owner[k]), variables.prior[k]
        self.options = restore_options(fit)

    def rise(self, value: float, near: DecisionVector | None) -> tuple[float, DecisionVector]:
        """Rise of the minimal cost with the constant at ``value``; infinite where there is no fit."""
        if self.owner == SHARED:
            problem = restore_problem(self.fit, self.fit.model.fix(**{self.name: value}))
        else:
            problem = restore_problem(self.fit, held={self.owner: {self.name: value}})
        if near is not None:
            fixed = near.fixed.copy()
            fixed[list(problem.model.values).index(self.name)] = value
            conditions = problem.variables.conditions
            problem = replace(problem, variables=replace(near, model=problem.model, fixed=fixed, conditions=conditions))
        solution: Solution = solve(problem, self.options)
        cost = solution.evaluation.cost + ((value - self.mean) / self.std) ** 2
        return (max(cost - self.least, 0.0) / self.scale if np.isfinite(cost) else np.inf), solution.variables


def _side(
    search: _Refits, best: float, std: float | None, positive: bool, bound: float, sign: int, threshold: float
) -> tuple[float, list[tuple[float, float]]]:
    """Where the rise crosses the threshold on one side, and the points visited."""

    def place(step: float) -> float:
        value = best * float(np.exp(np.clip(sign * step / abs(best), -300, 300))) if positive else best + sign * step
        return max(value, bound) if sign < 0 else min(value, bound)

    points: list[tuple[float, float]] = []
    if best == bound:
        return bound, points
    # A step so large that a constant without a standard deviation is tried over a factor of e^0.1 first.
    step = FIRST * (std if std is not None and std > 0 else 0.1 * (abs(best) or 1.0))
    inner, near = (0.0, 0.0), None
    for _ in range(STEPS):
        value = place(step)
        rise, near = search.rise(value, near)
        points.append((value, rise))
        if rise > threshold:
            return _crossing(search, place, inner, (step, rise), near, threshold, points), points
        if value == bound:
            return bound, points
        inner, step = (step, rise), GROWTH * step
    return (bound if np.isfinite(bound) else sign * np.inf), points


def _crossing(
    search: _Refits,
    place: Callable[[float], float],
    inner: tuple[float, float],
    outer: tuple[float, float],
    near: DecisionVector,
    threshold: float,
    points: list[tuple[float, float]],
) -> float:
    """The value between two steps where the rise meets the threshold: regula falsi on its square root, which is nearly straight."""
    for k in range(REFITS):
        (a, fa), (b, fb) = inner, outer
        ra, rb = np.sqrt(fa), np.sqrt(fb) if np.isfinite(fb) else np.inf
        step = (
            a + (b - a) * (np.sqrt(threshold) - ra) / (rb - ra) if np.isfinite(rb) and k < REFITS - 2 else (a + b) / 2
        )
        rise, near = search.rise(place(step), near)
        points.append((place(step), rise))
        if abs(rise - threshold) <= CLOSE * threshold:
            return place(step)
        inner, outer = ((step, rise), outer) if rise < threshold else (inner, (step, rise))
    return place(outer[0])
