"""What a record shows of its sensors: those that stand still, jump for one row, or end before the motion does.

Nothing is repaired and nothing is left out: every remark says what was seen, where, and what to do if it is a fault.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from greybox.experiment.problems import SHOWN, enumerate_first, is_constant

FROZEN_ROWS = 20  # of a sensor that stands still
AS_EVER = 0.5  # of an input's range before: one that goes on so far is still moving the plant
SELDOM = 0.05  # of the steps elsewhere; a sensor that repeats its values more often is coarse or rests
SPIKE = 5.0  # of the distance from the neighbours that is hardly ever exceeded
PULSE = 0.25  # of an input's range: one that leaves so far for a row
MOST_SPIKES = 0.02  # of the rows; more of them are a kind of noise
ENDS = 3  # times that a sensor stays at exactly the same end of its range
ENDED_ROWS = 10  # that it stays there altogether
# How the remarks begin that cast doubt on the measurement itself.
STILL, JUMPS, REACHES = "stands still at exactly", "jumps away and back within one row", "reads exactly its"


def inspect_record(
    time: np.ndarray, inputs: Mapping[str, np.ndarray], outputs: Mapping[str, np.ndarray]
) -> Iterator[str]:
    """What is accepted but should be known: what is constant, sensors in doubt, gaps."""
    for name, values in inputs.items():
        if is_constant(values):
            yield f"input {name!r} is constant at {values[0]:g}"
    for name, values in outputs.items():
        if is_constant(values):
            value = values[~np.isnan(values)][0]
            yield f"output {name!r} is constant at {value:g}: a sensor that never moves tells nothing; leave it out"
        else:
            yield from (f"output {name!r} {doubt}" for doubt in _doubts(time, values, list(inputs.values())))
        gaps = int(np.isnan(values).sum())
        if gaps:
            yield f"output {name!r} has {gaps} gap{'s' if gaps > 1 else ''} in {len(values)} rows"


def is_sensor_fault(remark: str) -> bool:
    """Whether a remark on a record casts doubt on the measurement itself: then nothing else explains a bad fit better."""
    return any(words in remark for words in (STILL, JUMPS, REACHES))


def _doubts(time: np.ndarray, values: np.ndarray, inputs: Sequence[np.ndarray]) -> Iterator[str]:
    if frozen := _frozen(values, inputs):
        first, last = frozen
        yield (
            f"{STILL} {values[first]:g} for {last - first + 1} rows, from {time[first]:.6g} to {time[last]:.6g} s, while the input moves,"
            " and comes or goes with a jump: if the sensor or the logger failed there, leave these fields empty"
        )
    elif (dead := _died(values, inputs)) is not None:
        yield (
            f"{STILL} {values[dead]:g} from {time[dead]:.6g} s to the end ({len(time) - dead} rows), while the input goes on moving: if the"
            " sensor or the logger failed there, leave these fields empty"
        )
    elif len(found := _spikes(values, inputs)):
        places = enumerate_first([f"{time[k]:.6g} s" for k in found[:SHOWN]], len(found))
        yield (
            f"{JUMPS}, {len(found)} time{'s' * (len(found) > 1)} (at {places}): if the sensor did that and not the plant, leave these"
            " fields empty, or fit with a robust loss (shell: --loss huber)"
        )
    for word, rows, times in _ends(values):
        yield (
            f"{REACHES} {word} value, {values[rows[0]]:g}, in {len(rows)} rows, {times} times for two rows or more: if the sensor or the"
            " converter ends there, leave these fields empty (a stop that the plant runs into looks the same)"
        )


def _frozen(values: np.ndarray, inputs: Sequence[np.ndarray]) -> tuple[int, int] | None:
    """First and last row of the longest stretch in which an output repeats one value while an input moves.

    None for short stretches, for a sensor that repeats its values elsewhere too, and where the output comes and goes no
    faster than it moves elsewhere: as fast as ever at the end of its range (an end stop, an overflow), else as usual. The
    input of the last row does not count: its answer comes after.
    """
    step = np.abs(np.diff(values))
    edges = np.flatnonzero(np.diff(np.concatenate(([False], step == 0, [False])).astype(int)))
    if not len(edges):
        return None
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    first, last = int(edges[2 * longest]), int(edges[2 * longest + 1])
    before = max(first - 1, 0)
    elsewhere = np.concatenate((step[:before], step[last + 1 :]))
    moves = elsewhere[np.isfinite(elsewhere)]
    if last - first + 1 < FROZEN_ROWS or not len(moves) or np.mean(moves == 0) > SELDOM:
        return None
    at_limit = values[first] in (np.nanmin(values), np.nanmax(values))
    jumps = np.concatenate((step[before:first], step[last : last + 1]))
    if not np.any(jumps > np.quantile(moves, 1.0 if at_limit else 1 - SELDOM)):
        return None
    return None if all(is_constant(u[first:last]) for u in inputs) else (first, last)


def _died(values: np.ndarray, inputs: Sequence[np.ndarray]) -> int | None:
    """Row from which an output repeats one value to the end of the record, while an input moves about as far as before.

    None for a short stretch, for a sensor that repeats its values elsewhere too, and at the end of its range (an end stop, an overflow).
    """
    first = len(values) - int(np.argmax(np.append(values[::-1] != values[-1], True)))
    steps = np.diff(values[: first + 1])
    moves = steps[np.isfinite(steps)]
    if len(values) - first < FROZEN_ROWS or not len(moves) or np.mean(moves == 0) > SELDOM:
        return None
    if values[-1] in (np.nanmin(values), np.nanmax(values)):
        return None
    on = any(np.ptp(u[first:-1]) > AS_EVER * np.ptp(u[: first + 1]) for u in inputs)
    return first if on else None


def _ends(values: np.ndarray) -> Iterator[tuple[str, np.ndarray, int]]:
    """Each end of the range at which an output stays again and again: which, its rows, and how many times it stays.

    Not for a sensor that repeats its values elsewhere too: it is coarse.
    """
    ends = {"largest": values == np.nanmax(values), "smallest": values == np.nanmin(values)}
    stays = np.logical_or.reduce([there[1:] & there[:-1] for there in ends.values()])
    moves = np.diff(values)[~stays]
    moves = moves[np.isfinite(moves)]
    for word, there in ends.items():
        edges = np.flatnonzero(np.diff(np.concatenate(([False], there, [False])).astype(int)))
        times = int(np.sum(edges[1::2] - edges[::2] > 1))
        rows = np.flatnonzero(there)
        if times >= ENDS and len(rows) >= ENDED_ROWS and len(moves) and np.mean(moves == 0) <= SELDOM:
            yield word, rows, times


def _spikes(values: np.ndarray, inputs: Sequence[np.ndarray]) -> np.ndarray:
    """Rows in which an output lies by far more beside its neighbours than it ever does.

    Not where an input leaves and is back as well, or has just done so: the plant may follow. None where there are many: that is noise.
    """
    beside, beyond = _beside(values)
    usual = beside[beside > 0]  # neither rest nor gaps
    if not len(usual):
        return np.zeros(0, int)
    driven = np.zeros(len(values), bool)
    for u in inputs:
        pulse = _beside(u)[1] > PULSE * np.ptp(u)
        driven |= pulse | np.concatenate(([False], pulse[:-1]))
    # a spike puts its neighbours aside too, by half as much
    highest = (beside >= np.append(beside[1:], 0)) & (beside >= np.append(0, beside[:-1]))
    found = np.flatnonzero(highest & (beyond > SPIKE * np.quantile(usual, 1 - SELDOM)) & ~driven)
    return found if len(found) <= max(1, MOST_SPIKES * len(values)) else found[:0]


def _beside(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far each value (N,) lies from the middle of its neighbours; and beyond both, where they are close together, else 0."""
    away, beyond = np.zeros(len(values)), np.zeros(len(values))
    if len(values) > 2:
        before, after = values[1:-1] - values[:-2], values[1:-1] - values[2:]
        away[1:-1] = np.abs(before + after) / 2
        alone = (before * after > 0) & (np.abs(before - after) <= away[1:-1])
        beyond[1:-1][alone] = np.minimum(np.abs(before), np.abs(after))[alone]
    return away, beyond
