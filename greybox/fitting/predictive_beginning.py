"""A model with its constants known, on records of its own: the filter ready to run, and the first states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from greybox.errors import ModelError
from greybox.experiment import Experiment
from greybox.filtering import KalmanFilter
from greybox.fitting.options import FitOptions, options_given
from greybox.fitting.predictive_cost import PredictionError
from greybox.fitting.predictive_search import climbed, maximise
from greybox.fitting.predictive_unknowns import unknowns_of
from greybox.fitting.problem import prepare
from greybox.model import Model
from greybox.noise import Noise
from greybox.result import Fit

# Rows from which the first states are estimated where a prediction must not look at the rest of the record.
FIRST_ROWS = 50


@dataclass(frozen=True)
class Known:
    """A model whose constants are known, and what else a run of its filter needs: ``noise`` by output (None: to be found), options."""

    model: Model
    noise: Mapping[str, float] | Noise | None
    options: FitOptions


def known(given: Model | Fit, noise: Mapping[str, float] | Noise | None, options: FitOptions | None) -> Known:
    """The model of a fit with the noise and the options of that fit, unless others are given; a model as it is."""
    if isinstance(given, Fit):
        return Known(
            given.model, given.noise.std if noise is None else noise, options_given(options or options_of(given))
        )
    if not isinstance(given, Model):
        raise ModelError(f"{given!r} is neither a model nor a fit; give a Model, or what fit(...) returned")
    return Known(given, noise, options_given(options))


def options_of(fit: Fit) -> FitOptions:
    """How ``fit`` integrated and began its records."""
    saved = fit.provenance.options
    return FitOptions(at_rest=bool(saved.get("at_rest", False)), method=str(saved.get("method", "automatic")))


def likelihood_of(
    given: Known, experiments: Experiment | Sequence[Experiment], *, free: bool = False
) -> PredictionError:
    """The likelihood of records with nothing unknown but the first states, and the outputs' noise where that is neither given
    nor known from a quiet record; with ``free`` the free constants of the model are unknown too."""
    options = given.options
    model = given.model if free else given.model.fix(*given.model.values)
    problem = prepare(
        model, experiments, given.noise, at_rest=options.at_rest, method=options.method, substeps=options.substeps,
        own=options.own if free else (),
    )  # fmt: skip
    kalman = KalmanFilter.of(model.system, problem.step, known_start=not problem.variables.initial.free.any())
    return PredictionError(unknowns_of(problem, problem.variables), kalman, problem.records)


def begun(cost: PredictionError, options: FitOptions, rows: int = 0) -> PredictionError:
    """``cost`` with ``z = 0`` at the most likely unknowns, from the first ``rows`` of each record (0: all of them)."""
    part = replace(cost, records=tuple(r.first(min(rows, len(r.y))) for r in cost.records)) if rows else cost
    found = maximise(part, options)
    if not found.status.success:
        found = climbed(part)
    return cost.at(found.cost.unknowns)
