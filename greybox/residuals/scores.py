"""Free run and prediction side by side: how well a model does alone, and with the last measurements at hand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.errors import DataError
from greybox.estimation import FitOptions, Predictor, predictor
from greybox.experiment import Experiment
from greybox.model import Model
from greybox.result import Fit, Trace


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
class PredictionScores:
    """Scores by output."""

    outputs: Mapping[str, OutputScore]

    def __str__(self) -> str:
        ahead = sorted({k for s in self.outputs.values() for k in s.prediction})
        head = ["rmse", "free run", *(f"{k} step{'s' if k > 1 else ''} ahead" for k in ahead), "movement", "unit"]
        rows = [
            [name, *(f"{v:.4g}" for v in (s.free_run, *(s.prediction[k] for k in ahead), s.movement)), s.unit]
            for name, s in self.outputs.items()
        ]
        widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
        lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in [head, *rows]]
        return "\n".join(
            [*lines, *(f"corrected by: {text}" for text in dict.fromkeys(s.predictor for s in self.outputs.values()))]
        )


def score(
    model: Fit | Model | Predictor,
    experiments: Experiment | Sequence[Experiment] = (),
    *,
    steps: Sequence[int] = (1, 10),
    skip: int = 0,
    options: FitOptions | None = None,
) -> PredictionScores:
    """Free-run and ``steps``-ahead errors of ``model`` on ``experiments``; of a fit on its own records where none are given.

    ``model``: a fit, a model, a `Predictor`, or anything with ``simulate(experiment)`` and ``predict(experiment, steps)``, such as a
    black-box model. What corrects a fit from sample to sample comes from its own records and never from those being judged; of a
    model that was not fitted it comes from ``experiments`` (`greybox.estimation.predictor`). The first states of other records than the
    fit's own are estimated from their first rows. Left out of the errors are the first ``skip`` rows, and of a prediction ``k`` samples
    ahead the first ``k``, which have no measurement to go by.

    Raises DataError for steps below one or beyond every record, and where there is no record.
    """
    group = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    judged = [t.experiment for t in model.traces] if isinstance(model, Fit) and not group else list(group)
    if not judged:
        raise DataError("scores: no record to judge by; give experiments, or a fit, which has its own")
    check_steps_ahead(steps, judged)
    ready = (
        predictor(model, () if isinstance(model, Fit) else group, options=options)
        if isinstance(model, Fit | Model)
        else model
    )
    traces = model.traces if isinstance(model, Fit) and not group else [None] * len(judged)
    runs = [_runs(ready, e, steps, trace) for e, trace in zip(judged, traces, strict=True)]
    words = ready.correction.words if isinstance(ready, Predictor) else "its own noise model"
    units = {o.name: o.unit for o in model.model.outputs} if isinstance(model, Fit) else _units(ready)
    result = {}
    for name in dict.fromkeys(n for free, _ in runs for n in free):
        seen = [
            (e.outputs[name], *run) for e, run in zip(judged, runs, strict=True) if name in e.outputs and name in run[0]
        ]
        measured = np.concatenate([y[skip:] for y, _, _ in seen] or [np.zeros(0)])
        if np.isfinite(measured).any():
            result[name] = OutputScore(
                units.get(name, ""), _rms([(y - free[name])[skip:] for y, free, _ in seen]),
                {k: _rms([(y - ahead[k][name])[max(skip, k) :] for y, _, ahead in seen]) for k in steps},
                float(np.nanstd(measured)), words,
            )  # fmt: skip
    return PredictionScores(result)


def check_steps_ahead(steps: Iterable[int], records: Sequence[Experiment]) -> None:
    """Refuse predictions of less than one sample, and of so many that not one of ``records`` has a sample to compare with."""
    wanted, longest = list(steps), max((e.rows for e in records), default=0)
    if any(k < 1 for k in wanted):
        raise DataError(f"steps ahead: {', '.join(map(str, wanted))}; give whole numbers from 1")
    if longest and any(k >= longest for k in wanted):
        raise DataError(
            f"steps ahead: {max(wanted)}, but the longest record has {longest} rows, and the first {max(wanted)} of a record have no"
            " measurement to go by; give fewer"
        )


def _runs(
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


def _rms(parts: Sequence[np.ndarray]) -> float:
    """Root mean square over several records (N,), gaps left out; NaN where nothing is left."""
    values = np.concatenate(parts)
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")
