"""How a minimisation ended, and what is minimised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

import numpy as np


class TerminationStatus(Enum):
    """How an optimisation ended: its members' values are what a person reads."""

    CONVERGED = "converged"
    KINK = "converged at a kink of the cost (dry friction has them): no small step in any direction lowers it"
    ACCEPTABLE = "converged to a looser tolerance: the last digits may move"
    ITERATION_LIMIT = "stopped at the iteration limit before it converged"
    INTERRUPTED = "interrupted: this is the best point so far"
    STUCK = "no further progress: the search ended without meeting the convergence test"
    NO_START = "the model cannot be simulated from the start values"
    FAILED = "the solver gave up"

    @property
    def success(self) -> bool:
        """Whether the point can be used as an optimum."""
        return self in (TerminationStatus.CONVERGED, TerminationStatus.KINK, TerminationStatus.ACCEPTABLE)


class QuadraticModel(Protocol):
    """Cost with gradient (n,) and a positive semidefinite Hessian approximation (n, n)."""

    @property
    def cost(self) -> float:
        """The cost; infinite where it cannot be computed."""

    @property
    def gradient(self) -> np.ndarray:
        """Its slope (n,)."""

    @property
    def hessian(self) -> np.ndarray:
        """Its curvature, or a positive semidefinite stand-in (n, n)."""


@dataclass(frozen=True)
class MinimisationResult:
    """Best point ``z`` (n,), its ``cost``, how it ended, and what it took.

    ``value`` is what ``evaluate`` gave at ``z``, None where it never gave anything finite.
    """

    z: np.ndarray
    cost: float
    status: TerminationStatus
    iterations: int
    evaluations: int
    seconds: float
    solver_status: str = ""
    value: Any = None


IterationCallback = Callable[[int, float], object]
"""``(iteration, cost)``, called after every iteration."""

TerminationTest = Callable[[np.ndarray, Any], TerminationStatus | None]
"""``(z, value)`` of the best point so far, ``value`` being what the minimised function returned there; a status ends the search."""

# IPOPT's return status in its own words.
IPOPT_STATUS = {
    "Solve_Succeeded": TerminationStatus.CONVERGED,
    "Solved_To_Acceptable_Level": TerminationStatus.ACCEPTABLE,
    "Maximum_Iterations_Exceeded": TerminationStatus.ITERATION_LIMIT,
    "User_Requested_Stop": TerminationStatus.INTERRUPTED,
    "Search_Direction_Becomes_Too_Small": TerminationStatus.STUCK,
    "Restoration_Failed": TerminationStatus.STUCK,
    "Feasible_Point_Found": TerminationStatus.STUCK,
}
