"""Intensities of process noise: from which to start, whether zero would do as well, and how large one may be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.special import chdtrc, chdtri

from greybox.estimation.likelihood_search import (
    LikelihoodOptimum,
    fisher_scoring,
    hold_parameters,
    maximise_likelihood,
    raise_noise_to_innovations,
    select_best_start,
    start_at,
)
from greybox.estimation.options import FitOptions
from greybox.estimation.prediction_error import PredictionErrorObjective
from greybox.model import Model

# Start values looked at: shares of the intensity that would explain every movement of a state by chance.
SHARES = 10.0 ** np.arange(0.0, -6.1, -0.5)
# An intensity below this share counts as zero.
FLOOR = 1e-8
# Zero does as well where it costs less than this in -2 log L.
NOTHING = 0.1
# One-sided 95 % and 99 % points of the likelihood ratio of an intensity, which is zero in half of all cases without any noise.
LIMIT, SIGNIFICANT = float(chdtri(1, 0.1)), 0.01
GROWTH, STEPS, CLOSE = 2.0, 40, 0.02


@dataclass(frozen=True)
class ProcessNoiseTest:
    """One intensity of process noise as a fit found it.

    ``ratio``: likelihood ratio, twice the gain of the logarithm over zero intensity; ``p_value``: how often chance alone gives so
    much; ``limits``: one-sided 95 % limit (0, upper) where it is not significant, else None.
    """

    name: str
    value: float
    ratio: float
    p_value: float
    limits: tuple[float, float] | None = None

    @property
    def significant(self) -> bool:
        """Whether the records show process noise (at 1 %)."""
        return self.p_value < SIGNIFICANT


def compute_largest_intensities(model: Model, steps: np.ndarray) -> dict[str, float]:
    """For each intensity the one that would explain the movement of its states by chance alone.

    ``steps`` (nx,): root mean square of the states' change from row to row over the root of the interval.
    """
    system = model.system
    p = np.array(list(model.values.values()))
    by_p = ca.Function("noise", [system.p], [ca.jacobian(system.diffusion, system.p)])(p).full()
    found = {}
    for name in model.noise_parameters:
        slope = np.abs(by_p[:, list(model.values).index(name)])
        with np.errstate(divide="ignore", invalid="ignore"):
            each = steps[slope > 0] / slope[slope > 0]
        each = each[np.isfinite(each) & (each > 0)]
        found[name] = float(each.min()) if len(each) else 1.0
    return found


def guess_intensities(
    cost: PredictionErrorObjective, names: Sequence[str], sizes: Mapping[str, float]
) -> PredictionErrorObjective:
    """``cost`` with ``z = 0`` at the most likely of some start values of the intensities ``names``, the other unknowns as they are.

    All of them together first, then each by itself.
    """
    together = [start_at(cost, {n: share * sizes[n] for n in names}) for share in SHARES]
    cost = select_best_start([cost, *together])
    for name in names if len(names) > 1 else ():
        cost = select_best_start([cost, *(start_at(cost, {name: share * sizes[name]}) for share in SHARES)])
    return cost


def drop_insignificant(
    found: LikelihoodOptimum, names: Sequence[str], options: FitOptions
) -> tuple[LikelihoodOptimum, tuple[str, ...]]:
    """The optimum with every intensity at zero for which that is as likely, and their names."""
    zero: list[str] = []
    for name in names:
        near = fisher_scoring(remove_process_noise(found.cost, name))
        if near.evaluation.cost <= found.evaluation.cost + NOTHING:
            # Each by itself: of two intensities that stand for one another either can be zero, not both.
            zero.append(name)
            found = maximise_likelihood(near.cost, options)
    return found, tuple(zero)


def remove_process_noise(cost: PredictionErrorObjective, name: str) -> PredictionErrorObjective:
    """``cost`` without process noise of the intensity ``name``."""
    return hold_parameters(cost, {name: 0.0})


def likelihood_ratio_tests(
    found: LikelihoodOptimum, names: Sequence[str], zero: Sequence[str], sizes: Mapping[str, float], options: FitOptions
) -> tuple[ProcessNoiseTest, ...]:
    """Each intensity with its likelihood ratio against zero, everything else estimated anew."""
    p = found.cost.unknowns.variables.parameters(np.zeros(found.cost.unknowns.variables.size))
    values = dict(zip((q.name for q in found.cost.unknowns.variables.model.all_parameters), p, strict=True))
    result = []
    for name in names:
        if name in zero:
            result.append(
                ProcessNoiseTest(name, 0.0, 0.0, 1.0, (0.0, find_upper_limit(found, name, FLOOR * sizes[name])))
            )
            continue
        rest = maximise_likelihood(raise_noise_to_innovations(remove_process_noise(found.cost, name)), options)
        ratio = max(rest.evaluation.cost - found.evaluation.cost, 0.0)
        p_value = 0.5 * float(chdtrc(1, ratio))
        limits = (0.0, find_upper_limit(found, name, values[name])) if ratio < LIMIT else None
        result.append(ProcessNoiseTest(name, values[name], ratio, p_value, limits))
    return tuple(result)


def find_upper_limit(found: LikelihoodOptimum, name: str, begin: float) -> float:
    """The intensity from which on ``-2 log L`` exceeds its minimum by the one-sided 95 % point, the other unknowns estimated anew.

    ``begin`` is one that does not.
    """
    near, low, high = found.cost, begin, np.inf
    value = begin
    # With the other unknowns held the cost rises at least as fast: up to there the limit is not reached.
    while value < begin / FLOOR and hold_parameters(near, {name: value}).cost() - found.evaluation.cost < LIMIT:
        low, value = value, GROWTH * value
    for _ in range(STEPS):
        there = fisher_scoring(hold_parameters(near, {name: value}), CLOSE * LIMIT)
        rise = there.evaluation.cost - found.evaluation.cost
        if abs(rise - LIMIT) <= CLOSE * LIMIT:
            break
        if there.status.success:
            near = there.cost
        low, high = (value, high) if rise < LIMIT else (low, value)
        value = GROWTH * value if np.isinf(high) else float(np.sqrt(low * high))
    return value
