"""What the figures of every page are made of: curves, bands, axes, thinning. A colour is the name of a variable of the page's style."""

from __future__ import annotations

from typing import Any

import numpy as np

# Stretches of a long record (each drawn by its extremes) at most and at least, and all those of a page together.
STRETCHES, FEWEST, ALL_STRETCHES = 2000, 150, 45_000
# Colours of models beside one another: as many as can still be told apart.
SERIES = ("--model", "--residual", "--third", "--fourth", "--fifth", "--sixth", "--seventh", "--eighth")


def line(
    x: np.ndarray, y: np.ndarray, name: str, colour: str, *, width: float = 1.4, dash: str = "solid"
) -> dict[str, Any]:
    """A curve."""
    return {
        "type": "scatter", "mode": "lines", "x": x, "y": y, "name": name, "line": {"color": colour, "width": width, "dash": dash},
    }  # fmt: skip


def axes(x: str, y: str, *, logarithmic: str = "") -> dict[str, Any]:
    """A layout with both axes named; ``logarithmic`` lists those that are: "x", "y", "xy"."""
    titles = {"x": x, "y": y}
    return {
        f"{name}axis": {"title": {"text": title}, **({"type": "log"} if name in logarithmic else {})}
        for name, title in titles.items()
    }


def band(half: float) -> dict[str, Any]:
    """A horizontal band of ``half`` to both sides of zero."""
    return {
        "type": "rect", "xref": "paper", "x0": 0, "x1": 1, "y0": -half, "y1": half, "fillcolor": "--band", "line": {"width": 0},
        "layer": "below",
    }  # fmt: skip


def envelope_length(curves: int) -> int:
    """Stretches for each of so many curves, so that a page of many records stays small."""
    return int(np.clip(ALL_STRETCHES // max(curves, 1), FEWEST, STRETCHES))


def amplitude_density(values: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz and one-sided amplitude density of evenly sampled ``values`` (N,) by a Hann window.

    Gaps count as the mean of the rest, and not as rows: white noise has the same density with gaps and without.
    """
    known = np.isfinite(values)
    if len(values) < 4 or not known.any():
        return np.array([]), np.array([])
    window = np.hanning(len(values) + 1)[:-1]
    centred = np.where(known, values - values[known].mean(), 0.0)
    spectrum = np.fft.rfft(window * centred)
    frequency = np.fft.rfftfreq(len(values), step)
    return frequency[1:], np.sqrt(2 * step * np.abs(spectrum[1:]) ** 2 / np.sum(window[known] ** 2))


def thin_spectrum(f: np.ndarray, values: np.ndarray, most: int = STRETCHES) -> tuple[np.ndarray, np.ndarray]:
    """A long spectrum by the largest value of each stretch, the stretches equally wide on a logarithmic axis."""
    if len(f) <= most:
        return f, values
    edges = np.unique(np.geomspace(1, len(f), most).astype(int) - 1)
    return f[edges], np.maximum.reduceat(values, edges)


def uniform_sampling_time(time: np.ndarray) -> float | None:
    """Seconds between rows, None where they are not evenly spaced."""
    steps = np.diff(time)
    even = len(steps) > 0 and float(np.ptp(steps)) < 1e-3 * float(steps.mean())
    return float(steps.mean()) if even else None


def format_range(values: np.ndarray) -> str:
    """``-3.1 to 2.7``, for a description."""
    known = values[np.isfinite(values)]
    return f"{known.min():.4g} to {known.max():.4g}".replace("-", "−") if len(known) else "nothing"


def rms(values: np.ndarray) -> float:
    """Root mean square of what is there."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
