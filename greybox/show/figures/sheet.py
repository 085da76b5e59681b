"""Panels put together on one picture, still as data: which panel stands where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from greybox.base.figure import Panel, Role


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


# How figures look: the colour of each role by day and by night.


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
