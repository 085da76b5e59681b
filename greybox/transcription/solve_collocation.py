"""A fit by direct collocation: the equations are solved together with the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greybox.optim import MinimisationResult, solve_sparse
from greybox.transcription.collocation import Collocation
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.finish_by_simulation_error import finish_by_simulation_error
from greybox.transcription.initialisation import initialise_without_continuity
from greybox.transcription.multiple_shooting import choose_segment_rows, place_segments
from greybox.transcription.options import SolverOptions
from greybox.transcription.problem import EstimationProblem
from greybox.transcription.progress import FitProgressCallback, ProgressMonitor
from greybox.transcription.select_transcription import TranscriptionChoice, compute_growth_rates
from greybox.transcription.simulation_error import Evaluation, SingleShooting
from greybox.transcription.solution import Runs, SegmentedRun, Solution
from greybox.transcription.step_refinement import compute_change_over_noise, is_too_coarse, with_substeps

# Three points are of third order at least, also on stiff equations (Hairer, Wanner, Solving Ordinary Differential Equations II, stage
# order): halving an interval again changes eight times less than halving it once did.
_ORDER = 3
_POINTS = 3
_TITLES = {"radau": "Radau", "legendre": "Legendre"}


@dataclass(frozen=True)
class _CollocationPoint:
    """What a solver ended with: the states (N, nx) of each record and, if it succeeded, the problem linearised there."""

    outcome: MinimisationResult
    variables: DecisionVector
    states: Sequence[np.ndarray]
    held: int
    evaluation: Evaluation
    rows: Runs


def solve_collocation(
    choice: TranscriptionChoice, options: SolverOptions, report: FitProgressCallback | None = None
) -> Solution:
    """Minimise over the constants and the states at three points of every sampling interval.

    The intervals are halved once, to see what that changes, and again until it changes too little to matter. ``substeps`` of
    the options are the elements of an interval, if given.
    """
    policy = options.policy.step_refinement
    problem, scheme = choice.problem, choice.transcription.removeprefix("collocation-")
    elements = max(options.substeps, 1)
    at = _solve(problem, *_guess_start(problem), scheme, elements, options, report)
    work = [at]
    error, shift = np.zeros(len(problem.noise.std)), np.zeros(len(problem.variables.which))
    for _ in range(policy.halvings):
        if not at.outcome.status.success:
            break
        finer = _solve(problem, at.variables, at.states, scheme, 2 * elements, options, report)
        work.append(finer)
        if not finer.outcome.status.success:
            break
        error = compute_change_over_noise(problem, _simulate(problem, at), _simulate(problem, finer))
        shift = _compute_shift(at.variables, finer.variables)
        if options.substeps:
            break
        at, elements = finer, 2 * elements
        error, shift = error / 2.0**_ORDER, shift / 2.0**_ORDER
        if not is_too_coarse(error, problem, at.evaluation, policy, _POINTS * elements):
            break
    if not problem.step.per_interval:  # whoever continues with a free run needs steps as fine as these
        problem = with_substeps(problem, max(problem.step.substeps, _POINTS * elements), at.variables.fixed)
    success, title = at.outcome.status.success, _TITLES[scheme]
    solution = Solution(
        problem,
        at.variables,
        at.evaluation,
        at.outcome.status,
        at.outcome.solver_status,
        sum(w.outcome.iterations for w in work),
        sum(w.outcome.evaluations for w in work),
        sum(w.outcome.seconds for w in work),
        (1.0,),
        error,
        choice.to_strategy(held_samples=int(at.held)),
        choice.transcription,
        SegmentedRun(_simulate(problem, at), at.rows, at.variables.size, shift) if success else None,
        f"collocation, three {title} points"
        + (" a sample" if elements == 1 else f" in each of {elements} elements a sample"),
    )
    return finish_by_simulation_error(solution, options, report)


def _guess_start(problem: EstimationProblem) -> tuple[DecisionVector, list[np.ndarray]]:
    """Variables and states along each record to begin with; where no piece of it can be simulated, its first states stay."""
    v = problem.variables
    single = SingleShooting(v, problem.step, problem.kernel, problem.records, 1 / problem.noise.std)
    pairs = zip(compute_growth_rates(problem), single.records, strict=True)
    policy = problem.policy.transcription
    rows = [(r, choose_segment_rows(growth, r, policy.segments)) for growth, r in pairs]
    cuts = [place_segments(e, r, count, policy.segments) for e, (r, count) in enumerate(rows)]
    variables, states = initialise_without_continuity(single, cuts, policy)
    return variables, [np.where(np.isfinite(x), x, v.initial.guess[e]) for e, x in enumerate(states)]


def _solve(
    problem: EstimationProblem,
    variables: DecisionVector,
    states: Sequence[np.ndarray],
    scheme: str,
    elements: int,
    options: SolverOptions,
    report: FitProgressCallback | None,
) -> _CollocationPoint:
    records, weight = problem.records, 1 / problem.noise.std
    program = Collocation(variables, records, weight, states, scheme=scheme, elements=elements, hessian=options.hessian)
    outcome = solve_sparse(
        **program.problem(), iterations=options.iterations, progress=ProgressMonitor(problem, report)
    )
    point = program.interpret(outcome.z)
    if not outcome.status.success:
        free = SingleShooting(point.variables, problem.step, problem.kernel, records, weight)
        return _CollocationPoint(
            outcome, point.variables, point.states, point.at_bound, free.evaluate(variables.here), ()
        )
    return _CollocationPoint(outcome, point.variables, point.states, point.at_bound, *program.linearise(outcome.z))


def _simulate(problem: EstimationProblem, at: _CollocationPoint) -> Runs:
    """Outputs and states at the rows of each record."""
    output, zero = problem.model.system.output_function, at.variables.here
    runs = []
    for e, (record, x) in enumerate(zip(problem.records, at.states, strict=True)):
        p = at.variables.parameters(zero, e)
        runs.append((output(x.T, record.u.T, p).full().T, x))
    return tuple(runs)


def _compute_shift(before: DecisionVector, after: DecisionVector) -> np.ndarray:
    """How far the free constants have moved (nf,), in ``z`` of the second."""
    return (after.base - before.base) / after.spans
