"""Time stamps of a record: is it sampled uniformly, and with which step?

A logger prints time with few digits (0.00100000802, 0.00200001604 at 1 kHz) or keeps it in single precision, so that
the steps of a uniform record are not quite equal. With the mean step ``Ts = (t[N-1] - t[0]) / (N - 1)`` a record counts
as uniform when both hold:

1. every step differs from ``Ts`` by at most 0.1 % of ``Ts``, or by at most what rounding its two stamps can explain
   (one unit in the last printed place, or the spacing of single-precision numbers), and
2. every stamp lies within 10 % of ``Ts`` of the uniform grid ``t[0] + k Ts``.

The first alone would pass a clock that drifts away, the second alone a clock that truly jitters by several percent. A
missing row leaves the grid by about half a step and therefore makes the record irregular, however long it is.
"""

from __future__ import annotations

import numpy as np

STEP_TOLERANCE = 1e-3  # of the mean step, for a single step
GRID_TOLERANCE = 0.1  # of the mean step, for the distance of a stamp from the uniform grid
MOST_DECIMALS = 12  # printed places looked for
# Two roundings of half a unit make one unit; the rest is the error of the mean step itself.
ROUNDING_UNITS = 1.2


def uniform_step(time: np.ndarray) -> float | None:
    """Sampling time in seconds of the increasing stamps ``time`` (N,), N >= 2, or None when they are irregular."""
    step = float(time[-1] - time[0]) / (len(time) - 1)
    off_grid = np.abs(time - time[0] - step * np.arange(len(time)))
    if off_grid.max() > GRID_TOLERANCE * step:
        return None
    off_step = np.abs(np.diff(time) - step)
    if off_step.max() <= STEP_TOLERANCE * step:
        return step
    unit = resolution(time)
    allowed = np.maximum(STEP_TOLERANCE * step, ROUNDING_UNITS * np.maximum(unit[:-1], unit[1:]))
    return step if bool(np.all(off_step <= allowed)) else None


def resolution(time: np.ndarray) -> np.ndarray:
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
