"""`score`: how well a model follows records, running freely and some samples ahead of the measurements; for every kind of plant."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from greybox.base import DataError, Printable
from greybox.data.experiment import Experiment, as_records
from greybox.data.noise.noise_model import AutoRegression, fit_autoregression, join_series
from greybox.estimation.errors import OutputRun, OutputScore, PredictionsAhead
from greybox.estimation.options import FitOptions
from greybox.estimation.predictor import CorrectionKind, PredictingModel, PredictionCorrection, Predictor, predictor
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Trace
from greybox.estimation.validate import validate
from greybox.model import Model
from greybox.simulation.plant import Plant, PlantModel, as_model

Correction = Predictor | PredictionCorrection | None
"""What corrects a run at each sample: a predictor that runs by itself, or the colours of a free run's error; None: nothing."""


@dataclass(frozen=True)
class Scores(Printable):
    """Errors of free runs and of predictions.

    Attributes
    ----------
    outputs
        Errors of the free run and of predictions some samples ahead, by output.
    runs
        What they were computed from.
    """

    outputs: Mapping[str, OutputScore]
    runs: tuple[OutputRun, ...] = field(default=(), repr=False, compare=False)


def score(
    model: Fit | Model | Plant | PredictingModel,
    experiments: Experiment | Sequence[Experiment] = (),
    *,
    steps: Sequence[int] = (1, 10),
    skip: int = 0,
    initial_rows: int = 0,
    options: FitOptions | None = None,
) -> Scores:
    """Root mean square errors of the free run and of predictions some samples ahead.

    What corrects a fit from sample to sample comes from its own records and never from those being judged; of a model that was not
    fitted it comes from ``experiments`` (`greybox.estimation.predictor`). A plant without equations is corrected by the autoregression
    of the error of its fit. The free run of a record that the fit was made of or validated on is the one that the fit has; other
    records are run as by `greybox.validate`.

    Parameters
    ----------
    model
        A fit, a model, a plant, a `Predictor`, or anything with ``simulate(experiment)`` and ``predict(experiment, steps)``, such as a
        black-box model.
    experiments
        The records to judge by; of a fit its own where none are given.
    steps
        Numbers of samples ahead.
    skip
        First rows of each record that are left out of the errors. Of a prediction ``k`` samples ahead the first ``k`` are left out,
        too: they have no measurement to go by.
    initial_rows
        Rows from which the initial state of a record is estimated; 0: as many as determine it.
    options
        How a model that was not fitted is run, with the initial state at rest or estimated; None takes those of the fit.

    Returns
    -------
    Scores
        One `OutputScore` for each measured output, in its unit.

    Raises
    ------
    DataError
        For steps below one or beyond every record, and where there is no record.
    ModelError
        For predictions of a plant without equations that was not fitted.

    Examples
    --------
    >>> score(fit, validation, steps=(1, 10)).outputs["x"].rmse  # doctest: +SKIP
    """
    group = as_records(experiments)
    judged = [t.experiment for t in model.traces] if isinstance(model, Fit) and not group else list(group)
    if not judged:
        raise DataError("scores: no record; give experiments, or a fit, which has its own")
    check_steps_ahead(steps, judged)
    if isinstance(model, PredictingModel):
        runs = [run for e in judged for run in run_by_itself(model, e, steps, skip)]
        if isinstance(model, Predictor):
            return _gather(runs, str(model.correction), model.correction.model)
        return _gather(runs, "its own noise model", units=getattr(model, "units", {}))
    correction = _correct(model, () if isinstance(model, Fit) else group, steps, options)
    known = () if not isinstance(model, Fit) else model.validation.traces if group else model.traces
    runs = run_model(model, judged, steps, correction, known, skip=skip, initial_rows=initial_rows, options=options)
    return _gather(runs, _name_correction(correction), as_model(model))


def score_fit(
    fit: Fit, validation: Sequence[Experiment] = (), *, steps: Sequence[int] = (1, 10), skip: int = 0
) -> tuple[Scores, Scores | None]:
    """`score` of a fit on its own records and on those for validation: what corrects it, which takes long, is determined once.

    ``skip``: first rows of each record for validation that are left out; of the fit's own none are.
    """
    correction = _correct(fit, (), steps, None)
    scores: list[Scores] = []
    for judged, known, uncounted in (
        ([t.experiment for t in fit.traces], fit.traces, 0),
        (list(validation), fit.validation.traces, skip),
    ):
        if judged:
            check_steps_ahead(steps, judged)
            runs = run_model(fit, judged, steps, correction, known, skip=uncounted)
            scores.append(_gather(runs, _name_correction(correction), as_model(fit)))
    return scores[0], scores[1] if validation else None


def _correct(
    model: Fit | Model | Plant, learnt_from: Sequence[Experiment], steps: Sequence[int], options: FitOptions | None
) -> Correction:
    """What corrects a model from sample to sample: of a fit as its own records tell, of a model as ``learnt_from`` tells."""
    stated = as_model(model)
    if isinstance(model, Fit) and isinstance(stated, PlantModel):
        return colour_correction(model)
    return predictor(model if isinstance(model, Fit) else stated, learnt_from, options=options) if steps else None


