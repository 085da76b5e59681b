"""A search that is not IPOPT's, watched: progress to report, and Ctrl-C that ends it after the present iteration."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from greybox.optim.minimisation import stop_on_interrupt
from greybox.transcription.problem import EstimationProblem


@dataclass(frozen=True)
class FitProgress:
    """Where a running fit is: stage ``stage`` of ``stages`` (a growing part of the record), iteration, misfit over noise."""

    stage: int
    stages: int
    iteration: int
    noise_ratio: float


FitProgressCallback = Callable[[FitProgress], None]


class ProgressMonitor:
    """Called with the number of each iteration and its cost; whether to ``stop``."""

    def __init__(self, problem: EstimationProblem, report: FitProgressCallback | None) -> None:
        self.report, self.stop = report, False
        self.count = max(sum(int(np.isfinite(r.y).sum()) for r in problem.records), 1)

    def __call__(self, iteration: int, cost: float) -> bool:
        """Report where the search is; whether to end it."""
        if self.report:
            self.report(FitProgress(1, 1, iteration, float(np.sqrt(cost / self.count))))
        return self.stop


@contextmanager
def monitor_progress(problem: EstimationProblem, report: FitProgressCallback | None) -> Iterator[ProgressMonitor]:
    """A `ProgressMonitor` that hears Ctrl-C."""
    watch = ProgressMonitor(problem, report)
    with stop_on_interrupt(watch):
        yield watch
