"""What a record shows of its sensors: those that freeze, jump for one row, or saturate before the motion ends.

Nothing is repaired and nothing is left out: every finding says what was seen and where. The limits stand in
the constants above each function.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.base import ROWS_AT_A_TIME, Finding, Severity
from greybox.data.findings import RecordCode
from greybox.data.problems import FEW_ROWS, is_constant


def inspect_signals(
    time: np.ndarray, inputs: Mapping[str, np.ndarray], outputs: Mapping[str, np.ndarray]
) -> Iterator[Finding]:
    """What is accepted but should be known: few rows, what is constant, sensors in doubt, gaps."""
    if len(time) < FEW_ROWS:
        # Such a record is fitted all the same: the intervals say what it determines, and this why they rest on the model.
        yield Finding(RecordCode.FEW_ROWS, values={"rows": len(time)})
    for name, values in inputs.items():
        if is_constant(values):
            yield Finding(RecordCode.INPUT_CONSTANT, subject=name, values={"value": float(values[0])})
    for kind, signals in (("input", inputs), ("output", outputs)):
        for name, values in signals.items():
            if len(rows := find_code_for_missing(values)):
                figures = {
                    "kind": kind,
                    "value": float(values[rows[0]]),
                    "rows": len(rows),
                    "start": float(time[rows[0]]),
                }
                yield Finding(RecordCode.CODE_FOR_MISSING, Severity.WARNING, name, figures)
    for name, values in outputs.items():
        if is_constant(values):
            value = float(values[~np.isnan(values)][0])
            yield Finding(RecordCode.OUTPUT_CONSTANT, Severity.WARNING, name, {"value": value})
        else:
            for code, figures in _find_faults(time, values, list(inputs.values())):
                yield Finding(code, Severity.WARNING, name, figures)
            moves = np.abs(np.diff(values))
            moves = moves[np.isfinite(moves)]
            step = find_reading_step(values) if _repeats_often(moves) else None
            if (sent := find_change_band(time, values)) is not None:
                # A reading that is held between its changes comes late: constants take that up, beyond their intervals.
                severity = Severity.WARNING if sent.is_held else Severity.NOTE
                yield Finding(RecordCode.SENT_ON_CHANGE, severity, name, {"band": sent.band, "held": sent.is_held})
            elif inputs and (least := find_least_change(time, values)):
                yield Finding(RecordCode.ROWS_ON_CHANGE, Severity.WARNING, name, {"band": least})
            elif step is not None and np.median(moves[moves > 0]) <= COARSE_MOVE * step:
                yield Finding(RecordCode.READING_COARSE, subject=name, values={"step": step})
        gaps = int(np.isnan(values).sum())
        if gaps:
            yield Finding(RecordCode.OUTPUT_GAPS, subject=name, values={"gaps": gaps, "rows": len(values)})


def _find_faults(
    time: np.ndarray, values: np.ndarray, inputs: Sequence[np.ndarray]
) -> Iterator[tuple[RecordCode, dict[str, Any]]]:
    frozen = _find_frozen_stretch(values, inputs)
    dead = None if frozen else _find_dead_end(values, inputs)
    if frozen:
        first, last = frozen
        yield (
            RecordCode.SENSOR_FROZEN,
            {
                "value": float(values[first]),
                "rows": last - first + 1,
                "start": float(time[first]),
                "stop": float(time[last]),
            },
        )
    elif dead is not None:
        figures: dict[str, Any] = {"value": float(values[dead]), "start": float(time[dead]), "rows": len(time) - dead}
        yield RecordCode.SENSOR_DEAD, figures
    elif len(spikes := find_spikes(values, inputs)):
        yield RecordCode.SENSOR_SPIKES, {"count": len(spikes), "times": [float(time[k]) for k in spikes[:5]]}
    for end, rows, stays in _find_saturation(values):
        figures = {"end": end, "value": float(values[rows[0]]), "rows": len(rows), "stays": stays}
        yield RecordCode.SENSOR_SATURATED, figures


# Ranges of all other values by which one that repeats lies away from them: what a logger writes where it has no reading.
CODE_DISTANCE = 10.0
# Other values without which nothing is known of their range: a drive is at rest but for its pulses.
CODE_OTHERS = 10


def find_code_for_missing(values: np.ndarray) -> np.ndarray:
    """Rows in which the farthest value (N,), always the same, lies so far from all others that it stands for no reading: -999, 9999."""
    known = values[np.isfinite(values)]
    if len(known) < CODE_OTHERS:
        return np.zeros(0, int)
    # The end that lies farther from the middle of the values.
    code = max(known.min(), known.max(), key=lambda end: abs(end - np.median(known)))
    others = known[known != code]
    if len(others) < len(known) / 2 or abs(code - np.median(others)) <= CODE_DISTANCE * np.ptp(others):
        return np.zeros(0, int)
    rows = np.flatnonzero(values == code)
    return rows if len(rows) > 1 and len(np.unique(others)) >= CODE_OTHERS else rows[:0]


# A sensor whose readings repeat and else move by no more than so many of its steps is coarse: its noise is that of its steps.
COARSE_MOVE = 2.0
# Levels from which equal distances between them are no chance.
LEAST_LEVELS = 8
# Share of a step by which distances of levels may miss a multiple of it: printing with few digits.
STEP_ROUNDING = 0.05


def find_reading_step(values: np.ndarray) -> float | None:
    """The step of which all readings (N,) are multiples, up to an offset; None where they show none."""
    distances = np.diff(np.unique(values[np.isfinite(values)]))
    # A number holds no more steps than it has digits.
    if len(distances) < LEAST_LEVELS - 1 or distances.min() < np.finfo(float).eps * distances.max():
        return None
    counts = np.round(distances / distances.min())
    step = float((distances / counts.sum()).sum())
    return step if np.abs(distances / step - counts).max() <= STEP_ROUNDING else None


def compute_rounding_std(step: float) -> float:
    """Standard deviation of the error of a reading that is rounded to ``step``, in its unit."""
    # The error is uniform over a step: its variance is step^2 / 12 (Widrow and Kollar, Quantization noise, 2008).
    return float(step / np.sqrt(12))


def find_rounding_share(records: Sequence[np.ndarray], mean_square: float) -> tuple[float, float]:
    """The largest step of a sensor in its ``records``, and what rounding to it makes of the ``mean_square`` of a residual: its share."""
    step = max((find_reading_step(values) or 0.0 for values in records), default=0.0)
    return step, compute_rounding_std(step) ** 2 / mean_square if mean_square else 0.0


@dataclass(frozen=True)
class ChangeBand:
    """Readings of a sensor that sends only what has changed by ``band``.

    ``is_held``: between two of them the record repeats the last one; else it has a row for each alone.
    """

    band: float
    is_held: bool

    @property
    def std(self) -> float:
        """How far a reading is off: it is sent half a step from its value; while it is held the sensor is anywhere within the band."""
        return self.band / np.sqrt(3) if self.is_held else self.band / 2


# Changes from which a band shows.
LEAST_CHANGES = 20
# Share of the changes that may be smaller than the band: the first one, or a message that was lost.
SMALLER_CHANGES = 0.02
# The band over the usual change and over the step of the readings, from which it is a band: other motion has small changes too.
BAND_OF_CHANGE, BAND_OF_STEP = 0.5, 2.5
# Share of the rows that repeat the one before, from which a sensor is held between changes.
HELD_SHARE = 0.5


def find_change_band(time: np.ndarray, values: np.ndarray) -> ChangeBand | None:
    """The band of a sensor that sends its reading when it has changed by so much; None where nothing shows it."""
    rows = np.flatnonzero(np.isfinite(values))
    steps, moves = np.diff(time[rows]), np.abs(np.diff(values[rows]))
    changes = moves[moves > 0]
    if len(changes) < LEAST_CHANGES:
        return None
    levels = np.unique(values[rows])
    if len(levels) < LEAST_LEVELS:  # of a switch every change is alike
        return None
    band = float(np.quantile(changes, SMALLER_CHANGES))
    if band < BAND_OF_CHANGE * np.median(changes):
        return None
    if np.mean(moves == 0) > HELD_SHARE:
        # A coarse sensor is held as well: there the band is one step of it.
        grid = float(np.quantile(np.diff(levels), SMALLER_CHANGES))
        return ChangeBand(band, True) if band >= BAND_OF_STEP * grid else None
    step = find_reading_step(values[rows])
    usual = float(np.median(steps))
    # Its rows come when they must. A reading that is repeated so that somebody sees that the sensor lives comes late.
    if step is None or np.median(changes) > COARSE_MOVE * step or np.ptp(steps) <= usual:
        return None
    repeats_soon = np.mean(moves[steps < usual] == 0) > REPEAT_SHARE
    return None if repeats_soon else ChangeBand(step, False)


# The longest tenth of the intervals over the shortest, from which rows come when they must and not when a clock says.
SPREAD_OF_ROWS = 3.0


def find_least_change(time: np.ndarray, values: np.ndarray) -> float | None:
    """The change below which a record has no row; None where rows come for another reason."""
    rows = np.flatnonzero(np.isfinite(values))
    steps, changes = np.diff(time[rows]), np.abs(np.diff(values[rows]))
    if len(changes) < LEAST_CHANGES or len(np.unique(values[rows])) < LEAST_LEVELS:
        return None
    least = float(np.quantile(changes, SMALLER_CHANGES))
    shortest, longest = np.quantile(steps, (0.1, 0.9))
    is_band = least > 0 and least >= BAND_OF_CHANGE * np.median(changes)
    return least if is_band and longest >= SPREAD_OF_ROWS * shortest else None


# Rows with one value from which a sensor counts as frozen.
FROZEN_ROWS = 20
# Share of repeated values from which a sensor is coarse, or the plant rests, and a frozen stretch says nothing.
REPEAT_SHARE = 0.05


def _find_frozen_stretch(values: np.ndarray, inputs: Sequence[np.ndarray]) -> tuple[int, int] | None:
    """First and last row of the longest stretch in which an output repeats one value while an input moves.

    None for short stretches, for a sensor that repeats its values elsewhere too, and where the output comes and goes no
    faster than it moves elsewhere: as fast as ever at the end of its range (an end stop, an overflow), else as usual. The
    input of the last row does not count: its answer comes after.
    """
    step = np.abs(np.diff(values))
    edges = _find_edges(step == 0)
    if not len(edges):
        return None
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    first, last = int(edges[2 * longest]), int(edges[2 * longest + 1])
    before = max(first - 1, 0)
    elsewhere = np.concatenate((step[:before], step[last + 1 :]))
    moves = elsewhere[np.isfinite(elsewhere)]
    if last - first + 1 < FROZEN_ROWS or _repeats_often(moves):
        return None
    # At an end of its range an output may rest (a stop, an overflow): there only a jump beyond its fastest move shows a frozen sensor.
    at_limit = values[first] in (np.nanmin(values), np.nanmax(values))
    jumps = np.concatenate((step[before:first], step[last : last + 1]))
    if not np.any(jumps > np.quantile(moves, 1.0 if at_limit else 1 - REPEAT_SHARE)):
        return None
    return None if all(is_constant(u[first:last]) for u in inputs) else (first, last)


# Share of an input's earlier range that it must still cover for the plant to be moving.
INPUT_GOES_ON = 0.5


def _find_dead_end(values: np.ndarray, inputs: Sequence[np.ndarray]) -> int | None:
    """Row from which an output repeats one value to the end of the record, while an input moves about as far as before.

    None for a short stretch, for a sensor that repeats its values elsewhere too, and at the end of its range (an end stop, an overflow).
    """
    first = len(values) - int(np.argmax(np.append(values[::-1] != values[-1], True)))
    steps = np.diff(values[: first + 1])
    moves = steps[np.isfinite(steps)]
    if len(values) - first < FROZEN_ROWS or _repeats_often(moves):
        return None
    if values[-1] in (np.nanmin(values), np.nanmax(values)):
        return None
    goes_on = any(np.ptp(u[first:-1]) > INPUT_GOES_ON * np.ptp(u[: first + 1]) for u in inputs)
    return first if goes_on else None


# Times that a sensor stays at the same end of its range before it counts as saturated.
MIN_STAYS = 3
# Rows that it stays there altogether.
MIN_SATURATED_ROWS = 10


def _find_saturation(values: np.ndarray) -> Iterator[tuple[str, np.ndarray, int]]:
    """Each end of the range at which an output stays again and again: which, its rows, and how many times it stays.

    Not for a sensor that repeats its values elsewhere too: it is coarse.
    """
    ends = {"largest": values == np.nanmax(values), "smallest": values == np.nanmin(values)}
    stays = np.logical_or.reduce([at_end[1:] & at_end[:-1] for at_end in ends.values()])
    moves = np.diff(values)[~stays]
    moves = moves[np.isfinite(moves)]
    for end, at_end in ends.items():
        edges = _find_edges(at_end)
        # A stay is two rows or more.
        times = int(np.sum(edges[1::2] - edges[::2] > 1))
        rows = np.flatnonzero(at_end)
        often = times >= MIN_STAYS and len(rows) >= MIN_SATURATED_ROWS
        if often and not _repeats_often(moves):
            yield end, rows, times


# Distance from both neighbours, over the distance that 95 % of the rows stay within, from which a row is a spike.
SPIKE_RATIO = 5.0
# Share of an input's range; an input that leaves so far for one row may have caused the spike.
PULSE_SHARE = 0.25
# Share of the rows beside their neighbours up to which spikes are found by that distance: each puts three rows aside, and with more of
# them it is their own.
MAX_SPIKE_SHARE = REPEAT_SHARE / 3
# Largest share of those rows that can be spikes, where they come all over the record; more of them are a kind of noise.
MAX_STRAY_SHARE = 0.08
# Share of the rows that so many spikes leave where they are, and how far 95 % of normal noise reach over that share of it.
UNTOUCHED_SHARE, NORMAL_REACH = 0.7, 1.89
# The median distance of strays over their mean distance: 0.69 where they come at any time, far less of motion, which comes in stretches.
EVEN_SPREAD = 0.4


# Share of its height by which a stray misses the line through the two rows before it, or behind it; a corner lies on both.
CORNER_SHARE = 0.5


def find_spikes(values: np.ndarray, inputs: Sequence[np.ndarray]) -> np.ndarray:
    """Rows in which an output lies by far more beside its neighbours than it ever does.

    Not where an input leaves and is back as well, or has just done so: the plant may follow. None where there are many: that is noise.
    """
    beside, beyond = _measure_offset(values)
    usual = beside[beside > 0]  # neither rest nor gaps
    if not len(usual):
        return np.zeros(0, int)
    few, many = np.quantile(usual, (1 - REPEAT_SHARE, UNTOUCHED_SHARE), overwrite_input=True)
    # Of a coarse sensor most rows may lie in the middle of their neighbours; spikes are a share of the others.
    rows = len(usual)
    del usual  # a long record is in memory a few times only
    driven = np.zeros(len(values), bool)
    for u in inputs:
        pulse = _measure_offset(u)[1] > PULSE_SHARE * np.ptp(u)
        driven |= pulse | np.concatenate(([False], pulse[:-1]))
    # A spike puts its neighbours aside too, by half as much.
    highest = (beside >= 0) & ~driven
    highest[:-1] &= beside[:-1] >= beside[1:]
    highest[1:] &= beside[1:] >= beside[:-1]
    strays = np.flatnonzero(highest & (beyond > SPIKE_RATIO * NORMAL_REACH * many))
    if not MAX_SPIKE_SHARE * rows < len(strays) <= MAX_STRAY_SHARE * rows:
        spikes = np.flatnonzero(highest & (beyond > SPIKE_RATIO * few))
        return spikes if len(spikes) <= max(1, MAX_SPIKE_SHARE * rows) else spikes[:0]
    spread = float(np.median(np.diff(strays))) * len(strays) / len(values) if len(strays) > 1 else 0.0
    return strays if spread >= EVEN_SPREAD else strays[:0]


def find_strays(values: np.ndarray, inputs: Sequence[np.ndarray]) -> np.ndarray:
    """Rows of ``values`` (N,), which may have gaps, that are spikes; a second look finds those that stood beside another one."""
    kept = np.array(values, float)
    for _ in range(2):
        rows = np.flatnonzero(np.isfinite(kept))
        kept[rows[find_spikes(kept[rows], [u[rows] for u in inputs])]] = np.nan
    return np.flatnonzero(np.isnan(kept) & np.isfinite(values))


def is_first_off(values: np.ndarray) -> bool:
    """Whether the first value (N,) lies far off the next two, which are close together, and others hardly ever move so far."""
    moves = np.abs(np.diff(values))
    usual = moves[moves > 0]
    if len(moves) < 2 or not len(usual):
        return False
    return bool(moves[0] > SPIKE_RATIO * max(moves[1], np.quantile(usual, 1 - REPEAT_SHARE)))


def _measure_offset(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far each value (N,) lies from the middle of its neighbours; and beyond both, where they are close together, else 0.

    The corner of a curve, where a heater is switched, lies on the lines that lead to it: beyond its neighbours, and no stray.
    """
    offset, beyond = np.zeros(len(values)), np.zeros(len(values))
    for first in range(1, len(values) - 1, ROWS_AT_A_TIME):
        rows = slice(first, min(first + ROWS_AT_A_TIME, len(values) - 1))
        middle, left, right = (values[rows.start + k : rows.stop + k] for k in (0, -1, 1))
        before, after = middle - left, middle - right
        # |y - (left + right) / 2|.
        offset[rows] = np.abs(before + after) / 2
        # Above both neighbours or below both, and these are closer to each other than to it.
        alone = (before * after > 0) & (np.abs(before - after) <= offset[rows])
        height = np.minimum(np.abs(before), np.abs(after))
        is_corner = np.ones(len(middle), bool)
        # y - (2 y_1 - y_2) from either side, where two values stand there.
        for side, ahead in ((-1, before), (1, after)):
            second = np.arange(rows.start, rows.stop) + 2 * side
            nearer = values[rows.start + side : rows.stop + side]
            line = np.abs(ahead + values[np.clip(second, 0, len(values) - 1)] - nearer)
            is_corner &= (second >= 0) & (second < len(values)) & (line <= CORNER_SHARE * height)
        alone &= ~is_corner
        beyond[rows][alone] = height[alone]
    return offset, beyond


def _repeats_often(moves: np.ndarray) -> bool:
    """Whether a sensor that moves by ``moves`` from row to row repeats its values, or there is no move to judge by."""
    return not len(moves) or bool(np.mean(moves == 0) > REPEAT_SHARE)


def _find_edges(mask: np.ndarray) -> np.ndarray:
    """First row of each run of True, and the row after it, in turn."""
    return np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(int)))
