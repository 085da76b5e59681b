"""Whether the integrator's step is small enough at the optimum; if not, the search goes on with a smaller one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from greybox.integrators import choose_substeps
from greybox.integrators.discretisation import IMPLICIT
from greybox.integrators.exponential_relaxation import find_fast_relaxing_states
from greybox.optim import TerminationStatus
from greybox.transcription.options import SolverOptions
from greybox.transcription.policy import StepRefinementPolicy
from greybox.transcription.problem import EstimationProblem
from greybox.transcription.simulation_error import Evaluation
from greybox.transcription.solution import Runs, Solution

NO_RESULT = (TerminationStatus.INTERRUPTED, TerminationStatus.NO_START)
"""Nothing to go on from."""

Refinement = tuple[EstimationProblem | None, np.ndarray]
"""A problem with a smaller step, None where the present one will do; and the integration error of each output over its noise (ny,)."""


def solve_with_refined_steps(
    problem: EstimationProblem,
    solve: Callable[[EstimationProblem], Solution],
    refine: Callable[[Solution], Refinement],
    policy: StepRefinementPolicy,
) -> Solution:
    """``solve`` a problem, and go on with ever smaller steps from each solution that ``refine`` calls too coarse."""
    solution = solve(problem)
    for halving in range(policy.halvings + 1):
        if solution.status in NO_RESULT:
            break
        finer, error = refine(solution)
        solution = replace(solution, integration_error=error)
        if finer is None or halving == policy.halvings:
            break
        again = solve(replace(finer, variables=solution.variables)).with_work_of(solution)
        solution = replace(again, shares=solution.shares, integration_error=error)
    return solution


def refine_step(
    solution: Solution, options: SolverOptions, simulate: Callable[[EstimationProblem], Runs] | None = None
) -> Refinement:
    """What half the step changes in the outputs at a solution, and a smaller step if that matters.

    ``simulate`` runs a problem at its present point, usually over the first quarter of each record.
    """
    problem, policy = solution.at_optimum, options.policy.step_refinement
    if problem.step.per_interval:
        return None, np.zeros(len(problem.noise.std))
    if simulate is None:
        parts = tuple(r.first(max(policy.checked_rows, len(r.u) // 4)) for r in problem.records)

        def simulate(problem: EstimationProblem) -> Runs:
            return replace(problem, records=parts).shooting().simulate(problem.variables.here)

    runs, halved = simulate(problem), problem.halve_step()
    error = compute_change_over_noise(problem, runs, simulate(halved))
    used = problem.step.substeps
    if options.substeps or used >= policy.max_substeps:
        return None, error
    needed = _find_stable_substeps(problem, np.concatenate([x[:: max(1, len(x) // 10)] for _, x in runs]))
    needed = min(needed, policy.max_substeps)
    if is_too_coarse(error, problem, solution.evaluation, policy):
        return halved if needed <= halved.step.substeps else problem.with_substeps(needed), error
    return (problem.with_substeps(needed) if needed > used else None), error


def compute_change_over_noise(problem: EstimationProblem, runs: Runs, finer: Runs) -> np.ndarray:
    """Root-mean-square change of each output from ``runs`` to ``finer`` ones, over its noise (ny,)."""
    change = np.concatenate([a - b for (a, _), (b, _) in zip(runs, finer, strict=True)])
    with np.errstate(over="ignore", invalid="ignore"):
        return np.sqrt(np.mean(change**2, axis=0)) / problem.noise.std


def is_too_coarse(
    error: np.ndarray,
    problem: EstimationProblem,
    evaluation: Evaluation,
    policy: StepRefinementPolicy,
    substeps: int = 0,
) -> bool:
    """Whether an ``error`` over the noise (ny,), left by the integrator, matters beside noise and misfit.

    ``substeps`` of an interval (0: those of the problem's step) tell how much a smaller step would cost.
    """
    ratio = np.sqrt(evaluation.squares / np.maximum(evaluation.counts, 1))
    steps = (substeps or problem.step.substeps) * sum(len(r.h) for r in problem.records)
    few = steps <= policy.few_steps
    noise_share = policy.noise_share_of_few if few else policy.noise_share
    misfit_share = policy.noise_share_of_few if few else policy.misfit_share
    allowed = np.maximum(noise_share * np.minimum(ratio, 1.0), misfit_share * ratio)
    allowed = np.maximum(allowed, policy.movement_share * _compute_output_movement(problem) / problem.noise.std)
    measured = evaluation.counts > 0
    return not np.isfinite(error).all() or bool(np.any((error > allowed)[measured]))


def _compute_output_movement(problem: EstimationProblem) -> np.ndarray:
    """Standard deviation of each output as measured (ny,), zero where it was not."""
    y = np.concatenate([r.y for r in problem.records])
    measured = np.isfinite(y)
    count = np.maximum(measured.sum(axis=0), 1)
    mean = np.where(measured, y, 0.0).sum(axis=0) / count
    return np.sqrt(np.where(measured, (y - mean) ** 2, 0.0).sum(axis=0) / count)


def _find_stable_substeps(problem: EstimationProblem, visited: np.ndarray) -> int:
    """Substeps that an explicit method needs at the states ``visited`` (k, nx) to be stable and a little more."""
    system, p = problem.model.system, problem.variables.fixed
    if problem.method in IMPLICIT:
        return 1
    longest = max(float(r.lengths.max()) for r in problem.records)
    fast = find_fast_relaxing_states(system, p, visited) if problem.method == "mixed" else None
    return choose_substeps(system, p, visited, longest, relaxing=fast, policy=problem.policy.discretisation)
