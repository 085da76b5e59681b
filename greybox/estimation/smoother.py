"""`smooth`: what the states were, given a whole record, with bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from greybox.errors import ModelError, nearest
from greybox.estimation.objective import PredictionErrorObjective
from greybox.estimation.options import FitOptions
from greybox.estimation.policy import InitialStatePolicy
from greybox.estimation.predictor import estimate_initial_state, fix_parameters, make_likelihood
from greybox.experiment import Experiment
from greybox.filtering import smooth_states
from greybox.model import Model
from greybox.noise import NoiseModel
from greybox.numerics import TINY, UNSEEN_INFORMATION
from greybox.result import Fit
from greybox.values import Printable


@dataclass(frozen=True, eq=False)
class SmoothedStates(Printable):
    """States of one record given all of its measurements, at known constants.

    ``time`` (N,); ``mean`` and ``std`` by state (N,) in ``units``, and ``filtered``: the same from the measurements up to each row
    alone. ``innovations`` by output (N,): the error of the prediction from the rows before, over its standard deviation, NaN in gaps;
    white, normal and of variance one where nothing is missing. ``noise`` by output, ``process_noise`` by state. ``log_likelihood`` is
    that of the record from the most likely first states.
    """

    experiment: str
    time: np.ndarray
    mean: Mapping[str, np.ndarray]
    std: Mapping[str, np.ndarray]
    filtered: Mapping[str, np.ndarray]
    filtered_std: Mapping[str, np.ndarray]
    innovations: Mapping[str, np.ndarray]
    log_likelihood: float
    noise: Mapping[str, float]
    process_noise: Mapping[str, float]
    units: Mapping[str, str]
    discretisation: str

    def band(self, state: str, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper end (N,) of the interval that holds the state with probability ``level`` at each row."""
        if state not in self.mean:
            raise ModelError(f"no state {state!r}; {nearest(state, self.mean)}")
        if not 0 < level < 1:
            raise ModelError(f"level {level:g} of a band; give a probability between 0 and 1")
        reach = float(ndtri((1 + level) / 2)) * self.std[state]
        return self.mean[state] - reach, self.mean[state] + reach


def smooth(
    model: Model | Fit,
    experiment: Experiment,
    *,
    noise: Mapping[str, float] | NoiseModel | None = None,
    options: FitOptions | None = None,
) -> SmoothedStates:
    """States during a record given all of its measurements: Kalman filter and fixed-interval smoother, the parameters as they are.

    Without process noise on any state (`State`) they are those of the free run. The first states are unknown and estimated from the
    record, unless ``options.at_rest`` declares them. The bands allow for noise of process and sensors, and for the first states; not
    for the parameters.

    Parameters
    ----------
    model
        A model, or a fit.
    experiment
        The record.
    noise
        Standard deviation by output in the model's units; None takes that of the fit, or finds the most likely one.
    options
        Discretisation and treatment of the first states; None takes those of the fit.

    Returns
    -------
    SmoothedStates
        Mean and standard deviation (N,) of each state, the same from the filter alone, and the innovations.

    Raises
    ------
    DataError, ModelError
        For a record that does not go with the model.

    Examples
    --------
    >>> low, high = smooth(fit, record).band("v")  # doctest: +SKIP
    """
    given = fix_parameters(model, noise, options)
    cost = estimate_initial_state(make_likelihood(given, experiment), given.options)
    pn, x0 = cost.start(0)
    smoothed = smooth_states(
        cost.kalman, cost.records[0], pn, x0, _make_prior_covariance(cost, given.options.policy.initial_state)
    )
    record, names = cost.records[0], given.model.system.state_names
    spread = np.sqrt(np.maximum(np.diagonal(smoothed.covariance, axis1=1, axis2=2), 0.0))
    before = np.sqrt(np.maximum(np.diagonal(smoothed.filtered_covariance, axis1=1, axis2=2), 0.0))

    def by_state(values: np.ndarray) -> dict[str, np.ndarray]:
        return {name: record.samples(values)[:, k] for k, name in enumerate(names)}

    measured = [(j, o) for j, o in enumerate(given.model.outputs) if np.isfinite(record.y[:, j]).any()]
    innovations = record.samples(cost.innovations()[0])
    return SmoothedStates(
        experiment=experiment.name,
        time=experiment.time,
        mean=by_state(smoothed.mean),
        std=by_state(spread),
        filtered=by_state(smoothed.filtered),
        filtered_std=by_state(before),
        innovations={o.name: innovations[:, j] for j, o in measured},
        log_likelihood=-0.5 * cost.cost(),
        noise={o.name: float(cost.noise[j]) for j, o in measured},
        process_noise={name: value for name, value in given.model.noise_intensities.items() if value},
        units={s.name: s.unit for s in given.model.all_states},
        discretisation=cost.kalman.filter_step.label,
    )


def _make_prior_covariance(cost: PredictionErrorObjective, policy: InitialStatePolicy) -> np.ndarray | None:
    """A wide covariance (nx, nx) of the first states about their estimate; None where they are declared."""
    v = cost.variables
    free = v.free_states
    if not len(free):
        return None
    n = len(v.which)
    block = slice(n, n + len(free))
    information = cost.evaluate(v.here).hessian[block, block] / 2
    scale = np.sqrt(
        np.maximum(np.diag(information), UNSEEN_INFORMATION * max(np.diag(information).max(initial=0.0), TINY))
    )
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    inverse = (vectors / np.maximum(values, UNSEEN_INFORMATION)) @ vectors.T / np.outer(scale, scale)
    covariance = np.zeros((len(v.initial.free), len(v.initial.free)))
    reach = v.initial.scale[free]
    covariance[np.ix_(free, free)] = policy.smoother_prior * inverse * np.outer(reach, reach)
    return covariance
