"""`predict`: outputs some samples ahead from the measurements up to now, for every kind of model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.special import ndtri

from greybox.base import DataError, ModelError, Printable, nearest
from greybox.base.numerics import TINY, UNSEEN_INFORMATION
from greybox.data.data_frame import Frame
from greybox.data.experiment import Experiment, as_records
from greybox.data.noise.noise_model import AutoRegression, NoiseModel, fit_autoregression, join_series
from greybox.data.read import as_experiments
from greybox.estimation.noise_loop import solve
from greybox.estimation.objective import PredictionErrorObjective, refine_minimum, search_minimum
from greybox.estimation.options import FitOptions, resolve_options
from greybox.estimation.prediction_error import estimate_by_prediction_error
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Trace
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.estimation.transcription.select import select_transcription
from greybox.estimation.validate import FIRST_ROWS, determine_initial_states, refine_integration
from greybox.model import Model
from greybox.simulation.filtering.kalman_filter import LOG_TWO_PI
from greybox.simulation.filtering.smoother import smooth_states
from greybox.simulation.kernel.record import Record


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
    if isinstance(given, (Fit, Model)):
        (given.model if isinstance(given, Fit) else given).require_equations("a prediction or a smoother")
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
    return FitOptions.from_data(fit.provenance.options).integration


def make_likelihood(
    given: FixedParameterModel, experiments: Experiment | Sequence[Experiment]
) -> PredictionErrorObjective:
    """The likelihood of records with nothing unknown but the first states, and the outputs' noise where that is neither given
    nor known from a quiet record."""
    return PredictionErrorObjective.of(_refine(_prepare_known(given, experiments, filtered=True), given.options))


def _prepare_known(
    given: FixedParameterModel, experiments: Experiment | Sequence[Experiment], *, filtered: bool = False
) -> EstimationProblem:
    """Records with nothing unknown but the first states, and the method of integration that a fit to them takes."""
    frozen, options = given.model.fix(*given.model.values), replace(given.options, per_experiment=())
    problem = prepare_problem(frozen, experiments, given.noise, options, written_out=filtered)
    return select_transcription(problem, replace(options, progressive=False)).problem


def _refine(problem: EstimationProblem, options: FitOptions) -> EstimationProblem:
    """``problem`` with steps as short as a fit takes them; the usual ones where a free run leaves the data and says nothing of them."""
    refined = refine_integration(problem, options)
    finite = all(np.isfinite(y).all() for y, _ in refined.shooting().simulate(refined.variables.here))
    return refined if finite else problem


def estimate_initial_state(
    cost: PredictionErrorObjective, options: FitOptions, rows: int = 0
) -> PredictionErrorObjective:
    """``cost`` at its most likely point, from the first ``rows`` of each record (0: all of them)."""
    part = replace(cost, records=tuple(r.first(min(rows, len(r.y))) for r in cost.records)) if rows else cost
    optimum = search_minimum(part, options)
    if not optimum.status.success:
        optimum = refine_minimum(part, options)
    return cost.at(optimum.objective.variables)


class CorrectionKind(StrEnum):
    """How measurements correct a run."""

    KALMAN_FILTER = "kalman_filter"
    """Through the states, by the process noise of the model."""

    ESTIMATED_KALMAN_FILTER = "estimated_kalman_filter"
    """Through the states, by process noise that was estimated."""

    AUTOREGRESSION = "autoregression"
    """By the autoregression of each output's error."""

    NONE_WHITE = "none_white"
    """Not at all: the error of the free run is white."""

    NONE_ZERO = "none_zero"
    """Not at all: the process noise of the model is zero."""


@dataclass(frozen=True)
class PredictionCorrection(Printable):
    """How measurements correct a run: through the states of ``model``, where that has process noise, or by the autoregression
    ``colours`` of each output's error; by nothing where there is neither. ``noise``: what the sensors are taken to have, by output.
    """

    model: Model
    noise: Mapping[str, float]
    kind: CorrectionKind
    colours: Mapping[str, AutoRegression] = field(default_factory=dict)


