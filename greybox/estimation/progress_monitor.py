"""A search that is not IPOPT's, watched: progress to report, and Ctrl-C that ends it after the present iteration."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from greybox.estimation.options import FitProgress, FitProgressCallback
from greybox.estimation.problem import EstimationProblem
from greybox.optim.minimisation import stop_on_interrupt


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
