"""A fit by arcs of a chosen length: each begins at a state of its own, and none need meet the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from greybox.errors import DataError, ModelError
from greybox.linear_algebra import decompose_symmetric
from greybox.numerics import TINY
from greybox.optim import minimise
from greybox.transcription.arcs import ArcProblem, cut_into_arcs
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.finish_by_simulation_error import is_plain_least_squares
from greybox.transcription.options import SolverOptions
from greybox.transcription.problem import EstimationProblem
from greybox.transcription.progress import FitProgressCallback, ProgressMonitor
from greybox.transcription.projected_initial_states import ProjectedShooting
from greybox.transcription.select_transcription import TranscriptionChoice
from greybox.transcription.simulation_error import Evaluation, SingleShooting, compute_gauss_newton_step
from greybox.transcription.single_shooting import NO_RESULT, make_termination_test, solve_single
from greybox.transcription.solution import Runs, SegmentedRun, Solution
from greybox.transcription.step_refinement import compute_change_over_noise, halve_step, is_too_coarse


def solve_arcs(
    choice: TranscriptionChoice, options: SolverOptions, report: FitProgressCallback | None = None
) -> Solution:
    """Minimise the cost of every record cut in arcs of ``options.arc_length`` seconds, all their initial states estimated.

    Where the cost is plain squares the initial states are eliminated arc by arc, else they are searched for with the constants.
    Raises ModelError for too many arcs of the second kind, DataError for arcs that are too short (`split_into_arcs`) or longer than
    every record.
    """
    whole = choice.problem
    _check_length(whole, options)
    arcs = cut_into_arcs(_shooting(whole), seconds=options.arc_length, policy=options.policy.transcription.segments)
    problem = replace(whole, records=arcs.shooting.records, variables=arcs.shooting.variables)
    if is_plain_least_squares(problem):
        solved = _solve_with_states_eliminated(problem, arcs.starts_record, options, report)
    else:
        _check_number(problem, len(arcs.starts_record), options)
        solved = solve_single(problem, replace(options, progressive=False), report)
    problem = replace(solved.problem, variables=solved.variables)
    variables = _to_whole_records(whole.variables, solved.variables, arcs.starts_record)
    solution = replace(
        solved,
        problem=replace(whole, step=problem.step, kernel=problem.kernel),
        variables=variables,
        transcription="arcs",
        strategy=choice.to_strategy(
            arcs=len(arcs.starts_record), arc_length=options.arc_length, whole=bool(all(arcs.starts_record))
        ),
    )
    if not np.isfinite(solved.evaluation.cost):
        return solution
    rows = _project_residuals(problem)
    evaluation = _evaluate(solved.evaluation, rows, variables.size)
    shift = np.zeros(len(variables.which))
    if not problem.step.per_interval:
        finer = _evaluate(solved.evaluation, _project_residuals(halve_step(problem)), variables.size)
        shift = (compute_gauss_newton_step(variables, finer) - compute_gauss_newton_step(variables, evaluation))[
            : len(shift)
        ]
    runs = problem.shooting(problem.variables).simulate(problem.variables.here)
    states = len(variables.free_states)
    padded = [(r, np.pad(jacobian, ((0, 0), (0, 0), (0, states)))) for r, jacobian in rows]
    joined = SegmentedRun(_stitch(runs, arcs), _stitch(padded, arcs), problem.variables.size, shift)
    return replace(solution, joined=joined, evaluation=evaluation)


def _shooting(problem: EstimationProblem) -> SingleShooting:
    return SingleShooting(problem.variables, problem.step, problem.kernel, problem.records, 1 / problem.noise.std)


def _check_length(problem: EstimationProblem, options: SolverOptions) -> None:
    length = options.arc_length
    longest = max(float(record.h.sum()) for record in problem.records)
    if length > longest * (1 + options.policy.joining.length_tolerance):
        raise DataError(
            f"arcs of {length:g} s: the longest record lasts {longest:.6g} s, so no record would be divided; take shorter arcs, or leave"
            " arc_length out (shell: --arc-length)"
        )


def _check_number(problem: EstimationProblem, arcs: int, options: SolverOptions) -> None:
    most = options.policy.joining.most_unknowns
    if problem.variables.size > most:
        raise ModelError(
            f"arcs of {options.arc_length:g} s: {arcs} of them have {problem.variables.size} unknowns together; with coloured noise,"
            f" robust loss or priors at most {most} are possible: take longer arcs"
        )


def _solve_with_states_eliminated(
    problem: EstimationProblem,
    starts_record: Sequence[bool],
    options: SolverOptions,
    report: FitProgressCallback | None,
) -> Solution:
    """The search over the constants alone; the step is halved until that changes too little to matter."""
    iterations = passes = 0
    seconds, error = 0.0, np.zeros(len(problem.noise.std))
    policy = options.policy.step_refinement
    for halving in range(policy.halvings + 1):
        projected = ProjectedShooting(_shooting(problem), options.policy.transcription.projection)
        if halving == 0:
            projected.carry_states(starts_record)
        (low, high), zero = projected.bounds(), np.zeros(projected.size)
        first = projected.evaluate(zero)
        outcome = minimise(
            projected.evaluate,
            zero,
            low,
            high,
            scale=max(first.cost, TINY),
            value_at_start=first,
            tolerance=options.tolerance,
            iterations=options.iterations,
            termination_test=make_termination_test(low, high, options.policy.convergence),
            thorough=options.thorough,
            progress=ProgressMonitor(problem, report),
            policy=options.policy.minimisation,
        )
        iterations, passes = iterations + outcome.iterations, passes + outcome.evaluations
        value, seconds = outcome.value or first, seconds + outcome.seconds
        if outcome.status in NO_RESULT:
            break
        problem = replace(problem, variables=projected.variables.recentre(projected.full(outcome.z)))
        if problem.step.per_interval:
            break
        finer, zero = halve_step(problem), problem.variables.here
        error = compute_change_over_noise(problem, _shooting(problem).simulate(zero), _shooting(finer).simulate(zero))
        if options.substeps or halving == policy.halvings or not is_too_coarse(error, problem, value, policy):
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


def _to_whole_records(v: DecisionVector, fitted: DecisionVector, starts_record: Sequence[bool]) -> DecisionVector:
    """The variables ``v`` of the whole records with the constants ``fitted``; each record begins as its first arc does."""
    guess = fitted.initial.guess[np.flatnonzero(starts_record)]
    return replace(v, base=fitted.base, scale=fitted.scale, fixed=fitted.fixed, initial=replace(v.initial, guess=guess))


def _project_residuals(problem: EstimationProblem) -> list[tuple[np.ndarray, np.ndarray]]:
    """Residuals (N, ny) of each arc and their Jacobian (N, ny, nf), its initial state at its best for the constants."""
    n, result = len(problem.variables.which), []
    for r, jacobian in problem.shooting(problem.variables).residuals(problem.variables.here):
        measured = np.isfinite(r)
        along, states = jacobian[measured][:, :n], jacobian[measured][:, n:]
        slope = -decompose_symmetric(states.T @ states).without_doubtful().solve(states.T @ along)
        result.append((r, jacobian[:, :, :n] + jacobian[:, :, n:] @ slope))
    return result


def _evaluate(reached: Evaluation, rows: Sequence[tuple[np.ndarray, np.ndarray]], size: int) -> Evaluation:
    """Cost, gradient and Gauss-Newton matrix (size, size) along the constants, initial states eliminated (their rows are zero)."""
    gradient, hessian = np.zeros(size), np.zeros((size, size))
    for r, jacobian in rows:
        measured, n = np.isfinite(r), jacobian.shape[2]
        slopes = jacobian[measured]
        gradient[:n] += 2 * slopes.T @ r[measured]
        hessian[:n, :n] += 2 * slopes.T @ slopes
    return replace(reached, gradient=gradient, hessian=hessian)


def _stitch(pieces: Sequence[tuple[np.ndarray, np.ndarray]], arcs: ArcProblem) -> Runs:
    """The arcs of each record one after the other."""
    edges = [*np.flatnonzero(arcs.starts_record), len(arcs.starts_record)]
    joined = [[np.concatenate(parts) for parts in zip(*pieces[a:b], strict=True)] for a, b in pairwise(edges)]
    return tuple((first, second) for first, second in joined)
