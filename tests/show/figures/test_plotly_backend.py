"""Figures for a page: the same series, one panel at a time."""

from __future__ import annotations

import re

import numpy as np
import pytest

from greybox.base.figure import (
    Area,
    Axis,
    Band,
    Bars,
    Curve,
    Figure,
    Heatmap,
    Height,
    Panel,
    Points,
    Reference,
    Role,
    SampledSignal,
    Scale,
    Thinning,
)
from greybox.show.figures.figure import PALETTE, draw_sizes, size_axis, stretches_on_page
from greybox.show.figures.plotly_backend import (
    FRAME,
    LONGEST_NAME,
    PER_CATEGORY,
    POINTS_OF_A_CLOUD,
    css_variable,
    height_on_page,
    to_plotly,
)

X = np.array([0.0, 1.0, 2.0])
TIME, POSITION = Axis("time", "s"), Axis("x", "µm")


def figure(*panels: Panel) -> Figure:
    return Figure("f", panels, "Phase over frequency.")


def panel(*series, x: Axis = TIME, y: Axis = POSITION, name: str = "x", **more) -> Panel:
    return Panel(name, series, x, y, **more)


def test_each_panel_has_its_traces_and_its_axes() -> None:
    two = figure(
        panel(Curve(X, X, Role.MEASURED, "measured"), Curve(X, X, Role.SIMULATED, "simulated")),
        panel(Curve(X, X, Role.RESIDUAL), x=Axis("frequency", "Hz", Scale.LOG, (1.0, 100.0)), name="i"),
    )
    drawn = to_plotly(two, 100)
    assert [(v["name"], v["traces"]) for v in drawn.views] == [("x", [0, 1]), ("i", [2])]
    assert [t["line"]["color"] for t in drawn.traces] == ["--measured", "--simulated", "--residual"]
    first, second = (v["layout"] for v in drawn.views)
    assert first["xaxis"]["title"]["text"] == "time [s]" and first["showlegend"] and not second["showlegend"]
    assert second["xaxis"] | {"title": None} == {"title": None, "type": "log", "range": [0.0, 2.0]}
    assert first["hovermode"] == "x unified"


def test_bands_and_references_belong_to_the_layout_and_areas_are_traces() -> None:
    drawn = to_plotly(figure(panel(Band(-1.0, 1.0), Reference(0.5, upright=True), Area(X, X - 1, X + 1))), 100)
    rect, line = drawn.views[0]["layout"]["shapes"]
    assert (rect["y0"], rect["y1"], rect["xref"]) == (-1.0, 1.0, "paper")
    assert (line["x0"], line["x1"], line["yref"]) == (0.5, 0.5, "paper")
    low, high = drawn.traces
    assert high["fill"] == "tonexty" and "fill" not in low


def test_names_stand_on_an_axis_once_the_best_on_top_and_long_ones_are_cut() -> None:
    names = ["best", "a" * 60]
    bars = Bars(names, np.array([1.0, 3.0]), [Role.EXTENDED, Role.OTHER], "free run", horizontal=True, texts=["a", "b"])
    marks = Points(np.array([2.0, 4.0]), names, Role.REFERENCE, "ahead")
    y = Axis(scale=Scale.CATEGORY, reversed=True)
    one = figure(panel(bars, marks, x=Axis("error", "nm"), y=y, height=Height.PER_CATEGORY))
    drawn = to_plotly(one, 100)
    axis = drawn.views[0]["layout"]["yaxis"]
    assert axis["tickvals"] == names and axis["autorange"] == "reversed"
    assert len(axis["ticktext"][1]) == LONGEST_NAME and axis["ticktext"][1].endswith("…")
    assert drawn.traces[0]["hovertemplate"] == "%{y}: %{x:.4g} nm<extra>free run</extra>"
    assert height_on_page(one) == FRAME + 2 * PER_CATEGORY


def test_a_label_is_no_markup() -> None:
    bars = Bars(["a"], np.array([1.0]), [Role.OTHER], "<b>x</b>", horizontal=True)
    trace = to_plotly(figure(panel(bars, y=Axis(scale=Scale.CATEGORY))), 100).traces[0]
    assert trace["hovertemplate"].endswith("<extra>&lt;b&gt;x&lt;/b&gt;</extra>")


def test_long_curves_are_thinned_and_clouds_are_chosen_from() -> None:
    many = np.arange(10_000.0)
    series = Curve(many, many, Role.RESIDUAL, thinning=Thinning.ENVELOPE), Points(many, many, Role.RESIDUAL)
    curve, cloud = to_plotly(figure(panel(*series)), 150).traces
    assert len(curve["x"]) == 300
    assert len(cloud["x"]) == POINTS_OF_A_CLOUD


def test_a_spectrum_that_follows_says_which_trace_it_is() -> None:
    signal = SampledSignal("residual-0", 0.5, 0.1, X)
    drawn = to_plotly(figure(panel(Area(X, X, X), Curve(X, X, Role.RESIDUAL, signal=signal))), 100)
    (followed,) = drawn.signals
    assert (followed["trace"], followed["figure"], followed["start"], followed["step"]) == (2, "residual-0", 0.5, 0.1)


def test_a_heatmap_leaves_out_what_is_not_known() -> None:
    heatmap = Heatmap(np.array([[1.0, np.nan], [np.nan, 1.0]]), ["a", "b"])
    (trace,) = to_plotly(figure(panel(heatmap, y=Axis(scale=Scale.CATEGORY))), 100).traces
    assert trace["text"] == [["1.00", ""], ["", "1.00"]]


@pytest.mark.parametrize(
    ("lengths", "scale", "first"), [([1.0, 5.0], Scale.LINEAR, 0.0), ([1.0, 100.0], Scale.LOG, 10**-0.3)]
)
def test_sizes_are_bars_from_zero_or_points_where_they_lie_far_apart(
    lengths: list[float], scale: Scale, first: float
) -> None:
    sizes = np.array([*lengths, np.nan])
    axis = size_axis("error", "nm", sizes)
    series = draw_sizes(["a", "b", "c"], sizes, [Role.MODEL_1, Role.MODEL_2, Role.MODEL_3], axis, texts=["1", "2", ""])
    assert axis.scale is scale
    assert {type(s) for s in series} == {Bars if scale is Scale.LINEAR else Points}
    drawn = to_plotly(figure(panel(*series, x=axis, y=Axis(scale=Scale.CATEGORY))), 100).traces
    assert [t["type"] for t in drawn] == (["bar"] if scale is Scale.LINEAR else ["scatter"] * 3)
    assert [list(t["y"]) for t in drawn] == ([["a", "b", "c"]] if scale is Scale.LINEAR else [["a"], ["b"], ["c"]])
    assert axis.limits[0] == pytest.approx(first)
    assert axis.limits[1] > max(lengths)


def test_a_page_of_many_curves_draws_each_with_fewer_points() -> None:
    assert [stretches_on_page(n) for n in (1, 45, 10_000)] == [2000, 1000, 150]


def test_every_role_has_a_colour_by_day_and_by_night() -> None:
    assert set(PALETTE) == set(Role)
    for shade in PALETTE.values():
        assert all(re.fullmatch("#[0-9a-f]{6}([0-9a-f]{2})?", colour) for colour in (shade.light, shade.dark))
    assert css_variable(Role.MODEL_1) == "--model-1"
