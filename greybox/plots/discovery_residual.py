"""The validation error of a discovery in time and by frequency, before and after, with the noise floor."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from greybox.discovery import Discovery, estimate_residual_spectrum
from greybox.plots.layout import NAMES, legends, panels, settle
from greybox.plots.thinning import min_max_envelope
from greybox.plots.units import axis_label, scale_to_prefix
from greybox.result import Fit

BEFORE, AFTER, BAND = "#b7950b", "#1f5a8a", "#dcdcdc"


def draw_residuals(found: Discovery) -> Figure:
    """For each output the error of the plain and of the extended model on the first validation record, and their spectra."""
    outputs = list(found.gap)
    figure, axes = panels(11, 0.8 + 3.0 * len(outputs), rows=len(outputs), columns=2)
    after = found.extended
    for (time, frequency), output in zip(axes, outputs, strict=True):
        unit = found.gap[output].unit
        _time(time, output, unit, found.base, after)
        _frequency(frequency, output, unit, found)
    legends(*axes[0])
    heading = f"{found.base.model.name}: error on the validation records, free run; {after.model.title}"
    settle(figure, axes, heading, widths=(1.5, 1), above=1)
    return figure


def _time(axis: Axes, output: str, unit: str, base: Fit, after: Fit) -> None:
    before = next(t for t in base.validation.traces if output in t.measured)
    then = next(t for t in after.validation.traces if output in t.measured)
    factor, text = scale_to_prefix(unit, before.residual(output))
    noise = factor * base.noise.std.get(output, 0.0)
    axis.axhspan(-2 * noise, 2 * noise, color=BAND, lw=0, label="± 2 noise")
    axis.plot(*min_max_envelope(before.time, factor * before.residual(output)), color=BEFORE, lw=0.7, label="before")
    axis.plot(*min_max_envelope(then.time, factor * then.residual(output)), color=AFTER, lw=0.6, label="after")
    axis.set_xlabel("time [s]", fontsize=NAMES)
    axis.set_ylabel(axis_label(f"error of {output}", text), fontsize=NAMES)


def _frequency(axis: Axes, output: str, unit: str, found: Discovery) -> None:
    known = found.verdict != "unknown"
    before, then = (estimate_residual_spectrum(f, output, coloured=known) for f in (found.base, found.extended))
    factor, text = scale_to_prefix(unit, before.density)
    axis.loglog(before.frequency, factor * np.maximum(before.density, 1e-300), color=BEFORE, lw=0.9)
    axis.loglog(then.frequency, factor * np.maximum(then.density, 1e-300), color=AFTER, lw=0.9)
    axis.loglog(before.frequency, factor * before.floor, color="black", lw=0.9, ls=":", label="noise")
    axis.set_xlabel("frequency [Hz]", fontsize=NAMES)
    axis.set_ylabel(axis_label("amplitude a line", text), fontsize=NAMES)
