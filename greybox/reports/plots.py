"""Figures of a report as plain data for Plotly. A colour is the name of a variable of the page's style."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.signal import periodogram

from greybox.figures.envelope import envelope
from greybox.figures.scale import label, scaled
from greybox.reports.page import Figure
from greybox.result import Trace

# Stretches of a long record (each drawn by its extremes), and residual values kept whole for the spectrum of a stretch.
STRETCHES, WHOLE = 2000, 20_000
LAGS = 50


def line(x: np.ndarray, y: np.ndarray, name: str, colour: str, *, width: float = 1.4, **more: Any) -> dict[str, Any]:
    """A curve."""
    return {
        "type": "scatter",
        "mode": "lines",
        "x": x,
        "y": y,
        "name": name,
        "line": {"color": colour, "width": width},
        **more,
    }


def run_figure(trace: Trace, output: str, unit: str, name: str) -> Figure:
    """Measured and simulated output of one record."""
    factor, text = scaled(unit, trace.measured[output], trace.simulated[output])
    measured = envelope(trace.time, factor * trace.measured[output], STRETCHES)
    simulated = envelope(trace.time, factor * trace.simulated[output], STRETCHES)
    data = [
        line(*measured, "measured", "--measured", width=2.2),
        line(*simulated, "model, free run", "--model", width=1.2),
    ]
    gaps = int(np.isnan(trace.measured[output]).sum())
    words = (
        f"{output} of record {trace.name} over {trace.time[-1] - trace.time[0]:.4g} s: measured from {_range(measured[1])} {text}, "
        f"simulated from {_range(simulated[1])} {text}."
    )
    if gaps:
        words += f" {gaps} of {len(trace.time)} values are not there: the measured curve has gaps."
    return Figure(
        name, f"{output} of record {trace.name}: measured, and the model's free run.", words, data, axes("time [s]", label(output, text)),
        group=trace.name,
    )  # fmt: skip


def residual_figure(trace: Trace, output: str, unit: str, noise: float, name: str, spectrum: str) -> Figure:
    """What the model leaves over, with the band of two standard deviations of the noise."""
    residual = trace.residual(output)
    factor, text = scaled(unit, residual, np.array([2 * noise]))
    shown = envelope(trace.time, factor * residual, STRETCHES)
    layout = axes("time [s]", label("residual", text))
    words = f"Residual of {output}: rms {_rms(residual) * factor:.3g} {text}"
    if noise > 0:
        layout["shapes"] = [_band(factor * 2 * noise)]
        inside = (
            np.mean(np.abs(residual[np.isfinite(residual)]) <= 2 * noise) if np.isfinite(residual).any() else np.nan
        )
        words += f"; {100 * inside:.0f} % of it lies within two standard deviations of the noise ({factor * 2 * noise:.3g} {text})"
    signal: Mapping[str, Any] = {}
    if len(residual) <= WHOLE:
        signal = {"time": trace.time, "values": factor * residual, "figure": spectrum}
    return Figure(
        name, f"Residual of {output}: measured minus simulated; the band is two standard deviations of the noise.", words + ".",
        [line(*shown, "residual", "--residual", width=1.0)], layout, height=260, group=trace.name, signal=signal,
    )  # fmt: skip


def spectrum_figure(trace: Trace, output: str, unit: str, noise: float, name: str) -> Figure:
    """Amplitude density of the residual beside that of white noise of the known size."""
    residual = trace.residual(output)
    factor, text = scaled(unit, residual, np.array([2 * noise]))
    step = float(np.median(np.diff(trace.time)))
    filled = np.where(np.isfinite(residual), residual, 0.0)
    f, power = periodogram(factor * (filled - filled.mean()), 1 / step, window="hann")
    f, amplitude = _thinned(f[1:], np.sqrt(np.maximum(power[1:], 1e-300)))
    data = [line(f, amplitude, "residual", "--residual", width=1.0)]
    if noise > 0:
        floor = factor * noise * np.sqrt(2 * step)
        data.append(
            line(
                np.array([f[0], f[-1]]),
                np.array([floor, floor]),
                "noise floor",
                "--measured",
                line={"color": "--measured", "dash": "dash"},
            )
        )
    peak = int(np.argmax(amplitude))
    layout = axes("frequency [Hz]", label("density", f"{text}/√Hz"))
    layout["xaxis"] |= {"type": "log"}
    layout["yaxis"] |= {"type": "log"}
    return Figure(
        name, f"Spectrum of the residual of {output}. Zoom into the residual in time: the spectrum follows.",
        f"The residual of {output} is strongest at {f[peak]:.4g} Hz.", data, layout, height=280,
    )  # fmt: skip


def intervals_figure(name: str, rows: Sequence[tuple[str, float, float]]) -> Figure:
    """Half width of each 95 % interval in percent of the value: what the data determine well, and what they do not."""
    ordered = sorted(rows, key=lambda row: row[2] / abs(row[1]) if row[1] else np.inf)
    names = [row[0] for row in ordered]
    percent = [100 * half / abs(value) if value else np.nan for _, value, half in ordered]
    data = [{
        "type": "bar", "orientation": "h", "x": percent, "y": names, "marker": {"color": "--residual"}, "name": "± % of the value",
        "hovertemplate": "%{y}: ± %{x:.3g} %<extra></extra>",
    }]  # fmt: skip
    layout = axes("half width of the 95 % interval [% of the value]", "") | {
        "showlegend": False,
        "hovermode": "closest",
    }
    layout["xaxis"] |= {"type": "log"}
    layout["yaxis"] |= {"automargin": True, "type": "category"}
    words = "; ".join(f"{n} ± {p:.3g} %" for n, p in zip(names, percent, strict=True))
    return Figure(
        name,
        "How well each constant is known: shorter is better.",
        words + ".",
        data,
        layout,
        height=90 + 28 * len(names),
    )


def correlation_figure(name: str, output: str, residuals: Sequence[np.ndarray]) -> Figure:
    """Autocorrelation of the residual with the 99 % band of white noise."""
    known = [r[np.isfinite(r)] for r in residuals]
    centred = [r - r.mean() for r in known if len(r) > 2]
    count = sum(map(len, centred))
    lags = np.arange(1, min(LAGS, min(map(len, centred), default=1) - 1) + 1)
    power = sum(float(r @ r) for r in centred) or 1.0
    values = np.array([sum(float(r[k:] @ r[:-k]) for r in centred) / power for k in lags])
    band = 2.576 / np.sqrt(max(count, 1))
    outside = int(np.sum(np.abs(values) > band))
    layout = axes("lag [samples]", "autocorrelation") | {"shapes": [_band(band)], "showlegend": False}
    data = [{"type": "bar", "x": lags, "y": values, "marker": {"color": "--residual"}, "name": "autocorrelation"}]
    words = f"{outside} of {len(lags)} lags lie outside the 99 % band of white noise (± {band:.2g}); some {len(lags) / 100:.1g}."
    return Figure(
        name,
        f"Autocorrelation of the residual of {output}; the band is that of white noise, 99 %.",
        words,
        data,
        layout,
        height=250,
    )


def axes(x: str, y: str) -> dict[str, Any]:
    """A layout with both axes named."""
    return {"xaxis": {"title": {"text": x}}, "yaxis": {"title": {"text": y}}}


def _band(half: float) -> dict[str, Any]:
    return {
        "type": "rect", "xref": "paper", "x0": 0, "x1": 1, "y0": -half, "y1": half, "fillcolor": "--band", "line": {"width": 0},
        "layer": "below",
    }  # fmt: skip


def _thinned(f: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A long spectrum by the largest value of each stretch, the stretches equally wide on a logarithmic axis."""
    if len(f) <= STRETCHES:
        return f, values
    edges = np.unique(np.geomspace(1, len(f), STRETCHES).astype(int) - 1)
    return f[edges], np.maximum.reduceat(values, edges)


def _range(values: np.ndarray) -> str:
    if not np.isfinite(values).any():
        return "nothing"
    return f"{np.nanmin(values):.4g} to {np.nanmax(values):.4g}"


def _rms(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan
