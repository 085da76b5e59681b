"""Panels put together on one picture, still as data: which panel stands where."""

from __future__ import annotations

from dataclasses import dataclass

from greybox.findings import Finding
from greybox.plots.figure import Panel


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
    titles: tuple[Finding, ...] = ()
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
    heading: Finding
    size: tuple[float, float]
    widths: tuple[float, ...] = (1.0,)
    heights: tuple[float, ...] = (1.0,)
