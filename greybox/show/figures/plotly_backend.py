"""Figures for a page: what Plotly takes, as plain dictionaries and arrays. Colours are names of variables of the page's style."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from greybox.base import figure as fig
from greybox.show.figures.figure import choose_evenly, thin_curve, write_cell

PAPER = "--paper"
SYMBOLS = {
    fig.Symbol.CIRCLE: "circle",
    fig.Symbol.DIAMOND: "diamond",
    fig.Symbol.SQUARE: "square",
    fig.Symbol.CROSS: "x",
}
# Pixels of a figure.
HEIGHTS = {fig.Height.LOW: 250, fig.Height.MEDIUM: 290, fig.Height.TALL: 360}
# Pixels above and below the names of a vertical axis, and for each of these names.
FRAME, PER_CATEGORY = 110, 32
# Points of a cloud at most, chosen evenly: more would hide one another.
POINTS_OF_A_CLOUD = 1500
# Letters of a name beside a bar.
LONGEST_NAME = 34


@dataclass(frozen=True)
class PlotlyFigure:
    """A figure as the page's script draws it.

    Parameters
    ----------
    traces
        Of all panels, as Plotly takes them.
    views
        For each panel its name, the numbers of its traces and its layout.
    signals
        Residuals whose spectrum is taken anew over the stretch that the reader looks at: ``trace`` shows it, ``figure`` is the one with
        the time axis.
    """

    traces: list[dict[str, Any]]
    views: list[dict[str, Any]]
    signals: list[dict[str, Any]]


def to_plotly(figure: fig.Figure, stretches: int) -> PlotlyFigure:
    """What Plotly draws of a figure, long curves by so many stretches."""
    drawn = PlotlyFigure([], [], [])
    for panel in figure.panels:
        first = len(drawn.traces)
        for series in panel.series:
            if isinstance(series, fig.Curve) and series.signal is not None:
                s = series.signal
                drawn.signals.append(
                    {
                        "trace": len(drawn.traces),
                        "figure": s.figure,
                        "start": s.start,
                        "step": s.step,
                        "values": s.values,
                    }
                )
            drawn.traces.extend(_traces(series, panel, stretches))
        traces = list(range(first, len(drawn.traces)))
        drawn.views.append({"name": panel.name, "traces": traces, "layout": _layout(panel)})
    return drawn


def height_on_page(figure: fig.Figure) -> int:
    """Pixels of a figure."""
    return max(
        FRAME + PER_CATEGORY * len(panel.categories)
        if panel.height is fig.Height.PER_CATEGORY
        else HEIGHTS[panel.height]
        for panel in figure.panels
    )


def css_variable(role: fig.Role) -> str:
    """Name of the style's variable with the colour of a role."""
    return f"--{role}"


def _traces(series: fig.Series, panel: fig.Panel, stretches: int) -> list[dict[str, Any]]:
    match series:
        case fig.Curve():
            return [_curve(series, panel, stretches)]
        case fig.Points():
            return [_points(series, panel)]
        case fig.Bars():
            return [_bars(series, panel)]
        case fig.Area():
            edge = {"type": "scatter", "mode": "lines", "x": series.x, "line": {"width": 0}, "hoverinfo": "skip"}
            fill = {"fill": "tonexty", "fillcolor": css_variable(series.role)}
            return [edge | {"y": series.low, **_named("")}, edge | {"y": series.high, **fill, **_named(series.label)}]
        case fig.Heatmap():
            return [_heatmap(series)]
    return []  # bands and references across the whole panel belong to its layout


def _curve(curve: fig.Curve, panel: fig.Panel, stretches: int) -> dict[str, Any]:
    x, y = thin_curve(curve.x, curve.y, curve.thinning, stretches)
    line = {
        "color": css_variable(curve.role),
        "width": curve.width,
        "dash": curve.dash.value,
        **({"shape": "hv"} if curve.held else {}),
    }
    trace = {"type": "scatter", "mode": "lines", "x": x, "y": y, "line": line, **_named(curve.label)}
    if curve.label in panel.listing:
        trace["legendrank"] = panel.listing.index(curve.label)
    return trace


def _points(points: fig.Points, panel: fig.Panel) -> dict[str, Any]:
    colour = css_variable(points.role)
    marker = {"symbol": SYMBOLS[points.symbol], "size": points.size, "color": colour, "opacity": points.opacity}
    if points.hollow:
        marker |= {"color": PAPER, "line": {"color": colour, "width": 1.5}}
    mode = "markers" + "+lines" * points.joined + "+text" * bool(points.texts)
    kept = np.arange(len(points.x)) if mode != "markers" else choose_evenly(len(points.x), POINTS_OF_A_CLOUD)
    x, y = _chosen(points.x, kept), _chosen(points.y, kept)
    trace = {"type": "scatter", "mode": mode, "x": x, "y": y, "marker": marker, **_named(points.label)}
    if points.joined:
        trace["line"] = {"color": colour, "width": 1.0}
    if points.half_bars is not None:
        trace["error_y"] = {
            "type": "data",
            "array": _chosen(points.half_bars, kept),
            "color": colour,
            "thickness": 1.0,
            "width": 0,
        }
    if points.texts:
        trace |= {
            "text": [f"\u2002{text}" for text in points.texts],
            "textposition": "middle right",
            "cliponaxis": False,
        }
    if panel.categories:
        trace["hovertemplate"] = _pointed_at(f"%{{y}}: %{{x:.4g}} {escape(panel.x.unit)}", points.label)
    return trace


