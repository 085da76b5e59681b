"""Intensities of process noise: from which to start, whether zero would do as well, and how large one may be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.special import chdtrc

from greybox.estimation.objective import PredictionErrorObjective
from greybox.estimation.objective_search import (
    LikelihoodMaximum,
    hold_parameters,
    raise_noise_to_innovations,
    refine_minimum,
    search_minimum,
    select_best_start,
    start_at,
)
from greybox.estimation.options import FitOptions
from greybox.estimation.policy import ProcessNoisePolicy
from greybox.model import Model
from greybox.result import Estimate


@dataclass(frozen=True)
class ProcessNoiseTest:
    """One intensity of process noise as a fit found it.

    ``ratio``: likelihood ratio, twice the gain of the logarithm over zero intensity; ``p_value``: how often chance alone gives so
    much; ``significant``: whether the records show process noise; ``limits``: one-sided 95 % limit
    (0, upper) where it is not significant, else None.
    """

    name: str
    value: float
    ratio: float
    p_value: float
    significant: bool = False
    limits: tuple[float, float] | None = None


def compute_largest_intensities(model: Model, steps: np.ndarray) -> dict[str, float]:
    """For each intensity the one that would explain the movement of its states by chance alone.

    ``steps`` (nx,): root mean square of the states' change from row to row over the root of the interval.
    """
    system = model.system
    p = np.array(list(model.values.values()))
    by_p = ca.Function("noise", [system.p], [ca.jacobian(system.diffusion, system.p)])(p).full()
    largest = {}
    for name in model.noise_parameters:
        slope = np.abs(by_p[:, list(model.values).index(name)])
        with np.errstate(divide="ignore", invalid="ignore"):
            each = steps[slope > 0] / slope[slope > 0]
        each = each[np.isfinite(each) & (each > 0)]
        largest[name] = float(each.min()) if len(each) else 1.0
    return largest


def guess_intensities(
    cost: PredictionErrorObjective,
    names: Sequence[str],
    sizes: Mapping[str, float],
    policy: ProcessNoisePolicy,
) -> PredictionErrorObjective:
    """``cost`` with ``z = 0`` at the most likely of some start values of the intensities ``names``, the other unknowns as they are.

    All of them together first, then each by itself.
    """
    # Shares of the intensity that would explain every movement of a state by chance.
    shares = 10.0 ** np.arange(0.0, -(policy.start_decades + 0.1), -policy.start_spacing)
    together = [start_at(cost, {n: share * sizes[n] for n in names}) for share in shares]
    cost = select_best_start([cost, *together])
    for name in names if len(names) > 1 else ():
        cost = select_best_start([cost, *(start_at(cost, {name: share * sizes[name]}) for share in shares)])
    return cost


def drop_insignificant(
    optimum: LikelihoodMaximum, names: Sequence[str], options: FitOptions
) -> tuple[LikelihoodMaximum, tuple[str, ...]]:
    """The optimum with every intensity at zero for which that is as likely, and their names."""
    zero: list[str] = []
    for name in names:
        near = refine_minimum(remove_process_noise(optimum.objective, name), options)
        if near.evaluation.cost <= optimum.evaluation.cost + options.policy.process_noise.negligible_decrease:
            # Each by itself: of two intensities that stand for one another either can be zero, not both.
            zero.append(name)
            optimum = search_minimum(near.objective, options)
    return optimum, tuple(zero)


def remove_process_noise(cost: PredictionErrorObjective, name: str) -> PredictionErrorObjective:
    """``cost`` without process noise of the intensity ``name``."""
    return hold_parameters(cost, {name: 0.0})


def likelihood_ratio_tests(
    optimum: LikelihoodMaximum,
    names: Sequence[str],
    zero: Sequence[str],
    sizes: Mapping[str, float],
    options: FitOptions,
) -> tuple[ProcessNoiseTest, ...]:
    """Each intensity with its likelihood ratio against zero, everything else estimated anew."""
    if not optimum.status.success:
        return ()
    policy, variables = options.policy.process_noise, optimum.objective.variables
    p = variables.parameters(variables.here)
    values = dict(zip((q.name for q in variables.model.all_parameters), p, strict=True))
    tests = []
    for name in names:
        if name in zero:
            upper = find_upper_limit(optimum, name, policy.floor * sizes[name], options)
            tests.append(ProcessNoiseTest(name, 0.0, 0.0, 1.0, limits=(0.0, upper)))
            continue
        rest = search_minimum(raise_noise_to_innovations(remove_process_noise(optimum.objective, name)), options)
        ratio = max(rest.evaluation.cost - optimum.evaluation.cost, 0.0)
        p_value = 0.5 * float(chdtrc(1, ratio))
        limited = ratio < policy.limit_ratio
        limits = (0.0, find_upper_limit(optimum, name, values[name], options)) if limited else None
        tests.append(ProcessNoiseTest(name, values[name], ratio, p_value, p_value < policy.significance, limits))
    return tuple(tests)


def find_upper_limit(optimum: LikelihoodMaximum, name: str, begin: float, options: FitOptions) -> float:
    """The intensity from which on ``-2 log L`` exceeds its minimum by the one-sided 95 % point, the other unknowns estimated anew.

    ``begin`` is one that does not.
    """
    policy = options.policy.process_noise
    limit, tolerance = policy.limit_ratio, policy.limit_tolerance * policy.limit_ratio
    enough = replace(options.policy.likelihood_search.termination, negligible_decrease=tolerance)
    least = optimum.evaluation.cost
    near, low, high = optimum.objective, begin, np.inf
    value = begin
    # With the other unknowns held the cost rises at least as fast: up to there the limit is not reached.
    while value < begin / policy.floor and hold_parameters(near, {name: value}).cost() - least < limit:
        low, value = value, policy.limit_growth * value
    for _ in range(policy.limit_steps):
        trial = refine_minimum(hold_parameters(near, {name: value}), options, enough)
        rise = trial.evaluation.cost - least
        if abs(rise - limit) <= tolerance:
            break
        if trial.status.success:
            near = trial.objective
        low, high = (value, high) if rise < limit else (low, value)
        value = policy.limit_growth * value if np.isinf(high) else float(np.sqrt(low * high))
    return value


def set_intensity_limits(parameters: Mapping[str, Estimate], tests: Sequence[ProcessNoiseTest]) -> dict[str, Estimate]:
    """Intensities that are zero, or not certainly more, with their limit in place of an interval that cannot reach zero."""
    limited = dict(parameters)
    for test in tests:
        if test.value == 0:
            limited[test.name] = Estimate(0.0, parameters[test.name].unit, None, test.limits, False, True)
        elif test.limits is not None:
            limited[test.name] = replace(parameters[test.name], interval=test.limits)
    return limited
