"""The gap between model and rig in one picture: the misfit step by step, and what is left of the record before and after."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from greybox.plots.files import save_figure
from greybox.plots.thinning import min_max_envelope
from greybox.plots.units import axis_label, scale_to_prefix
from greybox.result import Trace

MEASURED, BEFORE, AFTER, OTHER, BAND = "#8a8a8a", "#c0392b", "#1f6f43", "#5d6d7e", "#dcdcdc"


def gap_figure(
    before: Trace, after: Trace, *, output: str, unit: str, noise: float, ratios: Mapping[str, float], names: tuple[str, str],
    path: str | Path,
) -> list[Path]:  # fmt: skip
    """Draw how far a record is from its model ``before`` and ``after`` an effect was added, as PNG and SVG. Returns the files.

    Left the residual (measured minus free run) of ``output``, in ``unit``, with a band of two standard deviations of the ``noise``;
    right the misfit in units of the noise for every model in ``ratios``, in their order. ``names`` of the two models; ``path``
    without suffix.
    """
    figure = Figure(figsize=(9.5, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    left = figure.add_gridspec(2, 2, width_ratios=[1.6, 1], height_ratios=[1, 1.25])
    signal, residual = figure.add_subplot(left[0, 0]), figure.add_subplot(left[1, 0])
    bars = figure.add_subplot(left[:, 1])
    residual.sharex(signal)
    _signal(signal, before, after, output, unit, names)
    _residual(residual, before, after, output, unit, noise)
    _bars(bars, ratios, names)
    figure.align_ylabels([signal, residual])
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    file = target.with_name(f"{target.name}.png")
    save_figure(figure, file)
    return [file, file.with_suffix(".svg")]


def _signal(axis: Axes, before: Trace, after: Trace, output: str, unit: str, names: tuple[str, str]) -> None:
    factor, text = scale_to_prefix(unit, before.measured[output], before.simulated[output])
    rows = (
        (before.measured[output], MEASURED, 2.2, "measured"),
        (before.simulated[output], BEFORE, 0.9, names[0]),
        (after.simulated[output], AFTER, 0.9, names[1]),
    )
    for values, colour, width, name in rows:
        axis.plot(*min_max_envelope(before.time, factor * values), color=colour, lw=width, label=name)
    axis.set_title(f"{output}: free run on a record not used for the fit", loc="left", fontsize=9)
    axis.legend(loc="upper left", fontsize=8, frameon=False, ncols=3, columnspacing=1.0, handlelength=1.4)
    top = 1.1 * float(np.nanmax(np.abs(factor * before.measured[output])))
    axis.set_ylim(-top, 1.45 * top)  # room for the legend
    axis.tick_params(labelbottom=False)
    _finish(axis, axis_label(output, text))


def _residual(axis: Axes, before: Trace, after: Trace, output: str, unit: str, noise: float) -> None:
    factor, text = scale_to_prefix(unit, before.residual(output))
    axis.axhspan(-2 * factor * noise, 2 * factor * noise, color=BAND, lw=0, label="± 2 noise")
    for trace, colour in ((before, BEFORE), (after, AFTER)):
        axis.plot(*min_max_envelope(trace.time, factor * trace.residual(output)), color=colour, lw=0.9)
    axis.set_title("what the model leaves over", loc="left", fontsize=9)
    axis.set_xlabel("time [s]", fontsize=9)
    _finish(axis, axis_label("residual", text))


def _finish(axis: Axes, text: str) -> None:
    axis.set_ylabel(text, fontsize=9)
    axis.grid(alpha=0.25, lw=0.5)
    axis.margins(x=0.01)
    axis.tick_params(labelsize=8)


def _bars(axis: Axes, ratios: Mapping[str, float], names: tuple[str, str]) -> None:
    colours = {names[0]: BEFORE, names[1]: AFTER}
    places = np.arange(len(ratios))[::-1]
    axis.barh(places, list(ratios.values()), color=[colours.get(n, OTHER) for n in ratios], height=0.6)
    for place, (name, ratio) in zip(places, ratios.items(), strict=True):
        axis.text(0.75, place + 0.36, name, fontsize=8.5, va="bottom")
        axis.text(1.08 * ratio, place, f"{ratio:.3g}", fontsize=8.5, va="center")
    axis.axvline(1.0, color="#303030", lw=0.8, ls=":")
    axis.set_xscale("log")
    axis.set_xlim(0.7, 3.0 * max(ratios.values()))
    axis.set_ylim(-0.6, len(ratios) - 0.2)
    axis.set_yticks([])
    axis.set_xlabel("misfit over noise (1: only noise is left)", fontsize=9)
    axis.set_title("the gap", loc="left", fontsize=9)
    axis.tick_params(labelsize=8)
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
