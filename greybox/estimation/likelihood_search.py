"""The optimum of the likelihood: IPOPT with Fisher's curvature, then a few steps of scoring for the last digits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.estimation.options import FitOptions
from greybox.estimation.policy import LikelihoodSearchPolicy
from greybox.estimation.prediction_error import PredictionErrorObjective
from greybox.numerics import AT_BOUND, RANK_CUTOFF, TINY
from greybox.optim import TerminationStatus, minimise
from greybox.transcription import Evaluation
from greybox.transcription.progress import FitProgress, FitProgressCallback


@dataclass(frozen=True)
class LikelihoodOptimum:
    """The optimum: ``cost`` with ``z = 0`` there, its evaluation, how the search ended, and the work it took."""

    cost: PredictionErrorObjective
    evaluation: Evaluation
    status: TerminationStatus
    word: str
    iterations: int
    evaluations: int
    seconds: float

    @property
    def likelihood(self) -> float:
        """Logarithm of the likelihood, priors included."""
        return -0.5 * self.evaluation.cost


def maximise_likelihood(
    cost: PredictionErrorObjective, options: FitOptions, report: FitProgressCallback | None = None
) -> LikelihoodOptimum:
    """The most likely unknowns, from ``z = 0`` of ``cost`` on."""
    begin = cost.evaluate(np.zeros(cost.unknowns.size))
    if not np.isfinite(begin.cost):
        return LikelihoodOptimum(cost, begin, TerminationStatus.NO_START, "", 0, 1, 0.0)
    if not cost.unknowns.size:
        return LikelihoodOptimum(cost, begin, TerminationStatus.CONVERGED, "", 0, 1, 0.0)
    cost = cost.at(cost.unknowns.rescale(max(begin.count, 1), np.diag(begin.hessian) / 2))
    low, high = cost.unknowns.bounds()
    policy, costs = options.policy.likelihood_search, list[float]()

    def finished(z: np.ndarray, e: Evaluation) -> TerminationStatus | None:
        if predicted_decrease(e, compute_scoring_step(e, low - z, high - z)) <= policy.negligible_decrease:
            return TerminationStatus.CONVERGED
        costs.append(e.cost)
        flat = len(costs) > policy.patience and costs[-1 - policy.patience] - e.cost <= policy.little_gain
        return TerminationStatus.ACCEPTABLE if flat else None

    def progress(iteration: int, _: float) -> None:
        if report:
            report(FitProgress(1, 1, iteration, 1.0))

    outcome = minimise(
        cost.evaluate,
        np.zeros(cost.unknowns.size),
        low,
        high,
        scale=float(max(begin.count, 1)),
        tolerance=options.tolerance,
        iterations=options.iterations,
        termination_test=finished,
        thorough=False,
        progress=progress,
        policy=options.policy.minimisation,
    )
    polished, status = (
        fisher_scoring(cost.at(cost.unknowns.moved(outcome.z)), policy, policy.last_digits),
        outcome.status,
    )
    if polished.status.success and not status.success and status is not TerminationStatus.INTERRUPTED:
        status = TerminationStatus.CONVERGED
    return LikelihoodOptimum(
        polished.cost,
        polished.evaluation,
        status,
        outcome.solver_status,
        outcome.iterations,
        outcome.evaluations + 1 + polished.evaluations,
        outcome.seconds,
    )


def fisher_scoring(
    cost: PredictionErrorObjective, policy: LikelihoodSearchPolicy, negligible: float | None = None
) -> LikelihoodOptimum:
    """The most likely unknowns near ``z = 0`` of ``cost`` by scoring alone: cheaper than `maximise_likelihood` where that is close already.

    Ends where a step promises to lower -2 log L by less than ``negligible``, or none lowers it: stuck, if much was promised.
    """
    negligible = policy.negligible_decrease if negligible is None else negligible
    evaluation, passes = cost.evaluate(np.zeros(cost.unknowns.size)), 1
    if not np.isfinite(evaluation.cost):
        return LikelihoodOptimum(cost, evaluation, TerminationStatus.NO_START, "", 0, passes, 0.0)
    decrease = np.inf
    for _ in range(policy.scoring_steps):
        low, high = cost.unknowns.bounds()
        step = compute_scoring_step(evaluation, low, high)
        decrease = predicted_decrease(evaluation, step)
        if decrease <= negligible:
            break
        for share in 0.5 ** np.arange(policy.halvings):
            z = np.clip(share * step, np.minimum(low, 0.0), np.maximum(high, 0.0))
            moved = cost.at(cost.unknowns.moved(z))
            after = moved.evaluate(np.zeros(len(z)))
            passes += 1
            if after.cost < evaluation.cost:
                cost, evaluation = moved, after
                break
        else:
            break
    status = (
        TerminationStatus.CONVERGED
        if decrease <= max(negligible, policy.negligible_decrease)
        else TerminationStatus.STUCK
    )
    return LikelihoodOptimum(cost, evaluation, status, "", 0, passes, 0.0)


def compute_scoring_step(evaluation: Evaluation, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The step (size,) to the minimum of the quadratic model of the cost within bounds, by an active set.

    ``low`` and ``high`` are the distances to the bounds. Undetermined directions stay. An intensity of process noise near zero has next to
    no curvature and a large step: what its bound cuts off must count neither as a step nor as a promise.
    """
    g, h = evaluation.gradient, evaluation.hessian
    low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    step, inside = np.zeros(len(g)), ~((low >= -AT_BOUND) & (g > 0) | (high <= AT_BOUND) & (g < 0))
    while inside.any():
        block = h[np.ix_(inside, inside)]
        slope = g[inside] + h[np.ix_(inside, ~inside)] @ step[~inside]
        scale = np.sqrt(np.maximum(np.diag(block), TINY))
        free = -np.linalg.lstsq(block / np.outer(scale, scale), slope / scale, rcond=RANK_CUTOFF)[0] / scale
        step[inside] = np.clip(free, low[inside], high[inside])
        beyond = inside.copy()
        beyond[inside] = step[inside] != free
        if not beyond.any():
            break
        inside &= ~beyond
    return step


