"""Which transcription a fit uses, and why, in words."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from greybox.fitting.options import FitOptions
from greybox.fitting.problem import Problem
from greybox.transcription import growth_of, pick

ASKED = "as asked"


@dataclass(frozen=True)
class Choice:
    """``transcription`` is one of `TRANSCRIPTIONS` without ``automatic``; ``problem`` has the steps that go with it."""

    transcription: str
    reason: str
    problem: Problem

    def told(self, what: str) -> str:
        """``what``, with the reason."""
        return f"{what}, {ASKED}" if self.reason == ASKED else f"{what}; picked because {self.reason}"


def choose(problem: Problem, options: FitOptions) -> Choice:
    """The transcription that was asked for, else the one that suits the model and the longest record at the start values.

    A stiff model also gets implicit steps, unless the method or the substeps were given.
    """
    longest = max(problem.records, key=lambda r: float(r.h.sum()))
    found = pick(problem.model.system, _start(problem), longest, integrating="single")
    if found.implicit and options.method == "automatic" and not options.substeps:
        problem = replace(problem, method="radau").with_step(0, _start(problem))
    if options.arc_length:
        return Choice("arcs", ASKED, problem)
    if options.transcription != "automatic":
        return Choice(options.transcription, ASKED, problem)
    name = "collocation-radau" if found.transcription == "collocation" else found.transcription
    return Choice(name, found.reason, problem)


def growths(problem: Problem) -> list[float]:
    """Rate (1/s) at which small errors grow along each record, at the start values."""
    return [growth_of(problem.model.system, _start(problem), r) for r in problem.records]


def _start(problem: Problem) -> np.ndarray:
    return problem.variables.parameters(np.zeros(problem.variables.size))
