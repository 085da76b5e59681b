"""Free run and prediction side by side: how well a model does alone, and with the last measurements at hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.errors import DataError
from greybox.experiment import Experiment
from greybox.fitting import FitOptions, validate
from greybox.noise import AutoRegression, autoregression, segments
from greybox.result import Fit, Trace


@dataclass(frozen=True)
class Score:
    """Root mean square errors of one output in ``unit``: ``free_run``, and ``prediction`` by the number of samples ahead.

    ``movement`` is the standard deviation of the measurement itself; ``predictor`` the order of the residual's autoregression.
    """

    unit: str
    free_run: float
    prediction: Mapping[int, float]
    movement: float
    predictor: int


@dataclass(frozen=True)
class Scores:
    """Scores by output."""

    outputs: Mapping[str, Score]

    def __str__(self) -> str:
        ahead = sorted({k for s in self.outputs.values() for k in s.prediction})
        head = ["rmse", "free run", *(f"{k} step{'s' if k > 1 else ''} ahead" for k in ahead), "movement", "unit"]
        rows = [
            [name, *(f"{v:.4g}" for v in (s.free_run, *(s.prediction[k] for k in ahead), s.movement)), s.unit]
            for name, s in self.outputs.items()
        ]
        widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
        return "\n".join(
            "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in [head, *rows]
        )


def scores(
    fit: Fit,
    experiments: Experiment | Sequence[Experiment] = (),
    *,
    steps: Sequence[int] = (1, 10),
    skip: int = 0,
    options: FitOptions | None = None,
) -> Scores:
    """Free-run and ``steps``-ahead errors of ``fit`` on its own records, or on other ``experiments`` (judged as `validate` does).

    The prediction is the free run plus an autoregression's forecast of its error from the errors up to ``k`` samples before:
    ``yhat(t | t-k) = y_free(t) + rhat(t | t-k)``. That is the exact predictor of an output-error model with autoregressive noise, and
    needs no state estimate; order and coefficients come from the records of the fit, never from those being judged. It is not a
    Kalman filter: measurements do not correct the states, so a wrong initial state or a drifting state is only met as far as the
    autoregression carries it. The first ``skip`` rows of ``experiments`` are left out of the errors.

    Raises DataError for steps below one.
    """
    if any(k < 1 for k in steps):
        raise DataError(f"steps ahead: {', '.join(map(str, steps))}; give whole numbers from 1")
    group = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    judged: Sequence[Trace] = fit.traces
    if group:
        judged = validate(
            fit.model, group, noise=fit.noise, skip=skip, options=options or FitOptions(**fit.options)
        ).traces
    result = {}
    for output in fit.model.outputs:
        own = [t.residual(output.name) for t in fit.traces if output.name in t.measured]
        others = [t for t in judged if output.name in t.measured]
        if own and others:
            model = autoregression(segments(own))
            result[output.name] = _score(others, output.name, output.unit, model, steps, skip if group else 0)
    return Scores(result)


def _score(
    runs: Sequence[Trace], output: str, unit: str, model: AutoRegression, steps: Sequence[int], skip: int
) -> Score:
    residuals = [t.residual(output) for t in runs]
    ahead = {}
    for k in steps:
        ahead[k] = _rms(np.concatenate([(r - model.predict(r, k))[skip:] for r in residuals]))
    movement = float(np.nanstd(np.concatenate([t.measured[output][skip:] for t in runs])))
    return Score(unit, _rms(np.concatenate([r[skip:] for r in residuals])), ahead, movement, model.order)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
