"""IPOPT on a sum of squares: cost, gradient and Gauss-Newton matrix from one call. The only file that names the solver."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

import casadi as ca
import numpy as np


class Status(Enum):
    """How an optimisation ended: its members' values are what a person reads."""

    CONVERGED = "converged"
    ACCEPTABLE = "converged to a looser tolerance: the last digits may move"
    ITERATION_LIMIT = "stopped at the iteration limit before it converged"
    INTERRUPTED = "interrupted: this is the best point so far"
    STUCK = "no further progress: the search ended without meeting the convergence test"
    NO_START = "the model cannot be simulated from the start values"
    FAILED = "the solver gave up"

    @property
    def success(self) -> bool:
        """Whether the point can be used as an optimum."""
        return self in (Status.CONVERGED, Status.ACCEPTABLE)


class Quadratic(Protocol):
    """Cost with gradient (n,) and a positive semidefinite Hessian approximation (n, n)."""

    @property
    def cost(self) -> float:
        """The cost; infinite where it cannot be computed."""

    @property
    def gradient(self) -> np.ndarray:
        """Its slope (n,)."""

    @property
    def hessian(self) -> np.ndarray:
        """Its curvature, or a positive semidefinite stand-in (n, n)."""


@dataclass(frozen=True)
class Outcome:
    """Best point ``z`` (n,), its ``cost``, how it ended, and what it took."""

    z: np.ndarray
    cost: float
    status: Status
    iterations: int
    evaluations: int
    seconds: float
    solver_status: str = ""


Iteration = Callable[[int, float], None]
Finished = Callable[[np.ndarray, Quadratic], Status | None]

_STATUS = {
    "Solve_Succeeded": Status.CONVERGED,
    "Solved_To_Acceptable_Level": Status.ACCEPTABLE,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
    "User_Requested_Stop": Status.INTERRUPTED,
    "Search_Direction_Becomes_Too_Small": Status.STUCK,
    "Restoration_Failed": Status.STUCK,
    "Feasible_Point_Found": Status.STUCK,
}


def minimise(
    evaluate: Callable[[np.ndarray], Quadratic],
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    *,
    scale: float = 1.0,
    tolerance: float = 1e-8,
    iterations: int = 200,
    finished: Finished | None = None,
    progress: Iteration | None = None,
) -> Outcome:
    """Minimise ``evaluate(z).cost`` within bounds; an infinite cost is a step that IPOPT shortens.

    ``scale`` divides the cost. ``finished(z, value)`` is asked after every iteration about the best point so far and may end the
    search with a status: a statistical rule knows better than a gradient norm when nothing is left to gain. Ctrl-C ends it too; the best point so far is kept.
    """
    began = time.perf_counter()
    search = _Search(evaluate, scale, finished, progress)
    if not np.isfinite(search(start).cost):
        return Outcome(start, np.inf, Status.NO_START, 0, 1, time.perf_counter() - began)
    if len(start) == 0:
        return Outcome(start, search.best_cost, Status.CONVERGED, 0, 1, time.perf_counter() - began)
    with _interruptible(search):
        solver = _solver(search, len(start), tolerance, iterations)
        solver(x0=start, lbx=low, ubx=high)
        stats = solver.stats()
    word = stats["return_status"]
    status = search.done if search.done else Status.INTERRUPTED if search.stop else _STATUS.get(word, Status.FAILED)
    seconds = time.perf_counter() - began
    return Outcome(
        np.clip(start if search.best is None else search.best, low, high), search.best_cost, status, int(stats["iter_count"]), search.evaluations, seconds, word
    )  # fmt: skip


class _Search:
    """The function being minimised, with its last value kept (IPOPT asks for cost, gradient and Hessian one by one)."""

    def __init__(
        self, evaluate: Callable[[np.ndarray], Quadratic], scale: float, finished: Finished | None, progress: Iteration | None
    ) -> None:
        self.evaluate, self.scale, self.finished, self.progress = evaluate, scale, finished, progress
        self.evaluations = 0
        self.stop = False
        self.done: Status | None = None
        self.best: np.ndarray | None = None
        self.best_value: Quadratic | None = None
        self.best_cost = np.inf
        self.callbacks: tuple[ca.Callback, ...] = ()
        self._last: tuple[bytes, Any] = (b"", None)

    def __call__(self, z: np.ndarray) -> Quadratic:
        key = z.tobytes()
        if self._last[0] != key:
            self._last = key, self.evaluate(z)
            self.evaluations += 1
            value = self._last[1]
            if self.best is None or value.cost < self.best_cost:
                self.best, self.best_value, self.best_cost = z.copy(), value, value.cost
        return self._last[1]

    def enough(self) -> bool:
        """Whether the best point so far ends the search."""
        if self.finished and self.best is not None and self.best_value is not None:
            self.done = self.finished(self.best, self.best_value)
        return self.done is not None


