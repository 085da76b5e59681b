"""What every goal of a design has: plants that must be run, a value to make large, and its slopes along what they show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from greybox.experiment_design.plant import PlantScenario


class Run(Protocol):
    """What a goal looks at: a run of the compiled kernel, or one that can be differentiated."""

    @property
    def outputs(self) -> np.ndarray:
        """(N, ny)"""

    @property
    def slopes(self) -> np.ndarray:
        """(N, ny, L), over the noise."""

    @property
    def finite(self) -> bool:
        """Whether the run went through."""


Slopes = tuple[np.ndarray, np.ndarray]
"""Slopes of a value along the outputs (N, ny) and along the slopes (N, ny, L) of one run."""


class Goal(Protocol):
    """A goal; its value is a logarithm: e to a difference is a factor on widths, amounts, or distances in noise."""

    @property
    def plants(self) -> Sequence[PlantScenario]:
        """What has to be run, in this order."""

    def value(self, runs: Sequence[Run], scale: float = 1.0) -> float:
        """The value that ``runs`` bring, each counted ``scale`` times; larger is better, minus infinity where a run overflows."""

    def slopes(self, runs: Sequence[Run], scale: float = 1.0) -> list[Slopes]:
        """Its slopes along each run."""


GoalMaker = Callable[[int, float | None], Goal]
"""``(draws, step) -> Goal``: the goal with so many draws of the constants, at a sampling time (None: that of the question)."""


def information_of(run: Run, scale: float) -> np.ndarray:
    """Fisher's information (L, L) of ``scale`` such runs; outputs without a sensor do not count."""
    rows = np.nan_to_num(run.slopes).reshape(-1, run.slopes.shape[-1])
    return scale * rows.T @ rows


def add_earlier(plant: PlantScenario, information: np.ndarray, prior_spread: float) -> np.ndarray:
    """Information (L, L) of a run with that of earlier records, and with the order of magnitude that is known anyway."""
    n = plant.count
    total = information.copy()
    total[:n, :n] += plant.earlier + np.eye(n) / prior_spread**2
    others = np.arange(n, len(total))
    total[others, others] += 1 / prior_spread**2
    return total
