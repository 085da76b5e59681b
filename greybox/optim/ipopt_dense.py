"""IPOPT on a sum of squares: cost, gradient and Gauss-Newton matrix from one call."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from greybox.optim.damped_gauss_newton import run_damped_gauss_newton
from greybox.optim.gradient_sampling import run_gradient_sampling
from greybox.optim.minimisation import Minimisation, stop_on_interrupt
from greybox.optim.policy import DEFAULT_POLICY, MinimisationPolicy
from greybox.optim.quadratic_model import QuadraticModel
from greybox.optim.status import (
    IPOPT_STATUS,
    IterationCallback,
    MinimisationResult,
    TerminationStatus,
    TerminationTest,
)


def minimise(
    evaluate: Callable[[np.ndarray], QuadraticModel],
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    *,
    scale: float = 1.0,
    value_at_start: QuadraticModel | None = None,
    tolerance: float = 1e-8,
    iterations: int = 200,
    termination_test: TerminationTest | None = None,
    thorough: bool = True,
    progress: IterationCallback | None = None,
    policy: MinimisationPolicy = DEFAULT_POLICY,
) -> MinimisationResult:
    """Minimise ``evaluate(z).cost`` within bounds by IPOPT, and go on by other methods where IPOPT stalls.

    Where IPOPT shortens a step again and again for nothing, or finds none, damped Gauss-Newton steps go on from the best point. Where
    they gain nothing either, the cost has a kink and its gradient misleads: the search goes on by gradient sampling (``thorough``)
    or ends. Ctrl-C ends it after the present iteration; the best point so far is kept.

    Parameters
    ----------
    evaluate
        Cost, gradient (n,) and positive semidefinite Hessian approximation (n, n) at a point (n,). An infinite cost is a trial point
        that IPOPT draws back from.
    start, low, high
        The first point and the bounds (n,), infinite where there are none.
    scale
        Divides the cost, so that IPOPT's tolerance is a relative one.
    value_at_start
        ``evaluate(start)``, where the caller has it already.
    tolerance, iterations
        IPOPT's tolerance on the scaled problem, and the most iterations it may take.
    termination_test
        ``(z, value) -> TerminationStatus | None``, asked at the start and after every iteration about the best point so far: a
        statistical rule knows better than a gradient norm when nothing is left to gain.
    thorough
        Whether to search on around a kink.
    progress
        ``(iteration, cost)`` is called after every iteration.
    policy
        When a search counts as stalled, and how it goes on.

    Returns
    -------
    MinimisationResult
        The best point and how the search ended. A start that cannot be evaluated is a result as well, with
        `TerminationStatus.NO_START`.

    Raises
    ------
    Exception
        What ``evaluate`` raises.
    """
    began = time.perf_counter()
    search = Minimisation(evaluate, scale, termination_test, progress, policy)
    if value_at_start is not None:
        search.remember(start, value_at_start)
    if not np.isfinite(search(start).cost):
        seconds = time.perf_counter() - began
        return MinimisationResult(start, np.inf, TerminationStatus.NO_START, 0, search.evaluations, seconds)
    ipopt_word, iteration_count = "", 0
    if len(start) == 0:
        status = TerminationStatus.CONVERGED
    elif search.test_termination():
        status = search.status or TerminationStatus.CONVERGED
    else:
        with stop_on_interrupt(search):
            ipopt_word, iteration_count = _run_ipopt(search, start, low, high, tolerance, iterations)
            ipopt_status = IPOPT_STATUS.get(ipopt_word, TerminationStatus.FAILED)
            # Where IPOPT gives up, another method may not.
            gave_up = search.stalled or ipopt_status in (TerminationStatus.STUCK, TerminationStatus.FAILED)
            if gave_up and not (search.stop or search.status):
                _continue_without_ipopt(search, low, high, thorough)
        status = search.status or (TerminationStatus.INTERRUPTED if search.stop else ipopt_status)
    z, seconds = np.clip(search.best, low, high), time.perf_counter() - began
    return MinimisationResult(
        z, search.best_cost, status, iteration_count, search.evaluations, seconds, ipopt_word, search.best_value
    )


def _continue_without_ipopt(search: Minimisation, low: np.ndarray, high: np.ndarray, thorough: bool) -> None:
    """Where IPOPT finds no step that gains, either the search strayed from a smooth optimum, or the cost has a kink."""
    policy = search.policy
    if run_damped_gauss_newton(search, low, high, policy.damped) or search.stop:
        return
    if thorough:
        search.status = run_gradient_sampling(search, low, high, policy.sampling)
    else:
        search.status = TerminationStatus.STUCK


class _Callback(ca.Callback):
    """One of the four functions IPOPT wants, reading and writing CasADi's memory in place."""

    def __init__(self, name: str, owner: _Solver, inputs: list[ca.Sparsity], outputs: list[ca.Sparsity]) -> None:
        ca.Callback.__init__(self)
        self.owner, self.inputs, self.outputs = owner, inputs, outputs
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self.inputs)

    def get_n_out(self) -> int:
        return len(self.outputs)

    def get_sparsity_in(self, index: int) -> ca.Sparsity:
        return self.inputs[index]

    def get_sparsity_out(self, index: int) -> ca.Sparsity:
        return self.outputs[index]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arg: list[memoryview], res: list[memoryview]) -> int:
        """Fill ``res``; CasADi cannot carry an exception, so it is kept, the point counts as impossible, and the search ends."""
        search = self.owner.search
        outputs = [None if r is None else np.frombuffer(r) for r in res]
        try:
            if search.error is None:
                self.fill(search, [None if a is None else np.frombuffer(a) for a in arg], outputs)
                return 0
        except BaseException as error:
            search.error = error
        for values in outputs:
            if values is not None:
                values[:] = np.inf
        return 0

    def fill(self, search: Minimisation, arg: list, res: list) -> None:
        """Write the results for one point."""
        raise NotImplementedError


