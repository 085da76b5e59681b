"""A finished prediction-error fit as the likelihood that it was, at its optimum."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from greybox.errors import FitError
from greybox.estimation.fixed_parameters import FixedParameterModel, make_likelihood
from greybox.estimation.options import FitOptions
from greybox.estimation.prediction_error import PredictionErrorObjective
from greybox.noise import AutoRegression, NoiseModel
from greybox.result import Fit
from greybox.transcription import Evaluation


def restore_likelihood(fit: Fit) -> PredictionErrorObjective:
    """The likelihood of a fit with process noise, its constants and first states free, ``z = 0`` at its optimum.

    An intensity that became zero stays there.

    Raises FitError for a fit that did not succeed, or was saved without its inputs.
    """
    if not fit.success:
        raise FitError(
            f"fit of {fit.model.title}: {fit.solver.status_message}; its innovations need a fit that has succeeded"
        )
    if any(i.name not in t.inputs for t in fit.traces for i in fit.model.inputs):
        raise FitError(f"fit of {fit.model.title}: saved without the inputs of its records; fit again")
    saved = FitOptions(**fit.provenance.options)
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
    per_experiment = {
        f"{name} ({title})": e.value
        for name, found in fit.constraints.per_experiment.items()
        for title, e in found.items()
    }
    variables = replace(v.at(per_experiment), initial=replace(v.initial, guess=start))
    return cost.at(replace(cost.unknowns, variables=variables))


@dataclass(frozen=True, eq=False)
class Innovations:
    """Innovations (N, ny) of each record, NaN in gaps, and what they tell: the slopes (N, ny, L) of their mean over their standard
    deviation and of the logarithm of their variance; ``evaluation`` of the likelihood at the optimum.
    """

    rows: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]
    evaluation: Evaluation


def compute_innovations(cost: PredictionErrorObjective) -> Innovations:
    """The innovations at ``z = 0`` of a likelihood. Raises FitError where its filter is not finite."""
    zero = np.zeros(cost.unknowns.size)
    rows = []
    for record, found in zip(cost.records, cost.slopes(zero), strict=True):
        if found is None:
            title = cost.unknowns.variables.model.title
            raise FitError(f"fit of {title}: its filter is not finite at the fitted constants; fit again")
        e = np.full(record.y.shape, np.nan)
        mean, logarithm = (np.full((*record.y.shape, found.de.shape[1]), np.nan) for _ in range(2))
        e[found.rows, found.outputs] = found.e
        mean[found.rows, found.outputs], logarithm[found.rows, found.outputs] = found.mean_slopes, found.dlog_variance
        rows.append((record.samples(e), record.samples(mean), record.samples(logarithm)))
    return Innovations(tuple(rows), cost.evaluate(zero))


def compute_innovation_rows(fit: Fit) -> tuple[list[tuple[np.ndarray, np.ndarray]], PredictionErrorObjective]:
    """For each record of ``fit`` its standardised innovations (N, ny), NaN in gaps, and the slopes (N, ny, L) of the innovations
    themselves over their standard deviation.

    L are the columns of the experiment, see `LikelihoodUnknowns.columns`. How the standard deviations depend on the unknowns is
    left out: what
    only scales an innovation does not explain it.
    """
    cost = restore_likelihood(fit)
    return [(e, mean) for e, mean, _ in compute_innovations(cost).rows], cost