def identify_correction(given: FixedParameterModel, experiments: Sequence[Experiment]) -> PredictionCorrection:
    """The correction under which ``experiments`` are most likely, the constants being left as they are.

    A model with process noise of its own brings its Kalman filter. Else there are two rivals. Process noise on every balance that may
    lack something, its intensities and the noise of the sensors estimated by maximum likelihood: a filter that moves the states, which
    is right where the plant is pushed, drifts, or began elsewhere. An autoregression of the free run's error, the exact predictor where
    the sensors' noise is coloured: the states stay. The more likely one is taken, less what its numbers cost (BIC), and neither where
    the error of the free run is white: a model that lacks nothing predicts as it runs freely.
    """
    frozen = given.model.fix(*given.model.values)
    if frozen.noisy_states:
        cost = estimate_initial_state(make_likelihood(given, experiments), given.options)
        levels = _name_levels(frozen, cost.noise, cost.records)
        return PredictionCorrection(frozen, levels, CorrectionKind.KALMAN_FILTER)
    options, problem = replace(given.options, per_experiment=()), _prepare_known(given, experiments)
    levels, runs = _name_levels(frozen, problem.noise.std, problem.records), solve(problem, options).simulate()
    # The free run's own error: what an autoregression would have to predict.
    errors = [r.samples(r.y - y) for r, (y, _) in zip(problem.records, runs, strict=True)]
    series = {o.name: join_series([e[:, j] for e in errors]) for j, o in enumerate(frozen.outputs)}
    colours = {
        name: fit_autoregression(s, policy=options.policy.noise) for name, s in series.items() if np.isfinite(s).any()
    }
    # Nothing to predict from: a white error of the free run tells nothing about the next one.
    if not any(colour.order for colour in colours.values()):
        return PredictionCorrection(frozen, levels, CorrectionKind.NONE_WHITE)
    states = find_correctable_states(frozen)
    estimate = estimate_by_prediction_error(frozen.with_process_noise(*states), experiments, given.noise, options)
    # BIC = -2 log L + k ln N: of the autoregressions -2 log L = N (ln s^2 + 1 + ln 2 pi) at the most likely variance ...
    colour_score = 0.0
    for name, colour in colours.items():
        samples = int(np.isfinite(series[name]).sum())
        variance = float(np.nanmean(series[name] ** 2)) * colour.innovation_variance
        colour_score += samples * (float(np.log(max(variance, TINY))) + 1 + LOG_TWO_PI)
        colour_score += (colour.order + 1) * float(np.log(samples))
    # ... and the filter pays for its intensities and noise levels.
    evaluation, variables = estimate.optimum.evaluation, estimate.optimum.objective.variables
    numbers = len(variables.which) + len(variables.estimated_noise)
    state_score = evaluation.cost + numbers * float(np.log(max(evaluation.count, 1)))
    if estimate.optimum.status.success and state_score < colour_score:
        cost = estimate.optimum.objective
        values = dict(zip((q.name for q in variables.model.all_parameters), variables.fixed.tolist(), strict=True))
        # The intensities that were found become constants of the model, as its own are.
        model = frozen.with_process_noise(*states).fix(**{name: values[name] for name in estimate.names})
        levels = _name_levels(model, cost.noise, cost.records)
        return PredictionCorrection(model, levels, CorrectionKind.ESTIMATED_KALMAN_FILTER)
    return PredictionCorrection(frozen, levels, CorrectionKind.AUTOREGRESSION, colours)


def find_correctable_states(model: Model) -> tuple[str, ...]:
    """States whose balance may lack something: not one whose rate is another state by definition, nor one that is set after a step."""
    system = model.system
    moved = [b.state for b in system.balances]
    # dx/dt = v holds exactly: noise there would let the position jump without a velocity.
    by_definition = {name for k, name in enumerate(system.state_names) if system.rhs[k].is_symbolic()}
    return tuple(name for name in moved if name not in by_definition) or tuple(moved)


def _name_levels(model: Model, level: np.ndarray, records: Sequence[Record]) -> dict[str, float]:
    """Noise of the outputs that were measured."""
    seen = [j for j in range(len(level)) if any(np.isfinite(r.y[:, j]).any() for r in records)]
    return {model.outputs[j].name: float(level[j]) for j in seen}


InitialState = Mapping[str, float]


@runtime_checkable
class PredictingModel(Protocol):
    """What a black-box model and a `Predictor` have in common."""

    def simulate(self, experiment: Experiment) -> Mapping[str, np.ndarray]:
        """Outputs by name (N,) of the free run."""

    def predict(self, experiment: Experiment, steps: int = 1) -> Mapping[str, np.ndarray]:
        """Outputs by name (N,), each row from the measurements up to ``steps`` rows before it."""


