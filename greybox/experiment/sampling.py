"""Time stamps of a record: is it sampled uniformly, and with which step?

A logger prints time with few digits (0.00100000802, 0.00200001604 at 1 kHz) or keeps it in single precision, so that
the steps of a uniform record are not quite equal. With the mean step ``Ts = (t[N-1] - t[0]) / (N - 1)`` a record counts
as uniform when both hold:

1. every step differs from ``Ts`` by at most 0.1 % of ``Ts``, or by at most what rounding its two stamps can explain
   (one unit in the last printed place, or the spacing of single-precision numbers), and
2. every stamp lies within 10 % of ``Ts`` of the uniform grid ``t[0] + k Ts``.

The first alone would pass a clock that drifts away, the second alone a clock that truly jitters by several percent.

Coarser printing passes too: 4 kHz with four decimals has steps of 0.2 and 0.3 ms. There every stamp must lie within half a
printed unit of a straight line through them all, whose slope is the step, and every step within a unit of it. A missing
row leaves any grid by about half a step and therefore makes the record irregular, however long it is.
"""

from __future__ import annotations

import numpy as np

STEP_TOLERANCE = 1e-3  # of the mean step, for a single step
GRID_TOLERANCE = 0.1  # of the mean step, for the distance of a stamp from the uniform grid
MOST_DECIMALS = 12  # printed places looked for
# Two roundings of half a unit make one unit; the rest is the error of the mean step itself.
ROUNDING_UNITS = 1.2
COARSEST = 0.45  # printed unit over step: beyond, a missing row could pass for two roundings
HOLE = 1.5  # usual steps from which a step is a hole
SPLIT = "split the record there with split_at_holes() (shell: --split-holes)"
FEW_HOLES = 0.05  # of the steps; with more of them there is no usual step


def find_sampling_time(time: np.ndarray) -> float | None:
    """Sampling time in seconds of the increasing stamps ``time`` (N,), N >= 2, or None when they are irregular."""
    step = float(time[-1] - time[0]) / (len(time) - 1)
    off_grid = np.abs(time - time[0] - step * np.arange(len(time)))
    off_step = np.abs(np.diff(time) - step)
    on_grid = off_grid.max() <= GRID_TOLERANCE * step
    if on_grid and off_step.max() <= STEP_TOLERANCE * step:
        return step
    unit = estimate_time_resolution(time)
    allowed = np.maximum(STEP_TOLERANCE * step, ROUNDING_UNITS * np.maximum(unit[:-1], unit[1:]))
    if on_grid and bool(np.all(off_step <= allowed)):
        return step
    return _printed_coarsely(time, step, float(np.median(unit)))


def _printed_coarsely(time: np.ndarray, step: float, unit: float) -> float | None:
    """Slope of the line that every stamp was rounded from, to ``unit`` seconds; None where no line explains them."""
    if not 0 < unit <= COARSEST * step:
        return None
    row = np.arange(len(time)) - (len(time) - 1) / 2
    middle = time - time.mean()
    slope = float(row @ middle / (row @ row))
    on_line = np.abs(middle - slope * row).max() <= ROUNDING_UNITS * unit / 2
    return slope if on_line and np.abs(np.diff(time) - slope).max() <= ROUNDING_UNITS * unit else None


def describe_timing(time: np.ndarray, sampling_time: float | None) -> list[str]:
    """What to know about the stamps ``time`` (N,): coarse printing, holes, irregular steps."""
    step = np.diff(time)
    spread = f"steps from {step.min():.6g} to {step.max():.6g} s"
    if sampling_time is not None:
        if np.abs(step - sampling_time).max() <= STEP_TOLERANCE * sampling_time:
            return []
        return [
            f"time looks rounded: {spread} differ by no more than a printed unit; taken as every {sampling_time:.6g} s"
        ]
    hole, usual = describe_longest_time_gap(time), float(np.median(step))
    if hole:
        return [f"{hole}; {SPLIT}"]
    missing = np.round(step / usual) - 1
    if np.all(np.abs(step / usual - 1 - missing) <= GRID_TOLERANCE) and missing.any():
        return [
            f"time lacks {missing.sum():.0f} rows in {np.count_nonzero(missing)} places (usual step {usual:.6g} s): the input is taken to"
            " go on through each, and where it moved the fit cannot know"
        ]
    return [f"time is irregular: {spread}; each interval is taken as long as it is"]


def describe_longest_time_gap(time: np.ndarray) -> str:
    """The longest hole in the stamps ``time`` (N,) in words, with what a simulation makes of it; "" where there is none."""
    after, step = find_time_gaps(time), np.diff(time)
    if not len(after):
        return ""
    longest = after[np.argmax(step[after])]
    found = f"{len(after)} holes, the longest" if len(after) > 1 else "a hole"
    return (
        f"time has {found} from {time[longest]:.6g} to {time[longest + 1]:.6g} s (usual step {np.median(step):.6g} s): the input is"
        " taken to go on through it"
    )


def find_time_gaps(time: np.ndarray) -> np.ndarray:
    """Rows (from 0) after which the stamps ``time`` (N,) leave a hole; none where there is no usual step."""
    step = np.diff(time)
    found = np.flatnonzero(step > HOLE * float(np.median(step)))
    return found if len(found) <= max(1, FEW_HOLES * len(step)) else found[:0]


def estimate_time_resolution(time: np.ndarray) -> np.ndarray:
    """Unit in the last place (N,) in seconds to which each stamp of ``time`` was rounded, printed or single precision.

    The printed places are those of the longest number of the same power of ten: 0.5 beside 0.501 was printed with
    three.
    """
    places = _decimals(time)
    decade = np.floor(np.log10(np.maximum(np.abs(time), 10.0**-MOST_DECIMALS)))
    unit = np.zeros(len(time))
    for d in np.unique(decade):
        same = decade == d
        unit[same] = 10.0 ** -places[same].max()
    unit[np.isinf(unit)] = 0.0
    single = time.astype(np.float32)
    if np.array_equal(single, time):
        unit = np.maximum(unit, np.spacing(np.abs(single)).astype(float))
    return unit


def _decimals(time: np.ndarray) -> np.ndarray:
    """Decimal places (N,) that each number needs; more than `MOST_DECIMALS` when it was not rounded to decimals."""
    places = np.full(len(time), MOST_DECIMALS + 8)
    for k in range(MOST_DECIMALS, -1, -1):
        scaled = time * 10.0**k
        places[np.abs(scaled - np.round(scaled)) <= 4 * np.spacing(np.abs(scaled))] = k
    return places
