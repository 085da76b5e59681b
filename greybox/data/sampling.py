"""Time stamps of a record: is it sampled uniformly, with which step, and where are rows missing?

A logger prints time with few digits (0.00100000802, 0.00200001604 at 1 kHz) or keeps it in single precision, so that
the steps of a uniform record are not quite equal. With the mean step ``Ts = (t[N-1] - t[0]) / (N - 1)`` a record counts
as uniform when both hold:

1. every step differs from ``Ts`` by at most 0.1 % of ``Ts``, or by at most what rounding its two stamps can explain
   (one unit in the last printed place, or the spacing of single-precision numbers), and
2. every stamp lies within 10 % of ``Ts`` of the uniform grid ``t[0] + k Ts``.

The first alone would pass a clock that drifts away, the second alone a clock that jitters by several percent.

Coarser printing passes too: 4 kHz with four decimals has steps of 0.2 and 0.3 ms. There every stamp must lie within half a
printed unit of a straight line through them all, whose slope is the step, and every step within a unit of it. A missing
row leaves any grid by about half a step and therefore makes the record irregular, however long it is.

The limits stand above the functions that they steer.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from greybox.base import ROWS_AT_A_TIME, Finding, Severity
from greybox.data.findings import RecordCode
from greybox.data.problems import FEW_ROWS, is_constant

# A step may differ from the mean step by this share of it; clocks of loggers stay within.
STEP_TOLERANCE = 0.001
# A stamp may lie this share of the mean step off the uniform grid; beyond it, the clock drifts or jitters.
GRID_TOLERANCE = 0.1
# Printed units that rounding may change a step by: two roundings of half a unit, and the error of the mean step itself.
ROUNDING_UNITS = 1.2


def find_sampling_time(time: np.ndarray) -> float | None:
    """Sampling time in seconds of the increasing stamps ``time`` (N,), N >= 2, or None when they are irregular."""
    # The mean step: of the rounding of the stamps only that of the two ends is left.
    step = float(time[-1] - time[0]) / (len(time) - 1)
    on_grid = _measure_grid_offset(time, step) <= GRID_TOLERANCE * step
    off_step = np.diff(time)
    off_step -= step
    np.abs(off_step, out=off_step)
    if on_grid and off_step.max() <= STEP_TOLERANCE * step:
        return step
    unit = estimate_time_resolution(time)
    # A step has the rounding of both its stamps, half a unit each.
    allowed = np.maximum(unit[:-1], unit[1:])
    allowed *= ROUNDING_UNITS
    np.maximum(allowed, STEP_TOLERANCE * step, out=allowed)
    if on_grid and bool(np.all(off_step <= allowed)):
        return step
    del off_step, allowed
    return _find_coarsely_printed_step(time, step, float(np.median(unit)))


def _measure_grid_offset(time: np.ndarray, step: float) -> float:
    """Largest distance of a stamp from the grid ``time[0] + k step``."""
    largest = 0.0
    for first in range(0, len(time), ROWS_AT_A_TIME):
        stamps = time[first : first + ROWS_AT_A_TIME]
        grid = step * np.arange(first, first + len(stamps))
        largest = max(largest, float(np.abs(stamps - time[0] - grid).max()))
    return largest


# Largest printed unit, as a share of the step; with a coarser one a missing row could pass for two roundings.
COARSEST_PRINT = 0.45


def _find_coarsely_printed_step(time: np.ndarray, step: float, unit: float) -> float | None:
    """Slope of the line that every stamp was rounded from, to ``unit`` seconds; None where no line explains them."""
    if not 0 < unit <= COARSEST_PRINT * step:
        return None
    row = np.arange(len(time)) - (len(time) - 1) / 2
    centred = time - time.mean()
    # Least squares over centred rows: sum(k t) / sum(k^2).
    slope = float(row @ centred / (row @ row))
    on_line = np.abs(centred - slope * row).max() <= ROUNDING_UNITS * unit / 2
    return slope if on_line and np.abs(np.diff(time) - slope).max() <= ROUNDING_UNITS * unit else None


def inspect_timing(
    time: np.ndarray,
    sampling_time: float | None,
    inputs: Mapping[str, np.ndarray],
    outputs: Mapping[str, np.ndarray] = MappingProxyType({}),
) -> tuple[Finding, ...]:
    """What there is to know about the stamps ``time`` (N,): coarse printing, gaps, missing rows, irregular steps, jitter.

    A gap and missing rows matter where ``inputs`` move, which nobody saw meanwhile. Of irregular steps the ``outputs`` may show that only
    the stamps are so, and the readings were taken regularly.
    """
    step = np.diff(time)
    spread = {"shortest": float(step.min()), "longest": float(step.max())}
    if sampling_time is not None:
        if np.abs(step - sampling_time).max() <= STEP_TOLERANCE * sampling_time:
            return ()
        return (Finding(RecordCode.TIME_ROUNDED, values={**spread, "sampling_time": sampling_time}),)
    is_driven = not all(map(is_constant, inputs.values()))
    # The pieces of a short table would hold nothing: nobody is told to split it.
    gap = find_longest_time_gap(
        time, RecordCode.TIME_GAP if len(time) >= FEW_ROWS else RecordCode.INPUT_HELD_THROUGH_GAP
    )
    if is_driven and gap is not None:
        return (gap,)
    usual = float(np.median(step))
    # A step as long as n usual ones lacks n - 1 rows.
    missing = np.round(step / usual) - 1
    if is_driven and np.all(np.abs(step / usual - 1 - missing) <= GRID_TOLERANCE) and missing.any():
        values = {"rows": int(missing.sum()), "places": int(np.count_nonzero(missing)), "usual_step": usual}
        return (Finding(RecordCode.TIME_ROWS_MISSING, Severity.WARNING, values=values),)
    jitter = estimate_stamp_jitter(time, outputs.values())
    if jitter is not None:
        values = {"jitter": jitter, "usual_step": usual}
        return (Finding(RecordCode.TIME_JITTER, Severity.WARNING, values=values),)
    return (Finding(RecordCode.TIME_IRREGULAR, values=spread),)


# Rows below which the readings do not tell whether the stamps or the sampling are irregular.
LEAST_JITTER_ROWS = 50
# Standard deviations within which the share of the stamps' irregularity that the readings have must be 0, and beyond which it is not 1.
JITTER_CERTAINTY = 4.0


def estimate_stamp_jitter(time: np.ndarray, outputs: Iterable[np.ndarray]) -> float | None:
    """Standard deviation (s) of stamps ``time`` (N,) of readings that were taken regularly; None where they were not, or nothing shows it.

    A reading ``y`` that was taken at the grid's time and is stamped ``d`` off it follows the grid: its second differences are those of a
    smooth motion. One that was taken when its stamp says is off the smooth course by ``d dy/dt``. So the second differences of readings
    are held against those of ``d dy/dt``: their slope is 0 for stamps that jitter, and 1 for a sampling that does.
    """
    row = np.arange(len(time)) - (len(time) - 1) / 2
    step = float(row @ (time - time.mean()) / (row @ row))
    # How far each stamp lies off the straight line through all.
    off = time - time.mean() - step * row
    if len(time) < LEAST_JITTER_ROWS or np.abs(off).max() > step:
        return None
    products = squares = 0.0
    pairs = []
    for y in outputs:
        # dy/dt over four steps: rounding and noise of the readings next to a row must not pass for its rate.
        rate = (y[4:] - y[:-4]) / (4 * step)
        expected, seen = rate * np.diff(off, 2)[1:-1], np.diff(y, 2)[1:-1]
        known = np.isfinite(expected) & np.isfinite(seen)
        if not known.any() or not expected[known].any():
            continue
        scale = float(np.std(seen[known])) or 1.0
        pairs.append((expected[known] / scale, seen[known] / scale))
        products += float(pairs[-1][0] @ pairs[-1][1])
        squares += float(pairs[-1][0] @ pairs[-1][0])
    if not squares:
        return None
    slope = products / squares
    # The variance of the slope with errors of any size and correlated over two rows, as second differences are (Newey and West).
    variance = 0.0
    for expected, seen in pairs:
        scores = expected * (seen - slope * expected)
        variance += float(scores @ scores) + 2 * sum((1 - k / 3) * float(scores[k:] @ scores[:-k]) for k in (1, 2))
    std = float(np.sqrt(max(variance, 0.0))) / squares
    is_of_stamps = abs(slope) < JITTER_CERTAINTY * std and 1 - slope > JITTER_CERTAINTY * std
    return float(np.std(off)) if is_of_stamps else None


def find_longest_time_gap(time: np.ndarray, code: RecordCode = RecordCode.TIME_GAP) -> Finding | None:
    """The longest gap in the stamps ``time`` (N,) as a finding with this ``code``; None where there is none."""
    after, step = find_time_gaps(time), np.diff(time)
    if not len(after):
        return None
    longest = after[np.argmax(step[after])]
    values = {
        "gaps": len(after),
        "start": float(time[longest]),
        "stop": float(time[longest + 1]),
        "usual_step": float(np.median(step)),
    }
    return Finding(code, Severity.WARNING, values=values)


# A step of more than this many usual ones is a gap in time: at least one row is missing.
GAP_STEPS = 1.5
# Largest share of the steps that can be gaps; with more of them there is no usual step.
MAX_GAP_SHARE = 0.05


def find_time_gaps(time: np.ndarray) -> np.ndarray:
    """Rows (from 0) after which the stamps ``time`` (N,) leave a gap; none where there is no usual step."""
    step = np.diff(time)
    after = np.flatnonzero(step > GAP_STEPS * float(np.median(step)))
    return after if len(after) <= max(1, MAX_GAP_SHARE * len(step)) else after[:0]


def find_pieces(
    time: np.ndarray, outputs: Mapping[str, np.ndarray], min_rows: int
) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Rows ``(first, after last)`` of the pieces between the gaps of a record: those to keep, and those to leave out.

    Kept are pieces of ``min_rows`` rows or more in which an output was measured.
    """
    starts = (find_time_gaps(time) + 1).tolist()
    bounds = list(zip([0, *starts], [*starts, len(time)], strict=True))

    def is_usable(first: int, end: int) -> bool:
        measured = any(np.isfinite(values[first:end]).any() for values in outputs.values())
        return end - first >= max(min_rows, 2) and measured

    kept = [piece for piece in bounds if is_usable(*piece)]
    return kept, [piece for piece in bounds if piece not in kept]


