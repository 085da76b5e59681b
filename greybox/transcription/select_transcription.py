"""Which transcription a fit uses, and why, in words."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from greybox.findings import Finding
from greybox.transcription.options import SolverOptions, Transcription
from greybox.transcription.problem import EstimationProblem
from greybox.transcription.select import estimate_error_growth, propose_transcription
from greybox.transcription.strategy import make_strategy


@dataclass(frozen=True)
class TranscriptionChoice:
    """A transcription (`Transcription` without ``automatic``), why it was chosen (None where it was asked for), and the problem with the
    steps that go with it.
    """

    transcription: str
    reason: Finding | None
    problem: EstimationProblem

    def to_strategy(self, **values: object) -> Finding:
        """The strategy with what the search was made of."""
        code = "" if self.reason is None else str(self.reason.code)
        reason_values = {} if self.reason is None else dict(self.reason.values)
        return make_strategy(self.transcription, reason=code, reason_values=reason_values, **values)


def select_transcription(problem: EstimationProblem, options: SolverOptions) -> TranscriptionChoice:
    """The transcription that was asked for, else the one that suits the model and the longest record at the start values.

    A stiff model also gets implicit steps, unless the method or the substeps were given.
    """
    longest = max(problem.records, key=lambda r: float(r.h.sum()))
    policy = options.policy
    proposal = propose_transcription(
        problem.model.system,
        _start_parameters(problem),
        longest,
        integrating="single",
        policy=policy.transcription.choice,
        discretisation=policy.discretisation,
    )
    if proposal.implicit and options.method == "automatic" and not options.substeps:
        problem = replace(problem, method="radau").with_step(0, _start_parameters(problem))
    if options.arc_length:
        return TranscriptionChoice(Transcription.ARCS, None, problem)
    if options.transcription != Transcription.AUTOMATIC:
        return TranscriptionChoice(options.transcription, None, problem)
    name = "collocation-radau" if proposal.transcription == "collocation" else proposal.transcription
    return TranscriptionChoice(name, proposal.reason, problem)


def compute_growth_rates(problem: EstimationProblem) -> list[float]:
    """Rate (1/s) at which small errors grow along each record, at the start values."""
    policy, p = problem.policy.transcription.choice, _start_parameters(problem)
    return [estimate_error_growth(problem.model.system, p, r, policy) for r in problem.records]


def _start_parameters(problem: EstimationProblem) -> np.ndarray:
    return problem.variables.parameters(problem.variables.here)
