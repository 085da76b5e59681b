"""How many substeps: from the fastest eigenvalue as a first guess, and from the error measured by halving."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from greybox.integrators.exponential_relaxation import compute_fastest_rate
from greybox.integrators.input_delay import add_input_history
from greybox.integrators.step import Step
from greybox.model.system import System

# |h lambda| per substep. RK4 is stable up to 2.785; at 0.5 a fast mode is followed to a few parts in ten thousand.
TARGET = 0.5
MOST_SUBSTEPS = 1000
# The error is measured over the first rows of a record.
MOST_ROWS = 2000


def choose_substeps(
    system: System,
    p: np.ndarray,
    x: np.ndarray,
    longest: float,
    target: float = TARGET,
    *,
    relaxing: Sequence[int] | None = None,
) -> int:
    """Number of RK4 substeps for an interval of ``longest`` seconds, from the fastest eigenvalue at states ``x`` (k, nx).

    The own rates of the ``relaxing`` states (None: those declared so) do not count: their exponential is exact. A model with a
    delayed input takes twice as many, for the two sides of the cut.
    """
    u = np.zeros(system.u.numel())
    own = list(system.relaxing if relaxing is None else relaxing)
    fastest = max((compute_fastest_rate(system.jacobian(row, u, p).full(), own) for row in x), default=0.0)
    number = max(1, math.ceil(longest * fastest / target))
    # With a delayed input either side of the cut takes half of them, and may be nearly the whole interval.
    return min(2 * number if system.delays else number, MOST_SUBSTEPS)


def refine_substeps(
    target: float,
    make: Callable[[int], Step],
    first: int,
    p: np.ndarray,
    x0: np.ndarray,
    inputs: np.ndarray,
    length: float,
) -> Step:
    """The step with the fewest of ``first``, ``2 first``, ``4 first``, ... substeps that is within the ``target``.

    Its run over ``inputs`` (N, nu), held over intervals of ``length`` seconds, differs from that with half the substep by at most
    ``target`` times the movement of each state (root-mean-square). A run that overflows is not within any target.
    """
    step = make(first)
    path = run_step(step, p, x0, inputs, length)
    while step.substeps < MOST_SUBSTEPS:
        finer = make(2 * step.substeps)
        fine = run_step(finer, p, x0, inputs, length)
        if np.isfinite(fine).all() and np.all(_rms(path - fine) <= target * _rms(fine - fine[0])):
            return step
        step, path = finer, fine
    return step


def run_step(step: Step, p: np.ndarray, x0: np.ndarray, inputs: np.ndarray, length: float) -> np.ndarray:
    """States (N, nx) at the first rows of ``inputs``, without a kernel."""
    u = np.asarray(inputs, float)[:MOST_ROWS]
    if step.past is not None:
        u = add_input_history(u, np.array([length]), step.past, first_order=False)
    q, _ = step.coefficients(p, np.array([length]), np.empty(0, int))
    path = np.empty((len(u), len(x0)))
    path[0] = x0
    substep, share = step.advance.mapaccum(step.substeps), np.arange(step.substeps + 1) / step.substeps
    same = np.repeat(q.T, step.substeps, axis=1), np.full((1, step.substeps), length / step.substeps)
    for k in range(len(u) - 1):
        # The flags of a delayed input run from row to row, everything else is held.
        ends = u[k][:, None] + (u[k + 1] - u[k])[:, None] * (share if step.past is not None else 0 * share)
        path[k + 1] = substep(path[k], ends[:, :-1], ends[:, 1:], *same).full()[:, -1]
    return path


def _rms(values: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.sqrt(np.mean(values**2, axis=0))
