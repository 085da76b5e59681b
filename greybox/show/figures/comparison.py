"""Models side by side in figures: their errors, their runs over each record, and the errors of these."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from greybox.base.figure import MODELS, Axis, Curve, Figure, Height, Panel, Points, Role, Scale, Symbol
from greybox.comparison.result import Comparison, ComparisonEntry, ComparisonScore
from greybox.estimation.errors import OutputRun
from greybox.show.figures.figure import draw_over_time, draw_sizes, root_mean_square, scale_to_prefix, size_axis
from greybox.show.figures.records import TIME
from greybox.show.sentences.wording import capitalise, record_text, value_with_unit


def model_roles(entries: Sequence[ComparisonEntry]) -> dict[str, Role]:
    """A role for each model: grey boxes first."""
    ordered = sorted(entries, key=lambda e: e.kind != "grey")
    return {e.name: MODELS[k % len(MODELS)] for k, e in enumerate(ordered)}


# Size of a hollow mark for a second size: a filled one stands inside it where both are equal.
MARK_BESIDE_SIZE = 17.0
# Size of a hollow mark for a second size, on a bar.
MARK_ON_BAR = 9.0


def plot_model_errors(comparison: Comparison, record: str | None = None) -> Figure:
    """Free-run error of each model, best on top, and its error one sample ahead; a panel for each output.

    On all judging records, or on one ``record``.
    """
    roles, panels, description = model_roles(comparison.standing), [], []
    for output, unit in comparison.outputs.items():
        scores = {e.name: s for e in comparison.standing if (s := _score(comparison, e, output, record)) is not None}
        factor, text = scale_to_prefix(unit, np.array([_usable(s.rmse) for s in scores.values()] or [np.nan]))
        ranked = sorted(scores, key=lambda name: scores[name].rmse if np.isfinite(scores[name].rmse) else np.inf)
        free_run = np.array([factor * _usable(scores[name].rmse) for name in ranked])
        one_step = np.array([factor * _usable(scores[name].one_step_rmse) for name in ranked])
        fits = [
            f"{s.best_fit_percent:.1f} %" if np.isfinite(s.rmse) else "diverges" for s in (scores[n] for n in ranked)
        ]
        # A text stands behind the bar, or behind the mark where that lies further out.
        beyond = one_step > free_run
        behind_bars, behind_marks = (
            ["" if is_beyond is hidden else text for text, is_beyond in zip(fits, beyond.tolist(), strict=True)]
            for hidden in (True, False)
        )
        x = size_axis(f"rms error of {output}", text, np.concatenate([free_run, one_step]))
        sizes = draw_sizes(ranked, free_run, [roles[n] for n in ranked], x, "free run", behind_bars)
        is_on_log = x.scale is Scale.LOG
        ahead = Points(
            one_step,
            ranked,
            Role.REFERENCE,
            "one sample ahead",
            size=MARK_BESIDE_SIZE if is_on_log else MARK_ON_BAR,
            symbol=Symbol.DIAMOND,
            texts=behind_marks if beyond.any() else (),
            hollow=True,
        )
        # On a bar in front of it; around a point behind it.
        series = (ahead, *sizes) if is_on_log else (*sizes, ahead)
        panels.append(Panel(output, series, x, Axis(scale=Scale.CATEGORY, reversed=True), height=Height.PER_CATEGORY))
        errors = dict(zip(ranked, free_run.tolist(), strict=True))
        description.append(f"{output}, free run, best first: {_model_list(errors, text)}")
    return Figure(
        "errors",
        tuple(panels),
        "Rms error of the free run (filled, with the best fit in percent) and one sample ahead (hollow): smaller is better.",
        tuple(description),
    )


def plot_model_runs(comparison: Comparison, record: str, name: str) -> Figure:
    """Measured outputs and the free run of every model over one record, a panel for each output."""
    roles, panels = model_roles(comparison.standing), []
    sizes: dict[str, dict[str, float]] = {}
    for output, runs in _runs_by_output(comparison, record).items():
        first = next(iter(runs.values()))
        factor, unit = scale_to_prefix(comparison.outputs[output], first.measured)
        measured = draw_over_time(first.time, first.measured, Role.MEASURED, "measured", 3.0, factor=factor)
        sizes[output] = {}
        curves: list[Curve] = []
        for n, run in runs.items():
            simulated = run.simulated  # made anew whenever it is asked for
            sizes[output][n] = _error_size(run.measured, simulated)
            curve = draw_over_time(run.time, _cut(simulated, run.measured), roles[n], n, 1.4, factor=factor)
            curves.insert(0, curve)  # the first, as a rule the grey box, on top
        panels.append(
            Panel(
                output, (measured, *curves), TIME, Axis(output, unit), height=Height.TALL, listing=("measured", *runs)
            )
        )
    return Figure(
        name,
        tuple(panels),
        f"{capitalise(record_text(record))}: measured outputs and the free run of every model.",
        _error_sizes(comparison, sizes),
    )


# An axis of errors ends at so many times the largest root mean square: one model that grows away hides no other.
TYPICAL_ERRORS = 4.0


def plot_model_residuals(comparison: Comparison, record: str, name: str) -> Figure:
    """Measured minus simulated of every model over one record, a panel for each output."""
    roles, panels = model_roles(comparison.standing), []
    sizes: dict[str, dict[str, float]] = {}
    for output, runs in _runs_by_output(comparison, record).items():
        sizes[output] = {n: _error_size(run.measured, run.simulated) for n, run in runs.items()}
        typical = np.array(list(sizes[output].values()))
        factor, unit = scale_to_prefix(comparison.outputs[output], typical)
        curves = [
            draw_over_time(run.time, _cut(run.measured - run.simulated, run.measured), roles[n], n, 1.0, factor=factor)
            for n, run in reversed(runs.items())
        ]
        reach = TYPICAL_ERRORS * factor * max(typical[np.isfinite(typical)], default=1.0) or 1.0
        axis = Axis(f"error of {output}", unit, limits=(-reach, reach))
        panels.append(Panel(output, tuple(curves), TIME, axis, listing=tuple(runs)))
    return Figure(
        name,
        tuple(panels),
        f"{capitalise(record_text(record))}: measured minus simulated.",
        _error_sizes(comparison, sizes),
    )


def judging_records(comparison: Comparison) -> list[str]:
    """Names of the validation records, of the fitted ones where there are no others."""
    return list(dict.fromkeys(comparison.validation or comparison.training))


def _score(comparison: Comparison, entry: ComparisonEntry, output: str, record: str | None) -> ComparisonScore | None:
    return comparison.deciding_scores(entry).get(output) if record is None else entry.score(output, record=record)


def _runs_by_output(comparison: Comparison, record: str) -> dict[str, dict[str, OutputRun]]:
    """Output -> model -> its run over the judging record, where there is one."""
    runs: dict[str, dict[str, OutputRun]] = {output: {} for output in comparison.outputs}
    for entry in comparison.standing:
        for run in entry.validation_runs if comparison.validation else entry.training_runs:
            if run.record == record and run.output not in entry.failed_outputs:
                runs[run.output][entry.name] = run
    return {output: by_model for output, by_model in runs.items() if by_model}


def _model_list(errors: Mapping[str, float], unit: str) -> str:
    return ", ".join(
        f"{name} {value_with_unit(error, unit)}" if math.isfinite(error) else f"{name} diverges"
        for name, error in errors.items()
    )


def _error_sizes(comparison: Comparison, sizes: Mapping[str, Mapping[str, float]]) -> tuple[str, ...]:
    """Output -> model -> size of its error, in words."""
    description = []
    for output, by_model in sizes.items():
        factor, unit = scale_to_prefix(comparison.outputs[output], np.array(list(by_model.values())))
        errors = {n: factor * size for n, size in by_model.items()}
        description.append(f"Rms error of {output}: {_model_list(errors, unit)}")
    return tuple(description)


# From this size on a run has no error worth a number.
DRAWING_OVERFLOW = 1e100


def _error_size(measured: np.ndarray, simulated: np.ndarray) -> float:
    """Root mean square error; NaN where the run leaves all bounds."""
    if not (simulated.max() < DRAWING_OVERFLOW and simulated.min() > -DRAWING_OVERFLOW):
        return np.nan
    return _usable(root_mean_square(measured - simulated))


# A run is cut where it lies further from the measured signal than so many times that signal's range.
RANGES_FROM_MEASURED = 2.0


def _cut(values: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """A run (N,) without what lies far outside the measured signal."""
    low, high = np.nanmin(measured), np.nanmax(measured)
    reach = RANGES_FROM_MEASURED * (high - low) or 1.0
    inside = np.isfinite(values) & (values > low - reach) & (values < high + reach)
    return np.where(inside, values, np.nan)


def _usable(error: float) -> float:
    """An error that can be drawn: NaN where a run left all bounds, and where it is exact."""
    return error if np.isfinite(error) and 0 < error < DRAWING_OVERFLOW else np.nan
