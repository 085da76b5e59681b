"""What a figure shows, as data: panels of curves, points, bars and bands over named axes with units.

A figure is built once, from results, by the functions of `greybox.show.figures`. `greybox.show.figures.matplotlib_backend` draws it as PNG
and SVG, `greybox.show.figures.plotly_backend` for a page; neither adds anything to what is shown. Colours are given by the role that a
series plays, `greybox.show.figures.figure` turns roles into colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TypeAlias

import numpy as np


class Role(StrEnum):
    """What a series is in its figure; the style gives each role its colour."""

    MEASURED = "measured"
    SIMULATED = "simulated"
    RESIDUAL = "residual"
    OUTPUT = "output"
    INPUT = "input"
    STATE = "state"
    BASELINE = "baseline"
    """The model before an effect was added."""
    EXTENDED = "extended"
    """The model with the effect; also the chosen one of several candidates."""
    SURROGATE = "surrogate"
    """A curve or tone in place of an unknown effect."""
    RIVAL = "rival"
    """A candidate that explains the records as well as the chosen one."""
    OTHER = "other"
    """Anything beside which another series matters more."""
    NOISE = "noise"
    BAND = "band"
    """The surface between two limits."""
    REFERENCE = "reference"
    """Lines and points that the eye compares with."""
    MODEL_1 = "model-1"
    MODEL_2 = "model-2"
    MODEL_3 = "model-3"
    MODEL_4 = "model-4"
    MODEL_5 = "model-5"
    MODEL_6 = "model-6"
    MODEL_7 = "model-7"
    MODEL_8 = "model-8"


MODELS = tuple(role for role in Role if role.startswith("model-"))


class Dash(StrEnum):
    """How a line is drawn; Plotly's names."""

    SOLID = "solid"
    DASHED = "dash"
    DOTTED = "dot"


class Symbol(StrEnum):
    """The mark of a point."""

    CIRCLE = "circle"
    DIAMOND = "diamond"
    SQUARE = "square"
    CROSS = "cross"


class Thinning(StrEnum):
    """How a curve of many points is drawn with fewer."""

    NONE = "none"
    ENVELOPE = "envelope"
    """By the smallest and the largest value of each stretch of a record."""
    PEAKS = "peaks"
    """By the largest value of each stretch of a spectrum, the stretches equally wide on a logarithmic axis."""


class Scale(StrEnum):
    """How numbers lie along an axis; Plotly's names but for ``CATEGORY``, where names stand in place of numbers."""

    LINEAR = "linear"
    LOG = "log"
    CATEGORY = "category"


class Height(StrEnum):
    """How tall a panel is; the style says what that means on paper and on a page."""

    LOW = "low"
    MEDIUM = "medium"
    TALL = "tall"
    PER_CATEGORY = "per category"
    """So much for each name on its vertical axis."""


