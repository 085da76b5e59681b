"""IPOPT on a sum of squares: cost, gradient and Gauss-Newton matrix from one call."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from greybox.numerics import PUSH_OFF_BOUNDS
from greybox.optim.minimisation import Minimisation
from greybox.optim.status import IPOPT_STATUS, TerminationStatus


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
