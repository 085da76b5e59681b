"""`minimise`: the methods for a sum of squares or a likelihood, and how one hands over to the next."""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import StrEnum

import numpy as np

from greybox.base.interrupts import hold_interrupts
from greybox.estimation.optim.gauss_newton import run_gauss_newton, run_gradient_sampling
from greybox.estimation.optim.ipopt import run_ipopt
from greybox.estimation.optim.minimisation import (
    DEFAULT_POLICY,
    IterationCallback,
    Minimisation,
    MinimisationPolicy,
    MinimisationResult,
    SolverName,
    TerminationStatus,
    TerminationTest,
)
from greybox.estimation.optim.quadratic_model import QuadraticModel


class MinimisationMethod(StrEnum):
    """How a minimum is searched for."""

    IPOPT = "ipopt"
    """By an interior-point method, and by damped Gauss-Newton steps where the quadratic model predicts well: there they are cheaper."""

    GAUSS_NEWTON = "gauss_newton"
    """By damped Gauss-Newton steps alone."""

    DAMPED_FIRST = "damped_first"
    """By damped Gauss-Newton steps, and as by IPOPT from where these gain nothing."""


def minimise(
    objective: Callable[[np.ndarray], QuadraticModel],
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    *,
    method: MinimisationMethod | str = MinimisationMethod.IPOPT,
    scale: float = 1.0,
    value_at_start: QuadraticModel | None = None,
    tolerance: float = 1e-8,
    iterations: int = 200,
    termination_test: TerminationTest | None = None,
    thorough: bool = True,
    project: Callable[[np.ndarray], np.ndarray] | None = None,
    cost: Callable[[np.ndarray], float] | None = None,
    progress: IterationCallback | None = None,
    reach: np.ndarray | float = np.inf,
    policy: MinimisationPolicy = DEFAULT_POLICY,
) -> MinimisationResult:
    """Minimise ``objective(z).cost`` within bounds.

    IPOPT hands over to damped Gauss-Newton steps as soon as the quadratic model predicts well, and takes over again where a step gains
    little of what was predicted. Where IPOPT shortens a step again and again for nothing, or finds none, damped steps go on from the best
    point. Where they gain nothing either, the cost has a kink and its gradient misleads: the search goes on by gradient sampling
    (``thorough``) or ends; a kink at which it stood from the start, with most of the cost promised, is no optimum. Ctrl-C ends it after the
    present iteration; the best point so far is kept.

    Parameters
    ----------
    objective
        Cost, gradient (n,) and positive semidefinite Hessian approximation (n, n) at a point (n,). An infinite cost is a trial point
        that the search draws back from.
    start, low, high
        The first point and the bounds (n,), infinite where there are none.
    method
        See `MinimisationMethod`.
    scale
        Divides the cost, so that IPOPT's tolerance is a relative one.
    value_at_start
        ``objective(start)``, where the caller has it already.
    tolerance, iterations
        IPOPT's tolerance on the scaled problem, and the most iterations.
    termination_test
        ``(z, value) -> TerminationStatus | None``, asked at the start and after every iteration about the best point so far: a
        statistical rule knows better than a gradient norm when nothing is left to gain. See `Termination.test`.
    thorough
        Whether to search on around a kink.
    project
        Maps a point (n,) to the nearest allowed one, where bounds do not say what is allowed. Only for Gauss-Newton steps alone.
    cost
        ``objective(z).cost`` alone, where that is much cheaper: damped Gauss-Newton steps are tried by it.
    progress
        ``(iteration, cost)`` is called after every iteration.
    reach
        Longest change of each unknown (n,) in one step of damped steps that begin a search.
    policy
        When a method hands over to the next, and how that goes on.

    Returns
    -------
    MinimisationResult
        The best point, how the search ended, and which solvers ran. A start that cannot be evaluated is a result as well, with
        `TerminationStatus.NO_START`.

    Raises
    ------
    Exception
        What ``objective`` raises.
    """
    began = time.perf_counter()
    search = Minimisation(objective, scale, termination_test, progress, policy, cost)
    if value_at_start is not None:
        search.remember(start, value_at_start)
    if not np.isfinite(search(start).cost):
        seconds = time.perf_counter() - began
        return MinimisationResult(start, np.inf, TerminationStatus.NO_START, 0, search.evaluations, seconds)
    if len(start) == 0:
        search.status = TerminationStatus.CONVERGED
    elif not search.test_termination():
        with hold_interrupts(search):
            is_over = False
            if method != MinimisationMethod.IPOPT:
                search.record_solver(SolverName.GAUSS_NEWTON)
                is_over = run_gauss_newton(
                    search, low, high, policy.damped, steps=iterations, project=project, reach=reach
                )
            if method == MinimisationMethod.GAUSS_NEWTON and not is_over:
                search.status = TerminationStatus.STUCK
            elif not is_over:
                _search_with_ipopt(search, low, high, tolerance, iterations, thorough)
    # Whoever asked for an end must hear of it, also where the last iteration was the last anyway: the caller would go on.
    status = TerminationStatus.INTERRUPTED if search.stop else search.status or TerminationStatus.FAILED
    z, seconds = np.clip(search.best, low, high), time.perf_counter() - began
    return MinimisationResult(
        z,
        search.best_cost,
        status,
        search.steps,
        search.evaluations,
        seconds,
        search.ipopt_word,
        search.best_value,
        ", then ".join(search.solvers),
    )


