"""The residual's memory as a figure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from greybox.reports.axes import axes, band
from greybox.reports.page import Figure

LAGS = 50
NINETY_NINE = 2.5758  # standard deviations that 99 % of a normal variable stay within


def memory_figure(name: str, output: str, residuals: Sequence[np.ndarray]) -> Figure:
    """Autocorrelation of the residual (each record (N,), NaN in gaps) with the 99 % band of white noise."""
    centred = [r - np.nanmean(r) for r in residuals if np.isfinite(r).sum() > 2]
    count = sum(int(np.isfinite(r).sum()) for r in centred)
    lags = np.arange(1, min(LAGS, max((len(r) for r in centred), default=1) - 1) + 1)
    power = sum(float(np.nansum(r**2)) for r in centred) or 1.0
    values = np.array([sum(float(np.nansum(r[k:] * r[:-k])) for r in centred if len(r) > k) / power for k in lags])
    half = NINETY_NINE / np.sqrt(max(count, 1))
    outside = int(np.sum(np.abs(values) > half))
    layout = axes("lag [samples]", f"autocorrelation, {output}") | {"shapes": [band(half)], "showlegend": False}
    reach = 1.15 * max(float(np.abs(values).max(initial=0.0)), 2 * half)
    layout["yaxis"] |= {"range": [-reach, reach]}
    data = [{"type": "bar", "x": lags, "y": values, "marker": {"color": "--residual"}, "name": "autocorrelation"}]
    words = f"{outside} of {len(lags)} lags lie outside the 99 % band of white noise (± {half:.2g})"
    worst = (
        f"; the largest is {values[np.argmax(np.abs(values))]:.2g} at lag {lags[np.argmax(np.abs(values))]}"
        if len(lags)
        else ""
    )
    return Figure(
        name, f"Autocorrelation of the residual of {output}; the grey band is that of white noise, 99 %.", words + worst + ".", data,
        layout, height=250,
    )  # fmt: skip
