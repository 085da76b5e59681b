"""Holes in the time of a record: split the record there, and refuse to simulate through a long one.

In a hole nobody knows the input: it is taken to go on. That does little harm over a few rows, or where the drive stood still.
A simulation through a long hole of a moving input answers an input that was never there, so that whatever follows the hole
contradicts the model. There the record is two records. So it is where the equations are integrated in steps, whatever the
input does: every interval of a record takes as many of them as its longest.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from greybox.experiment.problems import FEWEST_ROWS, SHOWN, enumerate_first, is_constant, raise_problems
from greybox.experiment.sampling import GRID_TOLERANCE, SPLIT, describe_timing, find_time_gaps

if TYPE_CHECKING:
    from greybox.experiment.experiment import Experiment

LONG = 20  # missing rows; fewer do little harm
NEARBY = 20  # rows before and after a hole in which a drive that is off shows itself
TRIED = 12  # times up to the length of a hole, over which the input's change is looked at
# Of the input's standard deviation: what has changed so much (rms) is known no better than by its mean.
LOST = 1.0


class UnknownInputGap(NamedTuple):
    """A hole from ``start`` to ``stop`` (s) of ``rows`` missing rows; ``change`` of the input in it, of its standard deviation."""

    start: float
    stop: float
    rows: int
    name: str
    change: float


def split_record(record: Experiment, fewest: int = FEWEST_ROWS) -> tuple[Experiment, ...]:
    """``record`` cut at every hole in its time; itself where there is none. See `Experiment.split_at_holes`."""
    at = find_time_gaps(record.time) + 1
    if not len(at):
        return (record,)
    bounds = list(zip([0, *at], [*at, record.rows], strict=True))
    kept = [(a, b) for a, b in bounds if b - a >= max(fewest, 2) and _measures(record, a, b)]
    if not kept:
        longest = max(b - a for a, b in bounds)
        rule = f"the longest has {longest} rows, and a record needs at least {fewest} with a measured output"
        raise_problems(
            f"experiment {record.name!r}", [f"holes in time leave {len(bounds)} pieces: {rule}; record it anew"]
        )
    # what the whole record says of its time no longer holds of the pieces
    said = [text for text in record.notes if text not in describe_timing(record.time, record.sampling_time)]
    told = tuple(said + _left_out(record, [piece for piece in bounds if piece not in kept]))
    return tuple(replace(record.window(a, b), notes=told) for a, b in kept)


def common_sampling_time(parts: Iterable[Experiment]) -> float | None:
    """The sampling time (s) of all ``parts`` of one record together, None where they are not sampled alike.

    The stamps of each part alone give it to as many digits as they were printed with; equal steps make equal discrete models.
    """
    group = list(parts)
    steps = [(part.sampling_time, part.rows - 1) for part in group]
    usual = sum(part.duration for part in group) / sum(rows for _, rows in steps)
    alike = all(step is not None and abs(step - usual) * rows <= GRID_TOLERANCE * usual for step, rows in steps)
    return usual if alike else None


def refuse_unknown_input(records: Iterable[Experiment]) -> None:
    """Raise DataError for a record with a long hole in which an input moves on, unknown; it names the longest."""
    for record in records:
        guessed = _guessed(record)
        if guessed:
            worst = max(guessed, key=lambda guess: guess.rows)
            more = f" (and {len(guessed) - 1} more)" if len(guessed) > 1 else ""
            why = (
                f"{worst.rows} rows are missing, and in as long a time input {worst.name!r} changes by {worst.change:.2g} times its"
                " standard deviation, so that a simulation through the hole says nothing"
            )
            remedy = f"{SPLIT}, or fill in the missing rows of the input and leave the outputs empty"
            _refuse_hole(record, worst.start, worst.stop, more, f"{why}; {remedy}")


def refuse_long_time_gaps(records: Iterable[Experiment]) -> None:
    """Raise DataError for a record with a long hole: of a model that is integrated in steps."""
    for record in records:
        longest = max(_long(record), key=lambda hole: hole[1], default=None)
        if longest:
            k, rows = longest
            why = (
                f"{rows} rows are missing, and a model that is integrated in steps takes as many of them in every interval as in the"
                " longest"
            )
            _refuse_hole(record, float(record.time[k]), float(record.time[k + 1]), "", f"{why}; {SPLIT}")


def _refuse_hole(record: Experiment, start: float, stop: float, more: str, said: str) -> None:
    raise_problems(f"experiment {record.name!r}", [f"time has a hole from {start:.6g} to {stop:.6g} s{more}: {said}"])


def _long(record: Experiment) -> list[tuple[int, int]]:
    """Each long hole of ``record``: the row before it, and how many are missing."""
    usual = float(np.median(np.diff(record.time)))
    missing = [
        (int(k), round(float(record.time[k + 1] - record.time[k]) / usual) - 1) for k in find_time_gaps(record.time)
    ]
    return [(k, rows) for k, rows in missing if rows >= LONG]


def _guessed(record: Experiment) -> list[UnknownInputGap]:
    """The holes of ``record`` through which no simulation means anything."""
    after, found = find_time_gaps(record.time), []
    for k, rows in _long(record):
        around = slice(max(0, k + 1 - NEARBY), k + 1 + NEARBY)
        changes = {n: _change(u, after, k, rows) for n, u in record.inputs.items() if not is_constant(u[around])}
        lost = max(changes, key=lambda n: changes[n], default="")
        if lost and changes[lost] >= LOST:
            found.append(UnknownInputGap(float(record.time[k]), float(record.time[k + 1]), rows, lost, changes[lost]))
    return found


def _change(u: np.ndarray, after: np.ndarray, k: int, rows: int) -> float:
    """How much the input ``u`` (N,) changes in a hole of ``rows`` rows after row ``k``, in its standard deviations.

    The larger of what it does elsewhere in up to as many rows (rms, no pair is across a hole) and of the jump across this one.
    """
    parts = np.split(u, after + 1)
    spans = np.unique(np.geomspace(1, rows, TRIED).astype(int))
    moves = [np.concatenate([p[span:] - p[:-span] for p in parts if len(p) > span] or [[]]) for span in spans]
    elsewhere = max((float(np.sqrt(np.mean(m**2))) for m in moves if len(m)), default=0.0)
    return max(elsewhere, float(abs(u[k + 1] - u[k]))) / float(np.std(u))


def _measures(record: Experiment, a: int, b: int) -> bool:
    return any(np.isfinite(values[a:b]).any() for values in record.outputs.values())


def _left_out(record: Experiment, dropped: list[tuple[int, int]]) -> list[str]:
    """A note on the pieces that are too short to be records; none where none is."""
    if not dropped:
        return []
    shown = [f"{record.time[a]:.6g} to {record.time[b - 1]:.6g} s ({b - a})" for a, b in dropped[:SHOWN]]
    return [f"left out, too few rows between two holes in time: {enumerate_first(shown, len(dropped))}"]
