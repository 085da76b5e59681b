"""A fit in pictures: measured and simulated output with the residual below, one file for each record."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from greybox.estimation.traces import compute_misfit
from greybox.plots.files import save_figure
from greybox.plots.thinning import min_max_envelope
from greybox.plots.units import axis_label, scale_to_prefix
from greybox.result import Fit, Misfit, Trace

MEASURED, SIMULATED, RESIDUAL, BAND = "#9a9a9a", "#c0392b", "#1f5a8a", "#dcdcdc"
ZOOM_ROWS = 200  # rows of the closer look


def fit_figure(fit: Fit, directory: str | Path, *, skip: int = 0) -> list[Path]:
    """Draw each record of ``fit`` into ``directory`` as PNG, ``fit-<record>.png`` and ``validation-<record>.png``, with SVGs beside.

    For each output: measured and simulated over the whole record, a closer look at its liveliest stretch, and below
    both the residual (measured minus simulated) with a band of two standard deviations of the noise, where that is
    known. The title has the record's own misfit, for validation records without their first ``skip`` rows. Returns the
    PNG files, in the order of the records.
    """
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    for kind, traces in (("fit", fit.traces), ("validation", fit.validation.traces)):
        for trace in traces:
            file = folder / f"{kind}-{re.sub(r'[^A-Za-z0-9_.-]+', '_', trace.name)}.png"
            if file in files:
                file = file.with_stem(f"{file.stem}-{len(files) + 1}")
            own = misfits_of(fit, trace, skip if kind == "validation" else 0)
            save_figure(_draw(fit, trace, own, kind), file)
            files.append(file)
    return files


def misfits_of(fit: Fit, trace: Trace, skip: int = 0) -> dict[str, Misfit]:
    """Misfit of one record of ``fit`` by output, without its first ``skip`` rows."""
    units = {o.name: o.unit for o in fit.model.outputs}
    # An output that the fitted records lack has the noise by which the validation judged it.
    judged = {name: m.rmse / m.noise_ratio for name, m in fit.validation.misfit.items() if m.noise_ratio > 0}
    noise = {**judged, **fit.noise.std}
    return {name: compute_misfit([trace], name, units[name], noise.get(name, np.nan), skip) for name in trace.measured}


def _draw(fit: Fit, trace: Trace, own: Mapping[str, Misfit], kind: str) -> Figure:
    outputs = list(trace.measured)
    zoom = _liveliest(trace.measured[outputs[0]]) if len(trace.time) > 2 * ZOOM_ROWS else None
    figure = Figure(figsize=(11 if zoom else 8, 1.0 + 3.4 * len(outputs)), layout="constrained")
    FigureCanvasAgg(figure)
    columns = 2 if zoom else 1
    axes = figure.subplots(
        2 * len(outputs), columns, squeeze=False, sharex="col",
        gridspec_kw={"height_ratios": [2.2, 1] * len(outputs), "width_ratios": [1.7, 1][:columns]},
    )  # fmt: skip
    where = "fitted record" if kind == "fit" else "validation record"
    figure.suptitle(f"{fit.model.title}: {where} {trace.name}, free run", fontsize=11)
    for k, name in enumerate(outputs):
        for column in range(columns):
            rows = slice(None) if column == 0 else zoom
            _output(
                axes[2 * k, column], axes[2 * k + 1, column], fit, trace, name, rows or slice(None), first=column == 0
            )
        axes[2 * k, 0].set_title(_verdict(name, own[name]), loc="left", fontsize=9)
        if zoom:
            axes[2 * k, 1].set_title("closer look", loc="left", fontsize=9)
        _legend(axes[2 * k, columns - 1], axes[2 * k + 1, columns - 1])
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    figure.align_ylabels(axes[:, 0])
    return figure


def _output(top: Axes, bottom: Axes, fit: Fit, trace: Trace, name: str, rows: slice, *, first: bool) -> None:
    unit = next(o.unit for o in fit.model.outputs if o.name == name)
    factor, text = scale_to_prefix(unit, trace.measured[name], trace.simulated[name])
    noise = fit.noise.std.get(name, 0.0)
    small, small_text = scale_to_prefix(unit, trace.residual(name), np.array([2 * noise]))
    time = trace.time[rows]
    top.plot(*min_max_envelope(time, factor * trace.measured[name][rows]), color=MEASURED, lw=1.8, label="measured")
    top.plot(*min_max_envelope(time, factor * trace.simulated[name][rows]), color=SIMULATED, lw=0.8, label="simulated")
    band = small * 2 * noise
    if band:
        bottom.axhspan(-band, band, color=BAND, lw=0, label="± 2 noise")
    bottom.plot(*min_max_envelope(time, small * trace.residual(name)[rows]), color=RESIDUAL, lw=0.6)
    bottom.set_ylim(*_limits(small * trace.residual(name), band))
    for axis in (top, bottom):
        axis.grid(alpha=0.25, lw=0.5)
        axis.margins(x=0.01)
        axis.tick_params(labelsize=8)
    if first:
        top.set_ylabel(axis_label(name, text))
        bottom.set_ylabel(axis_label("residual", small_text), fontsize=9)


def _legend(top: Axes, bottom: Axes) -> None:
    """Above the right-hand picture, where no curve runs; the residual's band is in it too."""
    handles = [*top.get_legend_handles_labels()[0], *bottom.get_legend_handles_labels()[0]]
    top.legend(
        handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(handles), fontsize=8, frameon=False,
        borderaxespad=0.2, columnspacing=1.0, handlelength=1.4,
    )  # fmt: skip


def _limits(residual: np.ndarray, band: float) -> tuple[float, float]:
    """The residual's range, not blown up by a single outlier, and never less than the noise band."""
    known = residual[np.isfinite(residual)]
    reach = 1.1 * max(1.2 * band, float(np.quantile(np.abs(known), 0.9995)) if len(known) else 0.0)
    return (-reach, reach) if reach > 0 else (-1.0, 1.0)


def _verdict(name: str, m: Misfit) -> str:
    over_noise = f"misfit {m.noise_ratio:.3g} x noise, " if np.isfinite(m.noise_ratio) else ""
    return f"{name}: {over_noise}best fit {m.best_fit_percent:.2f} %"


def _liveliest(values: np.ndarray) -> slice:
    """Rows around the largest deviation from the mean."""
    deviation = np.abs(np.where(np.isfinite(values), values, np.nan) - np.nanmean(values))
    middle = int(np.nanargmax(deviation))
    start = min(max(0, middle - ZOOM_ROWS // 2), len(values) - ZOOM_ROWS)
    return slice(start, start + ZOOM_ROWS)