def _name_correction(correction: Correction) -> str:
    if correction is None:
        return "its own noise model"
    return str(correction.correction if isinstance(correction, Predictor) else correction)


def _gather(
    runs: Sequence[OutputRun], by: str, stated: Model | None = None, units: Mapping[str, str] | None = None
) -> Scores:
    """The scores of runs that were corrected ``by`` something; units are those of the outputs of ``stated``, where there is a model."""
    names = {o.name: o.unit for o in stated.outputs} if stated is not None else units or {}
    by_output = {name: [r for r in runs if r.output == name] for name in dict.fromkeys(r.output for r in runs)}
    scores = {name: OutputScore.of(each, names.get(name, ""), by) for name, each in by_output.items()}
    return Scores({name: s for name, s in scores.items() if s.samples}, tuple(runs))


def colour_correction(fit: Fit) -> PredictionCorrection:
    """The autoregression of the error of each output on the estimation records: it forecasts the error of a run, which stays as it is."""
    names = dict.fromkeys(name for trace in fit.traces for name in trace.measured)
    policy = FitOptions.from_data(fit.provenance.options).policy.noise
    colours = {
        n: fit_autoregression(
            join_series(t.residual(n) for t in fit.traces if n in t.measured), overwrite_input=True, policy=policy
        )
        for n in names
    }
    return PredictionCorrection(fit.model, fit.noise.std, CorrectionKind.AUTOREGRESSION, colours)


def run_model(
    model: Fit | Model | Plant,
    experiments: Sequence[Experiment],
    steps: Sequence[int] = (),
    correction: Correction = None,
    known: Sequence[Trace] = (),
    *,
    skip: int = 0,
    initial_rows: int = 0,
    options: FitOptions | None = None,
) -> list[OutputRun]:
    """Free run of a fit, a model or a plant over each record, and its predictions.

    Parameters
    ----------
    model
        Its constants are kept.
    experiments
        The records.
    steps, correction
        How many samples ahead is predicted, and by what; without a correction a prediction is the free run.
    known
        Runs that are known already; other records are run as by `greybox.validate`.
    skip, initial_rows, options
        As of `greybox.validate`.
    """
    # By the content of the record, not its name: one that the fit knows keeps the initial state of that fit.
    traces = {trace.fingerprint: trace for trace in known}
    others = [e for e in experiments if e.fingerprint not in traces]
    if others:
        noise = None
        if isinstance(model, Fit):
            noise, options = model.noise.std, options or FitOptions.from_data(model.provenance.options)
        run = validate(as_model(model), others, noise=noise, skip=skip, initial_rows=initial_rows, options=options)
        traces |= {e.fingerprint: trace for e, trace in zip(others, run.traces, strict=True)}
    runs = []
    for e in experiments:
        trace = traces[e.fingerprint]
        by_filter: dict[int, dict[str, np.ndarray]] = {}
        by_states = isinstance(correction, Predictor) and bool(correction.correction.model.noisy_states)
        if isinstance(correction, Predictor) and by_states:
            by_filter = {k: correction.predict(e, k, initial=trace.initial_state) for k in steps}
        for name, y in trace.measured.items():
            if by_states:
                ahead = PredictionsAhead(tuple(steps), {k: by_filter[k][name] for k in steps}.__getitem__)
            else:
                stated = correction.correction if isinstance(correction, Predictor) else correction
                colour = stated.colours.get(name) if stated else None
                ahead = PredictionsAhead(tuple(steps), partial(_predict_by_colour, trace, name, colour))
            runs.append(OutputRun(e.name, name, trace.time, y, trace.simulated[name], skip, ahead))
    return runs


def _predict_by_colour(trace: Trace, output: str, colour: AutoRegression | None, steps: int) -> np.ndarray:
    """``y(k|k-n)`` = free run + predicted error; of white error nothing is predicted."""
    if not colour:
        return trace.simulated[output]
    return trace.simulated[output] + colour.predict(trace.residual(output), steps)


def run_by_itself(
    model: PredictingModel, experiment: Experiment, steps: Sequence[int] = (), skip: int = 0, **begin: Any
) -> list[OutputRun]:
    """Free run and predictions of what has both by itself, with its own words on how a record ``begin`` s."""
    free = model.simulate(experiment, **begin)
    ahead = {k: model.predict(experiment, steps=k, **begin) for k in steps}
    return [
        OutputRun(
            experiment.name,
            name,
            experiment.time,
            experiment.outputs[name],
            run,
            skip,
            PredictionsAhead(tuple(steps), {k: each[name] for k, each in ahead.items()}.__getitem__),
        )
        for name, run in free.items()
        if name in experiment.outputs
    ]


def check_steps_ahead(steps: Iterable[int], records: Sequence[Experiment]) -> None:
    """Refuse predictions of less than one sample, and of so many that not one of ``records`` has a sample to compare with."""
    wanted, longest = list(steps), max((e.rows for e in records), default=0)
    if any(k < 1 for k in wanted):
        raise DataError(f"steps ahead: {', '.join(map(str, wanted))}; give whole numbers from 1")
    if longest and any(k >= longest for k in wanted):
        raise DataError(
            f"steps ahead: {max(wanted)}, but the longest record has {longest} rows, and the first {max(wanted)} of a record have no"
            " measurement to predict from; give fewer"
        )
