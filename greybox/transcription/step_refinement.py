"""Whether the integrator's step is small enough at the optimum, and a smaller one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.integrators import choose_substeps
from greybox.integrators.discretisation import IMPLICIT
from greybox.integrators.exponential_relaxation import find_fast_relaxing_states
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.options import SolverOptions
from greybox.transcription.policy import StepRefinementPolicy
from greybox.transcription.problem import EstimationProblem
from greybox.transcription.simulation_error import Evaluation

# Outputs (N, ny) and states (N, nx) of one record.
Run = tuple[np.ndarray, np.ndarray]


def compute_change_over_noise(problem: EstimationProblem, runs: Sequence[Run], finer: Sequence[Run]) -> np.ndarray:
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


def halve_step(problem: EstimationProblem) -> EstimationProblem:
    """``problem`` with half the step."""
    return with_substeps(problem, 2 * problem.step.substeps, problem.variables.fixed)


def refine_step(
    problem: EstimationProblem, variables: DecisionVector, evaluation: Evaluation, options: SolverOptions
) -> tuple[EstimationProblem | None, np.ndarray]:
    """A problem with a smaller step, if the present one is too coarse at the optimum; and its error over the noise (ny,).

    The error is that over the first quarter of each record.
    """
    if problem.step.per_interval:
        return None, np.zeros(len(problem.noise.std))
    policy, z = options.policy.step_refinement, variables.here
    first_part = replace(
        problem, records=tuple(r.first(max(policy.checked_rows, len(r.u) // 4)) for r in problem.records)
    )
    runs = first_part.shooting(variables).simulate(z)
    needed = _find_stable_substeps(problem, variables, np.concatenate([x[:: max(1, len(x) // 10)] for _, x in runs]))
    used = problem.step.substeps
    finer_runs = with_substeps(first_part, 2 * used, variables.fixed).shooting(variables).simulate(z)
    error = compute_change_over_noise(problem, runs, finer_runs)
    if options.substeps:
        return None, error
    if is_too_coarse(error, problem, evaluation, policy):
        return with_substeps(problem, max(2 * used, needed), variables.fixed), error
    return (with_substeps(problem, needed, variables.fixed) if needed > used else None), error


def _find_stable_substeps(problem: EstimationProblem, variables: DecisionVector, visited: np.ndarray) -> int:
    """Substeps that an explicit method needs at the states ``visited`` (k, nx) to be stable and a little more."""
    system, p = problem.model.system, variables.fixed
    if problem.method in IMPLICIT:
        return 1
    longest = max(float(r.lengths.max()) for r in problem.records)
    fast = find_fast_relaxing_states(system, p, visited) if problem.method == "mixed" else None
    return choose_substeps(system, p, visited, longest, relaxing=fast, policy=problem.policy.discretisation)


def with_substeps(problem: EstimationProblem, substeps: int, p: np.ndarray) -> EstimationProblem:
    """The same step, repeated more often: nothing is compiled. A delayed input is cut differently, so its step is made anew."""
    if problem.step.past is not None:
        return problem.with_step(substeps, p)
    step = replace(problem.step, substeps=substeps)
    return replace(problem, step=step, kernel=problem.kernel.with_substeps(substeps))
