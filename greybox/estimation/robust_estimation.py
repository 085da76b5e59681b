"""A robust fit: from the least-squares optimum on, with a loss that outliers cannot pull, at the scale of the bulk of the residual."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from greybox.estimation.options import FitOptions
from greybox.estimation.policy import RobustPolicy
from greybox.noise.differences import estimate_spread
from greybox.result import Misfit, RobustReport
from greybox.transcription.progress import FitProgressCallback
from greybox.transcription.robust_loss import LossKind, RobustLoss
from greybox.transcription.solution import Solution
from greybox.transcription.solve import solve


def refit_robustly(solution: Solution, options: FitOptions, report: FitProgressCallback | None) -> Solution:
    """``solution``, a least-squares fit, carried on with the loss that ``options`` ask for.

    Huber's loss first: its cost has one minimum where least squares has one, and what it finds is near enough for a loss that bends
    down. The ``scale`` of each output is that of the bulk of its residual over the noise (1.48 times the median size), and where the
    noise is known one at least: what the model lacks is not to be taken for outliers. It is constant while the cost is minimised.
    """
    policy = options.policy.robust
    loss = options.to_loss()
    if loss is None or not solution.status.success:
        return solution
    options = replace(options, progressive=False)
    huber = replace(loss, kind=LossKind.HUBER, threshold=loss.policy.huber_threshold)
    first = loss if loss.kind == LossKind.HUBER else huber
    for _ in range(policy.rounds):
        scale = estimate_bulk_scale(solution, policy)
        before = solution.problem.loss
        wanted = replace(first if before is None else loss, scale=scale)
        if before is not None and before.kind == loss.kind and _is_settled(before, wanted, policy):
            break
        problem = replace(solution.problem, loss=wanted, variables=solution.variables)
        iterations, evaluations, seconds = solution.iterations, solution.evaluations, solution.seconds
        solution = solve(problem, options, report)
        if not solution.status.success:
            break
        solution = replace(
            solution,
            iterations=solution.iterations + iterations,
            evaluations=solution.evaluations + evaluations,
            seconds=solution.seconds + seconds,
            shares=(1.0,),
        )
    return solution


def estimate_bulk_scale(solution: Solution, policy: RobustPolicy) -> np.ndarray:
    """Size of the bulk of each output's residual over its noise (ny,), one at least where the noise is given."""
    r = np.concatenate(compute_whitened_residuals(solution))
    least = 1.0 if solution.problem.noise.known else policy.least_scale
    return np.array([max(estimate_spread(column, robust=True), least) for column in r.T])


def compute_noise_ratios(solution: Solution, misfit: Mapping[str, Misfit]) -> dict[str, float]:
    """Misfit over noise of each output; of a robust fit that of the bulk, which outliers do not enlarge."""
    loss = solution.problem.loss
    if loss is None:
        return {name: m.noise_ratio for name, m in misfit.items()}
    names = [o.name for o in solution.problem.model.outputs]
    return {name: float(loss.scale[names.index(name)]) for name in misfit}


def compute_whitened_residuals(solution: Solution) -> list[np.ndarray]:
    """For each record the residual (N, ny) over its noise, whitened where the noise's colour is known; NaN in gaps."""
    problem, residuals = solution.problem, []
    for record, (y, _) in zip(problem.records, solution.simulate(), strict=True):
        r = record.samples(record.y - y) / problem.noise.std
        residuals.append(np.column_stack([colour.whiten(r[:, j]) for j, colour in enumerate(problem.noise.colour)]))
    return residuals


def summarise_outliers(solution: Solution) -> RobustReport:
    """What a robust fit made of the samples that it took for outliers; nothing for least squares."""
    loss = solution.problem.loss
    if loss is None:
        return RobustReport()
    r = np.concatenate(compute_whitened_residuals(solution))
    shares = loss.outliers(r).sum(axis=0) / np.maximum(np.isfinite(r).sum(axis=0), 1)
    names = [o.name for o in solution.problem.model.outputs]
    measured = [j for j in range(len(names)) if np.isfinite(r[:, j]).any()]
    return RobustReport(
        str(loss), {names[j]: float(loss.scale[j]) for j in measured}, {names[j]: float(shares[j]) for j in measured}
    )


def _is_settled(before: RobustLoss, after: RobustLoss, policy: RobustPolicy) -> bool:
    return bool(np.all(np.abs(after.scale / before.scale - 1) < policy.settled_scale))