@dataclass(frozen=True)
class Predictor:
    """A model with known constants and what corrects it at each sample (`PredictionCorrection`), ready for any record."""

    correction: PredictionCorrection
    options: FitOptions
    known: tuple[Trace, ...] = ()
    """Free runs of a fit: where nothing moves the states a prediction is the run, and what is foretold of its error."""

    def predict(
        self, experiment: Experiment | Frame, steps: int = 1, *, initial: InitialState | None = None
    ) -> dict[str, np.ndarray]:
        """Predict the outputs of a record: row ``k`` from the inputs, and from the measurements up to row ``k - steps``.

        Parameters
        ----------
        experiment
            The record.
        steps
            How many samples ahead; the first ``steps`` rows are those of the free run.
        initial
            First states by name; None estimates them from so many first rows that these determine them (or takes the declared ones,
            with ``options.at_rest``).

        Returns
        -------
        dict
            Outputs by name (N,).

        Raises
        ------
        DataError
            For steps below one.
        """
        _check_steps(steps)
        (experiment,) = as_experiments(experiment, self.correction.model)
        if self.correction.model.noisy_states:
            names = [o.name for o in self.correction.model.outputs]
            cost = PredictionErrorObjective.of(self._prepare(experiment, initial))
            if initial is None:
                cost = estimate_initial_state(cost, self.options, FIRST_ROWS)
            return _name_outputs(names, cost.predict_ahead(steps)[0])
        free, colours = self.simulate(experiment, initial=initial), self.correction.colours
        # y(k|k-n) = free run + predicted error
        corrected = {
            n: y + colours[n].predict(experiment.outputs[n] - y, steps)
            for n, y in free.items()
            if n in colours and n in experiment.outputs
        }
        return free | corrected

    def simulate(self, experiment: Experiment | Frame, *, initial: InitialState | None = None) -> dict[str, np.ndarray]:
        """Outputs by name (N,) of the free run; ``initial`` as for `predict`."""
        (experiment,) = as_experiments(experiment, self.correction.model)
        names = [o.name for o in self.correction.model.outputs]
        for trace in self.known if initial is None else ():
            if trace.experiment.identity == experiment.identity and set(names) <= set(trace.simulated):
                return dict(trace.simulated)
        problem = self._prepare(experiment, initial)
        if initial is None and self.correction.model.noisy_states:
            likely = estimate_initial_state(PredictionErrorObjective.of(problem), self.options, FIRST_ROWS)
            return _name_outputs(names, problem.records[0].samples(likely.simulate()[0][0]))
        run, _ = problem.shooting().simulate(problem.variables.here)[0]
        return _name_outputs(names, problem.records[0].samples(run))

    def _prepare(self, experiment: Experiment, initial: InitialState | None) -> EstimationProblem:
        model = self.correction.model
        given = FixedParameterModel(model, self.correction.noise, self.options)
        filtered = bool(model.noisy_states)
        if initial is None:
            problem = _prepare_known(given, experiment, filtered=filtered)
            # A filter forgets how it began; a free run carries its start along.
            if not filtered and problem.variables.initial.free.any():
                problem = replace(problem, variables=determine_initial_states(problem, self.options)[0])
            return _refine(problem, self.options)
        states = model.system.state_names
        unknown = [n for n in initial if n not in states]
        if unknown:
            raise ModelError(f"model {model.title!r} has no state {unknown[0]!r}; {nearest(unknown[0], states)}")
        missing = [n for n in states if n not in initial]
        if missing:
            raise ModelError(f"initial: no value for {', '.join(missing)}; give every state, or None to estimate them")
        given = replace(given, options=replace(self.options, at_rest=False))
        problem = _prepare_known(given, experiment, filtered=filtered)
        # As a guess that nothing moves: the run begins where the caller says.
        begin = replace(problem.variables.initial, guess=np.array([[float(initial[n]) for n in states]]))
        return _refine(replace(problem, variables=replace(problem.variables, initial=begin)), self.options)


def predictor(
    model: Model | Fit,
    experiments: Experiment | Sequence[Experiment] = (),
    *,
    noise: Mapping[str, float] | NoiseModel | None = None,
    options: FitOptions | None = None,
) -> Predictor:
    """Make a model or a fit ready to predict any record some samples ahead.

    For a model with process noise it is the Kalman filter. Any other model is corrected as the records say
    (`greybox.estimation.predictor.identify_correction`); its parameters stay. Judge it on other records than those. With a model that
    lacks nothing there is nothing to correct, and the prediction is the free run.

    Parameters
    ----------
    model
        A model, or a fit.
    experiments
        Records that tell the correction; left out, those of the fit.
    noise
        Standard deviation by output in the model's units; None takes that of the fit, or finds the most likely one.
    options
        Discretisation and treatment of the first states; None takes those of the fit.

    Returns
    -------
    Predictor
        With ``predict`` and ``simulate``.

    Raises
    ------
    DataError
        If there are no records to tell the correction.

    Examples
    --------
    >>> predictor(fit).predict(other_record, steps=5)["x"]  # doctest: +SKIP
    """
    known = fix_parameters(model, noise, options)
    group = as_experiments(experiments, known.model)
    if isinstance(model, Fit):
        if model.model.noisy_states and noise is None and not group:
            frozen = model.model.fix(*model.model.values)
            correction = PredictionCorrection(
                frozen,
                model.noise.std,
                CorrectionKind.KALMAN_FILTER if frozen.noisy_states else CorrectionKind.NONE_ZERO,
            )
            return Predictor(correction, known.options)
        if not model.model.noisy_states and noise is None:
            # Noise that is not known independently is estimated together with the process noise.
            sources = model.noise.sources
            independent = {n: v for n, v in model.noise.std.items() if n in sources and sources[n].is_independent}
            known = replace(known, noise=independent)
        group = group or tuple(t.experiment for t in model.traces)
    if not group:
        raise DataError("predictor: no record to determine the correction from; give experiments, or a fit")
    runs = (*model.traces, *model.validation.traces) if isinstance(model, Fit) and options is None else ()
    return Predictor(identify_correction(known, group), known.options, runs)


