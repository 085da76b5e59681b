"""A finished fit as the problem it was, at its optimum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from greybox.errors import FitError
from greybox.fitting.options import FitOptions
from greybox.fitting.problem import Problem, prepare
from greybox.model import Model
from greybox.noise import AutoRegression, Noise
from greybox.noise.hierarchy import GIVEN, QUIET
from greybox.result import Fit


def options_of(fit: Fit) -> FitOptions:
    """The options of ``fit`` for a search that begins next to its optimum, with the step it ended with."""
    options = FitOptions(**fit.options)
    return replace(options, progressive=False, substeps=int(fit.solver.get("substeps", options.substeps)))


def problem_of(fit: Fit, model: Model | None = None) -> Problem:
    """The problem of ``fit`` with its records, its noise and its initial states, at its optimum; with another ``model`` if given.

    Raises FitError for a fit that did not succeed, or that was saved without its inputs.
    """
    if not fit.success:
        raise FitError(f"fit of {fit.model.title}: {fit.meaning}; intervals need a fit that has succeeded")
    if any(i.name not in t.inputs for t in fit.traces for i in fit.model.inputs):
        raise FitError(f"fit of {fit.model.title}: saved without the inputs of its records; fit again")
    options = options_of(fit)
    problem = prepare(
        model or fit.model, [t.experiment for t in fit.traces], noise_of_fit(fit), at_rest=options.at_rest, method=options.method,
        substeps=options.substeps,
    )  # fmt: skip
    variables = problem.variables
    start = np.array([[t.initial_state[name] for name in problem.model.system.state_names] for t in fit.traces])
    initial = replace(variables.initial, guess=start)
    return replace(problem, variables=replace(variables, initial=initial))


def noise_of_fit(fit: Fit) -> Noise:
    """The noise that ``fit`` was weighted with."""
    outputs = fit.model.outputs
    std = np.array([fit.noise.get(o.name, 1.0) for o in outputs])
    colour = tuple(AutoRegression(tuple(fit.noise_colour.get(o.name, ()))) for o in outputs)
    known = bool(fit.noise_sources) and set(fit.noise_sources.values()) <= {GIVEN, QUIET}
    return Noise(std, fit.noise_source, known, fit.noise_sources, colour)
