"""Sheets as pictures: PNG to look at, SVG to print and to edit; panels in axes of others. The only module that imports matplotlib."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis as NumberedAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure as Picture
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, MultipleLocator, NullFormatter, NullLocator

from greybox.base import figure as fig
from greybox.base import write_file
from greybox.base.texts import to_lines
from greybox.show.figures.figure import PALETTE, Cell, Sheet, thin_curve, typeset_exponents, write_cell

MARKERS = {fig.Symbol.CIRCLE: "o", fig.Symbol.DIAMOND: "D", fig.Symbol.SQUARE: "s", fig.Symbol.CROSS: "x"}
LINES = {fig.Dash.SOLID: "-", fig.Dash.DASHED: "--", fig.Dash.DOTTED: ":"}
# Of a PNG.
DOTS_PER_INCH = 110
# Of a PNG: higher levels save a tenth of its size and cost a fifth of the time to draw it.
COMPRESSION = 1
# Of a long record, each drawn by its smallest and its largest value: about the pixels of a wide panel.
STRETCHES = 1500
# Points of a line for each unit of its width on a page, and of a mark for each unit of its size.
LINE_WIDTH, MARK_SIZE = 0.7, 0.6
# Points of the numbers on axes, of legends and of names beside bars.
NUMBER_SIZE = 8.0
# Points of the names of axes and of what stands above a panel, and of what stands above the picture.
NAME_SIZE, HEADING_SIZE = 9.0, 11.0
# Width of a letter over its size, on average, and inches beside a panel for the numbers and the name of its axis: a title is broken there.
LETTER_WIDTH, BESIDE_PANEL = 0.53, 0.8
# The grid: its opacity, and points of its lines.
GRID_OPACITY, GRID_WIDTH = 0.25, 0.5
# Share of the width that stays free beside a curve over time.
MARGIN = 0.01


def save_sheet(sheet: Sheet, png: Path) -> None:
    """Write a sheet as ``png`` and, with the same name, as SVG and PDF; equal sheets give equal files."""
    picture = draw_sheet(sheet)
    engine = picture.get_layout_engine()
    if engine is not None:  # once for all files
        engine.execute(picture)
        picture.set_layout_engine(None)
    compression = {"compress_level": COMPRESSION}
    write_file(png, lambda file: picture.savefig(file, format="png", dpi=DOTS_PER_INCH, pil_kwargs=compression))
    with rc_context({"svg.hashsalt": "greybox"}):
        write_file(png.with_suffix(".svg"), lambda file: picture.savefig(file, format="svg", metadata={"Date": None}))
    write_file(
        png.with_suffix(".pdf"), lambda file: picture.savefig(file, format="pdf", metadata={"CreationDate": None})
    )


def draw_sheet(sheet: Sheet) -> Picture:
    """A sheet as a figure of matplotlib. Texts are shown as they are: a dollar sign in a name begins no formula."""
    with rc_context({"text.parse_math": False}):
        picture = _draw_cells(sheet)
    for text in picture.findobj(Text):
        text.set_text(to_lines(text.get_text()))  # fonts have no control characters
    return picture


def draw_in_axes(panel: fig.Panel, axes: Axes | None) -> Axes:
    """Draw a panel with its legend into ``axes``; None makes them, in a figure that a notebook shows."""
    if axes is None:
        from matplotlib import pyplot  # chooses a window for all that is drawn: only where somebody wants one

        axes = pyplot.subplots(layout="constrained")[1]
    inches = axes.get_window_extent().transformed(axes.figure.dpi_scale_trans.inverted())
    with rc_context({"text.parse_math": False}):
        _draw_panel(
            axes, Cell(panel, 0), *(_letters(side + BESIDE_PANEL, NAME_SIZE) for side in (inches.width, inches.height))
        )
        if len(panel.labels) > 1:
            axes.legend(fontsize=NUMBER_SIZE, frameon=False)
    return axes


def _draw_cells(sheet: Sheet) -> Picture:
    picture = Picture(figsize=sheet.size, dpi=DOTS_PER_INCH, layout="constrained")
    FigureCanvasAgg(picture)
    picture.suptitle(fill(sheet.heading, _letters(sheet.size[0], HEADING_SIZE)), fontsize=HEADING_SIZE)
    grid = picture.add_gridspec(
        len(sheet.heights), len(sheet.widths), height_ratios=sheet.heights, width_ratios=sheet.widths
    )
    entries: dict[str, Artist] = {}
    for cell in sheet.cells:
        axes = picture.add_subplot(grid[cell.row : cell.row + cell.rows, cell.column])
        share = sheet.widths[cell.column] / sum(sheet.widths)
        high = sum(sheet.heights[cell.row : cell.row + cell.rows]) / sum(sheet.heights)
        _draw_panel(axes, cell, *(_letters(side, NAME_SIZE) for side in (sheet.size[0] * share, sheet.size[1] * high)))
        handles, labels = axes.get_legend_handles_labels()
        drawn = dict(zip(labels, handles, strict=True))
        entries |= {label: drawn[label] for label in cell.panel.labels if label in drawn and label not in entries}
    if entries:
        picture.legend(
            entries.values(),
            entries.keys(),
            loc="outside lower center",
            ncols=len(entries),
            fontsize=NUMBER_SIZE,
            frameon=False,
        )
    picture.align_ylabels()
    return picture


def _letters(width: float, size: float) -> int:
    """Letters of so many points that find room along a panel of so many inches, with its axis."""
    return max(int((width - BESIDE_PANEL) * 72 / (LETTER_WIDTH * size)), 10)


def _draw_panel(axes: Axes, cell: Cell, letters: int, upward: int) -> None:
    panel = cell.panel if cell.window is None else cell.panel.between(*cell.window)
    axes.set_xscale("log" if panel.x.scale is fig.Scale.LOG else "linear")
    axes.set_yscale("log" if panel.y.scale is fig.Scale.LOG else "linear")
    for series in panel.series:
        _draw(axes, series, panel)
    if all(isinstance(s, (fig.Curve, fig.Area, fig.Band, fig.Reference)) for s in panel.series):
        axes.margins(x=MARGIN)
    if panel.equal_scales:
        axes.set_aspect("equal", adjustable="datalim")
    _set_up(axes.xaxis, axes.set_xlim, panel.x, panel.columns)
    _set_up(axes.yaxis, axes.set_ylim, panel.y, panel.categories)
    # A unit is not broken: fill breaks at no space that holds its neighbours together.
    name, bracket, unit = panel.y.label.partition("[")
    axes.set_ylabel(fill(name + bracket + unit.replace(" ", "\u00a0"), upward), fontsize=NAME_SIZE)
    axes.grid(axis="x" if panel.categories else "both", alpha=GRID_OPACITY, lw=GRID_WIDTH)
    axes.set_axisbelow(True)
    if cell.above_another:
        axes.set_xlabel("")
        axes.tick_params(labelbottom=False)
    titles = cell.titles or panel.titles
    if titles:
        text = "\n".join(fill(title, letters) for title in titles)
        colour = _colour(fig.Role.SIMULATED if panel.alarm else fig.Role.REFERENCE)
        axes.set_title(text, loc="left", fontsize=NAME_SIZE, color=colour)


def _set_up(axis: NumberedAxis, set_limits: Callable[..., object], spec: fig.Axis, categories: Sequence[str]) -> None:
    """Name, numbers and limits of one axis."""
    axis.set_label_text(spec.label, fontsize=NAME_SIZE)
    axis.set_tick_params(labelsize=NUMBER_SIZE)
    limits = spec.limits or spec.still_limits
    if limits is not None:
        set_limits(*limits)
    if categories:
        axis.set_ticks(range(len(categories)), list(map(to_lines, categories)))
    if spec.scale is fig.Scale.LOG:
        _number_decades(axis)
    elif spec.spacing is not None:
        axis.set_major_locator(MultipleLocator(spec.spacing))
    if spec.reversed:
        axis.set_inverted(True)


def _number_decades(axis: NumberedAxis) -> None:
    """Numbers on a logarithmic axis: 1, 2, 5 and their powers of ten; round numbers where it spans less than a decade."""
    low, high = sorted(axis.get_view_interval())
    decades = math.log10(high / low)
    round_numbers = MaxNLocator(6, steps=[1, 2, 2.5, 5, 10])
    axis.set_major_locator(
        round_numbers if decades < 1 else LogLocator(subs=(1.0, 2.0, 5.0) if decades < 3 else (1.0,))
    )
    axis.set_major_formatter(FuncFormatter(lambda v, _: typeset_exponents(f"{v:.6g}").replace("-", "−")))
    axis.set_minor_locator(NullLocator() if decades < 1 else LogLocator(subs=tuple(range(2, 10))))
    axis.set_minor_formatter(NullFormatter())


def _draw(axes: Axes, series: fig.Series, panel: fig.Panel) -> None:
    match series:
        case fig.Curve():
            _draw_curve(axes, series)
        case fig.Points():
            _draw_points(axes, series, panel)
        case fig.Bars():
            _draw_bars(axes, series, panel)
        case fig.Band():
            axes.axhspan(series.low, series.high, color=_colour(series.role), lw=0, label=series.label or None)
        case fig.Area():
            axes.fill_between(
                series.x, series.low, series.high, color=_colour(series.role), lw=0, label=series.label or None
            )
        case fig.Reference():
            draw = axes.axvline if series.upright else axes.axhline
            colour, width = _colour(series.role), LINE_WIDTH * series.width
            draw(series.value, color=colour, lw=width, ls=LINES[series.dash], label=series.label or None)
        case fig.Heatmap():
            ends = [_colour(fig.Role.RESIDUAL), "white", _colour(fig.Role.SIMULATED)]
            axes.imshow(series.values, cmap=LinearSegmentedColormap.from_list("correlation", ends), vmin=-1, vmax=1)
            axes.set_xticks(range(len(series.names)), series.names)
            for (row, column), value in np.ndenumerate(series.values):
                if np.isfinite(value):
                    axes.text(column, row, write_cell(value), ha="center", va="center", fontsize=NUMBER_SIZE)


def _draw_curve(axes: Axes, curve: fig.Curve) -> None:
    x, y = thin_curve(curve.x, curve.y, curve.thinning, STRETCHES)
    axes.plot(
        x,
        y,
        color=_colour(curve.role),
        lw=LINE_WIDTH * curve.width,
        ls=LINES[curve.dash],
        label=curve.label or None,
        drawstyle="steps-post" if curve.held else "default",
    )


def _draw_points(axes: Axes, points: fig.Points, panel: fig.Panel) -> None:
    colour = _colour(points.role)
    x, y = _places(points.x, panel.columns), _places(points.y, panel.categories)
    if points.half_bars is not None:
        axes.errorbar(x, y, points.half_bars, fmt="none", ecolor=colour, elinewidth=LINE_WIDTH)
    axes.plot(
        x,
        y,
        color=colour,
        ls="-" if points.joined else "none",
        lw=LINE_WIDTH,
        marker=MARKERS[points.symbol],
        ms=MARK_SIZE * points.size,
        mfc="white" if points.hollow else colour,
        mec=colour,
        mew=LINE_WIDTH * points.hollow,
        alpha=points.opacity,
        label=points.label or None,
    )
    for place, text in zip(zip(x, y, strict=True), points.texts, strict=bool(points.texts)):
        # Beside the largest marker, which another series may have put there.
        axes.annotate(f"    {text}", place, va="center", fontsize=NUMBER_SIZE)


def _draw_bars(axes: Axes, bars: fig.Bars, panel: fig.Panel) -> None:
    places, colours = _places(bars.places, panel.categories), [_colour(role) for role in bars.roles]
    if bars.horizontal:
        axes.barh(places, bars.lengths, height=bars.width, color=colours)
    else:
        axes.bar(places, bars.lengths, width=bars.width, color=colours)
    for place, length, text in zip(places, bars.lengths, bars.texts, strict=False):
        axes.annotate(f"  {text}", (np.nan_to_num(length), place), va="center", fontsize=NUMBER_SIZE)


def _places(values: np.ndarray | Sequence[str], names: Sequence[str]) -> np.ndarray:
    """Where numbers or the ``names`` of an axis are drawn."""
    if isinstance(values, np.ndarray):
        return values
    place = {name: k for k, name in enumerate(names)}
    return np.array([place[name] for name in values], dtype=float)


def _colour(role: fig.Role) -> str:
    return PALETTE[role].light
