"""How many substeps: from the fastest eigenvalue as a first guess, and from the error measured by halving."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from greybox.integrators.exponential_relaxation import compute_fastest_rate
from greybox.integrators.input_delay import add_input_history
from greybox.integrators.policy import DEFAULT_POLICY, DiscretisationPolicy
from greybox.integrators.step import Step
from greybox.model.system import System


def choose_substeps(
    system: System,
    p: np.ndarray,
    x: np.ndarray,
    longest: float,
    *,
    relaxing: Sequence[int] | None = None,
    policy: DiscretisationPolicy = DEFAULT_POLICY,
) -> int:
    """Number of RK4 substeps for the longest sampling interval, from the fastest eigenvalue.

    A model with a delayed input takes twice as many, for the two sides of the cut.

    Parameters
    ----------
    system
        The equations.
    p, x
        Parameters (np,) and the states (k, nx) at which the equations are linearised.
    longest
        The longest sampling interval in seconds.
    relaxing
        States whose own rate does not count, because their exponential is exact. None: those declared as relaxing.
    policy
        The largest ``|h lambda|`` of a substep, and the most substeps.
    """
    u = np.zeros(system.u.numel())
    exact_states = list(system.relaxing if relaxing is None else relaxing)
    fastest = max((compute_fastest_rate(system.jacobian(row, u, p).full(), exact_states) for row in x), default=0.0)
    number = max(1, math.ceil(longest * fastest / policy.eigenvalue_step))
    # With a delayed input either side of the cut takes half of them, and may be nearly the whole interval.
    return min(2 * number if system.delays else number, policy.max_substeps)


def refine_substeps(
    target: float,
    make: Callable[[int], Step],
    first: int,
    p: np.ndarray,
    x0: np.ndarray,
    inputs: np.ndarray,
    length: float,
    policy: DiscretisationPolicy = DEFAULT_POLICY,
) -> Step:
    """The step with the fewest of ``first``, ``2 first``, ``4 first``, ... substeps that is within the ``target``.

    Its run over ``inputs`` (N, nu), held over intervals of ``length`` seconds, differs from that with half the substep by at most
    ``target`` times the movement of each state (root-mean-square). A run that overflows is not within any target.
    """
    step = make(first)
    path = run_step(step, p, x0, inputs, length, policy.error_rows)
    while step.substeps < policy.max_substeps:
        finer = make(2 * step.substeps)
        finer_path = run_step(finer, p, x0, inputs, length, policy.error_rows)
        if np.isfinite(finer_path).all() and np.all(
            _rms(path - finer_path) <= target * _rms(finer_path - finer_path[0])
        ):
            return step
        step, path = finer, finer_path
    return step


def run_step(
    step: Step,
    p: np.ndarray,
    x0: np.ndarray,
    inputs: np.ndarray,
    length: float,
    rows: int = DEFAULT_POLICY.error_rows,
) -> np.ndarray:
    """States (N, nx) at the first ``rows`` of ``inputs`` (., nu), held over intervals of ``length`` seconds, without a kernel."""
    u = np.asarray(inputs, float)[:rows]
    if step.past is not None:
        u = add_input_history(u, np.array([length]), step.past, first_order=False)
    q, _ = step.coefficients(p, np.array([length]), np.empty(0, int))
    path = np.empty((len(u), len(x0)))
    path[0] = x0
    advance, share = step.advance.mapaccum(step.substeps), np.arange(step.substeps + 1) / step.substeps
    common = np.repeat(q.T, step.substeps, axis=1), np.full((1, step.substeps), length / step.substeps)
    for k in range(len(u) - 1):
        # The flags of a delayed input run from row to row, everything else is held.
        ends = u[k][:, None] + (u[k + 1] - u[k])[:, None] * (share if step.past is not None else 0 * share)
        path[k + 1] = advance(path[k], ends[:, :-1], ends[:, 1:], *common).full()[:, -1]
    return path


def _rms(values: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.sqrt(np.mean(values**2, axis=0))
