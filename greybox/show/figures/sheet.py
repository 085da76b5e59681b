"""Panels put together on one picture, still as data: which panel stands where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from greybox.base.figure import Height, Panel, Role


@dataclass(frozen=True, eq=False)
class Cell:
    """A panel at ``row`` and ``column`` (from 0), ``rows`` high.

    ``window``: only the part of it over time from ... to, in s; ``titles`` in place of its own; ``above_another``: it shares the
    horizontal axis with the panel below, which has the numbers.
    """

    panel: Panel
    row: int
    column: int = 0
    rows: int = 1
    window: tuple[float, float] | None = None
    titles: tuple[str, ...] = ()
    above_another: bool = False


@dataclass(frozen=True, eq=False)
class Sheet:
    """One picture.

    Parameters
    ----------
    name
        Of its file, without what no file may be called.
    cells
        The panels and their places.
    heading
        What stands above all of them.
    size
        Width and height in inches.
    widths, heights
        Shares of the columns and of the rows; equal where left out.
    """

    name: str
    cells: tuple[Cell, ...]
    heading: str
    size: tuple[float, float]
    widths: tuple[float, ...] = (1.0,)
    heights: tuple[float, ...] = (1.0,)


# How figures look: the colour of each role by day and by night, sizes, and how many points a curve has.


@dataclass(frozen=True)
class Shade:
    """A colour on white paper and on a dark screen, as CSS writes it."""

    light: str
    dark: str


RED, BLUE, GREY = Shade("#c0392b", "#ff7b6b"), Shade("#1f5a8a", "#79b8ff"), Shade("#8a8f96", "#9aa4af")
PURPLE, GREEN, ORANGE = Shade("#7a4fa3", "#c79bf2"), Shade("#18794e", "#5bd29b"), Shade("#b5651d", "#f0a868")
TEAL, PINK, SLATE = Shade("#0f7c8a", "#5cc8d6"), Shade("#9a3b6d", "#ee8fbe"), Shade("#4b5a67", "#a9b7c4")

# The colour of each role.
PALETTE: Mapping[Role, Shade] = MappingProxyType(
    {
        Role.MEASURED: GREY,
        Role.SIMULATED: RED,
        Role.RESIDUAL: BLUE,
        Role.OUTPUT: BLUE,
        Role.INPUT: GREEN,
        Role.STATE: PURPLE,
        Role.BASELINE: RED,
        Role.EXTENDED: GREEN,
        Role.SURROGATE: PURPLE,
        Role.RIVAL: ORANGE,
        Role.OTHER: GREY,
        Role.NOISE: Shade("#57606a", "#a5b0bc"),
        Role.BAND: Shade("#78828c38", "#a0afbe38"),
        Role.REFERENCE: Shade("#1b1f24", "#e6edf3"),
        Role.MODEL_1: RED,
        Role.MODEL_2: BLUE,
        Role.MODEL_3: PURPLE,
        Role.MODEL_4: GREEN,
        Role.MODEL_5: ORANGE,
        Role.MODEL_6: TEAL,
        Role.MODEL_7: PINK,
        Role.MODEL_8: SLATE,
    }
)


@dataclass(frozen=True)
class PictureStyle:
    """How matplotlib draws a picture."""

    dots_per_inch: int = 110
    """Of a PNG."""

    compression: int = 1
    """Of a PNG: higher levels save a tenth of its size and cost a fifth of the time to draw it."""

    stretches: int = 1500
    """Of a long record, each drawn by its smallest and its largest value: about the pixels of a wide panel."""

    line: float = 0.7
    """Points of a line, for each unit of its width on a page."""

    mark: float = 0.6
    """Points of a mark, for each unit of its size on a page."""

    numbers: float = 8.0
    """Points of the numbers on axes, of legends and of names beside bars."""

    names: float = 9.0
    """Points of the names of axes and of what stands above a panel."""

    heading: float = 11.0
    """Points of what stands above the picture."""

    title_width: int = 85
    """Characters of a title above one panel, from which it is broken."""

    grid_opacity: float = 0.25
    grid_width: float = 0.5
    """Points."""

    margin: float = 0.01
    """Share of the width that stays free beside a curve over time."""


@dataclass(frozen=True)
class PageStyle:
    """How a page shows figures."""

    heights: Mapping[Height, int] = field(
        default_factory=lambda: MappingProxyType({Height.LOW: 250, Height.MEDIUM: 290, Height.TALL: 360})
    )
    """Pixels of a figure."""

    frame: int = 110
    """Pixels above and below the names of a vertical axis."""

    per_category: int = 32
    """Pixels for each name on a vertical axis."""

    most_stretches: int = 2000
    """Of a long record, each drawn by its smallest and its largest value: as fine as a wide screen shows."""

    least_stretches: int = 150
    """Of each curve, even where a page has many."""

    stretches_of_a_page: int = 45_000
    """Of all its curves together, so that a page of many records can still be mailed."""

    points_of_a_cloud: int = 1500
    """At most, chosen evenly: more would hide one another."""

    longest_name: int = 34
    """Letters of a name beside a bar."""

    def stretches(self, curves: int) -> int:
        """Stretches for each of so many long curves of a page."""
        share = self.stretches_of_a_page // max(curves, 1)
        return min(max(share, self.least_stretches), self.most_stretches)


PICTURE, PAGE = PictureStyle(), PageStyle()
