"""The minimum of an objective: a search from far off, and damped Gauss-Newton or scoring steps nearby."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from greybox.estimation.objective import Objective, PredictionErrorObjective
from greybox.estimation.optim.methods import MinimisationMethod, minimise
from greybox.estimation.optim.minimisation import Termination, TerminationPolicy, TerminationStatus
from greybox.estimation.options import FitOptions
from greybox.estimation.transcription.simulation_error import Evaluation
from greybox.estimation.transcription.solution import FitProgress, FitProgressCallback

ObjectiveT = TypeVar("ObjectiveT", bound=Objective)


@dataclass(frozen=True)
class ObjectiveMinimum(Generic[ObjectiveT]):
    """A minimum: the ``objective`` with its present point there, the evaluation, how the search ended, and the work it took."""

    objective: ObjectiveT
    evaluation: Evaluation
    status: TerminationStatus
    solver_status: str = ""
    solver: str = ""
    iterations: int = 0
    evaluations: int = 1
    seconds: float = 0.0


LikelihoodMaximum = ObjectiveMinimum[PredictionErrorObjective]


# Where a search ends: a thousandth of a standard deviation, squared; acceptable where -2 log L fell by less than a hundredth within the
# patience, as a filter of a model with dry friction is not smooth everywhere.
LIKELIHOOD_TERMINATION = TerminationPolicy(negligible_decrease=1e-6, little_gain=1e-2)
# The same for the steps after it, so that the parameters have their digits.
LIKELIHOOD_LAST_DIGITS = TerminationPolicy(negligible_decrease=1e-12, little_gain=0.0)


def search_minimum(
    objective: ObjectiveT, options: FitOptions, report: FitProgressCallback | None = None
) -> ObjectiveMinimum[ObjectiveT]:
    """The minimum from the present point on, to the last digits."""
    begin = objective.evaluate(objective.variables.here)
    if not np.isfinite(begin.cost):
        return ObjectiveMinimum(objective, begin, TerminationStatus.NO_START)
    if not objective.variables.size:
        return ObjectiveMinimum(objective, begin, TerminationStatus.CONVERGED)
    # A step of one in ``z`` then changes the cost by about itself: IPOPT is told not to scale the problem by itself.
    objective = objective.at(objective.variables.rescale(float(max(begin.count, 1)), np.diag(begin.hessian) / 2))
    low, high = objective.variables.bounds()

    def progress(iteration: int, _: float) -> None:
        if report:
            report(FitProgress(1, 1, iteration, 1.0))

    outcome = minimise(
        objective.evaluate,
        objective.variables.here,
        low,
        high,
        scale=float(max(begin.count, 1)),
        tolerance=options.tolerance,
        iterations=options.iterations,
        termination_test=Termination(LIKELIHOOD_TERMINATION, low, high, objective.squares).test,
        thorough=False,
        progress=progress,
        policy=options.policy.minimisation,
    )
    near = objective.at(objective.variables.recentre(outcome.z))
    # IPOPT's tolerance is not the end: likelihood ratios are differences of two such costs.
    last = refine_minimum(near, options, LIKELIHOOD_LAST_DIGITS, begin=outcome.value)
    status = outcome.status
    # Steps that converge say more than the search that handed over; Ctrl-C stays an interruption.
    if last.status.success and status is not TerminationStatus.INTERRUPTED:
        status = status if status.success else TerminationStatus.CONVERGED
    return replace(
        last,
        status=status,
        solver_status=outcome.solver_status,
        solver=outcome.solver,
        iterations=outcome.iterations,
        evaluations=outcome.evaluations + 1 + last.evaluations,
        seconds=outcome.seconds,
    )


# Damped steps of Fisher scoring, or Gauss and Newton's, at most where a minimum is near.
SCORING_STEPS = 10


def refine_minimum(
    objective: ObjectiveT,
    options: FitOptions,
    termination: TerminationPolicy | None = None,
    *,
    begin: Evaluation | None = None,
) -> ObjectiveMinimum[ObjectiveT]:
    """The minimum near the present point by a few damped steps alone: cheaper than `search_minimum` where that is close already.

    ``termination``: what is nothing left to gain, as for a whole search if left out. ``begin``: the evaluation at the present point.
    """
    passes = 0 if begin else 1
    begin = begin or objective.evaluate(objective.variables.here)
    low, high = objective.variables.bounds()
    outcome = minimise(
        objective.evaluate,
        objective.variables.here,
        low,
        high,
        method=MinimisationMethod.GAUSS_NEWTON,
        value_at_start=begin,
        iterations=SCORING_STEPS,
        termination_test=Termination(termination or LIKELIHOOD_TERMINATION, low, high, objective.squares).test,
        policy=options.policy.minimisation,
    )
    return ObjectiveMinimum(
        objective.at(objective.variables.recentre(outcome.z)) if outcome.evaluations else objective,
        begin if outcome.value is None else outcome.value,
        outcome.status,
        solver=outcome.solver,
        evaluations=outcome.evaluations + passes,
        seconds=outcome.seconds,
    )


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
        # Mean square of the standardised innovations is one where the level is right; it is raised, never lowered,
        # because without process noise only the level can explain them.
        growth = np.log(np.sqrt(squares / counts))[v.estimated_noise]
    z = v.here
    v.split(z).noise_levels[:] = np.where(np.isfinite(growth), np.maximum(growth, 0.0), 0.0)
    return cost.at(v.recentre(z))


def select_best_start(costs: Sequence[PredictionErrorObjective]) -> PredictionErrorObjective:
    """The one with the lowest cost at ``z = 0``; the first where none is finite."""
    return min(costs, key=lambda cost: cost.cost())
