"""Discrimination: rivals stay far apart after each has been refitted (T-optimality), for two explanations or more.

For an explanation A that is right and a rival B, ``T = min over B's constants of |y_A - y_B|^2 + (what earlier records hold against the
change)``, in units of the noise (Atkinson and Fedorov 1975): the cost by which B would lose. The minimum is that of B's linearisation.
The value is half the logarithm of the harmonic mean of all ordered pairs, at the best constants of A and at drawn ones: the pair
that lies closest counts most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.experiment_design.goals import Run, Slopes, add_earlier, information_of
from greybox.experiment_design.plant import PlantScenario, draw_plants, make_plant
from greybox.experiment_design.problem import DesignProblem
from greybox.numerics import TINY


@dataclass(frozen=True)
class RivalPair:
    """The run of the plant that is right, and that of the rival, by their positions."""

    right: int
    rival: int


@dataclass(frozen=True, eq=False)
class Discrimination:
    """The goal of telling explanations apart.

    Parameters
    ----------
    plants
        Every explanation at its best constants, then the draws of each.
    pairs
        Which of them are compared.
    prior_spread
        What is known of constants without data.
    """

    plants: Sequence[PlantScenario]
    pairs: Sequence[RivalPair]
    prior_spread: float

    def separations(self, runs: Sequence[Run], scale: float = 1.0) -> list[float]:
        """The cost by which the rival of each pair would lose."""
        return [self._compare(pair, runs, scale)[0] for pair in self.pairs]

    def value(self, runs: Sequence[Run], scale: float = 1.0) -> float:
        """Half the logarithm of the harmonic mean of the costs."""
        if not all(run.finite for run in runs):
            return -np.inf
        costs = np.array(self.separations(runs, scale))
        return float(-0.5 * np.log(np.mean(1 / np.maximum(costs, TINY))))

    def slopes(self, runs: Sequence[Run], scale: float = 1.0) -> list[Slopes]:
        """Slopes along each run: at the minimum over the rival's constants these do not move (envelope theorem)."""
        result = [(np.zeros(run.outputs.shape), np.zeros(run.slopes.shape)) for run in runs]
        compared = [self._compare(pair, runs, scale) for pair in self.pairs]
        costs = np.maximum([cost for cost, _, _ in compared], TINY)
        weights = 0.5 / costs**2 / np.sum(1 / costs)
        for pair, weight, (_, left, change) in zip(self.pairs, weights, compared, strict=True):
            plant = self.plants[pair.rival]
            pull = 2 * scale * weight * left
            noise = np.where(plant.measured, plant.weight, 0.0)
            result[pair.right][0][:] += pull * noise
            result[pair.rival][0][:] -= pull * noise
            result[pair.rival][1][:] -= pull[:, :, None] * change
        return result

    def _compare(self, pair: RivalPair, runs: Sequence[Run], scale: float) -> tuple[float, np.ndarray, np.ndarray]:
        """The cost, what the refitted rival leaves (N, ny), and the change of its constants (L,)."""
        plant, right, rival = self.plants[pair.rival], runs[pair.right], runs[pair.rival]
        weight = np.where(plant.measured, plant.weight, 0.0)
        apart = (right.outputs - rival.outputs) * weight
        rows = np.nan_to_num(rival.slopes)
        flat = rows.reshape(-1, rows.shape[-1])
        total = add_earlier(plant, information_of(rival, scale), self.prior_spread)
        change = np.linalg.solve(total, scale * (flat.T @ apart.ravel()))
        left = apart - rows @ change
        cost = scale * float(np.sum(apart * left))
        return max(cost, 0.0), left, change


def make_discrimination(question: DesignProblem, draws: int, step: float | None = None) -> Discrimination:
    """The goal of ``question`` with so many ``draws`` of the constants of each explanation."""
    plants = [make_plant(question, model, k, step) for k, model in enumerate(question.models)]
    count = len(plants)
    pairs = [RivalPair(a, b) for a in range(count) for b in range(count) if a != b]
    everything = list(plants)
    for a in range(count):
        for drawn in draw_plants(plants[a], question, draws):
            everything.append(drawn)
            pairs += [RivalPair(len(everything) - 1, b) for b in range(count) if b != a]
    return Discrimination(everything, pairs, question.policy.goal.prior_spread)


def closest_pairs(goal: Discrimination, costs: Sequence[float]) -> Mapping[tuple[int, int], float]:
    """For each pair of explanations the smaller cost of both orders and all draws."""
    closest: dict[tuple[int, int], float] = {}
    for pair, cost in zip(goal.pairs, costs, strict=True):
        one, other = goal.plants[pair.right].number, goal.plants[pair.rival].number
        key = min(one, other), max(one, other)
        closest[key] = min(cost, closest.get(key, np.inf))
    return closest
