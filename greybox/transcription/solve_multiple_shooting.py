"""A fit by multiple shooting: segments that meet at the optimum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.optim import TerminationStatus
from greybox.transcription.finish_by_simulation_error import finish_by_simulation_error
from greybox.transcription.initialisation import simulate_segments
from greybox.transcription.multiple_shooting import MultipleShooting, MultipleShootingResult, choose_segment_rows
from greybox.transcription.options import SolverOptions
from greybox.transcription.problem import EstimationProblem
from greybox.transcription.progress import FitProgressCallback, monitor_progress
from greybox.transcription.select_transcription import TranscriptionChoice, compute_growth_rates
from greybox.transcription.simulation_error import SingleShooting
from greybox.transcription.solution import SegmentedRun, Solution
from greybox.transcription.step_refinement import compute_change_over_noise, halve_step, is_too_coarse


def solve_multiple(
    choice: TranscriptionChoice, options: SolverOptions, report: FitProgressCallback | None = None
) -> Solution:
    """Minimise the cost of each record's segments, which end where the next one begins.

    The step is halved until that changes the segments too little to matter, as with single shooting.
    """
    problem = choice.problem
    pairs = zip(compute_growth_rates(problem), problem.records, strict=True)
    rows = [choose_segment_rows(growth, r, options.policy.transcription.segments) for growth, r in pairs]
    shooting = _make_shooting(problem, rows)
    iterations = passes = 0
    seconds, error = 0.0, np.zeros(len(problem.noise.std))
    policy = options.policy.step_refinement
    with monitor_progress(problem, report) as monitor:
        for halving in range(policy.halvings + 1):
            result = shooting.solve(iterations=options.iterations, relax=halving == 0, report=monitor)
            iterations, passes, seconds = (
                iterations + result.iterations,
                passes + result.evaluations,
                seconds + result.seconds,
            )
            if not result.runs or result.status is TerminationStatus.INTERRUPTED or problem.step.per_interval:
                break
            problem = replace(problem, variables=result.variables)
            error = _compute_step_error(problem, shooting.cuts, result)
            if (
                options.substeps
                or halving == policy.halvings
                or not is_too_coarse(error, problem, result.evaluation, policy)
            ):
                break
            problem = halve_step(problem)
            shooting = _make_shooting(problem, rows, result.nodes)
    segments = sum(len(n) - 1 for n in result.nodes)
    solution = Solution(
        problem,
        result.variables,
        result.evaluation,
        result.status,
        "",
        iterations,
        passes,
        seconds,
        (1.0,),
        error,
        choice.to_strategy(segments=segments),
        "multiple",
    )
    if not result.runs:
        return solution
    joined = SegmentedRun(result.runs, result.rows, result.variables.size, _compute_step_shift(problem, rows, result))
    return finish_by_simulation_error(replace(solution, joined=joined), options, report)


def _make_shooting(
    problem: EstimationProblem, rows: list[int], nodes: Sequence[np.ndarray] | None = None
) -> MultipleShooting:
    return MultipleShooting(
        problem.variables,
        problem.step,
        problem.kernel,
        problem.records,
        1 / problem.noise.std,
        rows,
        nodes,
        problem.policy.transcription,
    )


def _compute_step_error(
    problem: EstimationProblem, cuts: Sequence[Sequence[int]], result: MultipleShootingResult
) -> np.ndarray:
    """What half the step changes in the segments, over the noise (ny,)."""
    finer, z = halve_step(problem), result.variables.here
    single = SingleShooting(result.variables, finer.step, finer.kernel, problem.records, 1 / problem.noise.std)
    runs = [simulate_segments(single, z, e, rows, result.nodes[e]) for e, rows in enumerate(cuts)]
    return compute_change_over_noise(problem, result.runs, runs)


def _compute_step_shift(problem: EstimationProblem, rows: list[int], result: MultipleShootingResult) -> np.ndarray:
    """What half the step changes in the constants (nf,), in ``z``."""
    if problem.step.per_interval or not len(result.variables.which):
        return np.zeros(len(result.variables.which))
    at_optimum = replace(problem, variables=result.variables)
    return (
        _make_shooting(halve_step(at_optimum), rows, result.nodes).gauss_newton_step()
        - _make_shooting(at_optimum, rows, result.nodes).gauss_newton_step()
    )
