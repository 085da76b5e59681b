"""A finished fit as the problem that it was, at its optimum: by simulation error or by prediction error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from greybox.errors import FitError
from greybox.estimation.options import FitOptions
from greybox.estimation.prediction_error import PredictionErrorObjective, compute_innovations
from greybox.estimation.predictor import FixedParameterModel, make_likelihood
from greybox.model import Model
from greybox.noise import AutoRegression, NoiseModel
from greybox.result import Fit
from greybox.transcription.problem import EstimationProblem, prepare_problem
from greybox.transcription.robust_loss import RobustLoss


def restore_options(fit: Fit) -> FitOptions:
    """The options of ``fit`` for a search that begins next to its optimum, with the step it ended with."""
    options = FitOptions.from_data(fit.provenance.options)
    return replace(
        options,
        progressive=False,
        method=str(fit.solver.statistics.get("method", options.method)),
        substeps=int(fit.solver.statistics.get("substeps", options.substeps)),
        transcription="single",
        arc_length=0.0,
        hessian="gauss-newton",
    )


def has_free_run(fit: Fit) -> bool:
    """Whether the run of ``fit`` is a free one from each record's initial state, and not arcs or the segments of an unstable plant."""
    return fit.solver.statistics.get("transcription", "single") != "arcs" and bool(
        fit.solver.statistics.get("free_run", True)
    )


def restore_problem(
    fit: Fit, model: Model | None = None, held: Mapping[int, Mapping[str, float]] | None = None
) -> EstimationProblem:
    """The problem of ``fit`` with its records, its noise, its loss and its initial states, at its optimum.

    With another ``model`` if given, and with constants ``held`` at a value in some experiments (by their number).

    Raises FitError for a fit that did not succeed, that was saved without its inputs, or whose run is not a free one (arcs, or
    the segments of an unstable plant).
    """
    _check_fit(fit, "intervals need")
    if not has_free_run(fit):
        raise FitError(
            f"fit of {fit.model.title}: its simulation is not a free run ({fit.solver.statistics['transcription']}), which"
            " this result needs; use the intervals of the fit itself, or fit by single shooting if the plant is stable"
        )
    options = restore_options(fit)
    records = [t.experiment for t in fit.traces]
    for e, values in (held or {}).items():
        records[e] = replace(records[e], conditions={**records[e].conditions, **values})
    problem = prepare_problem(
        model or fit.model,
        records,
        restore_noise(fit),
        at_rest=options.at_rest,
        method=options.method,
        substeps=options.substeps,
        per_experiment=options.per_experiment,
        policy=options.policy,
    )
    variables = problem.variables.with_values(_label_experiment_values(fit))
    problem = replace(problem, loss=restore_loss(fit))
    start = np.array([[t.initial_state[name] for name in problem.model.system.state_names] for t in fit.traces])
    initial = replace(variables.initial, guess=start)
    return replace(problem, variables=replace(variables, initial=initial))


def _check_fit(fit: Fit, what: str) -> None:
    if not fit.success:
        raise FitError(f"fit of {fit.model.title}: {fit.solver.status_message}; {what} a fit that has succeeded")
    if any(i.name not in t.inputs for t in fit.traces for i in fit.model.inputs):
        raise FitError(f"fit of {fit.model.title}: saved without the inputs of its records; fit again")


def _label_experiment_values(fit: Fit) -> dict[str, float]:
    """Values of the parameters that each experiment has for itself, by their labels ``B (day 1)``."""
    return {
        f"{name} ({title})": estimate.value
        for name, estimates in fit.constraints.per_experiment.items()
        for title, estimate in estimates.items()
    }


def restore_loss(fit: Fit) -> RobustLoss | None:
    """The robust loss of ``fit`` with its scales; None for least squares."""
    loss = FitOptions.from_data(fit.provenance.options).to_loss()
    scale = np.array([fit.robust.scale.get(o.name, 1.0) for o in fit.model.outputs])
    return None if loss is None else replace(loss, scale=scale)


def restore_noise(fit: Fit) -> NoiseModel:
    """The noise that ``fit`` was weighted with."""
    outputs = fit.model.outputs
    std = np.array([fit.noise.std.get(o.name, 1.0) for o in outputs])
    colour = tuple(AutoRegression(tuple(fit.noise.colour.get(o.name, ()))) for o in outputs)
    known = bool(fit.noise.sources) and all(source.is_independent for source in fit.noise.sources.values())
    return NoiseModel(tuple(o.name for o in outputs), std, fit.noise.sources, colour, known, fit.noise.bounds)


def restore_likelihood(fit: Fit) -> PredictionErrorObjective:
    """The likelihood of a fit with process noise, its constants and first states free, ``z = 0`` at its optimum.

    An intensity that became zero stays there.

    Raises FitError for a fit that did not succeed, or was saved without its inputs.
    """
    _check_fit(fit, "its innovations need")
    saved = FitOptions.from_data(fit.provenance.options)
    options = replace(
        saved,
        method=str(fit.solver.statistics.get("method", saved.method)),
        substeps=int(fit.solver.statistics.get("substeps", 0)),
    )
    std = np.array([fit.noise.std.get(o.name, 1.0) for o in fit.model.outputs])
    outputs = tuple(o.name for o in fit.model.outputs)
    noise = NoiseModel(outputs, std, fit.noise.sources, tuple(AutoRegression() for _ in std), True)
    none = [name for name in fit.model.noise_parameters if fit.model.values[name] == 0]
    cost = make_likelihood(
        FixedParameterModel(fit.model.fix(*none), noise, options), [t.experiment for t in fit.traces], free=True
    )
    v = cost.unknowns.variables
    start = np.array([[t.initial_state[name] for name in fit.model.system.state_names] for t in fit.traces])
    variables = replace(v.with_values(_label_experiment_values(fit)), initial=replace(v.initial, guess=start))
    return cost.at(replace(cost.unknowns, variables=variables))


def compute_innovation_rows(fit: Fit) -> tuple[list[tuple[np.ndarray, np.ndarray]], PredictionErrorObjective]:
    """For each record of ``fit`` its standardised innovations (N, ny), NaN in gaps, and the slopes (N, ny, L) of the innovations
    themselves over their standard deviation.

    L are the columns of the experiment, see `LikelihoodUnknowns.columns`. How the standard deviations depend on the unknowns is
    left out: what
    only scales an innovation does not explain it.
    """
    cost = restore_likelihood(fit)
    return [(e, mean) for e, mean, _ in compute_innovations(cost).rows], cost
