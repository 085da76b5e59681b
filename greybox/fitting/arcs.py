"""A fit by arcs of a chosen length: each begins at a state of its own, and none need meet the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from greybox.errors import DataError, ModelError
from greybox.fitting.choose import Choice
from greybox.fitting.freely import plain
from greybox.fitting.halving import gauss_newton_step
from greybox.fitting.options import FitOptions, Report
from greybox.fitting.problem import Problem
from greybox.fitting.refine import HALVINGS, halved, over_noise, too_coarse
from greybox.fitting.single import NEGLIGIBLE, NO_RESULT, finished, solve_single
from greybox.fitting.solution import Joined, Runs, Solution
from greybox.fitting.watch import Watch
from greybox.optimiser import minimise
from greybox.transcription import Evaluation, ProjectedShooting, SingleShooting, Variables, cut
from greybox.transcription.arcs import Cut
from greybox.transcription.projected import inverse_of

# Unknowns that a search with other than plain squares can take (its Hessian is dense).
MOST_UNKNOWNS = 1000
# Of a record's duration: one sampling interval more than it is still the whole record, and no mistake.
HAIR = 0.01


def solve_arcs(choice: Choice, options: FitOptions, report: Report | None = None) -> Solution:
    """Minimise the cost of every record cut in arcs of ``options.arc_length`` seconds, all their initial states estimated.

    Where the cost is plain squares the initial states are eliminated arc by arc, else they are searched for with the constants.
    Raises ModelError for too many arcs of the second kind, DataError for arcs that are too short (`arcs_of`) or longer than
    every record.
    """
    whole = choice.problem
    _check_length(whole, options.arc_length)
    arcs = cut(_shooting(whole), seconds=options.arc_length)
    problem = replace(whole, records=arcs.shooting.records, variables=arcs.shooting.variables)
    if plain(problem):
        solved = _eliminated(problem, arcs.begins, options, report)
    else:
        _check_number(problem, len(arcs.begins), options)
        solved = solve_single(problem, replace(options, progressive=False), report)
    problem = replace(solved.problem, variables=solved.variables)
    variables = _of_records(whole.variables, solved.variables, arcs.begins)
    solution = replace(
        solved, problem=replace(whole, step=problem.step, kernel=problem.kernel), variables=variables, transcription="arcs",
        strategy=choice.told(_told(arcs, options.arc_length)),
    )  # fmt: skip
    if not np.isfinite(solved.evaluation.cost):
        return solution
    rows = _projected(problem)
    evaluation = _evaluation(solved.evaluation, rows, variables.size)
    shift = np.zeros(len(variables.which))
    if not problem.step.per_interval:
        finer = _evaluation(solved.evaluation, _projected(halved(problem)), variables.size)
        shift = (gauss_newton_step(variables, finer) - gauss_newton_step(variables, evaluation))[: len(shift)]
    runs = problem.shooting(problem.variables).simulate(np.zeros(problem.variables.size))
    own = len(variables.states_each)
    padded = [(r, np.pad(jacobian, ((0, 0), (0, 0), (0, own)))) for r, jacobian in rows]
    joined = Joined(_stitched(runs, arcs), _stitched(padded, arcs), problem.variables.size, shift)
    return replace(solution, joined=joined, evaluation=evaluation)


def _shooting(problem: Problem) -> SingleShooting:
    return SingleShooting(problem.variables, problem.step, problem.kernel, problem.records, 1 / problem.noise.std)


def _told(arcs: Cut, length: float) -> str:
    number = len(arcs.begins)
    if all(arcs.begins):
        return f"arcs of {length:g} s, which leave every record whole (what is left is less than half an arc)"
    return f"{number} arcs of {length:g} s, each from a state of its own"


def _check_length(problem: Problem, length: float) -> None:
    longest = max(float(record.h.sum()) for record in problem.records)
    if length > longest * (1 + HAIR):
        raise DataError(
            f"arcs of {length:g} s: the longest record lasts {longest:.6g} s, so no record would be cut; take shorter arcs, or leave"
            " arc_length out (shell: --arc-length)"
        )


def _check_number(problem: Problem, arcs: int, options: FitOptions) -> None:
    if problem.variables.size > MOST_UNKNOWNS:
        raise ModelError(
            f"arcs of {options.arc_length:g} s: {arcs} of them have {problem.variables.size} unknowns together; with coloured noise,"
            f" robust loss or priors at most {MOST_UNKNOWNS} are possible: take longer arcs"
        )


def _eliminated(problem: Problem, begins: Sequence[bool], options: FitOptions, report: Report | None) -> Solution:
    """The search over the constants alone; the step is halved until that changes too little to matter."""
    iterations = passes = 0
    seconds, error = 0.0, np.zeros(len(problem.noise.std))
    for halving in range(HALVINGS + 1):
        projected = ProjectedShooting(_shooting(problem))
        if halving == 0:
            projected.carry(begins)
        (low, high), zero = projected.bounds(), np.zeros(projected.size)
        first = projected.evaluate(zero)
        outcome = minimise(
            projected.evaluate, zero, low, high, scale=max(first.cost, 1e-300), first=first, tolerance=options.tolerance,
            iterations=options.iterations, finished=finished(low, high, NEGLIGIBLE), thorough=options.thorough,
            progress=Watch(problem, report),
        )  # fmt: skip
        iterations, passes = iterations + outcome.iterations, passes + outcome.evaluations
        value, seconds = outcome.value or first, seconds + outcome.seconds
        if outcome.status in NO_RESULT:
            break
        problem = replace(problem, variables=projected.variables.moved(projected.full(outcome.z)))
        if problem.step.per_interval:
            break
        finer, here = halved(problem), np.zeros(problem.variables.size)
        error = over_noise(problem, _shooting(problem).simulate(here), _shooting(finer).simulate(here))
        if options.substeps or halving == HALVINGS or not too_coarse(error, problem, value):
            break
        problem = finer
    return Solution(
        problem,
        problem.variables,
        value,
        outcome.status,
        outcome.solver_status,
        iterations,
        passes,
        seconds,
        (1.0,),
        error,
    )


def _of_records(v: Variables, found: Variables, begins: Sequence[bool]) -> Variables:
    """The variables ``v`` of the whole records with the constants ``found``; each record begins as its first arc does."""
    guess = found.initial.guess[np.flatnonzero(begins)]
    return replace(v, base=found.base, scale=found.scale, fixed=found.fixed, initial=replace(v.initial, guess=guess))


def _projected(problem: Problem) -> list[tuple[np.ndarray, np.ndarray]]:
    """Residuals (N, ny) of each arc and their Jacobian (N, ny, nf), its initial state at its best for the constants."""
    n, result = len(problem.variables.which), []
    for r, jacobian in problem.shooting(problem.variables).residuals(np.zeros(problem.variables.size)):
        there = np.isfinite(r)
        along, own = jacobian[there][:, :n], jacobian[there][:, n:]
        slope = -inverse_of(own.T @ own) @ (own.T @ along)
        result.append((r, jacobian[:, :, :n] + jacobian[:, :, n:] @ slope))
    return result


def _evaluation(reached: Evaluation, rows: Sequence[tuple[np.ndarray, np.ndarray]], size: int) -> Evaluation:
    """Cost, gradient and Gauss-Newton matrix (size, size) along the constants, initial states eliminated (their rows are zero)."""
    gradient, hessian = np.zeros(size), np.zeros((size, size))
    for r, jacobian in rows:
        there, n = np.isfinite(r), jacobian.shape[2]
        slopes = jacobian[there]
        gradient[:n] += 2 * slopes.T @ r[there]
        hessian[:n, :n] += 2 * slopes.T @ slopes
    return replace(reached, gradient=gradient, hessian=hessian)


def _stitched(pieces: Sequence[tuple[np.ndarray, np.ndarray]], arcs: Cut) -> Runs:
    """The arcs of each record one after the other."""
    edges = [*np.flatnonzero(arcs.begins), len(arcs.begins)]
    joined = [[np.concatenate(parts) for parts in zip(*pieces[a:b], strict=True)] for a, b in pairwise(edges)]
    return tuple((first, second) for first, second in joined)
