"""Sizes, units and long curves as figures show them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from greybox.base import ROWS_AT_A_TIME, format_unit
from greybox.base.document import MOST_STRETCHES
from greybox.base.figure import Axis, Bars, Curve, Panel, Points, Role, Scale, Series, Symbol, Thinning
from greybox.show.sentences.wording import choose_prefix

# Size of the point that stands in the place of a bar on a logarithmic axis: as visible as the bar would be.
MARK_OF_SIZE = 11.0


def draw_sizes(
    names: Sequence[str],
    sizes: np.ndarray,
    roles: Sequence[Role],
    axis: Axis,
    label: str = "",
    texts: Sequence[str] = (),
) -> tuple[Series, ...]:
    """Sizes (N,) along a horizontal axis: bars from zero where it is linear, a point each where it is logarithmic and has no zero.

    What has no size is a cross at the edge of a logarithmic axis, with its text.
    """
    if axis.scale is not Scale.LOG:
        return (Bars(names, sizes, roles, label, horizontal=True, texts=texts),)
    behind = texts or [""] * len(names)
    edge = axis.limits[0] if axis.limits else np.nan
    return tuple(
        Points(
            np.array([size if np.isfinite(size) else edge]),
            [name],
            role,
            size=MARK_OF_SIZE,
            symbol=Symbol.CIRCLE if np.isfinite(size) else Symbol.CROSS,
            texts=[text] if text else (),
        )
        for name, size, role, text in zip(names, sizes, roles, behind, strict=True)
    )


# Ratio of the largest to the smallest error from which bars have a logarithmic axis.
LOG_FROM = 10.0
# Space behind the longest bar for its text, as a share of the bar: ``4.5 × noise`` fits into half the width of a page.
ROOM_FOR_TEXT = 0.6


def size_axis(name: str, unit: str, lengths: np.ndarray) -> Axis:
    """The axis along sizes (N,), with room for a text behind the largest; `draw_sizes` draws them.

    It begins at zero; where the sizes lie so far apart that the smallest could not be seen, it is logarithmic.
    """
    known = lengths[np.isfinite(lengths) & (lengths > 0)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (1.0, 1.0)
    if high <= LOG_FROM * low:
        return Axis(name, unit, limits=(0.0, (1 + ROOM_FOR_TEXT) * high))
    decades = np.log10(high / low)
    return Axis(name, unit, Scale.LOG, (low / 10 ** (0.15 * decades), high * 10 ** (ROOM_FOR_TEXT * decades)))


# Numbers and units as people read them on an axis: micrometres rather than 1e-6 m.

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
EXPONENT = re.compile(r"(\d+(?:\.\d+)?)e([+-])0*(\d+)")


def scale_to_prefix(unit: str, *signals: np.ndarray) -> tuple[float, str]:
    """Factor and unit in which the largest value of ``signals`` has one to three digits: ``(1e6, "µm")``."""
    largest = max((abs(end) for s in signals for end in value_range(s) if math.isfinite(end)), default=0.0)
    factor, prefix = choose_prefix(unit, largest)
    return factor, prefix + typeset_unit(unit)


def typeset_unit(unit: str) -> str:
    """A unit as print has it: ``N s/m²``, ``Ω``."""
    return raise_powers(format_unit(unit))


def raise_powers(unit: str) -> str:
    """A formatted unit with raised powers: ``N s/m²`` for ``N*s/m^2``."""
    return unit.replace("^2", "²").replace("^3", "³").replace("*", " ").replace("ohm", "Ω")


def typeset_exponents(text: str) -> str:
    """Numbers with their powers of ten as print has them: ``5e-04`` is 5·10⁻⁴, ``4e+01`` is 40."""
    return EXPONENT.sub(_typeset_exponent, text)


# The hyphen in front of a negative number, not the one within a name or between two numbers.
NEGATIVE = re.compile(r"(?<![^\s(\[,;=])-(?=\d)")


def typeset_number(text: str) -> str:
    """A text with numbers as print has it: ``-5.01e-04 +- 3e-06`` is −5.01·10⁻⁴ ± 3·10⁻⁶."""
    return NEGATIVE.sub("−", typeset_exponents(text.replace("+-", "±").replace(" x noise", " × noise")))


def write_cell(value: float) -> str:
    """A correlation in two digits: ``−0.25``, and ``0.00`` without a sign."""
    return f"{value:z.2f}".replace("-", "−")


# Powers of ten up to this one are written out: 40 is read faster than 4·10¹.
LARGEST_POWER_WRITTEN_OUT = 3


def _typeset_exponent(match: re.Match[str]) -> str:
    digits, sign, exponent = match.groups()
    if sign == "+" and int(exponent) <= LARGEST_POWER_WRITTEN_OUT:
        return f"{float(match[0]):.15g}"
    return f"{digits}·10" + (sign.replace("+", "") + exponent).translate(RAISED)


def root_mean_square(values: np.ndarray) -> float:
    """Root mean square of the finite ``values`` (N,); NaN where there are none."""
    squares, count = 0.0, 0
    for first in range(0, len(values), ROWS_AT_A_TIME):  # a long record is not copied
        block = values[first : first + ROWS_AT_A_TIME]
        known = block[np.isfinite(block)]
        squares, count = squares + float(known @ known), count + len(known)
    return math.sqrt(squares / count) if count else math.nan


def value_range(values: np.ndarray) -> tuple[float, float]:
    """Smallest and largest of the finite ``values`` (N,); NaN where there are none."""
    low, high = math.inf, -math.inf
    for first in range(0, len(values), ROWS_AT_A_TIME):  # a long record is not copied
        block = values[first : first + ROWS_AT_A_TIME]
        known = block[np.isfinite(block)]
        low, high = min(low, float(known.min(initial=math.inf))), max(high, float(known.max(initial=-math.inf)))
    return (low, high) if low <= high else (math.nan, math.nan)


# Long records and spectra in few points, so that no peak is lost.


# Stretches of each curve at least, even where a page has many.
LEAST_STRETCHES = 150
# Of all curves of a page together, so that a page of many records can still be mailed.
STRETCHES_OF_A_PAGE = 45_000


def stretches_on_page(curves: int) -> int:
    """Stretches for each of so many long curves of a page."""
    return min(max(STRETCHES_OF_A_PAGE // max(curves, 1), LEAST_STRETCHES), MOST_STRETCHES)


def thin_curve(x: np.ndarray, y: np.ndarray, thinning: Thinning, stretches: int) -> tuple[np.ndarray, np.ndarray]:
    """``x`` and ``y`` (N,) with so many stretches at most, thinned by the rule for this kind of curve."""
    if thinning is Thinning.ENVELOPE:
        return min_max_envelope(x, y, stretches)
    if thinning is Thinning.PEAKS:
        return thin_spectrum(x, y, stretches)
    return x, y


def min_max_envelope(time: np.ndarray, values: np.ndarray, stretches: int) -> tuple[np.ndarray, np.ndarray]:
    """The smallest and the largest value of each stretch of a long record, in the order of their time.

    Parameters
    ----------
    time, values
        The record (N,), NaN in gaps.
    stretches
        So many of them, equally long.

    Returns
    -------
    time, values
        (2 stretches,); the record itself where it is not longer. A stretch without any value stays a gap.
    """
    n = len(time)
    if n <= 2 * stretches:
        return time, values
    edges = np.linspace(0, n, stretches + 1).astype(int)[:-1]
    # fmin and fmax pass over NaN; only a signal that overflows has to be copied.
    bounded = np.where(np.isinf(values), np.nan, values) if np.isinf(values).any() else values
    low, high = np.fmin.reduceat(bounded, edges), np.fmax.reduceat(bounded, edges)
    last = np.append(edges[1:], n) - 1
    return np.column_stack([time[edges], time[last]]).ravel(), np.column_stack([low, high]).ravel()


# Stretches that a curve over time keeps of a long record: ten times as many as any printer draws.
KEPT_STRETCHES = 20_000


def draw_over_time(
    time: np.ndarray,
    values: np.ndarray,
    role: Role,
    label: str = "",
    width: float = 1.2,
    *,
    factor: float = 1.0,
    held: bool = False,
) -> Curve:
    """``factor`` times ``values`` (N,) over ``time`` (N,), of a long record no more than its envelope; ``held``: as steps."""
    x, y = min_max_envelope(time, values, KEPT_STRETCHES)
    return Curve(x, factor * y, role, label, width, thinning=Thinning.ENVELOPE, held=held)


def thin_spectrum(frequency: np.ndarray, values: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """A long spectrum (N,) by the largest value of each of at most ``most`` stretches, equally wide on a logarithmic axis."""
    if len(frequency) <= most:
        return frequency, values
    edges = np.unique(np.geomspace(1, len(frequency), most).astype(int) - 1)
    return frequency[edges], np.maximum.reduceat(values, edges)


def choose_evenly(count: int, most: int) -> np.ndarray:
    """Indices of at most ``most`` of ``count`` points, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, most).astype(int)) if count > most else np.arange(count)


# Panels put together on one picture, still as data: which panel stands where.


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
