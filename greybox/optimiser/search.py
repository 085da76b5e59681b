"""The function being minimised, its best point so far, and when to stop."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from greybox.optimiser.outcome import Finished, Iteration, Quadratic, Status

# A step that was shortened so often without gain points the wrong way: the gradient there is that of one side of a kink.
SHORTENINGS = 10


class Search:
    """The function being minimised, with its last value kept (IPOPT asks for cost, gradient and Hessian one by one)."""

    def __init__(
        self,
        evaluate: Callable[[np.ndarray], Quadratic],
        scale: float,
        finished: Finished | None,
        progress: Iteration | None,
    ) -> None:
        self.evaluate, self.scale, self.finished, self.progress = evaluate, scale, finished, progress
        self.evaluations = self.iteration = self.shortenings = 0
        self.stop = False
        self.error: BaseException | None = None
        self.done: Status | None = None
        self.best = np.empty(0)
        self.best_value: Quadratic | None = None
        self.best_cost = np.inf
        self._last: tuple[bytes, Any] = (b"", None)

    def __call__(self, z: np.ndarray) -> Quadratic:
        """The function at ``z``; what it gave last if that is asked again."""
        if self._last[0] != z.tobytes() or self._last[1] is None:
            if self.lost:
                return Nothing(
                    np.inf, np.zeros_like(z), np.eye(len(z))
                )  # IPOPT cannot be told to stop between two iterations
            self.evaluations += 1
            self.keep(z, self.evaluate(z))
        return self._last[1]

    @property
    def lost(self) -> bool:
        """Whether the present step has been shortened for nothing."""
        return self.shortenings > SHORTENINGS

    def keep(self, z: np.ndarray, value: Quadratic) -> None:
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
class Nothing:
    """A point at which nothing was computed."""

    cost: float
    gradient: np.ndarray
    hessian: np.ndarray


class Stoppable(Protocol):
    """Something that looks at its flag from time to time."""

    stop: bool


@contextmanager
def interruptible(search: Stoppable) -> Iterator[None]:
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
