"""Free run and prediction side by side: the errors of a model without and with past measurements."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.errors import DataError
from greybox.estimation import FitOptions, Predictor, predictor
from greybox.experiment import Experiment
from greybox.model import Model
from greybox.result import Fit, Trace
from greybox.values import Printable


@dataclass(frozen=True)
class OutputScore:
    """Root mean square errors of one output in ``unit``: ``free_run``, and ``prediction`` by the number of samples ahead.

    ``movement`` is the standard deviation of the measurement itself; ``predictor`` says what corrects the model at each sample.
    """

    unit: str
    free_run: float
    prediction: Mapping[int, float]
    movement: float
    predictor: str


@dataclass(frozen=True)
class PredictionScores(Printable):
    """Scores by output."""

    outputs: Mapping[str, OutputScore]


def score(
    model: Fit | Model | Predictor,
    experiments: Experiment | Sequence[Experiment] = (),
    *,
    steps: Sequence[int] = (1, 10),
    skip: int = 0,
    options: FitOptions | None = None,
) -> PredictionScores:
    """Root mean square errors of the free run and of predictions some samples ahead.

    What corrects a fit from sample to sample comes from its own records and never from those being judged; of a model that was not
    fitted it comes from ``experiments`` (`greybox.estimation.predictor`). The first states of other records than the fit's own are
    estimated from their first rows.

    Parameters
    ----------
    model
        A fit, a model, a `Predictor`, or anything with ``simulate(experiment)`` and ``predict(experiment, steps)``, such as a
        black-box model.
    experiments
        The records to judge by; of a fit its own where none are given.
    steps
        Numbers of samples ahead.
    skip
        First rows of each record that are left out of the errors. Of a prediction ``k`` samples ahead the first ``k`` are left out,
        too: they have no measurement to go by.
    options
        Options of the predictor of a model that was not fitted.

    Returns
    -------
    PredictionScores
        One `OutputScore` for each measured output, in its unit.

    Raises
    ------
    DataError
        For steps below one or beyond every record, and where there is no record.

    Examples
    --------
    >>> score(fit, validation, steps=(1, 10)).outputs["x"].free_run  # doctest: +SKIP
    """
    group = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    judged = [t.experiment for t in model.traces] if isinstance(model, Fit) and not group else list(group)
    if not judged:
        raise DataError("scores: no record; give experiments, or a fit, which has its own")
    check_steps_ahead(steps, judged)
    ready = (
        predictor(model, () if isinstance(model, Fit) else group, options=options)
        if isinstance(model, Fit | Model)
        else model
    )
    traces = model.traces if isinstance(model, Fit) and not group else [None] * len(judged)
    runs = [_run_record(ready, e, steps, trace) for e, trace in zip(judged, traces, strict=True)]
    correction = str(ready.correction) if isinstance(ready, Predictor) else "its own noise model"
    units = {o.name: o.unit for o in model.model.outputs} if isinstance(model, Fit) else _units(ready)
    outputs = {}
    for name in dict.fromkeys(n for free, _ in runs for n in free):
        pairs = [
            (e.outputs[name], *run) for e, run in zip(judged, runs, strict=True) if name in e.outputs and name in run[0]
        ]
        measured = np.concatenate([y[skip:] for y, _, _ in pairs] or [np.zeros(0)])
        if np.isfinite(measured).any():
            outputs[name] = OutputScore(
                units.get(name, ""),
                _compute_rms([(y, free[name]) for y, free, _ in pairs], skip),
                {k: _compute_rms([(y, ahead[k][name]) for y, _, ahead in pairs], max(skip, k)) for k in steps},
                float(np.nanstd(measured)),
                correction,
            )
    return PredictionScores(outputs)


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


def _run_record(
    model: Predictor, experiment: Experiment, steps: Sequence[int], trace: Trace | None
) -> tuple[Mapping[str, np.ndarray], dict[int, Mapping[str, np.ndarray]]]:
    """Free run and predictions of one record by output; ``trace``: the free run of a record of the fit, whose first states are known."""
    if trace is None:
        return model.simulate(experiment), {k: model.predict(experiment, steps=k) for k in steps}
    return trace.simulated, {k: model.predict(experiment, steps=k, initial=trace.initial_state) for k in steps}


def _units(model: Predictor) -> dict[str, str]:
    if isinstance(model, Predictor):
        return {o.name: o.unit for o in model.correction.model.outputs}
    return dict(getattr(model, "units", {}))


def _compute_rms(pairs: Sequence[tuple[np.ndarray, np.ndarray]], skip: int) -> float:
    """Root mean square difference of measured and computed values (N,) without the first ``skip`` rows of each record.

    Gaps are left out; NaN where nothing was measured, infinite where what was computed overflows.
    """
    measured, computed = (np.concatenate([pair[k][skip:] for pair in pairs]) for k in (0, 1))
    is_measured = np.isfinite(measured)
    if not is_measured.any():
        return float("nan")
    with np.errstate(over="ignore", invalid="ignore"):
        error = (measured - computed)[is_measured]
        if not np.isfinite(error).all():
            return float("inf")
        square = np.mean(error**2)
    if np.isfinite(square):
        return float(np.sqrt(square))
    largest = float(np.abs(error).max())
    return largest * float(np.sqrt(np.mean((error / largest) ** 2)))