def _search_with_ipopt(
    search: Minimisation, low: np.ndarray, high: np.ndarray, tolerance: float, iterations: int, thorough: bool
) -> None:
    """IPOPT, damped steps in its place where the quadratic model predicts well, and other methods where it gives up."""
    policy, first_cost = search.policy, search.best_cost
    # Without a statistical test nothing says when damped steps are done: IPOPT's own tolerance ends the search then.
    left = policy.hand_overs if search.termination_test is not None else 0
    if left and search.is_near(low, high) and _follow_quadratic_model(search, low, high, iterations):
        return
    while True:
        search.record_solver(SolverName.IPOPT)
        status = run_ipopt(search, low, high, tolerance, iterations, left > 0)
        if search.status or search.stop:
            return
        if not search.predicts_well:
            break
        if _follow_quadratic_model(search, low, high, iterations):
            return
        # Each return to IPOPT uses up one hand-over, so that the two cannot pass the search to and fro without end.
        left -= 1
    if not (search.stalled or status in (TerminationStatus.STUCK, TerminationStatus.FAILED)):
        search.status = status
        return
    # Where IPOPT finds no step that gains, either the search strayed from a smooth optimum, or the cost has a kink.
    search.record_solver(SolverName.GAUSS_NEWTON)
    if run_gauss_newton(search, low, high, policy.damped, steps=max(iterations - search.steps, 0)) or search.stop:
        return
    stands = search.best_cost >= first_cost
    # The most expensive last: each round evaluates twice as many points as there are unknowns.
    if thorough:
        search.record_solver(SolverName.GRADIENT_SAMPLING)
        search.status = run_gradient_sampling(search, low, high, policy.sampling)
        # Where no step gained from the start on, while most of the cost is promised, the slopes are wrong: no optimum.
        if search.status is TerminationStatus.KINK and stands and not search.is_near(low, high):
            search.status = TerminationStatus.STUCK
    else:
        search.status = TerminationStatus.STUCK


def _follow_quadratic_model(search: Minimisation, low: np.ndarray, high: np.ndarray, iterations: int) -> bool:
    """Damped steps as long as they gain what the quadratic model predicts; whether the search is over."""
    search.record_solver(SolverName.GAUSS_NEWTON)
    steps = min(search.policy.damped.max_steps, max(iterations - search.steps, 0))
    is_over = run_gauss_newton(search, low, high, search.policy.damped, steps=steps, while_predicted=True)
    if search.status is TerminationStatus.ITERATION_LIMIT and search.steps < iterations:
        # Reweighted least squares may gain a little of everything for a hundred steps: IPOPT goes on.
        search.status, is_over = None, False
    return is_over or search.stop
