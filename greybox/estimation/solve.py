"""From a problem to its optimum, by the transcription that was asked for or that suits the model."""

from __future__ import annotations

from dataclasses import replace

from greybox.estimation.options import FitOptions, FitProgressCallback
from greybox.estimation.problem import EstimationProblem
from greybox.estimation.select_transcription import select_transcription
from greybox.estimation.solution import Solution
from greybox.estimation.solve_arcs import solve_arcs
from greybox.estimation.solve_collocation import solve_collocation
from greybox.estimation.solve_multiple_shooting import solve_multiple
from greybox.estimation.solve_single_shooting import solve_single

__all__ = ["Solution", "solve"]

JOINED = {
    "multiple": solve_multiple, "collocation-radau": solve_collocation, "collocation-legendre": solve_collocation,
    "arcs": solve_arcs,
}  # fmt: skip


def solve(problem: EstimationProblem, options: FitOptions, report: FitProgressCallback | None = None) -> Solution:
    """Minimise the noise-weighted simulation error of ``problem``; `Solution.strategy` says how, and why so.

    Raises ModelError for a transcription that the model does not allow.
    """
    choice = select_transcription(problem, options)
    if choice.transcription in JOINED:
        return JOINED[choice.transcription](choice, options, report)
    found = solve_single(choice.problem, options, report)
    return replace(found, strategy=choice.told(found.strategy))
