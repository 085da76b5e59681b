"""A linear model as figures: gain and phase over frequency, and its poles."""

from __future__ import annotations

from typing import Any

import numpy as np

from greybox.export import Linearisation, ModelFamily
from greybox.plots.units import axis_label
from greybox.reports.axes import axes, line
from greybox.reports.page import Figure, View
from greybox.reports.typography import typeset_number, typeset_page_unit

POINTS = 500  # frequencies of a curve
REACH = 20.0  # times the slowest and the fastest pole


def frequencies(linear: Linearisation) -> np.ndarray:
    """Angular frequencies (nw,) in rad/s around the poles; up to half the sampling rate."""
    poles = linear.poles[np.abs(linear.poles) > 0]
    speeds = np.abs(np.log(poles) / linear.dt) if linear.dt else np.abs(poles)
    speeds = speeds[np.isfinite(speeds) & (speeds > 1e-9)]
    low, high = (float(speeds.min()), float(speeds.max())) if len(speeds) else (1.0, 1.0)
    high = min(high * REACH, 0.999 * np.pi / linear.dt) if linear.dt else high * REACH
    peaks = np.concatenate([s * np.linspace(0.9, 1.1, 81) for s in np.unique(speeds)]) if len(speeds) else np.array([])
    grid = np.concatenate([np.geomspace(min(low / REACH, high / 10), high, POINTS), peaks])
    return np.unique(grid[grid <= high])


def bode_figures(linear: Linearisation, family: ModelFamily | None) -> list[Figure]:
    """Gain and phase, a button for each channel; around them the spread of the family (95 %)."""
    if not linear.input_names or not linear.output_names:
        return []
    w = frequencies(linear)
    response = linear.frequency_response(w)
    bounds = family.bounds(w) if family is not None else None
    gains: list[dict[str, Any]] = []
    phases: list[dict[str, Any]] = []
    up, down, words, hertz = {}, {}, [], w / (2 * np.pi)
    for r, output in enumerate(linear.output_names):
        for c, name in enumerate(linear.input_names):
            channel, start, size = f"{name} → {output}", len(gains), np.abs(response[:, r, c])
            unit = typeset_page_unit(f"({linear.output_units[r] or '1'})/({linear.input_units[c] or '1'})")
            if bounds is not None:
                low, high = (line(hertz, b[:, r, c], "95 % of the models", "--soft", width=0.5) for b in bounds)
                gains += [low, high | {"fill": "tonexty", "fillcolor": "--band", "showlegend": False}]
            gains.append(line(hertz, np.where(size > 0, size, np.nan), "gain", "--model"))
            angle = np.degrees(np.unwrap(np.angle(response[:, r, c])))
            phases.append(line(hertz, angle, "phase", "--residual"))
            up[channel] = View(list(range(start, len(gains))), {"yaxis": {"title": {"text": axis_label("gain", unit)}}})
            down[channel] = View([len(phases) - 1])
            top = int(np.argmax(size))
            words.append(
                f"{channel}: gain {size[0]:.4g} {unit} at {hertz[0]:.3g} Hz, largest {size[top]:.4g} {unit} at"
                f" {hertz[top]:.4g} Hz"
            )
    layout = axes("frequency [Hz]", "gain", logarithmic="xy")
    turned = axes("frequency [Hz]", "phase [°]", logarithmic="x") | {"showlegend": False}
    turned["yaxis"] |= {"dtick": 90}
    said = typeset_number(". ".join(words)) + "."
    around = "; the band holds 95 % of the drawn models" if family is not None else ""
    return [
        Figure(
            "gain",
            f"Gain over frequency{around}.",
            said,
            gains,
            layout,
            height=330,
            group="bode",
            views=up,
            switch="bode",
        ),
        Figure(
            "phase", "Phase over frequency.", said, phases, turned, height=250, group="bode", views=down, switch="bode"
        ),
    ]


def poles_figure(linear: Linearisation, family: ModelFamily | None) -> Figure | None:
    """Poles in the complex plane, with those of the family."""
    poles = linear.poles
    if not len(poles):
        return None
    data: list[dict[str, Any]] = []
    if family is not None and len(family.members):
        cloud = family.poles.ravel()
        data.append(_dots(cloud, "drawn models", {"size": 4, "color": "--measured", "opacity": 0.5}))
    data.append(_dots(poles, "nominal", {"size": 11, "symbol": "x", "color": "--model"}))
    layout = axes(
        "real part" if linear.dt else "real part [1/s]", "imaginary part" if linear.dt else "imaginary part [rad/s]"
    )
    layout |= {"hovermode": "closest"}
    if linear.dt:
        circle = {"type": "circle", "x0": -1, "x1": 1, "y0": -1, "y1": 1, "line": {"color": "--soft", "width": 1}}
        layout |= {"shapes": [circle]}
        layout["yaxis"] |= {"scaleanchor": "x"}
    words = "; ".join(f"{p.real:.5g} {'+' if p.imag >= 0 else '−'} {abs(p.imag):.5g} j" for p in poles)
    where = "inside the circle" if linear.dt else "left of the vertical axis"
    return Figure(
        "poles",
        f"Poles in the complex plane; {where} they decay.",
        typeset_number(f"Poles at {words}."),
        data,
        layout,
        height=330,
    )


def _dots(values: np.ndarray, name: str, marker: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "scatter", "mode": "markers", "x": values.real, "y": values.imag, "name": name, "marker": marker,
        "hovertemplate": "%{x:.5g} %{y:+.5g} j<extra></extra>",
    }  # fmt: skip
