"""Sheets as pictures: numbers that fit, nothing that overlaps or leaves the page, and files drawn no more often than needed."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure as Picture
from matplotlib.text import Text

from greybox.base.figure import (
    Area,
    Axis,
    Band,
    Bars,
    Curve,
    Heatmap,
    Panel,
    Points,
    Reference,
    Role,
    Scale,
    Symbol,
    Thinning,
)
from greybox.show.figures.figure import PALETTE, Cell, Sheet
from greybox.show.figures.matplotlib_backend import draw_sheet, save_sheet

HEADING = "Validation record test: free run of every model"


def curve(x: list[float], y: list[float], label: str = "", **more) -> Curve:
    return Curve(np.array(x), np.array(y), Role.MEASURED, label, **more)


def sheet(*panels: Panel, **more) -> Sheet:
    cells = tuple(Cell(panel, k // 2, k % 2) for k, panel in enumerate(panels))
    rows = (len(panels) + 1) // 2
    return Sheet("test", cells, HEADING, (11, 3 * rows), (1.5, 1.0), (1.0,) * rows, **more)


@pytest.fixture(scope="module")
def picture() -> Picture:
    """Four panels with names and numbers of very different widths."""
    log, names = Axis("frequency", "Hz", Scale.LOG), Axis(scale=Scale.CATEGORY, reversed=True)
    effects = ["viscoelastic_creep + position_dependent_volume", "one"]
    drawn = draw_sheet(
        sheet(
            Panel("wide", (curve([1e5, 1e5 + 0.05], [-3e-9, 2e-9], "measured"),), Axis("time", "s"), Axis("x", "m")),
            Panel("log", (curve([0.2, 50.0], [1.0, 6e-5], "noise"),), log, Axis("amplitude", "µm", Scale.LOG)),
            Panel("bars", (Bars(effects, np.array([1.0, 30.0]), [Role.OTHER] * 2, horizontal=True),), log, names),
            Panel("tall", (curve([0.0, 1.0], [-123_456.0, 3.0]),), Axis("time", "s"), Axis("force", "N")),
        )
    )
    drawn.draw_without_rendering()
    return drawn


def test_no_text_leaves_the_page_or_lies_on_another(picture: Picture) -> None:
    hidden = {
        tick.label1
        for axes in picture.axes
        for axis in (axes.xaxis, axes.yaxis)
        for tick in axis.get_major_ticks()
        if not min(axis.get_view_interval()) <= tick.get_loc() <= max(axis.get_view_interval())
    }
    texts = [t for t in picture.findobj(Text) if t.get_visible() and t.get_text().strip() and t not in hidden]
    boxes = {t: t.get_window_extent() for t in texts}
    assert len(boxes) > 25
    for text, box in boxes.items():
        assert 0 <= box.x0 < box.x1 <= picture.bbox.x1 and 0 <= box.y0 < box.y1 <= picture.bbox.y1, text.get_text()
    for one, other in combinations(boxes, 2):
        assert not boxes[one].overlaps(boxes[other]), f"{one.get_text()!r} lies on {other.get_text()!r}"


def test_panels_lie_side_by_side(picture: Picture) -> None:
    places = [axes.get_position() for axes in picture.axes]
    for one, other in combinations(places, 2):
        assert not one.overlaps(other)
    assert places[0].width == pytest.approx(1.5 * places[1].width)


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.18, 60.0, ["0.2", "0.5", "1", "2", "5", "10", "20", "50"]),
        (8e-7, 3e-2, ["1·10⁻⁶", "1·10⁻⁵", "0.0001", "0.001", "0.01"]),
        (0.8, 5.2, ["1", "2", "3", "4", "5"]),
    ],
)
def test_a_logarithmic_axis_has_decades_and_more_where_they_fit(low: float, high: float, expected: list[str]) -> None:
    axis = Axis("f", "Hz", Scale.LOG, (low, high))
    axes = draw_sheet(sheet(Panel("p", (curve([low, high], [0.0, 1.0]),), axis, Axis("y")))).axes[0]
    axes.figure.draw_without_rendering()
    shown = [(v, t.get_text()) for v, t in zip(axes.get_xticks(), axes.get_xticklabels(), strict=True)]
    assert [text for v, text in shown if low <= v <= high] == expected


def test_every_kind_of_series_is_drawn_with_the_colour_of_its_role() -> None:
    x = np.array([0.0, 1.0, 2.0])
    series = (
        Band(-1.0, 1.0, label="band"),
        Area(x, x - 1, x + 1, label="area"),
        Reference(0.5, upright=True),
        Bars(x, x, [Role.OUTPUT] * 3),
        Points(x, x, Role.STATE, "points", symbol=Symbol.SQUARE, half_bars=0.1 * x, texts=["a", "b", "c"], joined=True),
        Curve(x, x**2, Role.SIMULATED, "curve"),
    )
    axes = draw_sheet(sheet(Panel("p", series, Axis("t"), Axis("y")))).axes[0]
    drawn = {line.get_color() for line in axes.lines}
    assert {PALETTE[role].light for role in (Role.SIMULATED, Role.STATE, Role.REFERENCE)} <= drawn
    assert [t.get_text().strip() for t in axes.texts] == ["a", "b", "c"]
    assert len(axes.patches) == 4 and len(axes.collections) == 2
    legend = [t.get_text() for t in axes.figure.legends[0].get_texts()]
    assert legend == ["band", "area", "points", "curve"]


def test_a_heatmap_has_its_numbers() -> None:
    values = np.array([[1.0, -0.5], [-0.5, np.nan]])
    panel = Panel("h", (Heatmap(values, ["a", "b"]),), Axis(), Axis(scale=Scale.CATEGORY, reversed=True))
    axes = draw_sheet(sheet(panel)).axes[0]
    assert [t.get_text() for t in axes.texts] == ["1.00", "−0.50", "−0.50"]
    assert [t.get_text() for t in axes.get_yticklabels()] == ["a", "b"]


def test_a_window_shows_its_rows_alone_and_long_curves_are_thinned() -> None:
    x = np.arange(10_000.0)
    panel = Panel("p", (Curve(x, x, Role.MODEL_1, thinning=Thinning.ENVELOPE),), Axis("t"), Axis("y"))
    whole, part = Cell(panel, 0), Cell(panel, 0, 1, window=(100.0, 199.0))
    axes = draw_sheet(Sheet("s", (whole, part), HEADING, (8, 3), (1.0, 1.0))).axes
    assert len(axes[0].lines[0].get_xdata()) == 3000
    np.testing.assert_array_equal(axes[1].lines[0].get_xdata(), np.arange(100.0, 200.0))


def test_a_warning_above_a_panel_stands_out() -> None:
    titles, colours = ("whiteness (p = 1e-09): memory over 20 samples",), []
    for alarm in (False, True):
        axes = draw_sheet(sheet(Panel("p", (curve([0, 1], [0, 1]),), Axis("t"), Axis("y"), titles, alarm))).axes[0]
        colours.append(axes._left_title.get_color())
    assert colours == [PALETTE[Role.REFERENCE].light, PALETTE[Role.SIMULATED].light]


@pytest.mark.rest
def test_each_file_is_drawn_once_and_equal_sheets_are_equal_files(tmp_path: Path, monkeypatch) -> None:
    draws = []
    draw = Picture.draw
    monkeypatch.setattr(Picture, "draw", lambda self, renderer: draws.append(1) or draw(self, renderer))
    for name in ("one", "two"):
        save_sheet(
            sheet(Panel("p", (curve([0, 1], [1e4, -1e4]),), Axis("t"), Axis("a name"))), tmp_path / f"{name}.png"
        )
    assert len(draws) == 6
    for kind in ("png", "svg", "pdf"):
        assert (tmp_path / f"one.{kind}").read_bytes() == (tmp_path / f"two.{kind}").read_bytes()


def test_a_closer_look_cuts_curves_and_areas_alike() -> None:
    x = np.arange(5.0)
    panel = Panel("p", (Area(x, x - 1, x + 1), curve(list(x), list(x))), Axis("t"), Axis("y")).between(1.0, 2.0)
    area, line = panel.series
    assert isinstance(area, Area) and isinstance(line, Curve)
    assert area.x.tolist() == line.x.tolist() == [1.0, 2.0]
    assert area.low.tolist() == [0.0, 1.0] and area.high.tolist() == [2.0, 3.0]


def test_a_legend_lists_the_labels_in_the_order_of_the_panel() -> None:
    series = (curve([0, 1], [0, 1], "last"), curve([0, 1], [1, 0], "first"))
    picture = draw_sheet(sheet(Panel("p", series, Axis("t"), Axis("y"), listing=("first", "last"))))
    assert [text.get_text() for text in picture.legends[0].get_texts()] == ["first", "last"]


def test_names_stand_below_the_points_of_a_horizontal_axis_of_names() -> None:
    names = Points(["K", "B"], np.array([1.0, 2.0]), Role.OTHER, half_bars=np.array([0.1, 0.1]))
    later = Points(["B"], np.array([2.0]), Role.BASELINE)
    panel = Panel("changes", (names, later), Axis(scale=Scale.CATEGORY), Axis("change", "%"))
    (axes,) = draw_sheet(sheet(panel)).axes
    assert [t.get_text() for t in axes.get_xticklabels()] == ["K", "B"]
    assert axes.lines[-1].get_xdata().tolist() == [1.0]


def test_a_name_along_an_axis_is_no_longer_than_its_panel() -> None:
    name = "missing at the balance substrate in the second reactor"
    panel = Panel("long", (curve([0.0, 1.0], [0.0, 1.0]),), Axis("time", "s"), Axis(name, "mmol/(L s)"))
    drawn = draw_sheet(Sheet("test", (Cell(panel, 0),), "", (5.6, 3.6)))
    drawn.draw_without_rendering()
    (axes,) = drawn.axes
    label = axes.yaxis.label
    assert label.get_text().replace("\n", " ") == f"{name} [mmol/(L\u00a0s)]"
    assert label.get_window_extent().height <= axes.get_window_extent().height
