"""Models side by side in pictures: their runs over each record, their errors, and who is best."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from greybox.comparison import Comparison, ComparisonEntry, ComparisonRun
from greybox.plots.files import save_figure
from greybox.plots.thinning import min_max_envelope
from greybox.plots.units import axis_label, scale_to_prefix

MEASURED = "#b0b0b0"
# Grey boxes in warm colours, black boxes in cold and dark ones
GREY = ("#c0392b", "#e67e22", "#b7950b", "#8e44ad")
BLACK = ("#1f5a8a", "#16a085", "#5d6d7e", "#2e86c1", "#1e8449", "#17202a", "#76448a")
ZOOM_ROWS = 200
DECADE = 10.0  # ratio of the largest to the smallest error, from which bars have a logarithmic axis
BEYOND = 1e100  # size from which a run is no longer drawn
FAR = 2.0  # ranges of the measured signal, beyond which a run is cut off


def comparison_figure(comparison: Comparison, directory: str | Path) -> list[Path]:
    """Draw each validation record (each training record where there is no other) as ``comparison-<record>.png``, with an SVG beside it.

    For each output: measured and every model's free run around its liveliest stretch, the free-run errors over the whole record, and
    bars of the free-run and the one-step error, best first. Returns the files.
    """
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    for record in dict.fromkeys(comparison.validation or comparison.training):
        file = folder / f"comparison-{re.sub(r'[^A-Za-z0-9_.-]+', '_', record)}.png"
        if file in files:
            file = file.with_stem(f"{file.stem}-{len(files) + 1}")
        save_figure(_draw(comparison, record), file)
        files.append(file)
    return files


def _runs(comparison: Comparison, entry: ComparisonEntry, record: str, output: str) -> ComparisonRun | None:
    group = entry.validation_runs if comparison.validation else entry.training_runs
    return next((r for r in group if (r.record, r.output) == (record, output)), None)


def _draw(comparison: Comparison, record: str) -> Figure:
    outputs = [
        name for name in comparison.outputs if any(_runs(comparison, e, record, name) for e in comparison.entries)
    ]
    figure = Figure(figsize=(12, 0.8 + 4.2 * len(outputs)), layout="constrained")
    FigureCanvasAgg(figure)
    where = "validation record" if comparison.validation else "fitted record"
    figure.suptitle(f"{where} {record}: free run of every model", fontsize=11)
    grid = figure.add_gridspec(2 * len(outputs), 2, height_ratios=[1.6, 1] * len(outputs), width_ratios=[2.1, 1])
    colours = _colours(comparison.entries)
    for k, output in enumerate(outputs):
        found = {e.name: _runs(comparison, e, record, output) for e in comparison.entries}
        runs = {name: run for name, run in found.items() if run is not None}
        top, bottom = (figure.add_subplot(grid[2 * k + row, 0]) for row in (0, 1))
        _output(top, bottom, output, comparison.outputs[output], runs, colours)
        _bars(figure.add_subplot(grid[2 * k : 2 * k + 2, 1]), comparison, record, output, colours)
    return figure


def _output(
    top: Axes, bottom: Axes, output: str, unit: str, runs: dict[str, ComparisonRun], colours: dict[str, str]
) -> None:
    some = next(iter(runs.values()))
    factor, text = scale_to_prefix(unit, some.measured)
    free = {name: _drawable(run.simulated) for name, run in runs.items()}
    errors = [run.measured - free[name] for name, run in runs.items()]
    small, small_text = scale_to_prefix(unit, np.array([_typical(e) for e in errors]))
    start, stop = _liveliest(some)
    inside = (some.time >= start) & (some.time <= stop)
    top.plot(some.time[inside], factor * some.measured[inside], color=MEASURED, lw=3.0, label="measured")
    for name, run in reversed(runs.items()):  # the first, as a rule the grey box, on top
        rows = (run.time >= start) & (run.time <= stop)
        top.plot(run.time[rows], factor * free[name][rows], color=colours[name], lw=1.0)
        bottom.plot(
            *min_max_envelope(run.time, small * (run.measured - free[name])), color=colours[name], lw=0.6, alpha=0.8
        )
    low, high = np.nanmin(factor * some.measured), np.nanmax(factor * some.measured)
    reach = FAR * (high - low) or 1.0
    bounds = np.clip(top.get_ylim(), low - reach, high + reach)
    top.set_ylim(*bounds)
    most = 4 * small * max(_typical(e) for e in errors if np.isfinite(_typical(e)))
    bottom.set_ylim(-most or -1.0, most or 1.0)
    top.set_ylabel(axis_label(output, text))
    bottom.set_ylabel(axis_label("error", small_text), fontsize=9)
    bottom.set_xlabel("time [s]")
    closer = "closer look where it moves most; " if stop - start < some.time[-1] - some.time[0] else ""
    top.set_title(f"{closer}measured in light grey", loc="left", fontsize=9)
    for axis in (top, bottom):
        axis.grid(alpha=0.25, lw=0.5)
        axis.margins(x=0.01)
        axis.tick_params(labelsize=8)


def _bars(axis: Axes, comparison: Comparison, record: str, output: str, colours: dict[str, str]) -> None:
    """Free-run error as a bar and one-step error as a mark, best at the top; on a logarithmic axis where they lie far apart."""
    scores = {e.name: e.records[record][output] for e in comparison.entries if output in e.records.get(record, {})}
    ranked = sorted(scores, key=lambda name: -scores[name].rmse if np.isfinite(scores[name].rmse) else -np.inf)
    factor, text = scale_to_prefix(comparison.outputs[output], np.array([_finite(s.rmse) for s in scores.values()]))
    for row, name in enumerate(ranked):
        s = scores[name]
        axis.barh(row, factor * _finite(s.rmse), color=colours[name], height=0.6)
        axis.plot(
            [factor * _finite(s.one_step_rmse)], [row], marker="D", ms=5, mfc="white", mec=colours[name], ls="none"
        )
        end = factor * np.nanmax([_finite(s.rmse), _finite(s.one_step_rmse), 0.0])
        said = f" {s.best_fit_percent:.1f} %" if np.isfinite(s.rmse) else " grows away"
        axis.annotate(said, (end, row), va="center", fontsize=8)
    errors = [factor * e for s in scores.values() for e in (s.rmse, s.one_step_rmse) if np.isfinite(_finite(e))]
    low, high = min(errors, default=1.0), max(errors, default=1.0)
    if high > DECADE * low:
        axis.set_xscale("log")
        axis.set_xlim(low / 2, high * (2 * high / low) ** 0.25)
    else:
        axis.set_xlim(0, 1.3 * high)
    axis.set_yticks(range(len(ranked)), [f"{name} ({comparison[name].parameters})" for name in ranked], fontsize=8)
    axis.set_xlabel(axis_label("rms error", text), fontsize=9)
    axis.set_title("bar: free run, with best fit; diamond: one sample ahead", loc="right", fontsize=8)
    axis.tick_params(axis="x", labelsize=8)
    axis.grid(axis="x", alpha=0.25, lw=0.5)


def _colours(entries: Sequence[ComparisonEntry]) -> dict[str, str]:
    found, used = {}, {"grey": 0, "black": 0}
    for entry in entries:
        palette = GREY if entry.kind == "grey" else BLACK
        found[entry.name] = palette[used[entry.kind] % len(palette)]
        used[entry.kind] += 1
    return found


def _drawable(values: np.ndarray) -> np.ndarray:
    """``values`` (N,) with NaN where a run has left all bounds."""
    return np.where(np.abs(values) < BEYOND, values, np.nan)


def _typical(error: np.ndarray) -> float:
    """Root mean square of the finite errors; NaN where there are none."""
    known = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan


def _finite(value: float) -> float:
    return value if np.isfinite(value) and value > 0 else np.nan


def _liveliest(run: ComparisonRun) -> tuple[float, float]:
    """Times of the `ZOOM_ROWS` rows around the largest deviation from the mean; the whole record where it is short."""
    if len(run.time) <= 2 * ZOOM_ROWS:
        return float(run.time[0]), float(run.time[-1])
    middle = int(np.nanargmax(np.abs(run.measured - np.nanmean(run.measured))))
    first = min(max(0, middle - ZOOM_ROWS // 2), len(run.time) - ZOOM_ROWS)
    return float(run.time[first]), float(run.time[first + ZOOM_ROWS - 1])
