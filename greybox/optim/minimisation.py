"""The function being minimised, its best point so far, and when to stop."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from greybox.optim.status import IterationCallback, QuadraticModel, TerminationStatus, TerminationTest

# A step that was shortened so often without gain points the wrong way: the gradient there is that of one side of a kink.
SHORTENINGS = 10


class Minimisation:
    """The function being minimised, with its last value kept (IPOPT asks for cost, gradient and Hessian one by one)."""

    def __init__(
        self,
        evaluate: Callable[[np.ndarray], QuadraticModel],
        scale: float,
        finished: TerminationTest | None,
        progress: IterationCallback | None,
    ) -> None:
        self.evaluate, self.scale, self.finished, self.progress = evaluate, scale, finished, progress
        self.evaluations = self.iteration = self.shortenings = 0
        self.stop = False
        self.error: BaseException | None = None
        self.done: TerminationStatus | None = None
        self.best = np.empty(0)
        self.best_value: QuadraticModel | None = None
        self.best_cost = np.inf
        self._last: tuple[bytes, Any] = (b"", None)

    def __call__(self, z: np.ndarray) -> QuadraticModel:
        """The function at ``z``; what it gave last if that is asked again."""
        if self._last[0] != z.tobytes() or self._last[1] is None:
            if self.lost:
                return NotEvaluated(
                    np.inf, np.zeros_like(z), np.eye(len(z))
                )  # IPOPT cannot be told to stop between two iterations
            self.evaluations += 1
            self.keep(z, self.evaluate(z))
        return self._last[1]

    @property
    def lost(self) -> bool:
        """Whether the present step has been shortened for nothing."""
        return self.shortenings > SHORTENINGS

    def keep(self, z: np.ndarray, value: QuadraticModel) -> None:
        """Remember the value at ``z``, and the best one."""
        self._last = z.tobytes(), value
        self.shortenings += np.isfinite(value.cost)
        if self.best_value is None or value.cost < self.best_cost:
            self.best, self.best_value, self.best_cost, self.shortenings = z.copy(), value, value.cost, 0

    def enough(self) -> bool:
        """Whether the best point so far ends the search."""
        if self.finished and self.best_value is not None:
            self.done = self.finished(self.best, self.best_value)
        return self.done is not None

    def iterated(self) -> bool:
        """After an iteration: report progress; whether to stop."""
        if self.progress:
            self.progress(self.iteration, self.best_cost)
        self.iteration += 1
        return self.stop or self.lost or self.error is not None or self.enough()


@dataclass(frozen=True)
class NotEvaluated:
    """A point at which nothing was computed."""

    cost: float
    gradient: np.ndarray
    hessian: np.ndarray


class Stoppable(Protocol):
    """Something that looks at its flag from time to time."""

    stop: bool


@contextmanager
def stop_on_interrupt(search: Stoppable) -> Iterator[None]:
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
