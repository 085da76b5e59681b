"""Panels with computed places: numbers that fit, nothing that overlaps or leaves the page, and pictures drawn no more often than needed."""

from __future__ import annotations

import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from greybox.plots.files import save_figure
from greybox.plots.layout import legends, panels, settle
from greybox.plots.ticks import linear_ticks, log_lines, log_ticks


@pytest.mark.parametrize(
    ("low", "high", "most", "expected"),
    [
        (-1.05, 1.05, 4, ["−1", "0", "1"]),
        (-1.05, 1.05, 5, ["−1.0", "−0.5", "0.0", "0.5", "1.0"]),
        (0.0, 0.52, 6, ["0.0", "0.1", "0.2", "0.3", "0.4", "0.5"]),
        (0.0, 0.52, 3, ["0.0", "0.2", "0.4"]),
        (100_000.01, 100_000.05, 5, ["100000.01", "100000.02", "100000.03", "100000.04", "100000.05"]),
        (0.0, 4.4e7, 3, ["0", "2·10⁷", "4·10⁷"]),
        (-2.2e-9, 0.0, 3, ["−2·10⁻⁹", "−1·10⁻⁹", "0"]),
    ],
)
def test_an_even_axis_has_round_numbers_as_print_has_them(low, high, most, expected) -> None:
    ticks, texts = linear_ticks(low, high, most)
    assert texts == expected
    assert len(ticks) == len(texts)
    assert np.all((ticks >= low) & (ticks <= high))


@pytest.mark.parametrize(
    ("low", "high", "most", "expected"),
    [
        (0.18, 60.0, 9, ["0.2", "0.5", "1", "2", "5", "10", "20", "50"]),
        (0.18, 60.0, 4, ["1", "10"]),
        (8e-7, 3e-2, 9, ["1·10⁻⁶", "1·10⁻⁵", "0.0001", "0.001", "0.01"]),
        (8e-7, 3e-2, 3, ["1·10⁻⁶", "0.0001", "0.01"]),
        (0.8, 5.2, 9, ["1", "2", "3", "5"]),
        (0.8, 2.2, 4, ["1.0", "1.5", "2.0"]),
    ],
)
def test_a_logarithmic_axis_has_decades_and_more_where_they_fit(low, high, most, expected) -> None:
    ticks, texts = log_ticks(low, high, most)
    assert texts == expected
    assert len(ticks) <= most
    assert np.all((ticks >= low) & (ticks <= high))


def test_the_finer_lines_of_a_logarithmic_axis_are_all_multiples() -> None:
    assert log_lines(0.35, 30.0) == pytest.approx([*np.arange(0.4, 0.95, 0.1), *range(1, 11), 20, 30])


@pytest.fixture(scope="module")
def sheet() -> Figure:
    """Four panels with names and numbers of very different widths."""
    figure, axes = panels(11, 6, rows=2, columns=2)
    (wide, spectrum), (bars, tall) = axes
    wide.plot([1e5, 1e5 + 0.05], [-3e-9, 2e-9], label="measured")
    spectrum.loglog([0.2, 50.0], [1.0, 6e-5], label="noise")
    bars.barh([0, 1], [1.0, 30.0])
    bars.set_yticks([0, 1], ["viscoelastic_creep + position_dependent_volume", "one"])
    bars.set_xscale("log")
    tall.plot([0.0, 1.0], [-123_456.0, 3.0])
    for axis in axes.ravel():
        axis.set_xlabel("frequency [Hz]", fontsize=9)
        axis.set_ylabel("amplitude a line [µm]", fontsize=9)
    legends(wide, spectrum)
    settle(figure, axes, "a heading over all of them", widths=(1.5, 1), above=1)
    return figure


def test_no_text_leaves_the_page_or_lies_on_another(sheet: Figure) -> None:
    sheet.draw_without_rendering()
    texts = [t for t in sheet.findobj(Text) if t.get_visible() and t.get_text().strip()]
    boxes = {t: t.get_window_extent() for t in texts}
    assert len(boxes) > 30
    for text, box in boxes.items():
        assert 0 <= box.x0 < box.x1 <= sheet.bbox.x1 and 0 <= box.y0 < box.y1 <= sheet.bbox.y1, text.get_text()
    for one, other in combinations(boxes, 2):
        assert not boxes[one].overlaps(boxes[other]), f"{one.get_text()!r} lies on {other.get_text()!r}"


def test_panels_lie_side_by_side(sheet: Figure) -> None:
    places = [axis.get_position() for axis in sheet.axes]
    for one, other in combinations(places, 2):
        assert not one.overlaps(other)
    assert places[0].width == pytest.approx(1.5 * places[1].width)
    assert places[0].height == pytest.approx(places[3].height)


def test_each_file_is_drawn_once_and_equal_figures_are_equal_files(tmp_path: Path, monkeypatch) -> None:
    draws = []
    draw = Figure.draw
    monkeypatch.setattr(Figure, "draw", lambda self, renderer: draws.append(1) or draw(self, renderer))
    for name in ("one", "two"):
        figure = Figure(figsize=(3, 2), layout="constrained")
        axis = figure.subplots()
        axis.plot([0, 1], [1e4, -1e4])
        axis.set_ylabel("a name")
        save_figure(figure, tmp_path / f"{name}.png")
    assert len(draws) == 4
    figure.draw_without_rendering()
    assert axis.yaxis.label.get_window_extent().x0 > 0  # the layout was worked out, and without drawing
    for kind in ("png", "svg"):
        assert (tmp_path / f"one.{kind}").read_bytes() == (tmp_path / f"two.{kind}").read_bytes()


PROGRAM = """
import os, sys, threading
from pathlib import Path
from greybox.figures import several

several.cores = lambda: 2
here = os.getpid()
def note(name, fails=False):
    def job():
        Path(name).write_text(str(os.getpid()))
        if fails:
            raise ValueError(f"{name} by {'us' if os.getpid() == here else 'a copy'}")
    return job

several.both([note("a"), note("b"), note("c")])
print([Path(name).read_text() == str(here) for name in "abc"])
for jobs in ([note("d", True), note("e")], [note("d"), note("e", True)]):
    try:
        several.both(jobs)
    except ValueError as error:
        print(error, Path("e").read_text() == str(here))
    Path("e").unlink()
try:
    os.wait()
except ChildProcessError:
    print("no copy is left")
wait = threading.Event()
other = threading.Thread(target=wait.wait)
other.start()
several.both([note("f"), note("g")])
print(Path("g").read_text() == str(here))
wait.set()
"""


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="a process is copied on Linux only")
def test_half_of_the_pictures_are_drawn_in_a_copy_whose_failure_is_told_here(tmp_path: Path) -> None:
    run = subprocess.run([sys.executable, "-c", PROGRAM], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert run.stderr == ""
    assert run.stdout.splitlines() == [
        "[True, False, True]", "d by us False", "e by us True", "no copy is left", "True",
    ]  # fmt: skip
