"""Does an input follow the readings of an output? Told from the record alone, without a model of the plant or of the controller.

An input that was chosen beforehand is predicted by its own past as well as by that and past readings together: what the readings know of
it they have from its past (Granger, Econometrica 37, 1969). A controller's input is not. Where the input is recorded with noise or with
holes, readings know more of its past than the record of it does; but they know at least as much of it afterwards, when the plant has
answered (Sims, American Economic Review 62, 1972), which a controller's input shows less than the readings that made it. The reading of
the same row is left out: a plant, or filter, that is faster than the sampling shows the input there already.

This finds a loop whose controller answers past readings by much of what it does anew. It is silent on one that answers only the reading of
the same row, that follows a reference that jumps, or whose sensor has hardly any noise: no finding is no proof of an open loop.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from greybox.base import Finding
from greybox.data.findings import RecordCode
from greybox.data.problems import is_constant

# Rows of the past that may tell the next value of an input; more of them tell a smooth input ever better, and so its copies.
PAST_ROWS = 8
# Rows that are looked at: a loop shows in few.
MOST_ROWS = 5000
# Least share of what an input's own past leaves of it that past readings must take, and how many times the share that later readings take.
# Of 149 pairs of input and output of records in an open loop none comes near both (the largest share is 0.20, that of a smooth speed, and
# later readings take more); the seven records of a rotor under a speed controller have 0.58 or more in either half, and 1.55 times.
LOOP_SHARE = 0.25
LOOP_LEAD = 1.3
# Share of an input's variance that its own past must leave: below it the input is a formula of its past (a sweep, a sum of sines), and
# rounding is left.
LEAST_INNOVATION = 1e-4
# Probability of as large a share by chance, an F test; records have several inputs and outputs.
LOOP_CHANCE = 1e-6


def find_loops(inputs: Mapping[str, np.ndarray], outputs: Mapping[str, np.ndarray]) -> Iterator[Finding]:
    """The inputs that follow an output, each with the output that tells most of it."""
    for name, values in inputs.items():
        if is_constant(values):
            continue
        rows = min(len(values), MOST_ROWS)
        halves = slice(0, rows // 2), slice(rows // 2, rows)
        # A loop acts all the time: one event, the beginning of a motion, must not pass for it.
        shares = {
            output: min(measure_feedback(values[half], reading[half]) for half in halves)
            for output, reading in outputs.items()
        }
        best = max(shares, key=lambda output: shares[output], default="")
        if best and shares[best] > LOOP_SHARE:
            about = {"output": best, "share": shares[best]}
            yield Finding(RecordCode.INPUT_FOLLOWS_OUTPUT, subject=name, values=about)


def measure_feedback(values: np.ndarray, reading: np.ndarray) -> float:
    """Share of what an input's (N,) own past leaves of it that past readings (N,) take.

    0 where that may be chance, where the input leaves no more than rounding, and where later readings tell as much of it.
    """
    from scipy.special import fdtrc

    rows = len(values) - 2 * PAST_ROWS
    if rows <= 2 * PAST_ROWS + 1:
        return 0.0
    # Row k: the input PAST_ROWS ... 1 rows before, and the readings there and 1 ... PAST_ROWS rows after.
    stretch = np.lib.stride_tricks.sliding_window_view
    past, before, after = (
        stretch(v, PAST_ROWS)[k : k + rows] for v, k in ((values, 0), (reading, 0), (reading, PAST_ROWS + 1))
    )
    columns, now = np.column_stack([np.ones(rows), past]), values[PAST_ROWS : PAST_ROWS + rows]
    known = np.isfinite(np.column_stack([columns, before, after, now])).all(axis=1)
    columns, before, after, now = columns[known], before[known], after[known], now[known]
    left = len(now) - columns.shape[1] - PAST_ROWS
    if left <= 0 or not np.ptp(now):
        return 0.0
    alone = _sum_of_squares_left(columns, now)
    if alone < LEAST_INNOVATION * len(now) * float(np.var(now)):
        return 0.0
    with_past, with_later = (_sum_of_squares_left(np.column_stack([columns, y]), now) for y in (before, after))
    # F = ((S0 - S1) / q) / (S1 / (n - p)) of the q coefficients of the readings.
    chance = fdtrc(PAST_ROWS, left, (alone - with_past) / PAST_ROWS / (with_past / left)) if with_past > 0 else 0.0
    leads = alone - with_past > LOOP_LEAD * (alone - with_later)
    return 1 - with_past / alone if leads and chance < LOOP_CHANCE else 0.0


# Least share of what its own past and past readings leave of an input that the reading of the same row takes where a controller answers it:
# a plant that the input moves within the row shows less, 0.5 at the most with noise on its sensor.
SAME_ROW_SHARE = 0.95


def answers_same_row(values: np.ndarray, reading: np.ndarray) -> bool:
    """Whether an input (N,) answers the reading (N,) of its own row, of a plant that shows nothing of the input there."""
    rows = len(values) - PAST_ROWS
    if rows <= 4 * PAST_ROWS:
        return False
    stretch = np.lib.stride_tricks.sliding_window_view
    past, before = (stretch(v, PAST_ROWS)[:rows] for v in (values, reading))
    columns, now, beside = np.column_stack([np.ones(rows), past, before]), values[PAST_ROWS:], reading[PAST_ROWS:]
    known = np.isfinite(np.column_stack([columns, now, beside])).all(axis=1)
    columns, now, beside = columns[known], now[known], beside[known]
    if len(now) <= 4 * PAST_ROWS:
        return False
    alone = _sum_of_squares_left(columns, now)
    if alone < LEAST_INNOVATION * len(now) * float(np.var(now)):
        return False
    return _sum_of_squares_left(np.column_stack([columns, beside]), now) < (1 - SAME_ROW_SHARE) * alone


def _sum_of_squares_left(columns: np.ndarray, target: np.ndarray) -> float:
    sizes = np.sqrt(np.mean(columns**2, axis=0))
    scaled = columns / np.where(sizes > 0, sizes, 1.0)
    # Smooth signals make nearly equal columns: directions of rounding are left out.
    solution, *_ = np.linalg.lstsq(scaled, target, rcond=1e-10)
    return float(np.sum((target - scaled @ solution) ** 2))
