"""Decisions of black-box estimation: how hard to search, which structures to try, and what counts as good enough."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from greybox.estimation.optim.minimisation import GaussNewtonPolicy, TerminationPolicy


@dataclass(frozen=True)
class PredictionErrorPolicy:
    """How hard a prediction-error model is searched for (ARMAX, output error, Box-Jenkins, Hammerstein)."""

    starts: int = 3
    """Starting points that are followed, best first. The linear estimates seldom disagree more than threefold."""
    first_iterations: int = 8
    """Iterations from each start; after these only the best goes on. Enough to tell basins apart."""
    iterations: int = 100
    """Iterations of the final search. A quadratically converging search needs about ten."""
    termination: TerminationPolicy = field(
        default_factory=lambda: TerminationPolicy(
            negligible_decrease=1e-12, perfect_noise_ratio=0.0, patience=1, little_gain=1e-12
        )
    )
    """When a search ends: a millionth of a standard deviation gives the coefficients their digits. The errors are in the output's unit, so
    that none is small by itself."""
    damped: GaussNewtonPolicy = field(
        default_factory=lambda: GaussNewtonPolicy(initial_damping=1e-4, max_rejections=10, max_kink_steps=100)
    )
    """How its steps are damped. Starts are far off, and there are no kinks."""


@dataclass(frozen=True)
class StructureScanPolicy:
    """Which structures are tried, on which rows, and which of the good ones is chosen."""

    search: PredictionErrorPolicy = field(
        default_factory=lambda: PredictionErrorPolicy(
            starts=2,
            first_iterations=4,
            iterations=15,
            termination=TerminationPolicy(
                negligible_decrease=1e-2, perfect_noise_ratio=0.0, patience=1, little_gain=1e-6
            ),
        )
    )
    """Search while scanning: enough to rank structures."""
    final_search: PredictionErrorPolicy = field(default_factory=PredictionErrorPolicy)
    """Search for the chosen structure."""
    largest_poles: int = 6
    """Most poles of an ARX model, which is a linear problem."""
    largest_searched_poles: int = 4
    """Most poles of a structure that needs an iterative search."""
    first_delays: tuple[int, ...] = (0, 1, 2)
    """Delays in samples that are always tried."""
    nonlinearities: Mapping[str, tuple[int, ...]] = field(
        default_factory=lambda: {"polynomial": (2, 3, 5), "piecewise": (3, 5)}
    )
    """Basis sizes that are tried for each shape of a static nonlinearity."""


DEFAULT_SEARCH = PredictionErrorPolicy()
DEFAULT_SCAN = StructureScanPolicy()
