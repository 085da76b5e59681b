"""The function being minimised, its best point so far, and when to stop."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np

from greybox.numerics import PUSH_OFF_BOUNDS
from greybox.optim.policy import MinimisationPolicy
from greybox.optim.quadratic_model import QuadraticModel
from greybox.optim.status import IterationCallback, SolverName, TerminationStatus, TerminationTest
from greybox.optim.termination import measure_room


class Minimisation:
    """The function being minimised, with its last value kept (IPOPT asks for cost, gradient and Hessian one by one).

    ``best``, ``best_value`` and ``best_cost`` are those of the best point so far; ``status`` is how the search ended, None while it
    runs; ``shortenings`` counts the evaluations since the last gain; ``error`` is what ``evaluate`` raised. ``steps`` and ``solvers``
    are the iterations so far and what made them; ``ipopt_word`` is IPOPT's return status in its own words.
    ``starts_at_best``: a solver that pushes its start a hair off the bounds is told the value of the best point there.
    """

    def __init__(
        self,
        evaluate: Callable[[np.ndarray], QuadraticModel],
        scale: float,
        termination_test: TerminationTest | None,
        progress: IterationCallback | None,
        policy: MinimisationPolicy,
        cost: Callable[[np.ndarray], float] | None = None,
    ) -> None:
        self.cost = cost
        self.evaluate, self.scale, self.progress, self.policy = evaluate, scale, progress, policy
        self.termination_test = termination_test
        self.evaluations = self.iteration = self.shortenings = self.steps = 0
        self.solvers: list[SolverName] = []
        self.ipopt_word = ""
        self.forget_prediction()
        self.stop = self.starts_at_best = False
        self.error: BaseException | None = None
        self.status: TerminationStatus | None = None
        self.best = np.empty(0)
        self.best_value: QuadraticModel | None = None
        self.best_cost = np.inf
        self._last: tuple[bytes, Any] = (b"", None)

    def __call__(self, z: np.ndarray) -> QuadraticModel:
        """The function at ``z``; what it gave last, or at the best point, if that is asked again."""
        if self.best_value is not None and self._is_best(z):
            self._last = z.tobytes(), self.best_value
        if self._last[0] != z.tobytes() or self._last[1] is None:
            if self.stalled:  # IPOPT cannot be told to stop between two iterations
                return QuadraticModel(np.inf, np.zeros_like(z), np.eye(len(z)))
            self.evaluations += 1
            self.remember(z, self.evaluate(z))
        return self._last[1]

    def _is_best(self, z: np.ndarray) -> bool:
        """Whether ``z`` is the best point, or that pushed a hair off its bounds where a solver starts from it."""
        if self.starts_at_best:
            return bool(np.all(np.abs(z - self.best) <= 2 * PUSH_OFF_BOUNDS * np.maximum(np.abs(self.best), 1.0)))
        return np.array_equal(z, self.best)

    def compare(self, z: np.ndarray) -> None:
        """Make ``z`` the best point if its cost is lower; the derivatives of the others are not computed where the cost is cheaper."""
        if self.cost is None or self.cost(z) < self.best_cost:
            self(z)

    @property
    def stalled(self) -> bool:
        """Whether the present step has been shortened again and again without any gain."""
        return self.shortenings > self.policy.max_shortenings

    def remember(self, z: np.ndarray, value: QuadraticModel) -> None:
        """Remember the value at ``z``, which becomes the best point if its cost is lower."""
        self._last = z.tobytes(), value
        self.shortenings += np.isfinite(value.cost)
        if self.best_value is None or value.cost < self.best_cost:
            self.best, self.best_value, self.best_cost, self.shortenings = z.copy(), value, value.cost, 0

    def test_termination(self) -> bool:
        """Whether the caller's test says that the best point so far ends the search."""
        if self.termination_test and self.best_value is not None:
            self.status = self.termination_test(self.best, self.best_value)
        return self.status is not None

    def record_solver(self, name: SolverName) -> None:
        """Note that ``name`` goes on with the search."""
        if self.solvers[-1:] != [name]:
            self.solvers.append(name)

    def predict_decrease(self, low: np.ndarray, high: np.ndarray) -> float:
        """By how much the quadratic model at the best point falls within the bounds."""
        assert self.best_value is not None  # a search keeps its start
        return self.best_value.predicted_decrease(*measure_room(self.best, low, high))

    def is_near(self, low: np.ndarray, high: np.ndarray) -> bool:
        """Whether the quadratic model sees the minimum close by."""
        return self.predict_decrease(low, high) <= self.policy.near_share * abs(self.best_cost)

    def forget_prediction(self) -> None:
        """Begin to compare anew: a solver starts at the best point."""
        self.predicts_well, self._predicted = False, (-np.inf, np.inf)

    def compare_with_prediction(self, low: np.ndarray, high: np.ndarray) -> bool:
        """Whether the last iteration gained what the quadratic model predicted before it (``predicts_well`` keeps the answer)."""
        before, predicted = self._predicted
        self._predicted = self.best_cost, self.predict_decrease(low, high)
        self.predicts_well = before - self.best_cost >= self.policy.damped.good_share * predicted
        return self.predicts_well

    def finish_iteration(self) -> bool:
        """Report the progress after an iteration; whether to stop."""
        self.starts_at_best = False
        if self.progress:
            self.progress(self.iteration, self.best_cost)
        self.iteration += 1
        return self.stop or self.stalled or self.error is not None or self.test_termination()


class Stoppable(Protocol):
    """Something that looks at its flag from time to time."""

    stop: bool


@contextmanager
def stop_on_interrupt(search: Stoppable) -> Iterator[None]:
    """Ctrl-C asks the search to stop after the present iteration (main thread only; elsewhere signals are not ours)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def request_stop(*_: object) -> None:
        if search.stop:
            raise KeyboardInterrupt
        search.stop = True

    previous = signal.signal(signal.SIGINT, request_stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
