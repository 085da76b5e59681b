"""Decisions of a fit through an FMU, which is a black box that runs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FmuFitPolicy:
    """How an FMU is run and how its parameters are sought."""

    difference: float = 1e-4
    """Step of a parameter for a slope, over its size: above what solvers with a tolerance of 1e-8 scatter, below what bends."""
    relative_tolerance: float = 1e-8
    """Relative tolerance asked of the FMU's solver."""
    iterations: int = 30
    """Most steps that gain."""
    converged: float = 1e-4
    """Predicted decrease of the cost, over its noise (cost over degrees of freedom), from which nothing visible is left to gain."""
    exact: float = 1e-12
    """Share of the cost at the start that is a solver's scatter: exact data end here."""
    failed_cost: float = 100.0
    """Cost of a run that fails, over that of the start: bounded, so that the search turns back and goes on."""
    most_free: int = 12
    """Most parameters that are fitted unless they are named: each costs a run an iteration."""
    largest_unpacked: int = 1_000_000_000
    """Bytes that an FMU unpacks to at most."""
    least_std: float = 1e-9
    """Smallest noise of an output, over its movement, by which errors are weighted: simulated records have none."""


DEFAULT_FMU_FIT = FmuFitPolicy()
