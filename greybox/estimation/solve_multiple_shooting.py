"""A fit by multiple shooting: segments that meet at the optimum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.estimation.finish_by_simulation_error import finish_by_simulation_error
from greybox.estimation.options import FitOptions, FitProgressCallback
from greybox.estimation.problem import EstimationProblem
from greybox.estimation.progress_monitor import monitor_progress
from greybox.estimation.select_transcription import TranscriptionChoice, compute_growth_rates
from greybox.estimation.solution import SegmentedRun, Solution
from greybox.estimation.step_refinement import HALVINGS, compute_change_over_noise, halve_step, is_too_coarse
from greybox.optim import TerminationStatus
from greybox.transcription import (
    MultipleShooting,
    MultipleShootingResult,
    MultipleShootingStatus,
    SingleShooting,
    choose_segment_rows,
    simulate_segments,
)

STATUS = {
    MultipleShootingStatus.CONVERGED: TerminationStatus.CONVERGED,
    MultipleShootingStatus.FLAT: TerminationStatus.ACCEPTABLE,
    MultipleShootingStatus.LIMIT: TerminationStatus.ITERATION_LIMIT,
    MultipleShootingStatus.STUCK: TerminationStatus.STUCK,
    MultipleShootingStatus.NO_START: TerminationStatus.NO_START,
    MultipleShootingStatus.INTERRUPTED: TerminationStatus.INTERRUPTED,
}


def solve_multiple(
    choice: TranscriptionChoice, options: FitOptions, report: FitProgressCallback | None = None
) -> Solution:
    """Minimise the cost of each record's segments, which end where the next one begins.

    The step is halved until that changes the segments too little to matter, as with single shooting.
    """
    problem = choice.problem
    rows = [
        choose_segment_rows(growth, r) for growth, r in zip(compute_growth_rates(problem), problem.records, strict=True)
    ]
    shooting = _shooting(problem, rows)
    iterations = passes = 0
    seconds, error = 0.0, np.zeros(len(problem.noise.std))
    with monitor_progress(problem, report) as watch:
        for halving in range(HALVINGS + 1):
            found = shooting.solve(iterations=options.iterations, relax=halving == 0, report=watch)
            iterations, passes, seconds = (
                iterations + found.iterations,
                passes + found.evaluations,
                seconds + found.seconds,
            )
            if not found.runs or found.end is MultipleShootingStatus.INTERRUPTED or problem.step.per_interval:
                break
            problem = replace(problem, variables=found.variables)
            error = _error(problem, shooting.cuts, found)
            if options.substeps or halving == HALVINGS or not is_too_coarse(error, problem, found.evaluation):
                break
            problem = halve_step(problem)
            shooting = _shooting(problem, rows, found.nodes)
    number = sum(len(n) - 1 for n in found.nodes)
    segments = "one segment" if number == 1 else f"{number} segments"
    solution = Solution(
        problem, found.variables, found.evaluation, STATUS[found.end], "", iterations, passes, seconds, (1.0,), error,
        choice.told(f"multiple shooting over {segments}"), "multiple",
    )  # fmt: skip
    if not found.runs:
        return solution
    joined = SegmentedRun(found.runs, found.rows, found.variables.size, _shift(problem, rows, found))
    return finish_by_simulation_error(replace(solution, joined=joined), options, report)


def _shooting(
    problem: EstimationProblem, rows: list[int], nodes: Sequence[np.ndarray] | None = None
) -> MultipleShooting:
    return MultipleShooting(
        problem.variables, problem.step, problem.kernel, problem.records, 1 / problem.noise.std, rows, nodes
    )


def _error(problem: EstimationProblem, cuts: Sequence[Sequence[int]], found: MultipleShootingResult) -> np.ndarray:
    """What half the step changes in the segments, over the noise (ny,)."""
    finer, z = halve_step(problem), np.zeros(found.variables.size)
    single = SingleShooting(found.variables, finer.step, finer.kernel, problem.records, 1 / problem.noise.std)
    runs = [simulate_segments(single, z, e, own, found.nodes[e]) for e, own in enumerate(cuts)]
    return compute_change_over_noise(problem, found.runs, runs)


def _shift(problem: EstimationProblem, rows: list[int], found: MultipleShootingResult) -> np.ndarray:
    """What half the step changes in the constants (nf,), in ``z``."""
    if problem.step.per_interval or not len(found.variables.which):
        return np.zeros(len(found.variables.which))
    here = replace(problem, variables=found.variables)
    return (
        _shooting(halve_step(here), rows, found.nodes).gauss_newton_step()
        - _shooting(here, rows, found.nodes).gauss_newton_step()
    )
