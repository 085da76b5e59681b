"""IPOPT on a large sparse program with constraints."""

from __future__ import annotations

import time
from typing import Any

import casadi as ca
import numpy as np

from greybox.optim.minimisation import stop_on_interrupt
from greybox.optim.status import IPOPT_STATUS, IterationCallback, MinimisationResult, TerminationStatus


class _Follow(ca.Callback):
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
    """Minimise a sparse program with constraints ``g = 0``: ``nlp`` has the expressions ``x`` (n, 1), ``f`` and ``g``.

    ``hessian``: ``(x, p, lam_f, lam_g) -> triu(H)`` in place of the exact one, for example Gauss-Newton's. ``f`` is the cost over
    ``scale``. Each derivative comes from the expressions, so thousands of variables are no trouble as long as ``g`` is sparse.
    """
    began = time.perf_counter()
    follow = _Follow(nlp["x"].numel(), nlp["g"].numel(), scale, progress)
    options: dict[str, Any] = {
        "print_time": False, "show_eval_warnings": False, "iteration_callback": follow,
        "ipopt": {
            "print_level": 0, "sb": "yes", "tol": tolerance, "max_iter": iterations, "mu_strategy": "adaptive",
            "bound_relax_factor": 0.0, "nlp_scaling_method": "none",
            # The permutation that MUMPS likes best fills the matrix of a long record until memory ends; our variables are scaled.
            # Minimum degree orders the long thin matrix three times as fast as what MUMPS picks.
            "mumps_permuting_scaling": 0, "mumps_pivot_order": 0,
        },
    }  # fmt: skip
    if hessian is not None:
        options["hess_lag"] = hessian
    solver = ca.nlpsol("sparse", "ipopt", nlp, options)
    with stop_on_interrupt(follow):
        found = solver(x0=start, lbx=low, ubx=high, lbg=0.0, ubg=0.0)
    stats = solver.stats()
    word = stats["return_status"]
    status = TerminationStatus.INTERRUPTED if follow.stop else IPOPT_STATUS.get(word, TerminationStatus.FAILED)
    z = np.clip(found["x"].full().ravel(), low, high)
    seconds = time.perf_counter() - began
    return MinimisationResult(
        z, float(found["f"]) * scale, status, int(stats["iter_count"]), follow.count, seconds, word
    )