class _Callback(ca.Callback):
    """One of the three functions IPOPT wants, as CasADi sees it."""

    def __init__(self, name: str, search: _Search, n: int, inputs: list[ca.Sparsity], outputs: list[ca.Sparsity]) -> None:
        ca.Callback.__init__(self)
        self.search, self.n, self.inputs, self.outputs = search, n, inputs, outputs
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self.inputs)

    def get_n_out(self) -> int:
        return len(self.outputs)

    def get_sparsity_in(self, index: int) -> ca.Sparsity:
        return self.inputs[index]

    def get_sparsity_out(self, index: int) -> ca.Sparsity:
        return self.outputs[index]


class _Cost(_Callback):
    def eval(self, arg: list[ca.DM]) -> list[ca.DM]:
        return [ca.DM(self.search(arg[0].full().ravel()).cost / self.search.scale)]


class _Gradient(_Callback):
    def eval(self, arg: list[ca.DM]) -> list[ca.DM]:
        value = self.search(arg[0].full().ravel())
        return [ca.DM(value.cost / self.search.scale), ca.DM(value.gradient / self.search.scale)]


class _Hessian(_Callback):
    def eval(self, arg: list[ca.DM]) -> list[ca.DM]:
        value = self.search(arg[0].full().ravel())
        return [ca.triu(ca.DM(float(arg[2]) * value.hessian / self.search.scale))]


class _Watch(_Callback):
    """Called after every iteration: reports progress, and ends the search when it is done, or after Ctrl-C."""

    count = 0

    def eval(self, arg: list[ca.DM]) -> list[ca.DM]:
        if self.search.progress:
            self.search.progress(self.count, self.search.best_cost)
        self.count += 1
        return [ca.DM(1 if self.search.stop or self.search.enough() else 0)]


def _solver(search: _Search, n: int, tolerance: float, iterations: int) -> ca.Function:
    column, one, none = ca.Sparsity.dense(n, 1), ca.Sparsity.dense(1, 1), ca.Sparsity(0, 1)
    empty = ca.Sparsity(0, 0)
    cost = _Cost("cost", search, n, [column], [one])
    gradient = _Gradient("nlp_grad_f", search, n, [column, empty], [one, column])
    hessian = _Hessian("nlp_hess_l", search, n, [column, empty, one, none], [ca.Sparsity.upper(n)])
    watch = _Watch("watch", search, n, [_watched(ca.nlpsol_out(i), n) for i in range(ca.nlpsol_n_out())], [one])
    z = ca.MX.sym("z", n)
    options = {
        "grad_f": gradient, "hess_lag": hessian, "no_nlp_grad": True, "iteration_callback": watch, "print_time": False,
        "show_eval_warnings": False,
        "ipopt": {
            "print_level": 0, "sb": "yes", "tol": tolerance, "max_iter": iterations, "mu_strategy": "adaptive",
            "bound_relax_factor": 0.0, "bound_push": 1e-8, "bound_frac": 1e-8, "nlp_scaling_method": "none",
        },
    }  # fmt: skip
    solver = ca.nlpsol("fit", "ipopt", {"x": z, "f": cost(z)}, options)
    # CasADi keeps only weak references to Python callbacks: they must live as long as the solver.
    search.callbacks = (cost, gradient, hessian, watch)
    return solver


def _watched(name: str, n: int) -> ca.Sparsity:
    if name == "f":
        return ca.Sparsity.dense(1, 1)
    if name in ("x", "lam_x"):
        return ca.Sparsity.dense(n, 1)
    return ca.Sparsity(0, 1) if name in ("g", "lam_g") else ca.Sparsity(0, 0)


@contextmanager
def _interruptible(search: _Search) -> Iterator[None]:
    """Ctrl-C asks the search to stop after the present iteration (main thread only; elsewhere signals are not ours)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def ask(*_: object) -> None:
        if search.stop:
            raise KeyboardInterrupt
        search.stop = True

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


