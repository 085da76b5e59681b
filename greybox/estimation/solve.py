"""From a problem to its optimum, by the transcription that was asked for or that suits the model."""

from __future__ import annotations

from dataclasses import replace

from greybox.estimation.options import FitOptions, FitProgressCallback, Transcription
from greybox.estimation.problem import EstimationProblem
from greybox.estimation.select_transcription import select_transcription
from greybox.estimation.solution import Solution
from greybox.estimation.solve_arcs import solve_arcs
from greybox.estimation.solve_collocation import solve_collocation
from greybox.estimation.solve_multiple_shooting import solve_multiple
from greybox.estimation.solve_single_shooting import solve_single

__all__ = ["Solution", "solve"]

_SEGMENTED = {
    Transcription.MULTIPLE: solve_multiple,
    Transcription.COLLOCATION_RADAU: solve_collocation,
    Transcription.COLLOCATION_LEGENDRE: solve_collocation,
    Transcription.ARCS: solve_arcs,
}


def solve(problem: EstimationProblem, options: FitOptions, report: FitProgressCallback | None = None) -> Solution:
    """Minimise the noise-weighted simulation error of ``problem``; `Solution.strategy` says how, and why so.

    Raises ModelError for a transcription that the model does not allow.
    """
    choice = select_transcription(problem, options)
    if choice.transcription in _SEGMENTED:
        return _SEGMENTED[Transcription(choice.transcription)](choice, options, report)
    solution = solve_single(choice.problem, options, report)
    return replace(solution, strategy=choice.to_strategy(**solution.strategy.values))