class _Cost(_Callback):
    def fill(self, search: Minimisation, arg: list, res: list) -> None:
        res[0][0] = search(arg[0]).cost / search.scale


class _Gradient(_Callback):
    def fill(self, search: Minimisation, arg: list, res: list) -> None:
        value = search(arg[0])
        if res[0] is not None:
            res[0][0] = value.cost / search.scale
        if res[1] is not None:
            res[1][:] = value.gradient / search.scale


class _Hessian(_Callback):
    def fill(self, search: Minimisation, arg: list, res: list) -> None:
        factor = (0.0 if arg[2] is None else arg[2][0]) / search.scale
        res[0][:] = factor * search(arg[0]).hessian[self.owner.triangle]


class _AfterIteration(_Callback):
    """Called after every iteration."""

    def fill(self, search: Minimisation, arg: list, res: list) -> None:
        res[0][0] = search.finish_iteration()


class _Solver:
    """IPOPT for ``n`` variables. Making one costs as much as several iterations, so it is kept and given one search after another."""

    def __init__(self, n: int, tolerance: float, iterations: int) -> None:
        column, one = ca.Sparsity.dense(n, 1), ca.Sparsity.dense(1, 1)
        none, empty = ca.Sparsity(0, 1), ca.Sparsity(0, 0)
        self.search: Any = None
        # Symmetric: the rows of the lower triangle are the columns of the upper one.
        self.triangle = np.tril_indices(n)
        cost = _Cost("cost", self, [column], [one])
        gradient = _Gradient("nlp_grad_f", self, [column, empty], [one, column])
        hessian = _Hessian("nlp_hess_l", self, [column, empty, one, none], [ca.Sparsity.upper(n)])
        watch = _AfterIteration(
            "watch", self, [_solution_sparsity(ca.nlpsol_out(i), n) for i in range(ca.nlpsol_n_out())], [one]
        )
        # CasADi keeps only weak references to Python callbacks: they must live as long as the solver.
        self.callbacks = (cost, gradient, hessian, watch)
        options = {
            "grad_f": gradient,
            "hess_lag": hessian,
            "no_nlp_grad": True,
            "iteration_callback": watch,
            "print_time": False,
            "show_eval_warnings": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",  # no banner
                "tol": tolerance,
                "max_iter": iterations,
                # Takes about half the iterations of the default on these problems.
                "mu_strategy": "adaptive",
                # A constant at its bound ends exactly there, and a start beside a bound stays beside it.
                "bound_relax_factor": 0.0,
                "bound_push": 1e-8,
                "bound_frac": 1e-8,
                # The decision vector is scaled already.
                "nlp_scaling_method": "none",
            },
        }
        z = ca.MX.sym("z", n)
        self.function = ca.nlpsol("fit", "ipopt", {"x": z, "f": cost(z)}, options)


# Solvers that no search is using, by the arguments of `_Solver`.
_idle: dict[tuple[int, float, int], list[_Solver]] = {}


def _run_ipopt(
    search: Minimisation, start: np.ndarray, low: np.ndarray, high: np.ndarray, tolerance: float, iterations: int
) -> tuple[str, int]:
    """IPOPT's return status in its own words, and the number of its iterations."""
    key = len(start), tolerance, iterations
    idle = _idle.setdefault(key, [])
    try:
        solver = idle.pop()  # in one step, so that two threads never share a solver
    except IndexError:
        solver = _Solver(*key)
    solver.search = search
    solver.function(x0=start, lbx=low, ubx=high)
    stats = solver.function.stats()
    solver.search = None
    idle.append(solver)
    if search.error is not None:
        raise search.error
    return stats["return_status"], int(stats["iter_count"])


def _solution_sparsity(name: str, n: int) -> ca.Sparsity:
    """The shape in which CasADi hands an output of the solver to the iteration callback; empty for a problem without constraints."""
    if name == "f":
        return ca.Sparsity.dense(1, 1)
    if name in ("x", "lam_x"):
        return ca.Sparsity.dense(n, 1)
    return ca.Sparsity(0, 1) if name in ("g", "lam_g") else ca.Sparsity(0, 0)
