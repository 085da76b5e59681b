"""The optimum of the likelihood: IPOPT with Fisher's curvature, then a few steps of scoring for the last digits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from greybox.estimation.objective import Objective, PredictionErrorObjective
from greybox.estimation.options import FitOptions
from greybox.estimation.policy import LikelihoodSearchPolicy
from greybox.optim import TerminationStatus, minimise
from greybox.optim.termination import Termination
from greybox.transcription import Evaluation
from greybox.transcription.progress import FitProgress, FitProgressCallback

ObjectiveT = TypeVar("ObjectiveT", bound=Objective)


@dataclass(frozen=True)
class LikelihoodOptimum:
    """The optimum: ``objective`` with ``z = 0`` there, its evaluation, how the search ended, and the work it took."""

    objective: PredictionErrorObjective
    evaluation: Evaluation
    status: TerminationStatus
    solver_status: str
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
    begin = cost.evaluate(cost.variables.here)
    if not np.isfinite(begin.cost):
        return LikelihoodOptimum(cost, begin, TerminationStatus.NO_START, "", 0, 1, 0.0)
    if not cost.variables.size:
        return LikelihoodOptimum(cost, begin, TerminationStatus.CONVERGED, "", 0, 1, 0.0)
    cost = cost.at(cost.variables.rescale(float(max(begin.count, 1)), np.diag(begin.hessian) / 2))
    low, high = cost.variables.bounds()
    policy = options.policy.likelihood_search
    termination = Termination(policy.termination, low, high)

    def progress(iteration: int, _: float) -> None:
        if report:
            report(FitProgress(1, 1, iteration, 1.0))

    outcome = minimise(
        cost.evaluate,
        cost.variables.here,
        low,
        high,
        scale=float(max(begin.count, 1)),
        tolerance=options.tolerance,
        iterations=options.iterations,
        termination_test=termination.test,
        thorough=False,
        progress=progress,
        policy=options.policy.minimisation,
    )
    polished, status = (
        fisher_scoring(cost.at(cost.variables.recentre(outcome.z)), policy, policy.last_digits),
        outcome.status,
    )
    if polished.status.success and not status.success and status is not TerminationStatus.INTERRUPTED:
        status = TerminationStatus.CONVERGED
    return LikelihoodOptimum(
        polished.objective,
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
    negligible = policy.termination.negligible_decrease if negligible is None else negligible
    evaluation, passes = cost.evaluate(cost.variables.here), 1
    if not np.isfinite(evaluation.cost):
        return LikelihoodOptimum(cost, evaluation, TerminationStatus.NO_START, "", 0, passes, 0.0)
    decrease = np.inf
    for _ in range(policy.scoring_steps):
        low, high = cost.variables.bounds()
        step = evaluation.bounded_step(low, high)
        decrease = evaluation.decrease_along(step)
        if decrease <= negligible:
            break
        for share in 0.5 ** np.arange(policy.halvings):
            z = np.clip(share * step, np.minimum(low, 0.0), np.maximum(high, 0.0))
            moved = cost.at(cost.variables.recentre(z))
            after = moved.evaluate(np.zeros(len(z)))
            passes += 1
            if after.cost < evaluation.cost:
                cost, evaluation = moved, after
                break
        else:
            break
    status = (
        TerminationStatus.CONVERGED
        if decrease <= max(negligible, policy.termination.negligible_decrease)
        else TerminationStatus.STUCK
    )
    return LikelihoodOptimum(cost, evaluation, status, "", 0, passes, 0.0)


def hold_parameters(cost: ObjectiveT, values: Mapping[str, float]) -> ObjectiveT:
    """The same cost with some constants held at ``values``, in every experiment."""
    v = cost.variables
    names = [q.name for q in v.model.all_parameters]
    places = [names.index(name) for name in values]
    fixed = v.fixed.copy()
    fixed[places] = list(values.values())
    return cost.at(replace(v, fixed=fixed).hold(np.isin(v.which, places)))


def start_at(cost: PredictionErrorObjective, values: Mapping[str, float]) -> PredictionErrorObjective:
    """The same cost at other values of some free constants, by their names in the model."""
    v = cost.variables
    return cost.at(
        v.with_values(
            {label: values[q.name] for label, q in zip(v.names, v.quantities, strict=True) if q.name in values}
        )
    )


def raise_noise_to_innovations(cost: PredictionErrorObjective) -> PredictionErrorObjective:
    """``cost`` with each estimated noise as large as the innovations say, where nothing else can make them so large."""
    v = cost.variables
    squares = np.nansum(np.concatenate([r**2 for r in cost.innovations()]), axis=0)
    counts = sum(np.isfinite(r.y).sum(axis=0) for r in cost.records)
    with np.errstate(invalid="ignore", divide="ignore"):
        growth = np.log(np.sqrt(squares / counts))[v.estimated_noise]
    z = v.here
    v.split(z).noise_levels[:] = np.where(np.isfinite(growth), np.maximum(growth, 0.0), 0.0)
    return cost.at(v.recentre(z))


def select_best_start(costs: Sequence[PredictionErrorObjective]) -> PredictionErrorObjective:
    """The one with the lowest cost at ``z = 0``; the first where none is finite."""
    return min(costs, key=lambda cost: cost.cost())
