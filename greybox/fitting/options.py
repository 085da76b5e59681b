"""What can be chosen about a fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """Where a running fit is: stage ``stage`` of ``stages`` (a growing part of the record), iteration, misfit over noise."""

    stage: int
    stages: int
    iteration: int
    noise_ratio: float


Report = Callable[[Progress], None]


@dataclass(frozen=True)
class FitOptions:
    """Choices of a fit, kept with its result.

    ``at_rest``: every record starts at the states the model declares, instead of estimated ones. ``method``: ``automatic``,
    ``exact`` or ``rk4``. ``substeps`` of RK4 a sample, 0 to choose. ``progressive``: fit a growing part of the record, so that a start
    far off does not lock onto a wrong oscillation. ``iterations`` at most in each stage; ``tolerance`` of IPOPT; as a rule the
    search ends earlier, when a further step would change nothing that matters. ``thorough``: where the cost has a kink (dry
    friction) and its gradient misleads, search on without it; that takes many passes.
    """

    at_rest: bool = False
    method: str = "automatic"
    substeps: int = 0
    progressive: bool = True
    iterations: int = 200
    tolerance: float = 1e-12
    thorough: bool = True
