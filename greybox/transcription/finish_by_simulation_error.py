"""What segments and collocated points cannot weigh is weighed by a free run that begins at their optimum."""

from __future__ import annotations

from dataclasses import replace

from greybox.errors import ModelError
from greybox.noise import AutoRegression
from greybox.transcription.options import SolverOptions
from greybox.transcription.problem import EstimationProblem
from greybox.transcription.progress import FitProgressCallback
from greybox.transcription.simulation_error import SingleShooting
from greybox.transcription.single_shooting import solve_single
from greybox.transcription.solution import Solution
from greybox.transcription.strategy import Completion, extend_strategy


def is_plain_least_squares(problem: EstimationProblem) -> bool:
    """Whether the cost is the sum of squared errors over white noise alone."""
    return type(problem.shooting(problem.variables)) is SingleShooting and not problem.variables.has_prior.any()


def with_white_noise(problem: EstimationProblem) -> EstimationProblem:
    """The same with the noise taken to be white."""
    return problem.with_noise(replace(problem.noise, colour=tuple(AutoRegression() for _ in problem.noise.colour)))


def finish_by_simulation_error(
    solution: Solution, options: SolverOptions, report: FitProgressCallback | None
) -> Solution:
    """``solution``, found with white noise and least squares; carried on by single shooting where its problem asks for more.

    Where the free run does not follow it (an unstable plant) the noise's colour is left to the intervals, and the strategy says so;
    anything else is refused with ModelError.
    """
    problem = replace(solution.problem, variables=solution.variables)
    if is_plain_least_squares(problem) or not solution.status.success:
        return solution
    policy = options.policy.joining
    run = SingleShooting(problem.variables, problem.step, problem.kernel, problem.records, 1 / problem.noise.std)
    cost, count = run.evaluate(problem.variables.here).cost, solution.evaluation.count
    if cost <= policy.cost_ratio * solution.evaluation.cost + policy.perfect_noise_ratio**2 * count:
        finished = solve_single(problem, replace(options, progressive=False), report)
        return replace(
            finished,
            strategy=extend_strategy(solution.strategy, Completion.FREE_RUN),
            iterations=finished.iterations + solution.iterations,
            evaluations=finished.evaluations + solution.evaluations,
            seconds=finished.seconds + solution.seconds,
        )
    if is_plain_least_squares(with_white_noise(problem)):
        strategy = extend_strategy(solution.strategy, Completion.WHITE_NOISE)
        return replace(solution, problem=with_white_noise(solution.problem), strategy=strategy)
    title = "multiple shooting" if solution.transcription == "multiple" else "collocation"
    raise ModelError(
        f"{problem.model.title}: {title} minimises plain squares of the error; a robust loss needs a free run, and a free run does not"
        " follow this plant: leave the loss out"
    )