def find_common_sampling_time(pieces: Sequence[tuple[float | None, int, float]]) -> float | None:
    """The sampling time (s) of all ``pieces`` of one record together, None where they are not sampled alike.

    The stamps of each piece alone give it to as many digits as they were printed with; equal steps make equal discrete models.

    Parameters
    ----------
    pieces
        Sampling time (s, None where irregular), rows and duration (s) of each piece.
    """
    usual = sum(duration for _, _, duration in pieces) / sum(rows - 1 for _, rows, _ in pieces)
    alike = all(
        step is not None and abs(step - usual) * (rows - 1) <= GRID_TOLERANCE * usual for step, rows, _ in pieces
    )
    return usual if alike else None


# Units in which a file may have printed time, in seconds: the one in which its last place is coarsest counts.
PRINTED_UNITS: tuple[float, ...] = (1.0, 60.0, 3600.0)


def estimate_time_resolution(time: np.ndarray) -> np.ndarray:
    """Unit in the last place (N,) in seconds to which each stamp of ``time`` was rounded, printed or single precision.

    The printed places are those of the longest number of the same power of ten: 0.5 beside 0.501 was printed with
    three. A file may have printed them in minutes or hours: in seconds they have more places.
    """
    unit = np.zeros(len(time))
    for seconds in PRINTED_UNITS:
        printed = seconds * _estimate_printed_unit(time if seconds == 1 else time / seconds)
        unit = max(unit, printed, key=np.median)
    single = time.astype(np.float32)
    # Stamps that single precision holds exactly were stored in it.
    if np.array_equal(single, time):
        np.maximum(unit, np.spacing(np.abs(single)), out=unit)
    return unit