def predict(
    model: Model | Fit | PredictingModel,
    experiment: Experiment | Frame,
    *,
    steps: int = 1,
    noise: Mapping[str, float] | NoiseModel | None = None,
    options: FitOptions | None = None,
) -> dict[str, np.ndarray]:
    """Predict the outputs of a record some samples ahead of the measurements.

    Several records, or several ``steps``, are cheaper through one `predictor`.

    Parameters
    ----------
    model
        A fit or a model, as `predictor` makes them ready (a model without process noise is corrected as ``experiment`` itself says: a few
        numbers are fitted to it, the parameters are not), or anything with a ``predict`` of its own, such as a black-box model.
    experiment
        The record.
    steps
        How many samples ahead.
    noise
        Standard deviation by output in the model's units; None takes that of the fit, or finds the most likely one.
    options
        Discretisation and treatment of the first states; None takes those of the fit.

    Returns
    -------
    dict
        Outputs by name (N,), each row predicted from the measurements up to ``steps`` rows before it.

    Raises
    ------
    DataError
        For steps below one.
    ModelError
        For something that cannot predict.

    Examples
    --------
    >>> predict(fit, record, steps=5)["x"]  # doctest: +SKIP
    """
    _check_steps(steps)
    if isinstance(model, Fit | Model):
        (experiment,) = as_experiments(experiment, model.model if isinstance(model, Fit) else model)
        records = () if isinstance(model, Fit) else experiment
        return predictor(model, records, noise=noise, options=options).predict(experiment, steps)
    if not hasattr(model, "predict"):
        raise ModelError(f"{model!r} cannot predict; give a Model, a Fit, or a model with a predict method")
    (record,) = as_records(experiment)  # type: ignore[arg-type]  # a table has no model here to be read for, which is said
    return dict(model.predict(record, steps=steps))


def _check_steps(steps: int) -> None:
    if steps < 1:
        raise DataError(f"steps ahead: {steps}; give a whole number from 1")


def _name_outputs(names: Sequence[str], y: np.ndarray) -> dict[str, np.ndarray]:
    return {name: y[:, j] for j, name in enumerate(names)}


# `smooth`: what the states were, given a whole record, with bands.


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
        # Normal: (1 + level) / 2 leaves half of the rest on either side.
        reach = float(ndtri((1 + level) / 2)) * self.std[state]
        return self.mean[state] - reach, self.mean[state] + reach


def smooth(
    model: Model | Fit,
    experiment: Experiment | Frame,
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
    (experiment,) = as_experiments(experiment, given.model)
    cost = estimate_initial_state(make_likelihood(given, experiment), given.options)
    pn, x0 = cost.start(0)
    smoothed = smooth_states(cost.kalman, cost.records[0], pn, x0, _make_prior_covariance(cost))
    record, names = cost.records[0], given.model.system.state_names
    # Differences of covariances may leave a variance below zero by rounding.
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


# Variance of the first states' prior for a smoother, over what the record says of them: all but a ten-thousandth of the smoothed variance
# is left to the record.
SMOOTHER_PRIOR = 10000.0


def _make_prior_covariance(cost: PredictionErrorObjective) -> np.ndarray | None:
    """A wide covariance (nx, nx) of the first states about their estimate; None where they are declared."""
    v = cost.variables
    free = v.free_states
    if not len(free):
        return None
    n = len(v.which)
    block = slice(n, n + len(free))
    # Half the Hessian of -2 log L is the information of the record on its first states.
    information = cost.evaluate(v.here).hessian[block, block] / 2
    scale = np.sqrt(
        np.maximum(np.diag(information), UNSEEN_INFORMATION * max(np.diag(information).max(initial=0.0), TINY))
    )
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    # Eigenvalues that the data do not see are raised: their variance is wide, but finite, as the smoother needs it.
    inverse = (vectors / np.maximum(values, UNSEEN_INFORMATION)) @ vectors.T / np.outer(scale, scale)
    covariance = np.zeros((len(v.initial.free), len(v.initial.free)))
    reach = v.initial.scale[free]
    covariance[np.ix_(free, free)] = SMOOTHER_PRIOR * inverse * np.outer(reach, reach)
    return covariance