def predicted_decrease(evaluation: Evaluation, step: np.ndarray) -> float:
    """By how much the quadratic model of the cost falls along ``step``."""
    return -float(evaluation.gradient @ step + 0.5 * step @ evaluation.hessian @ step)


def hold_parameters(cost: PredictionErrorObjective, values: Mapping[str, float]) -> PredictionErrorObjective:
    """The same cost with some constants held at ``values``, in every experiment."""
    v = cost.unknowns.variables
    names = [q.name for q in v.model.all_parameters]
    places = [names.index(name) for name in values]
    fixed = v.fixed.copy()
    fixed[places] = list(values.values())
    return cost.at(replace(cost.unknowns, variables=replace(v, fixed=fixed).hold(np.isin(v.which, places))))


def start_at(cost: PredictionErrorObjective, values: Mapping[str, float]) -> PredictionErrorObjective:
    """The same cost with ``z = 0`` at other values of some free constants, by their names in the model."""
    u = cost.unknowns
    labels = {
        label: values[q.name]
        for label, q in zip(u.variables.names, u.variables.quantities, strict=True)
        if q.name in values
    }
    return cost.at(replace(u, variables=u.variables.with_values(labels)))


def raise_noise_to_innovations(cost: PredictionErrorObjective) -> PredictionErrorObjective:
    """``cost`` with each estimated noise as large as the innovations at ``z = 0`` say, where nothing else can make them so large."""
    u = cost.unknowns
    squares = np.nansum(np.concatenate([r**2 for r in cost.innovations()]), axis=0)
    counts = sum(np.isfinite(r.y).sum(axis=0) for r in cost.records)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.sqrt(squares / counts)
    ratio = np.where(u.estimated & np.isfinite(ratio) & (ratio > 1), ratio, 1.0)
    return cost.at(replace(u, level=u.level * ratio))


def select_best_start(costs: Sequence[PredictionErrorObjective]) -> PredictionErrorObjective:
    """The one with the lowest cost at ``z = 0``; the first where none is finite."""
    return min(costs, key=lambda cost: cost.cost())
