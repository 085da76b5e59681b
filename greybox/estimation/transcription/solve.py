"""From a problem to its optimum, by the transcription that was asked for or that suits the model."""

from __future__ import annotations

from dataclasses import replace

from greybox.base.errors import ModelError
from greybox.estimation.options import FitOptions, Transcription
from greybox.estimation.transcription.collocation import solve_collocation
from greybox.estimation.transcription.multiple_shooting import solve_multiple_shooting
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.estimation.transcription.select import select_transcription
from greybox.estimation.transcription.single_shooting import solve_single_shooting
from greybox.estimation.transcription.solution import Completion, FitProgressCallback, Solution

__all__ = ["Solution", "solve"]


def solve(problem: EstimationProblem, options: FitOptions, report: FitProgressCallback | None = None) -> Solution:
    """Minimise the noise-weighted simulation error of ``problem``; `Solution.strategy` says how, and why so.

    Raises ModelError for a transcription that the model does not allow.
    """
    choice = select_transcription(problem, options)
    if choice.transcription is Transcription.SINGLE:
        solution = solve_single_shooting(choice.problem, options, report)
        return replace(solution, strategy=choice.to_strategy(**solution.strategy.values))
    if choice.transcription is Transcription.ARCS:
        return solve_multiple_shooting(choice, options, report)
    is_multiple = choice.transcription is Transcription.MULTIPLE
    solution = (solve_multiple_shooting if is_multiple else solve_collocation)(choice, options, report)
    return finish_by_simulation_error(solution, options, report)


# A free run follows the joined one if its cost is at most so many times as large ...
COST_RATIO = 1.1
# ... or larger by this misfit over noise squared for each sample.
PERFECT_NOISE_RATIO = 0.001


def finish_by_simulation_error(solution: Solution, options: FitOptions, report: FitProgressCallback | None) -> Solution:
    """``solution``, found with white noise and least squares; carried on by a free run where its problem asks for more.

    Where the free run does not follow it (an unstable plant) the noise's colour is left to the intervals, and the strategy says so;
    anything else is refused with ModelError.
    """
    problem = solution.at_optimum
    if problem.is_plain_squares or not solution.status.success:
        return solution
    cost = problem.with_plain_squares().shooting().evaluate(problem.variables.here).cost
    if cost <= COST_RATIO * solution.evaluation.cost + PERFECT_NOISE_RATIO**2 * solution.evaluation.count:
        finished = solve_single_shooting(problem, replace(options, progressive=False), report).with_work_of(solution)
        return replace(finished, strategy=solution.strategy).with_strategy(completion=str(Completion.FREE_RUN))
    if problem.with_white_noise().is_plain_squares:
        white = replace(solution, problem=solution.problem.with_white_noise())
        return white.with_strategy(completion=str(Completion.WHITE_NOISE))
    title = "multiple shooting" if solution.transcription == Transcription.MULTIPLE else "collocation"
    raise ModelError(
        f"{problem.model.title}: {title} minimises plain squares of the error; a robust loss needs a free run, and a free run does not"
        " follow this plant: leave the loss out"
    )
