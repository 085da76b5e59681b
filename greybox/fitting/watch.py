"""A search that is not IPOPT's, watched: progress to report, and Ctrl-C that ends it after the present iteration."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from greybox.fitting.options import Progress, Report
from greybox.fitting.problem import Problem
from greybox.optimiser.search import interruptible


class Watch:
    """Called with the number of each iteration and its cost; whether to ``stop``."""

    def __init__(self, problem: Problem, report: Report | None) -> None:
        self.report, self.stop = report, False
        self.count = max(sum(int(np.isfinite(r.y).sum()) for r in problem.records), 1)

    def __call__(self, iteration: int, cost: float) -> bool:
        """Report where the search is; whether to end it."""
        if self.report:
            self.report(Progress(1, 1, iteration, float(np.sqrt(cost / self.count))))
        return self.stop


@contextmanager
def watched(problem: Problem, report: Report | None) -> Iterator[Watch]:
    """A `Watch` that hears Ctrl-C."""
    watch = Watch(problem, report)
    with interruptible(watch):
        yield watch