# Printed decimal places that are looked for; double precision shows no more of a time in seconds.
MAX_DECIMALS = 12


def _estimate_printed_unit(time: np.ndarray) -> np.ndarray:
    """Unit in the last place (N,) of each stamp, in the unit of ``time``; 0 where it was not rounded to decimals."""
    places, decade = (np.empty(len(time), np.int16) for _ in range(2))
    for first in range(0, len(time), ROWS_AT_A_TIME):
        rows = slice(first, first + ROWS_AT_A_TIME)
        places[rows] = _count_decimals(time[rows], MAX_DECIMALS)
        decade[rows] = np.floor(np.log10(np.maximum(np.abs(time[rows]), 10.0**-MAX_DECIMALS)))
    unit = np.zeros(len(time))
    for d in np.unique(decade):
        same = decade == d
        most = int(places[same].max())
        unit[same] = 10.0**-most if most <= MAX_DECIMALS else 0.0
    return unit


def _count_decimals(time: np.ndarray, most: int) -> np.ndarray:
    """Decimal places (N,) that each number needs; more than ``most`` when it was not rounded to decimals."""
    places = np.full(len(time), most + 8)
    for k in range(most, -1, -1):
        scaled = time * 10.0**k
        # k places are enough where t 10^k is a whole number, the last bits of the product aside.
        places[np.abs(scaled - np.round(scaled)) <= 4 * np.spacing(np.abs(scaled))] = k
    return places