def _bars(bars: fig.Bars, panel: fig.Panel) -> dict[str, Any]:
    across, along = ("y", "x") if bars.horizontal else ("x", "y")
    unit = escape((panel.x if bars.horizontal else panel.y).unit)
    trace = {
        "type": "bar",
        "orientation": "h" if bars.horizontal else "v",
        along: bars.lengths,
        across: _listed(bars.places),
        "marker": {"color": [css_variable(role) for role in bars.roles]},
        **_named(bars.label),
    }
    if not isinstance(_listed(bars.places), list):
        trace["width"] = bars.width if np.ndim(bars.width) else np.full(len(bars.lengths), bars.width)
    if bars.texts:
        trace |= {"text": [f"\u2003{text}" for text in bars.texts], "textposition": "outside", "cliponaxis": False}
    if bars.remarks:
        trace["customdata"] = list(bars.remarks)
    value = f"%{{{along}:.4g}} {unit}" + ", %{customdata}" * bool(bars.remarks)
    trace["hovertemplate"] = _pointed_at(f"%{{{across}}}: {value}", bars.label)
    return trace


def _heatmap(heatmap: fig.Heatmap) -> dict[str, Any]:
    cells = [[write_cell(v) if np.isfinite(v) else "" for v in row] for row in heatmap.values]
    colours = [[0, css_variable(fig.Role.RESIDUAL)], [0.5, PAPER], [1, css_variable(fig.Role.SIMULATED)]]
    names = list(heatmap.names)
    return {
        "type": "heatmap",
        "z": heatmap.values.tolist(),
        "x": names,
        "y": names,
        "zmin": -1,
        "zmax": 1,
        "text": cells,
        "texttemplate": "%{text}",
        "colorscale": colours,
        "showscale": False,
        "xgap": 2,
        "ygap": 2,
        "hovertemplate": _pointed_at("%{x}, %{y}: %{z:.3f}", ""),
    }


def _named(label: str) -> dict[str, Any]:
    return {"name": label, "showlegend": bool(label)}


def _pointed_at(template: str, label: str) -> str:
    """What stands beside the mark that the reader points at. A template takes tags as markup: a label has none."""
    return f"{template}<extra>{escape(label)}</extra>"


def _layout(panel: fig.Panel) -> dict[str, Any]:
    over_time = all(isinstance(s, (fig.Curve, fig.Area, fig.Band, fig.Reference)) for s in panel.series)
    layout: dict[str, Any] = {
        "xaxis": _axis(panel.x, panel),
        "yaxis": _axis(panel.y, panel),
        "shapes": [shape for s in panel.series if (shape := _shape(s)) is not None],
        "showlegend": len(panel.labels) > 1,
        "hovermode": "x unified" if over_time else "closest",
    }
    if panel.equal_scales:
        layout["yaxis"]["scaleanchor"] = "x"
    return layout


def _axis(axis: fig.Axis, panel: fig.Panel) -> dict[str, Any]:
    drawn: dict[str, Any] = {"title": {"text": axis.label}, "type": axis.scale.value}
    if axis.limits is not None:
        drawn["range"] = np.log10(axis.limits).tolist() if axis.scale is fig.Scale.LOG else list(axis.limits)
    if axis.spacing is not None:
        drawn["dtick"] = axis.spacing
    if axis.reversed:
        drawn["autorange"] = "reversed"
    if axis.scale is fig.Scale.CATEGORY and axis is panel.y:
        names = panel.categories
        drawn |= {"tickvals": names, "ticktext": [shorten(name, LONGEST_NAME) for name in names]}
    return drawn


def _shape(series: fig.Series) -> dict[str, Any] | None:
    """What reaches over the whole panel."""
    match series:
        case fig.Band():
            return _across("y", series.low, series.high) | {
                "type": "rect",
                "fillcolor": css_variable(series.role),
                "line": {"width": 0},
                "layer": "below",
                **_named(series.label),
            }
        case fig.Reference():
            line = {"color": css_variable(series.role), "width": series.width, "dash": series.dash.value}
            ends = _across("x" if series.upright else "y", series.value, series.value)
            return ends | {"type": "line", "line": line, **_named(series.label)}
    return None


def _across(axis: str, low: Any, high: Any) -> dict[str, Any]:
    other = "x" if axis == "y" else "y"
    return {f"{other}ref": "paper", f"{other}0": 0, f"{other}1": 1, f"{axis}0": low, f"{axis}1": high}


def _listed(values: np.ndarray | Sequence[str]) -> np.ndarray | list[str]:
    return values if isinstance(values, np.ndarray) else list(values)


def _chosen(values: np.ndarray | Sequence[str], kept: np.ndarray) -> np.ndarray | list[str]:
    return values[kept] if isinstance(values, np.ndarray) else [values[k] for k in kept]


def shorten(name: str, letters: int) -> str:
    """A name of so many letters at most."""
    return name if len(name) <= letters else f"{name[: letters - 1]}…"
