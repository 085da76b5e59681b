"""When a minimisation has nothing left to gain that matters: a rule in units of the residual's variance, not of a gradient norm."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from greybox.numerics import AT_BOUND
from greybox.optim.policy import DEFAULT_TERMINATION, TerminationPolicy
from greybox.optim.quadratic_model import QuadraticModel
from greybox.optim.status import TerminationStatus


@dataclass(frozen=True)
class Termination:
    """The end of one minimisation within bounds: `test` is asked about the best point so far after every iteration.

    It is converged where the quadratic model predicts a negligible decrease along its step within bounds, and acceptable where the last
    iterations gained next to nothing. It remembers the costs it was asked about, so each minimisation needs one of its own.
    """

    policy: TerminationPolicy = DEFAULT_TERMINATION
    """What is negligible, and how long nothing may be gained."""

    low: np.ndarray | float = -np.inf
    """Lower bounds (n,)."""

    high: np.ndarray | float = np.inf
    """Upper bounds (n,)."""

    count: int | None = None
    """Number of residuals whose squares the cost sums up; None: the cost is minus twice the logarithm of a likelihood."""

    costs: list[float] = field(default_factory=list)
    """The cost after each iteration that did not end the search."""

    def test(self, z: np.ndarray, value: QuadraticModel) -> TerminationStatus | None:
        """How the search ends at ``z`` (n,), where the minimised function is ``value``; None where it goes on."""
        if self.is_negligible(value.predicted_decrease(*measure_room(z, self.low, self.high)), value.cost):
            return TerminationStatus.CONVERGED
        return TerminationStatus.ACCEPTABLE if self.is_flat(value.cost) else None

    def is_negligible(self, decrease: float, cost: float, slack: float = 1.0) -> bool:
        """Whether a predicted ``decrease`` of ``cost`` changes nothing that matters; ``slack`` is a factor on what is allowed."""
        return decrease <= slack * self.policy.negligible(cost, self.count)

    def is_flat(self, cost: float) -> bool:
        """Whether the last iterations gained next to nothing, ``cost`` being that of the newest."""
        self.costs.append(cost)
        patience, whole = self.policy.patience, 1.0 if self.count is None else cost
        return len(self.costs) > patience and self.costs[-1 - patience] - cost <= self.policy.little_gain * whole


def measure_room(z: np.ndarray, low: np.ndarray | float, high: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Distances of ``z`` to its bounds (n,); none to one that it nearly lies on.

    An interior-point search stays a little off a bound that it is pressed against.
    """
    below, above = low - z, high - z
    return np.where(below >= -AT_BOUND, 0.0, below), np.where(above <= AT_BOUND, 0.0, above)
