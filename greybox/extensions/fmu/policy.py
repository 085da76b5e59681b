"""Decisions of a fit through an FMU, which is a black box that runs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FmuFitPolicy:
    """How an FMU is run and how its parameters are sought."""

    shares: tuple[float, ...] = (0.15, 0.4)
    """Shares of the records that are fitted before the whole: over a short part a start that is far off is not out of step yet, and a run
    costs little."""
    rounds: int = 12
    """Most times that the search goes on from slopes by differences."""


DEFAULT_FMU_FIT = FmuFitPolicy()
