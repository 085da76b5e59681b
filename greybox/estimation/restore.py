"""A finished fit as the problem that it was, at its optimum: by simulation error or by prediction error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from greybox.base.errors import FitError
from greybox.data.noise.noise_model import AutoRegression, NoiseModel
from greybox.estimation.objective import Objective, PredictionErrorObjective, ResidualRows, SimulationErrorObjective
from greybox.estimation.options import FitOptions, RobustLoss
from greybox.estimation.result import Fit
from greybox.estimation.transcription.problem import EstimationProblem, prepare_problem


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


def restore_problem(fit: Fit) -> EstimationProblem:
    """The problem of ``fit`` with its records, its noise, its loss and its initial states, at its optimum.

    An intensity of process noise that became zero stays there.

    Raises FitError for a fit that did not succeed, that was saved without its inputs, or whose run is neither a free one (but arcs, or
    the segments of an unstable plant) nor a prediction.
    """
    _check_fit(fit)
    without = [name for name in fit.model.noise_parameters if fit.model.values[name] == 0]
    problem = prepare_problem(
        fit.model.fix(*without), [t.experiment for t in fit.traces], restore_noise(fit), restore_options(fit)
    )
    variables = problem.variables.with_values(_label_experiment_values(fit))
    start = np.array([[t.initial_state[name] for name in problem.model.system.state_names] for t in fit.traces])
    variables = replace(variables, initial=replace(variables.initial, guess=start))
    return replace(problem, loss=restore_loss(fit), variables=variables)


def restore_objective(fit: Fit) -> Objective:
    """What ``fit`` minimised, at its optimum; raises as `restore_problem`."""
    problem = restore_problem(fit)
    if fit.prediction.process_noise:
        return PredictionErrorObjective.of(problem)
    return SimulationErrorObjective(problem)


def restore_residuals(fit: Fit) -> tuple[Objective, ResidualRows]:
    """What ``fit`` minimised, and its residuals or innovations with their slopes. Raises FitError where they are not finite."""
    objective = restore_objective(fit)
    residuals = objective.linearise()
    if residuals is None:
        raise FitError(f"fit of {fit.model.title}: its filter is not finite at the fitted parameters; fit again")
    return objective, residuals


def _check_fit(fit: Fit) -> None:
    if not fit.success:
        raise FitError(
            f"fit of {fit.model.title}: {fit.solver.status_message}; intervals need a fit that has succeeded"
        )
    if any(i.name not in t.inputs for t in fit.traces for i in fit.model.inputs):
        raise FitError(f"fit of {fit.model.title}: saved without the inputs of its records; fit again")
    if not (has_free_run(fit) or fit.prediction.process_noise):
        raise FitError(
            f"fit of {fit.model.title}: its simulation is not a free run ({fit.solver.statistics['transcription']}), which"
            " this result needs; use the intervals of the fit itself, or fit by single shooting if the plant is stable"
        )


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
    options = FitOptions.from_data(fit.provenance.options)
    known = bool(fit.noise.sources) and all(source.is_independent for source in fit.noise.sources.values())
    return NoiseModel(
        tuple(o.name for o in outputs), std, fit.noise.sources, colour, known, fit.noise.bounds, options.common_noise
    )
