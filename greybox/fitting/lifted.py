"""A fit by multiple shooting: segments that meet at the optimum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.fitting.choose import Choice, growths
from greybox.fitting.freely import freely
from greybox.fitting.options import FitOptions, Report
from greybox.fitting.problem import Problem
from greybox.fitting.refine import HALVINGS, halved, over_noise, too_coarse
from greybox.fitting.solution import Joined, Solution
from greybox.fitting.watch import watched
from greybox.optimiser import Status
from greybox.transcription import End, Lifted, MultipleShooting, SingleShooting, rows_of_segment, run_pieces

STATUS = {
    End.CONVERGED: Status.CONVERGED, End.FLAT: Status.ACCEPTABLE, End.LIMIT: Status.ITERATION_LIMIT, End.STUCK: Status.STUCK,
    End.NO_START: Status.NO_START, End.INTERRUPTED: Status.INTERRUPTED,
}  # fmt: skip


def solve_multiple(choice: Choice, options: FitOptions, report: Report | None = None) -> Solution:
    """Minimise the cost of each record's segments, which end where the next one begins.

    The step is halved until that changes the segments too little to matter, as with single shooting.
    """
    problem = choice.problem
    rows = [rows_of_segment(growth, r) for growth, r in zip(growths(problem), problem.records, strict=True)]
    shooting = _shooting(problem, rows)
    iterations = passes = 0
    seconds, error = 0.0, np.zeros(len(problem.noise.std))
    with watched(problem, report) as watch:
        for halving in range(HALVINGS + 1):
            found = shooting.solve(iterations=options.iterations, relax=halving == 0, report=watch)
            iterations, passes, seconds = (
                iterations + found.iterations,
                passes + found.evaluations,
                seconds + found.seconds,
            )
            if not found.runs or found.end is End.INTERRUPTED or problem.step.per_interval:
                break
            problem = replace(problem, variables=found.variables)
            error = _error(problem, shooting.cuts, found)
            if options.substeps or halving == HALVINGS or not too_coarse(error, problem, found.evaluation):
                break
            problem = halved(problem)
            shooting = _shooting(problem, rows, found.nodes)
    number = sum(len(n) - 1 for n in found.nodes)
    segments = "one segment" if number == 1 else f"{number} segments"
    solution = Solution(
        problem, found.variables, found.evaluation, STATUS[found.end], "", iterations, passes, seconds, (1.0,), error,
        choice.told(f"multiple shooting over {segments}"), "multiple",
    )  # fmt: skip
    if not found.runs:
        return solution
    joined = Joined(found.runs, found.rows, found.variables.size, _shift(problem, rows, found))
    return freely(replace(solution, joined=joined), options, report)


def _shooting(problem: Problem, rows: list[int], nodes: Sequence[np.ndarray] | None = None) -> MultipleShooting:
    return MultipleShooting(
        problem.variables, problem.step, problem.kernel, problem.records, 1 / problem.noise.std, rows, nodes
    )


def _error(problem: Problem, cuts: Sequence[Sequence[int]], found: Lifted) -> np.ndarray:
    """What half the step changes in the segments, over the noise (ny,)."""
    finer, z = halved(problem), np.zeros(found.variables.size)
    single = SingleShooting(found.variables, finer.step, finer.kernel, problem.records, 1 / problem.noise.std)
    runs = [run_pieces(single, z, e, own, found.nodes[e]) for e, own in enumerate(cuts)]
    return over_noise(problem, found.runs, runs)


def _shift(problem: Problem, rows: list[int], found: Lifted) -> np.ndarray:
    """What half the step changes in the constants (nf,), in ``z``."""
    if problem.step.per_interval or not len(found.variables.which):
        return np.zeros(len(found.variables.which))
    here = replace(problem, variables=found.variables)
    return _shooting(halved(here), rows, found.nodes).newton() - _shooting(here, rows, found.nodes).newton()
