"""`predict`: outputs so many samples ahead, the last measurements at hand, for every model of any kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from greybox.errors import DataError, ModelError, nearest
from greybox.estimation.fixed_parameters import (
    FIRST_ROWS,
    FixedParameterModel,
    estimate_initial_state,
    fix_parameters,
    make_likelihood,
)
from greybox.estimation.options import FitOptions
from greybox.estimation.prediction_correction import PredictionCorrection, describe_filter, identify_correction
from greybox.estimation.prediction_error import PredictionErrorObjective
from greybox.estimation.prediction_error_runs import compute_free_runs, predict_ahead
from greybox.experiment import Experiment
from greybox.model import Model
from greybox.noise import NoiseModel
from greybox.result import Fit

InitialState = Mapping[str, float]


class PredictingModel(Protocol):
    """What a black-box model and a `Predictor` have in common."""

    def predict(self, experiment: Experiment, steps: int = 1) -> Mapping[str, np.ndarray]:
        """Outputs by name (N,), each row from the measurements up to ``steps`` rows before it."""


@dataclass(frozen=True)
class Predictor:
    """A model with known constants and what corrects it at each sample (`PredictionCorrection`), ready for any record."""

    correction: PredictionCorrection
    options: FitOptions

    def predict(
        self, experiment: Experiment, steps: int = 1, *, initial: InitialState | None = None
    ) -> dict[str, np.ndarray]:
        """Outputs by name (N,): row ``k`` from the inputs, and from the measurements up to row ``k - steps``.

        The first ``steps`` rows are those of the free run. ``initial``: the first states by name; None estimates them from the first
        50 rows (or takes the declared ones, with ``options.at_rest``). Raises DataError for steps below one.
        """
        _check_steps(steps)
        cost = self._begun(experiment, initial)
        names = [o.name for o in self.correction.model.outputs]
        if self.correction.model.noisy_states:
            return _named(names, predict_ahead(cost, steps)[0])
        record = cost.records[0]
        free, seen = record.samples(compute_free_runs(cost)[0][0]), record.samples(record.y)
        for j, name in enumerate(names):
            if name in self.correction.colours:
                free[:, j] += self.correction.colours[name].predict(seen[:, j] - free[:, j], steps)
        return _named(names, free)

    def simulate(self, experiment: Experiment, *, initial: InitialState | None = None) -> dict[str, np.ndarray]:
        """Outputs by name (N,) of the free run; ``initial`` as for `predict`."""
        cost = self._begun(experiment, initial)
        names = [o.name for o in self.correction.model.outputs]
        return _named(names, cost.records[0].samples(compute_free_runs(cost)[0][0]))

    def _begun(self, experiment: Experiment, initial: InitialState | None) -> PredictionErrorObjective:
        model = self.correction.model
        given = FixedParameterModel(model, self.correction.noise, self.options)
        if initial is None:
            return estimate_initial_state(make_likelihood(given, experiment), self.options, FIRST_ROWS)
        states = model.system.state_names
        unknown = [n for n in initial if n not in states]
        if unknown:
            raise ModelError(f"model {model.title!r} has no state {unknown[0]!r}; {nearest(unknown[0], states)}")
        missing = [n for n in states if n not in initial]
        if missing:
            raise ModelError(f"initial: no value for {', '.join(missing)}; give every state, or None to estimate them")
        cost = make_likelihood(replace(given, options=replace(self.options, at_rest=False)), experiment)
        v = cost.unknowns.variables
        begin = replace(v.initial, guess=np.array([[float(initial[n]) for n in states]]))
        return cost.at(replace(cost.unknowns, variables=replace(v, initial=begin)))


def predictor(
    given: Model | Fit,
    experiments: Experiment | Sequence[Experiment] = (),
    *,
    noise: Mapping[str, float] | NoiseModel | None = None,
    options: FitOptions | None = None,
) -> Predictor:
    """A `Predictor` of a model or a fit.

    Of a model with process noise it is the Kalman filter. Any other model is corrected as ``experiments`` say (None: those of the
    fit), see `greybox.estimation.prediction_correction.identify_correction`; its constants stay. Judge it on other records than
    those. With a
    model that lacks nothing there is nothing to correct, and the prediction is the free run. ``noise`` of the sensors by output; None
    takes that of the fit, or finds the most likely one.

    Raises DataError where there are no records to tell the correction.
    """
    found = fix_parameters(given, noise, options)
    group = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    if isinstance(given, Fit):
        if given.model.noisy_states and noise is None and not group:
            frozen = given.model.fix(*given.model.values)
            return Predictor(
                PredictionCorrection(frozen, given.noise.std, words=describe_filter(frozen)), found.options
            )
        if not given.model.noisy_states and noise is None:
            # What was not told by anybody the filter finds together with the process noise.
            told = {
                n: v
                for n, v in given.noise.std.items()
                if n in given.noise.sources and given.noise.sources[n].is_independent
            }
            found = replace(found, noise=told)
        group = group or tuple(t.experiment for t in given.traces)
    if not group:
        raise DataError("predictor: no record tells how to correct the model; give experiments, or a fit")
    return Predictor(identify_correction(found, group), found.options)


def predict(
    given: Model | Fit | PredictingModel,
    experiment: Experiment,
    *,
    steps: int = 1,
    noise: Mapping[str, float] | NoiseModel | None = None,
    options: FitOptions | None = None,
) -> dict[str, np.ndarray]:
    """Outputs by name (N,) of ``experiment``, each row predicted from the measurements up to ``steps`` rows before it.

    ``given``: a fit or a model, as `predictor` makes them ready (a model that has no process noise is corrected as ``experiment`` itself
    says: a few numbers are fitted to it, the constants are not), or anything with a ``predict`` of its own, such as a black-box model.
    Several records, or several ``steps``, are cheaper through one `predictor`. Raises DataError for steps below one.
    """
    _check_steps(steps)
    if isinstance(given, Fit | Model):
        return predictor(given, () if isinstance(given, Fit) else experiment, noise=noise, options=options).predict(
            experiment, steps
        )
    if not hasattr(given, "predict"):
        raise ModelError(f"{given!r} cannot predict; give a Model, a Fit, or a model with a predict method")
    return dict(given.predict(experiment, steps=steps))


def _check_steps(steps: int) -> None:
    if steps < 1:
        raise DataError(f"steps ahead: {steps}; give a whole number from 1")


def _named(names: Sequence[str], y: np.ndarray) -> dict[str, np.ndarray]:
    return {name: y[:, j] for j, name in enumerate(names)}
