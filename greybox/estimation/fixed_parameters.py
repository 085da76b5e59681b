"""A model with its constants known, on records of its own: the filter ready to run, and the first states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from greybox.errors import ModelError
from greybox.estimation.likelihood_search import fisher_scoring, maximise_likelihood
from greybox.estimation.likelihood_unknowns import make_likelihood_unknowns
from greybox.estimation.options import FitOptions, resolve_options
from greybox.estimation.prediction_error import PredictionErrorObjective
from greybox.estimation.problem import prepare_problem
from greybox.experiment import Experiment
from greybox.filtering import KalmanFilter
from greybox.model import Model
from greybox.noise import NoiseModel
from greybox.result import Fit

# Rows from which the first states are estimated where a prediction must not look at the rest of the record.
FIRST_ROWS = 50


@dataclass(frozen=True)
class FixedParameterModel:
    """A model whose constants are known, and what else a run of its filter needs: ``noise`` by output (None: to be found), options."""

    model: Model
    noise: Mapping[str, float] | NoiseModel | None
    options: FitOptions


def fix_parameters(
    given: Model | Fit, noise: Mapping[str, float] | NoiseModel | None, options: FitOptions | None
) -> FixedParameterModel:
    """The model of a fit with the noise and the options of that fit, unless others are given; a model as it is."""
    if isinstance(given, Fit):
        return FixedParameterModel(
            given.model,
            given.noise.std if noise is None else noise,
            resolve_options(options or restore_integration_options(given)),
        )
    if not isinstance(given, Model):
        raise ModelError(f"{given!r} is neither a model nor a fit; give a Model, or what fit(...) returned")
    return FixedParameterModel(given, noise, resolve_options(options))


def restore_integration_options(fit: Fit) -> FitOptions:
    """How ``fit`` integrated and began its records."""
    saved = fit.provenance.options
    return FitOptions(at_rest=bool(saved.get("at_rest", False)), method=str(saved.get("method", "automatic")))


def make_likelihood(
    given: FixedParameterModel, experiments: Experiment | Sequence[Experiment], *, free: bool = False
) -> PredictionErrorObjective:
    """The likelihood of records with nothing unknown but the first states, and the outputs' noise where that is neither given
    nor known from a quiet record; with ``free`` the free constants of the model are unknown too."""
    options = given.options
    model = given.model if free else given.model.fix(*given.model.values)
    problem = prepare_problem(
        model, experiments, given.noise, at_rest=options.at_rest, method=options.method, substeps=options.substeps,
        per_experiment=options.per_experiment if free else (),
    )  # fmt: skip
    kalman = KalmanFilter.of(model.system, problem.step, known_start=not problem.variables.initial.free.any())
    return PredictionErrorObjective(make_likelihood_unknowns(problem, problem.variables), kalman, problem.records)


def estimate_initial_state(
    cost: PredictionErrorObjective, options: FitOptions, rows: int = 0
) -> PredictionErrorObjective:
    """``cost`` with ``z = 0`` at the most likely unknowns, from the first ``rows`` of each record (0: all of them)."""
    part = replace(cost, records=tuple(r.first(min(rows, len(r.y))) for r in cost.records)) if rows else cost
    found = maximise_likelihood(part, options)
    if not found.status.success:
        found = fisher_scoring(part)
    return cost.at(found.cost.unknowns)
