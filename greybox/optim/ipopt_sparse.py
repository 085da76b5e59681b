"""IPOPT on a large sparse program with constraints."""

from __future__ import annotations

import time
from typing import Any

import casadi as ca
import numpy as np

from greybox.optim.minimisation import stop_on_interrupt
from greybox.optim.status import IPOPT_STATUS, IterationCallback, MinimisationResult, SolverName, TerminationStatus


class _IterationMonitor(ca.Callback):
    """Reports each iteration of `solve_sparse` and ends it after Ctrl-C."""

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
        if self.progress:
            self.progress(self.count, float(arg[1]) * self.scale)
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
    with stop_on_interrupt(monitor):
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
