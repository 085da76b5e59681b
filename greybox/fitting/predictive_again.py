"""A finished prediction-error fit as the likelihood that it was, at its optimum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from greybox.errors import FitError
from greybox.fitting.options import FitOptions
from greybox.fitting.predictive_beginning import Known, likelihood_of
from greybox.fitting.predictive_cost import PredictionError
from greybox.noise import AutoRegression, Noise
from greybox.result import Fit


def likelihood_of_fit(fit: Fit) -> PredictionError:
    """The likelihood of a fit with process noise, its constants and first states free, ``z = 0`` at its optimum.

    Raises FitError for a fit that did not succeed, or was saved without its inputs.
    """
    if not fit.success:
        raise FitError(f"fit of {fit.model.title}: {fit.meaning}; its innovations need a fit that has succeeded")
    if any(i.name not in t.inputs for t in fit.traces for i in fit.model.inputs):
        raise FitError(f"fit of {fit.model.title}: saved without the inputs of its records; fit again")
    saved = FitOptions(**fit.options)
    options = replace(
        saved, method=str(fit.solver.get("method", saved.method)), substeps=int(fit.solver.get("substeps", 0))
    )
    std = np.array([fit.noise.get(o.name, 1.0) for o in fit.model.outputs])
    noise = Noise(std, fit.noise_source, True, fit.noise_sources, tuple(AutoRegression() for _ in std))
    cost = likelihood_of(Known(fit.model, noise, options), [t.experiment for t in fit.traces], free=True)
    v = cost.unknowns.variables
    start = np.array([[t.initial_state[name] for name in fit.model.system.state_names] for t in fit.traces])
    own = {f"{name} ({title})": e.value for name, found in fit.own.items() for title, e in found.items()}
    variables = replace(v.at(own), initial=replace(v.initial, guess=start))
    return cost.at(replace(cost.unknowns, variables=variables))


def innovation_rows(fit: Fit) -> tuple[list[tuple[np.ndarray, np.ndarray]], PredictionError]:
    """For each record of ``fit`` its standardised innovations (N, ny), NaN in gaps, and the slopes (N, ny, L) of the innovations
    themselves over their standard deviation.

    L are the columns of the experiment, see `Unknowns.columns`. How the standard deviations depend on the unknowns is left out: what
    only scales an innovation does not explain it.
    """
    cost = likelihood_of_fit(fit)
    result = []
    for record, found in zip(cost.records, cost.slopes(np.zeros(cost.unknowns.size)), strict=True):
        if found is None:
            raise FitError(f"fit of {fit.model.title}: its filter is not finite at the fitted constants; fit again")
        e = np.full(record.y.shape, np.nan)
        slopes = np.full((*record.y.shape, found.de.shape[1]), np.nan)
        e[found.rows, found.outputs] = found.e
        slopes[found.rows, found.outputs] = found.mean_slopes
        result.append((record.samples(e), record.samples(slopes)))
    return result, cost
