"""From a problem to its optimum, by the transcription that was asked for or that suits the model."""

from __future__ import annotations

from dataclasses import replace

from greybox.transcription.options import SolverOptions, Transcription
from greybox.transcription.problem import EstimationProblem
from greybox.transcription.progress import FitProgressCallback
from greybox.transcription.select_transcription import select_transcription
from greybox.transcription.single_shooting import solve_single
from greybox.transcription.solution import Solution
from greybox.transcription.solve_arcs import solve_arcs
from greybox.transcription.solve_collocation import solve_collocation
from greybox.transcription.solve_multiple_shooting import solve_multiple

__all__ = ["Solution", "solve"]

_SEGMENTED = {
    Transcription.MULTIPLE: solve_multiple,
    Transcription.COLLOCATION_RADAU: solve_collocation,
    Transcription.COLLOCATION_LEGENDRE: solve_collocation,
    Transcription.ARCS: solve_arcs,
}


def solve(problem: EstimationProblem, options: SolverOptions, report: FitProgressCallback | None = None) -> Solution:
    """Minimise the noise-weighted simulation error of ``problem``; `Solution.strategy` says how, and why so.

    Raises ModelError for a transcription that the model does not allow.
    """
    choice = select_transcription(problem, options)
    if choice.transcription in _SEGMENTED:
        return _SEGMENTED[Transcription(choice.transcription)](choice, options, report)
    solution = solve_single(choice.problem, options, report)
    return replace(solution, strategy=choice.to_strategy(**solution.strategy.values))
