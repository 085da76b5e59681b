"""A fit by direct collocation: the equations are solved together with the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greybox.fitting.choose import Choice, growths
from greybox.fitting.freely import freely
from greybox.fitting.options import FitOptions, Report
from greybox.fitting.problem import Problem
from greybox.fitting.refine import HALVINGS, over_noise, too_coarse, with_substeps
from greybox.fitting.solution import Joined, Runs, Solution
from greybox.fitting.watch import Watch
from greybox.optimiser import Outcome, solve_sparse
from greybox.transcription import Collocation, Evaluation, SingleShooting, Variables, relaxed_start, rows_of_segment
from greybox.transcription.segments import cuts_every

# What changed when an interval was halved changes so many times less when it is halved again: three points are of third order at
# least, also on stiff equations (Hairer, Wanner, Solving Ordinary Differential Equations II, stage order).
GAIN = 2.0**3
POINTS = 3
TITLES = {"radau": "Radau", "legendre": "Legendre"}


@dataclass(frozen=True)
class _Point:
    """What a solver ended with: the states (N, nx) of each record and, if it succeeded, the problem linearised there."""

    outcome: Outcome
    variables: Variables
    states: Sequence[np.ndarray]
    held: int
    evaluation: Evaluation
    rows: Runs


def solve_collocation(choice: Choice, options: FitOptions, report: Report | None = None) -> Solution:
    """Minimise over the constants and the states at three points of every sampling interval.

    The intervals are halved once, to see what that changes, and again until it changes too little to matter. ``substeps`` of
    the options are the elements of an interval, if given.
    """
    problem, scheme = choice.problem, choice.transcription.removeprefix("collocation-")
    elements = max(options.substeps, 1)
    at = _solved(problem, *_start(problem), scheme, elements, options, report)
    work = [at]
    error, shift = np.zeros(len(problem.noise.std)), np.zeros(len(problem.variables.which))
    for _ in range(HALVINGS):
        if not at.outcome.status.success:
            break
        finer = _solved(problem, at.variables, at.states, scheme, 2 * elements, options, report)
        work.append(finer)
        if not finer.outcome.status.success:
            break
        error = over_noise(problem, _runs(problem, at), _runs(problem, finer))
        shift = _shift(at.variables, finer.variables)
        if options.substeps:
            break
        at, elements = finer, 2 * elements
        error, shift = error / GAIN, shift / GAIN
        if not too_coarse(error, problem, at.evaluation, POINTS * elements):
            break
    if not problem.step.per_interval:  # for who runs the model freely from here
        problem = with_substeps(problem, max(problem.step.substeps, POINTS * elements), at.variables.fixed)
    held = f"; {at.held} samples lie at a bound of a state" if at.held else ""
    success, title = at.outcome.status.success, TITLES[scheme]
    solution = Solution(
        problem, at.variables, at.evaluation, at.outcome.status, at.outcome.solver_status,
        sum(w.outcome.iterations for w in work), sum(w.outcome.evaluations for w in work),
        sum(w.outcome.seconds for w in work), (1.0,), error,
        choice.told(f"direct collocation{held}"), choice.transcription,
        Joined(_runs(problem, at), at.rows, at.variables.size, shift) if success else None,
        f"collocation, three {title} points" + (" a sample" if elements == 1 else f" in each of {elements} elements a sample"),
    )  # fmt: skip
    return freely(solution, options, report)


def _start(problem: Problem) -> tuple[Variables, list[np.ndarray]]:
    """Variables and states along each record to begin with; where no piece of it can be simulated, its first states stay."""
    v = problem.variables
    single = SingleShooting(v, problem.step, problem.kernel, problem.records, 1 / problem.noise.std)
    pairs = zip(growths(problem), single.records, strict=True)
    cuts = [cuts_every(e, r, rows_of_segment(growth, r)) for e, (growth, r) in enumerate(pairs)]
    variables, states = relaxed_start(single, cuts)
    return variables, [np.where(np.isfinite(x), x, v.initial.guess[e]) for e, x in enumerate(states)]


def _solved(
    problem: Problem, variables: Variables, states: Sequence[np.ndarray], scheme: str, elements: int,
    options: FitOptions, report: Report | None,
) -> _Point:  # fmt: skip
    records, weight = problem.records, 1 / problem.noise.std
    program = Collocation(variables, records, weight, states, scheme=scheme, elements=elements, hessian=options.hessian)
    outcome = solve_sparse(**program.problem(), iterations=options.iterations, progress=Watch(problem, report))
    found = program.found(outcome.z)
    if not outcome.status.success:
        free = SingleShooting(found.variables, problem.step, problem.kernel, records, weight)
        return _Point(outcome, found.variables, found.states, found.held, free.evaluate(np.zeros(variables.size)), ())
    return _Point(outcome, found.variables, found.states, found.held, *program.linearised(outcome.z))


def _runs(problem: Problem, at: _Point) -> Runs:
    """Outputs and states at the rows of each record."""
    output, zero = problem.model.system.output_function, np.zeros(at.variables.size)
    runs = []
    for e, (record, x) in enumerate(zip(problem.records, at.states, strict=True)):
        p = at.variables.parameters(zero, e)
        runs.append((output(x.T, record.u.T, p).full().T, x))
    return tuple(runs)


def _shift(before: Variables, after: Variables) -> np.ndarray:
    """How far the free constants have moved (nf,), in ``z`` of the second."""
    return (after.base - before.base) / after.spans
