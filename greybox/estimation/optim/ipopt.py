"""IPOPT on a sum of squares: cost, gradient and Gauss-Newton matrix from one call."""

from __future__ import annotations

import time
from typing import Any

import casadi as ca
import numpy as np

from greybox.base.interrupts import hold_interrupts
from greybox.base.numerics import PUSH_OFF_BOUNDS
from greybox.estimation.optim.minimisation import (
    IPOPT_STATUS,
    IterationCallback,
    Minimisation,
    MinimisationResult,
    SolverName,
    TerminationStatus,
)


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
        except BaseException as error:  # raised again when IPOPT has returned
            search.error = error
        # Infinite: IPOPT takes the point for a bad trial and ends at its next look at the flag.
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
        # IPOPT multiplies the cost by lam_f; the bounds are linear and add no curvature.
        factor = (0.0 if arg[2] is None else arg[2][0]) / search.scale
        res[0][:] = factor * search(arg[0]).hessian[self.owner.triangle]


class _AfterIteration(_Callback):
    """Called after every iteration."""

    def fill(self, search: Minimisation, arg: list, res: list) -> None:
        bounds = self.owner.bounds
        res[0][0] = search.finish_iteration() or (bounds is not None and search.compare_with_prediction(*bounds))


class _Solver:
    """IPOPT for ``n`` variables. Making one costs as much as several iterations, so it is kept and given one search after another."""

    def __init__(self, n: int, tolerance: float, iterations: int) -> None:
        column, one = ca.Sparsity.dense(n, 1), ca.Sparsity.dense(1, 1)
        none, empty = ca.Sparsity(0, 1), ca.Sparsity(0, 0)
        self.search: Any = None
        self.bounds: tuple[np.ndarray, np.ndarray] | None = None
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
                "bound_push": PUSH_OFF_BOUNDS,
                "bound_frac": PUSH_OFF_BOUNDS,
                # The decision vector is scaled already.
                "nlp_scaling_method": "none",
            },
        }
        z = ca.MX.sym("z", n)
        self.function = ca.nlpsol("fit", "ipopt", {"x": z, "f": cost(z)}, options)


# Solvers that no search is using, by the arguments of `_Solver`.
_idle: dict[tuple[int, float, int], list[_Solver]] = {}


def run_ipopt(
    search: Minimisation, low: np.ndarray, high: np.ndarray, tolerance: float, iterations: int, may_hand_over: bool
) -> TerminationStatus:
    """IPOPT's status after its search from the best point.

    ``may_hand_over``: whether it stops after an iteration that gained what the quadratic model predicts, `Minimisation.predicts_well`.
    """
    key = len(search.best), tolerance, iterations
    idle = _idle.setdefault(key, [])
    try:
        solver = idle.pop()  # in one step, so that two threads never share a solver
    except IndexError:
        solver = _Solver(*key)
    solver.search, solver.bounds = search, (low, high) if may_hand_over else None
    search.forget_prediction()
    search.starts_at_best = True
    solver.function(x0=search.best, lbx=low, ubx=high)
    stats = solver.function.stats()
    solver.search = None
    idle.append(solver)
    if search.error is not None:
        raise search.error
    search.ipopt_word = stats["return_status"]
    search.steps += int(stats["iter_count"])
    return IPOPT_STATUS.get(search.ipopt_word, TerminationStatus.FAILED)


def _solution_sparsity(name: str, n: int) -> ca.Sparsity:
    """The shape in which CasADi hands an output of the solver to the iteration callback; empty for a problem without constraints."""
    if name == "f":
        return ca.Sparsity.dense(1, 1)
    if name in ("x", "lam_x"):
        return ca.Sparsity.dense(n, 1)
    return ca.Sparsity(0, 1) if name in ("g", "lam_g") else ca.Sparsity(0, 0)


# IPOPT on a large sparse program with constraints.


class _IterationMonitor(ca.Callback):
    """Reports each iteration of `solve_sparse`, and ends it after Ctrl-C or where the report asks for it."""

    def __init__(self, n: int, constraints: int, scale: float, progress: IterationCallback | None) -> None:
        ca.Callback.__init__(self)
        self.sizes = {"x": n, "lam_x": n, "g": constraints, "lam_g": constraints, "f": 1}
        self.scale, self.progress, self.stop, self.count = scale, progress, False, 0
        self.construct("follow", {})

    def get_n_in(self) -> int:
        return ca.nlpsol_n_out()

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, index: int) -> ca.Sparsity:
        size = self.sizes.get(ca.nlpsol_out(index), 0)
        return ca.Sparsity.dense(size, 1) if size else ca.Sparsity(0, 0)

    def eval(self, arg: list[ca.DM]) -> list[ca.DM]:
        if self.progress and self.progress(self.count, float(arg[1]) * self.scale):
            self.stop = True
        self.count += 1
        return [ca.DM(1 if self.stop else 0)]


def solve_sparse(
    nlp: dict[str, ca.MX],
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    *,
    hessian: ca.Function | None = None,
    scale: float = 1.0,
    tolerance: float = 1e-10,
    iterations: int = 500,
    progress: IterationCallback | None = None,
) -> MinimisationResult:
    """Minimise a sparse program with the constraints ``g = 0`` by IPOPT.

    Every derivative comes from the expressions, so thousands of variables are no trouble as long as ``g`` is sparse.

    Parameters
    ----------
    nlp
        The expressions ``x`` (n, 1), ``f`` (the cost over ``scale``) and ``g``.
    start, low, high
        The first point and the bounds (n,).
    hessian
        ``(x, p, lam_f, lam_g) -> triu(H)`` in the place of the exact Hessian of the Lagrangian, for example Gauss and Newton's.
    scale
        What ``f`` was divided by; the costs of ``progress`` and of the result are multiplied by it.
    tolerance, iterations, progress
        As for `minimise`.
    """
    began = time.perf_counter()
    monitor = _IterationMonitor(nlp["x"].numel(), nlp["g"].numel(), scale, progress)
    options: dict[str, Any] = {
        "print_time": False,
        "show_eval_warnings": False,
        "iteration_callback": monitor,
        "ipopt": {
            "print_level": 0,
            "sb": "yes",  # no banner
            "tol": tolerance,
            "max_iter": iterations,
            "mu_strategy": "adaptive",
            "bound_relax_factor": 0.0,
            "nlp_scaling_method": "none",
            # MUMPS's default permutation fills the matrix of a long record until memory runs out; our variables are scaled.
            "mumps_permuting_scaling": 0,
            # Minimum degree orders the long thin matrix three times as fast as the ordering that MUMPS picks.
            "mumps_pivot_order": 0,
        },
    }
    if hessian is not None:
        options["hess_lag"] = hessian
    solver = ca.nlpsol("sparse", "ipopt", nlp, options)
    with hold_interrupts(monitor):
        solution = solver(x0=start, lbx=low, ubx=high, lbg=0.0, ubg=0.0)
    stats = solver.stats()
    ipopt_word = stats["return_status"]
    status = TerminationStatus.INTERRUPTED if monitor.stop else IPOPT_STATUS.get(ipopt_word, TerminationStatus.FAILED)
    z = np.clip(solution["x"].full().ravel(), low, high)
    seconds = time.perf_counter() - began
    return MinimisationResult(
        z,
        float(solution["f"]) * scale,
        status,
        int(stats["iter_count"]),
        monitor.count,
        seconds,
        ipopt_word,
        solver=SolverName.IPOPT,
    )
