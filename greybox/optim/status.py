"""How a minimisation ended, and what is minimised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np


class TerminationStatus(StrEnum):
    """How a minimisation ended. Result files contain the values."""

    CONVERGED = "converged"
    """The termination test is met."""

    KINK = "kink"
    """At a kink of the cost, as dry friction has them: no small step in any direction lowers it."""

    ACCEPTABLE = "acceptable"
    """Converged to a looser tolerance: the last digits may move."""

    ITERATION_LIMIT = "iteration_limit"
    """Stopped at the iteration limit."""

    INTERRUPTED = "interrupted"
    """Stopped by the user; the best point so far is kept."""

    STUCK = "stuck"
    """No further progress, and the termination test is not met."""

    NO_START = "no_start"
    """The cost cannot be computed at the start."""

    FAILED = "failed"
    """The solver failed."""

    @property
    def success(self) -> bool:
        """Whether the point can be used as an optimum."""
        return self in (TerminationStatus.CONVERGED, TerminationStatus.KINK, TerminationStatus.ACCEPTABLE)


class SolverName(StrEnum):
    """The solvers that a minimisation may go through, as results name them."""

    IPOPT = "IPOPT"
    GAUSS_NEWTON = "Gauss-Newton"
    GRADIENT_SAMPLING = "gradient sampling"


@dataclass(frozen=True)
class MinimisationResult:
    """The best point of a minimisation, how it ended, and what it took."""

    z: np.ndarray
    """The best point (n,)."""

    cost: float
    """The cost there."""

    status: TerminationStatus
    """How the minimisation ended."""

    iterations: int
    evaluations: int
    seconds: float

    solver_status: str = ""
    """IPOPT's return status in its own words."""

    value: Any = None
    """What the minimised function returned at ``z``; None where it never returned anything finite."""

    solver: str = ""
    """Which solvers ran, in their order: "IPOPT, then Gauss-Newton"; empty where the start was the end."""


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