@dataclass(frozen=True)
class Axis:
    """One axis of a panel.

    Parameters
    ----------
    name
        The quantity, for instance ``"time"``.
    unit
        Its unit as print has it, empty where there is none.
    scale
        How numbers lie along it.
    limits
        Where it begins and ends, in its own unit; from the data where left out.
    still_limits
        Limits for a picture only: on a page, where the reader can zoom, the axis shows all data.
    reversed
        The first category stands on top.
    spacing
        Between its numbers, where round steps would be the wrong ones (90 degrees).
    """

    name: str = ""
    unit: str = ""
    scale: Scale = Scale.LINEAR
    limits: tuple[float, float] | None = None
    still_limits: tuple[float, float] | None = None
    reversed: bool = False
    spacing: float | None = None

    @property
    def label(self) -> str:
        """``x [µm]``; without brackets where there is no unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True, eq=False)
class SampledSignal:
    """A residual (N,) that is sampled evenly, for a spectrum that follows the zoom.

    Parameters
    ----------
    figure
        Name of the figure in whose time axis the reader zooms.
    start, step
        Time of the first value and between values, in s.
    values
        The residual (N,) in the unit of the spectrum's curve, NaN in gaps.
    """

    figure: str
    start: float
    step: float
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class Curve:
    """A line through ``x`` (N,) and ``y`` (N,), broken where one of them is NaN.

    ``width`` in points; ``held``: each value until the next, as steps.
    """

    x: np.ndarray
    y: np.ndarray
    role: Role
    label: str = ""
    width: float = 1.2
    dash: Dash = Dash.SOLID
    thinning: Thinning = Thinning.NONE
    signal: SampledSignal | None = None
    held: bool = False


@dataclass(frozen=True, eq=False)
class Points:
    """Marks at ``x`` (N,) and ``y`` (N,), numbers or categories.

    ``half_bars`` (N,): lengths of the error bars to both sides along the vertical axis; ``texts`` stand to the right of the marks;
    ``hollow`` marks are filled with the ground; ``joined`` by a thin line.
    """

    x: np.ndarray | Sequence[str]
    y: np.ndarray | Sequence[str]
    role: Role
    label: str = ""
    size: float = 5.0
    symbol: Symbol = Symbol.CIRCLE
    opacity: float = 1.0
    half_bars: np.ndarray | None = None
    texts: Sequence[str] = ()
    hollow: bool = False
    joined: bool = False


@dataclass(frozen=True, eq=False)
class Bars:
    """Bars from zero to ``lengths`` (N,) at ``places``, numbers or categories.

    ``roles`` (one for each bar); ``texts`` stand behind the ends; ``remarks`` are shown where the reader points at a bar. ``width`` (one
    number, or N) along the axis of the places.
    """

    places: np.ndarray | Sequence[str]
    lengths: np.ndarray
    roles: Sequence[Role]
    label: str = ""
    horizontal: bool = False
    width: float | np.ndarray = 0.6
    texts: Sequence[str] = ()
    remarks: Sequence[str] = ()


@dataclass(frozen=True)
class Band:
    """The surface from ``low`` to ``high`` across the whole panel."""

    low: float
    high: float
    role: Role = Role.BAND
    label: str = ""


@dataclass(frozen=True, eq=False)
class Area:
    """The surface between ``low`` (N,) and ``high`` (N,) over ``x`` (N,)."""

    x: np.ndarray
    low: np.ndarray
    high: np.ndarray
    role: Role = Role.BAND
    label: str = ""


@dataclass(frozen=True)
class Reference:
    """A straight line across the panel at ``value``; ``upright`` at a value of the horizontal axis."""

    value: float
    upright: bool = False
    role: Role = Role.REFERENCE
    label: str = ""
    dash: Dash = Dash.SOLID
    width: float = 0.8


@dataclass(frozen=True, eq=False)
class Heatmap:
    """A square of numbers (n, n) from -1 to 1, each with its value; NaN is left empty."""

    values: np.ndarray
    names: Sequence[str]


Series: TypeAlias = Curve | Points | Bars | Band | Area | Reference | Heatmap


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes and what is drawn in it.

    Parameters
    ----------
    name
        What tells it from the other panels of its figure: an output, a channel, a record.
    series
        From the back to the front.
    x, y
        The axes.
    titles
        What is to be read above it in a picture.
    alarm
        The titles tell of an alarm: they stand out.
    equal_scales
        A unit is as long on one axis as on the other.
    listing
        Labels in the order of the legend, where that is not the order of the series.
    """

    name: str
    series: tuple[Series, ...]
    x: Axis
    y: Axis
    titles: tuple[str, ...] = ()
    alarm: bool = False
    height: Height = Height.MEDIUM
    equal_scales: bool = False
    listing: tuple[str, ...] = ()

    @property
    def labels(self) -> tuple[str, ...]:
        """The entries of its legend, in their order: those that are listed, then the others."""
        drawn = [s.label for s in self.series if not isinstance(s, (Bars, Heatmap)) and s.label]
        listed = self.listing
        return tuple(sorted(drawn, key=lambda label: listed.index(label) if label in listed else len(listed)))

    @property
    def columns(self) -> list[str]:
        """The names on its horizontal axis, in the order in which they come first; none where it has numbers."""
        if self.x.scale is not Scale.CATEGORY:
            return []
        named = (s.x for s in self.series if isinstance(s, Points))
        return list(dict.fromkeys(str(name) for names in named for name in names))

    @property
    def categories(self) -> list[str]:
        """The names on its vertical axis, in the order in which they come first; none where it has numbers."""
        if self.y.scale is not Scale.CATEGORY:
            return []
        named = (
            s.names if isinstance(s, Heatmap) else s.places if isinstance(s, Bars) else s.y
            for s in self.series
            if isinstance(s, (Heatmap, Bars, Points))
        )
        return list(dict.fromkeys(str(name) for names in named for name in names))

    def between(self, low: float, high: float) -> Panel:
        """The part of a panel over time from ``low`` to ``high``, all its curves and areas cut there."""
        return replace(self, series=tuple(_between(s, low, high) for s in self.series))


@dataclass(frozen=True, eq=False)
class Figure:
    """What one figure shows: its panels, of which a page shows one at a time, and what there is to know of it.

    Parameters
    ----------
    name
        Its address within a page, and the name of its file.
    panels
        At least one; a page offers a button for each.
    caption
        What it shows, in a sentence.
    description
        What is to be seen, for a reader who does not see it.
    """

    name: str
    panels: tuple[Panel, ...]
    caption: str
    description: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Panel:
        """The panel of this name."""
        return next(panel for panel in self.panels if panel.name == name)


def _between(series: Series, low: float, high: float) -> Series:
    if not isinstance(series, (Curve, Area)):
        return series
    rows = (series.x >= low) & (series.x <= high)
    if isinstance(series, Area):
        return replace(series, x=series.x[rows], low=series.low[rows], high=series.high[rows])
    return replace(series, x=series.x[rows], y=series.y[rows])
