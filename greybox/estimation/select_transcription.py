"""Which transcription a fit uses, and why, in words."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from greybox.estimation.options import FitOptions
from greybox.estimation.problem import EstimationProblem
from greybox.transcription import estimate_error_growth, propose_transcription

ASKED = "as asked"


@dataclass(frozen=True)
class TranscriptionChoice:
    """``transcription`` is one of `TRANSCRIPTIONS` without ``automatic``; ``problem`` has the steps that go with it."""

    transcription: str
    reason: str
    problem: EstimationProblem

    def told(self, what: str) -> str:
        """``what``, with the reason."""
        return f"{what}, {ASKED}" if self.reason == ASKED else f"{what}; picked because {self.reason}"


def select_transcription(problem: EstimationProblem, options: FitOptions) -> TranscriptionChoice:
    """The transcription that was asked for, else the one that suits the model and the longest record at the start values.

    A stiff model also gets implicit steps, unless the method or the substeps were given.
    """
    longest = max(problem.records, key=lambda r: float(r.h.sum()))
    found = propose_transcription(problem.model.system, _start(problem), longest, integrating="single")
    if found.implicit and options.method == "automatic" and not options.substeps:
        problem = replace(problem, method="radau").with_step(0, _start(problem))
    if options.arc_length:
        return TranscriptionChoice("arcs", ASKED, problem)
    if options.transcription != "automatic":
        return TranscriptionChoice(options.transcription, ASKED, problem)
    name = "collocation-radau" if found.transcription == "collocation" else found.transcription
    return TranscriptionChoice(name, found.reason, problem)


def compute_growth_rates(problem: EstimationProblem) -> list[float]:
    """Rate (1/s) at which small errors grow along each record, at the start values."""
    return [estimate_error_growth(problem.model.system, _start(problem), r) for r in problem.records]


def _start(problem: EstimationProblem) -> np.ndarray:
    return problem.variables.parameters(np.zeros(problem.variables.size))
