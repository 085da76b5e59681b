"""Decisions of a fit through an FMU, which is a black box that runs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FmuFitPolicy:
    """How an FMU is run and how its parameters are sought."""

    difference: float = 1e-4
    """Step of a parameter for a slope, over its size: above what solvers with a tolerance of 1e-8 scatter, below what bends."""
    sensitivity_steps: int = 4
    """Runge-Kutta steps between two rows of a run with sensitivities."""
    sensitivity_error: float = 1e-4
    """Deviation of such a run from the one by the solver, over the movement of the output, up to which its slopes are used."""
    relative_tolerance: float = 1e-8
    """Relative tolerance asked of the FMU's solver."""
    iterations: int = 30
    """Most steps that gain, from one set of slopes by differences."""
    converged: float = 1e-4
    """Predicted decrease of the cost, over its noise (cost over degrees of freedom), from which nothing visible is left to gain."""
    exact: float = 1e-12
    """Share of the cost at the start that is a solver's scatter: exact data end here."""
    failed_cost: float = 100.0
    """Cost of a run that fails, over that of the start: bounded, so that the search turns back and goes on."""
    shares: tuple[float, ...] = (0.15, 0.4)
    """Shares of the records that are fitted before the whole: over a short part a start that is far off is not out of step yet, and a run
    costs little."""
    least_rows: int = 50
    """Rows of a record that the first part has at least."""
    almost_whole: float = 0.8
    """Share of the rows from which a part is not worth a search of its own."""
    secant_share: float = 0.25
    """Share of the promised decrease that a step must gain for slopes to follow by the secant update (Fletcher's lower ratio)."""
    initial_damping: float = 1e-3
    """Damping of the first step, as a share of the curvature: an undamped one may leave a start that is far off for another oscillation."""
    rejections: int = 5
    """Steps in a row that gain nothing before slopes are taken by differences again."""
    rounds: int = 12
    """Most times that the search goes on from slopes by differences."""
    most_free: int = 12
    """Most parameters that are fitted unless they are named: each costs a run an iteration."""
    largest_unpacked: int = 1_000_000_000
    """Bytes that an FMU unpacks to at most."""
    endless: float = 1e300
    """Bounds of a variable beyond it are none: tools write the largest number there."""
    least_std: float = 1e-9
    """Smallest noise of an output, over its movement, by which errors are weighted: simulated records have none."""


@dataclass(frozen=True)
class FmuResponsePolicy:
    """How the linear answer of an FMU to its inputs is identified, and how an effect is fitted with the FMU itself."""

    change: float = 0.05
    """Change of an input, over its movement: small beside what bends, large beside what solvers scatter."""
    slowest: float = 10.0
    """Longest times between two changes of sign, as the rows of a record over this."""
    seed: int = 1
    """Seed of the change, so that it can be repeated."""
    least_answer: float = 1e-6
    """Movement of an output, over that of its run, below which it does not answer to the inputs."""
    orders: tuple[int, ...] = (1, 2, 3, 4, 6)
    """Orders that are tried beside the one that the singular values show."""
    least_explained: float = 0.5
    """Share of the answer that the linear system must follow in each output; effects at inputs are not looked for below."""
    unstable: float = 1e-3
    """Distance of a pole from the unit circle outside of which an answer counts as unstable."""
    imaginary: float = 1e-6
    """Largest imaginary part of a continuous system, over its size, that is rounding."""
    rounds: int = 6
    """Most rounds of a fit of the local model and a run of the FMU there."""
    settled: float = 0.01
    """Change of the misfit, over its size, below which the FMU agrees with its local model."""
    refined: int = 8
    """Steps a row in which an input that an effect with memory changes is averaged."""


DEFAULT_FMU_FIT = FmuFitPolicy()
DEFAULT_RESPONSE = FmuResponsePolicy()
