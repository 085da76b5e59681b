"""Panels on a page, each at a place that follows from its texts: a layout engine would draw the page twice to find it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.ticker import FixedLocator, NullLocator

from greybox.plots.files import DPI
from greybox.plots.ticks import linear_ticks, log_lines, log_ticks

NUMBERS, NAMES, HEADING = 8, 9, 10  # points of the numbers on axes, of what the axes are, of what stands above
LINE, PAD = 0.2, 0.1  # inches for a line of text, and between texts
ROOM = 1.6  # inches that a number on an axis has for each inch of its text
APART, MOST = 0.35, 9  # inches between numbers that stand one above the other; numbers on an axis
DENSE = 1e10  # ratio of the ends of a logarithmic axis from which lines at all multiples would be a grey surface
FINE, FAINT = 0.5, 0.25  # width in points and opacity of the lines of a grid


def panels(width: float, height: float, *, rows: int = 1, columns: int = 1) -> tuple[Figure, np.ndarray]:
    """A page of ``width`` x ``height`` inches and its axes (rows, columns), to be drawn on and then put in place by `settle`."""
    figure = Figure(figsize=(width, height), dpi=DPI)
    axes = np.empty((rows, columns), dtype=object)
    for place in np.ndindex(rows, columns):
        axis = figure.add_axes((0, 0, 1, 1), label=str(place))
        axis.tick_params(labelsize=NUMBERS)
        axes[place] = axis
    return figure, axes


def settle(
    figure: Figure, axes: np.ndarray, heading: str, *, widths: Sequence[float] = (), above: float = 0, grid: bool = True
) -> None:
    """Put numbers on the ``axes`` (rows, columns), and everything in its place; to be called when all is drawn.

    ``heading`` stands over the page; ``widths`` are the shares of the columns, equal ones where none are given; ``above`` lines are
    left free over each row, for a title or a legend; ``grid`` draws fine lines at the numbers.
    """
    renderer = FigureCanvasAgg(figure).get_renderer()
    font = FontProperties(size=NUMBERS)

    def inches(text: str) -> float:
        return float(renderer.get_text_width_height_descent(text, font, False)[0]) / DPI

    page = figure.get_size_inches()
    under = 2 * LINE + 2 * PAD  # numbers and the name of an axis
    pitch = (page[1] - 2 * LINE) / len(axes)
    high = pitch - above * LINE - under
    beside = [max(_up(a.yaxis, high, inches) for a in column) + LINE + 3 * PAD for column in axes.T]
    shares = np.array(widths or np.ones(axes.shape[1]))
    wide = (page[0] - sum(beside) - 2 * PAD) * shares / shares.sum()
    for (row, column), axis in np.ndenumerate(axes):
        left, bottom = sum(beside[: column + 1]) + sum(wide[:column]), (len(axes) - row - 1) * pitch + under
        axis.set_position((left / page[0], bottom / page[1], wide[column] / page[0], high / page[1]))
        _across(axis.xaxis, wide[column], inches)
        axis.xaxis.set_label_coords(0.5, -(LINE + PAD) / high)
        axis.yaxis.set_label_coords(-(beside[column] - LINE - PAD) / wide[column], 0.5)
        if grid:
            _gridded(axis)
    figure.suptitle(heading, y=1 - PAD / page[1], va="top", fontsize=HEADING)


def legends(*axes: Axes, loc: Literal["lower left", "lower right"] = "lower left") -> None:
    """A legend in the line above each of the ``axes``, where no data are; ``loc`` says on which side."""
    corner = (float(loc == "lower right"), 1.0)
    for axis in axes:
        axis.legend(fontsize=NUMBERS, frameon=False, ncols=3, loc=loc, bbox_to_anchor=corner, borderaxespad=0.1)


def _up(axis: Axis, high: float, inches: Callable[[str], float]) -> float:
    """Numbers on an axis of ``high`` inches, one above the other; inches of the widest."""
    if not _named(axis):
        axis.set_ticks(*_ticks(axis, int(high / APART)))
    return max((inches(text.get_text()) for text in axis.get_ticklabels()), default=0.0)


def _across(axis: Axis, wide: float, inches: Callable[[str], float]) -> None:
    """Numbers on an axis of ``wide`` inches, side by side, as many as there is room for."""
    if _named(axis):
        return
    for most in range(MOST, 1, -1):
        ticks, texts = _ticks(axis, most)
        if ROOM * sum(map(inches, texts)) <= wide:
            break
    axis.set_ticks(ticks, texts)


def _named(axis: Axis) -> bool:
    """Whether the axis has names at its ticks, or numbers of its own."""
    return isinstance(axis.get_major_locator(), FixedLocator)


def _ticks(axis: Axis, most: int) -> tuple[np.ndarray, list[str]]:
    axis.set_minor_locator(NullLocator())
    low, high = sorted(axis.get_view_interval())
    return (log_ticks if axis.get_scale() == "log" else linear_ticks)(low, high, min(max(most, 2), MOST))


def _gridded(axis: Axes) -> None:
    """Lines at the numbers, and on a logarithmic axis at every multiple of a power of ten, these in one piece."""
    axis.grid(alpha=FAINT, lw=FINE)
    upright = [((v, 0), (v, 1)) for v in _fine(axis.xaxis)]
    level = [((0, v), (1, v)) for v in _fine(axis.yaxis)]
    for ends, transform in ((upright, axis.get_xaxis_transform()), (level, axis.get_yaxis_transform())):
        if ends:
            lines = LineCollection(ends, colors="#b0b0b0", alpha=FAINT, linewidths=FINE, zorder=0.5)
            lines.set_transform(transform)
            axis.add_collection(lines, autolim=False)


def _fine(axis: Axis) -> list[float]:
    low, high = sorted(axis.get_view_interval())
    return log_lines(low, high).tolist() if axis.get_scale() == "log" and high < DENSE * low else []
