"""Precision: narrow intervals of chosen constants (A-, D-, E-optimality), averaged over what is not known of all constants.

The value is minus half the logarithm of det C, trace C or the largest eigenvalue of C, per constant, where C is the covariance of the
chosen constants in their scaled form (relative, for a positive constant), after this record and all earlier ones (Pronzato and
Pazman, Design of experiments in nonlinear models, 2013, chapters 5 and 8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greybox.experiment_design.goals import Run, Slopes, add_earlier, information_of
from greybox.experiment_design.plant import PlantScenario, draw_plants, make_plant
from greybox.experiment_design.problem import CriterionName, DesignProblem
from greybox.numerics import TINY


@dataclass(frozen=True, eq=False)
class Precision:
    """The goal of narrow intervals.

    Parameters
    ----------
    plants
        One explanation at several sets of constants, the best one first.
    chosen
        Positions of the constants that count.
    criterion
        What of their covariance is made small.
    prior_spread
        What is known without data.
    """

    plants: Sequence[PlantScenario]
    chosen: np.ndarray
    criterion: CriterionName
    prior_spread: float

    def value(self, runs: Sequence[Run], scale: float = 1.0) -> float:
        """Mean over the plants of minus the logarithm of the typical relative standard deviation."""
        if not all(run.finite for run in runs):
            return -np.inf
        return float(
            np.mean([self._measure(plant, run, scale)[0] for plant, run in zip(self.plants, runs, strict=True)])
        )

    def slopes(self, runs: Sequence[Run], scale: float = 1.0) -> list[Slopes]:
        """Slopes along each run; outputs themselves do not matter."""
        result = []
        for plant, run in zip(self.plants, runs, strict=True):
            _, along = self._measure(plant, run, scale)
            rows = np.nan_to_num(run.slopes)
            result.append((np.zeros(run.outputs.shape), 2 * scale * (rows @ along) / len(self.plants)))
        return result

    def covariance(self, number: int, run: Run, scale: float = 1.0) -> np.ndarray:
        """Covariance (n, n) of all scaled constants of plant ``number`` after ``run``."""
        plant = self.plants[number]
        n = plant.count
        return np.linalg.inv(add_earlier(plant, information_of(run, scale), self.prior_spread))[:n, :n]

    def _measure(self, plant: PlantScenario, run: Run, scale: float) -> tuple[float, np.ndarray]:
        """The value for one plant, and its slope along the information (L, L)."""
        total = add_earlier(plant, information_of(run, scale), self.prior_spread)
        inverse = np.linalg.inv(total)
        c = inverse[np.ix_(self.chosen, self.chosen)]
        values, vectors = np.linalg.eigh((c + c.T) / 2)
        values = np.maximum(values, TINY)
        if self.criterion is CriterionName.D:
            value, slope = -0.5 * np.mean(np.log(values)), np.linalg.inv(c) / len(c)
        elif self.criterion is CriterionName.A:
            value, slope = -0.5 * np.log(np.mean(values)), np.eye(len(c)) / np.sum(values)
        else:
            value, slope = -0.5 * np.log(values[-1]), np.outer(vectors[:, -1], vectors[:, -1]) / values[-1]
        columns = inverse[:, self.chosen]
        return float(value), 0.5 * columns @ slope @ columns.T


def make_precision(question: DesignProblem, draws: int, step: float | None = None) -> Precision:
    """The goal of ``question`` with so many ``draws`` of the constants; ``step``: another sampling time."""
    plant = make_plant(question, question.model, step=step)
    names = list(plant.variables.names)
    chosen = np.array([names.index(n) for n in (question.constants or names)], int)
    plants = [plant, *draw_plants(plant, question, draws)]
    return Precision(plants, chosen, question.criterion, question.policy.goal.prior_spread)
