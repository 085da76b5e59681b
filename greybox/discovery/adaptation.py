"""What a model leaves on records that were not fitted once its constants may move within what the fit left open.

A free run carries the uncertainty of the constants and of the first states along: in a plant that integrates, a constant that is wrong by
one standard deviation moves the end of a long record by many times the noise. That is no model error. So the run is corrected by one
Gauss-Newton step of the first states and of the constants, which the estimation records hold as firmly as they determine them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.discovery.problem import CandidateFit, DiscoveryProblem, with_start_values
from greybox.experiment import Experiment
from greybox.linear_algebra import eliminate
from greybox.optim import QuadraticModel
from greybox.result import Validation
from greybox.transcription import DecisionVector

# Residuals (N,) of each output, one array a record.
Residuals = dict[str, list[np.ndarray]]


@dataclass(frozen=True)
class AdaptedRun:
    """A run over records that were not fitted, corrected within what the fit left open.

    Parameters
    ----------
    residuals
        By measured output the residuals in its unit, one array a record.
    rise
        By how much the step raises the cost of the estimation records: what the correction has to be charged with.
    """

    residuals: Residuals
    rise: float = 0.0


def adapt_to_records(
    problem: DiscoveryProblem, candidate: CandidateFit, experiments: Sequence[Experiment], run: Validation
) -> AdaptedRun | None:
    """``candidate`` on ``experiments`` after the step.

    Parameters
    ----------
    problem, candidate
        The search's records and noise, and the model as it was fitted.
    experiments, run
        Other records, and its free run over them.

    Returns
    -------
    AdaptedRun or None
        None where the model cannot be run after the step.
    """
    prepared = problem.prepare(candidate.model, tuple(experiments))
    if candidate.problem.step.substeps and not prepared.step.per_interval:
        prepared = prepared.with_substeps(candidate.problem.step.substeps)
    names = prepared.model.system.state_names
    guess = np.array([[trace.initial_state[name] for name in names] for trace in run.traces])
    variables = with_start_values(prepared.variables, candidate.model.values)
    variables = replace(variables, initial=replace(variables.initial, guess=guess))
    model = prepared.shooting(variables).evaluate(variables.here)
    if not (model.is_finite and len(variables.which) == len(candidate.variables.which)):
        return None
    held = _hold_constants(candidate, variables)
    step = QuadraticModel(model.cost, model.gradient, model.hessian + held).bounded_step(*variables.bounds())
    shooting = prepared.with_plain_squares().shooting(variables)
    errors = [r for r, _ in shooting.residuals(step)]
    # A residual that is no number is one of a sample that nobody measured, or of a model that did not survive the step.
    present = [np.isfinite(record.samples(record.y)) for record in shooting.records]
    if not all(np.isfinite(r[p]).all() for r, p in zip(errors, present, strict=True)):
        return None
    std = prepared.noise.std
    measured = {name for experiment in experiments for name in experiment.outputs}
    residuals = {
        output.name: [r[:, j] * std[j] for r in errors]
        for j, output in enumerate(prepared.model.outputs)
        if output.name in measured
    }
    return AdaptedRun(residuals, float(step @ held @ step) / 2)


def _hold_constants(candidate: CandidateFit, variables: DecisionVector) -> np.ndarray:
    """Information (n, n) of the estimation records on the constants, as the unknowns ``variables`` count them; none on first states.

    Beside what they tell, the size of a constant is one standard deviation of it: beyond that a linear step is not to be trusted, and one
    that they leave open would go to its bound.
    """
    constants = np.arange(len(candidate.variables.which))
    others = np.arange(len(constants), candidate.variables.size)
    information = candidate.evaluation.hessian
    projection = eliminate(information, constants, others)
    scale = variables.spans / candidate.variables.spans
    held = np.zeros((variables.size, variables.size))
    held[np.ix_(constants, constants)] = (projection @ information @ projection.T) * np.outer(scale, scale)
    held[constants, constants] += 1.0
    return held
