"""What a record must satisfy, said for all offending rows at once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.errors import DataError

FEWEST_ROWS = 10  # of a measured record
FROZEN_ROWS = 20  # of a sensor that stands still
AS_EVER = 0.5  # of an input's range before: one that goes on so far is still moving the plant
SELDOM = 0.05  # of the steps elsewhere; a sensor that repeats its values more often is coarse or rests
SHOWN = 5  # rows named in a message before "and 40 more"


@dataclass(frozen=True)
class Places:
    """How rows are called in messages: ``line 17`` of a text file, ``row 16`` of anything else (counted from 1)."""

    word: str = "row"
    numbers: np.ndarray | None = None

    def say(self, rows: Sequence[int] | np.ndarray) -> str:
        """Name the rows (counted from 0): ``line 17`` or ``lines 17, 18, 19, 20, 21 and 40 more``."""
        named = [str(int(r) + 1 if self.numbers is None else int(self.numbers[r])) for r in rows[:SHOWN]]
        word = self.word if len(rows) == 1 else f"{self.word}s"
        return f"{word} {enumerated(named, len(rows))}"


def enumerated(shown: Sequence[str], total: int) -> str:
    """``a, b, c and 40 more`` of ``total`` things."""
    return ", ".join(shown) + (f" and {total - len(shown)} more" if total > len(shown) else "")


def refuse(subject: str, problems: Sequence[str]) -> None:
    """Raise one DataError that lists every problem of ``subject``; nothing happens without problems."""
    if len(problems) == 1:
        raise DataError(f"{subject}: {problems[0]}")
    if problems:
        raise DataError(f"{subject}: {len(problems)} problems:\n" + "\n".join(f"  - {p}" for p in problems))


def invariants(
    time: np.ndarray, inputs: Mapping[str, np.ndarray], outputs: Mapping[str, np.ndarray], places: Places
) -> list[str]:
    """Problems that make arrays of equal length unusable as any record, whole or part."""
    found: list[str] = []
    if len(time) < 2:
        found.append(f"{len(time)} rows; a record needs at least 2")
    found += _time_problems(time, places)
    for name, values in inputs.items():
        found += _at(
            f"input {name!r} is empty or NaN",
            np.isnan(values),
            places,
            "an input must be known at every row; fill it or cut the record there",
        )
    for kind, signals in (("input", inputs), ("output", outputs)):
        for name, values in signals.items():
            found += _at(
                f"{kind} {name!r} is infinite",
                np.isinf(values),
                places,
                "write a finite number" + (", or leave it empty" if kind == "output" else ""),
            )
    return found


def measured(
    inputs: Mapping[str, np.ndarray], outputs: Mapping[str, np.ndarray], rows: int, allow_constant_input: bool
) -> list[str]:
    """Problems of a measured record that say: there is nothing to learn from it."""
    found: list[str] = []
    if rows < FEWEST_ROWS:
        found.append(f"{rows} rows; a record needs at least {FEWEST_ROWS}")
    if not outputs:
        found.append("no output; a record needs at least one measured output")
    if not rows:
        return found
    empty = [name for name, values in outputs.items() if np.isnan(values).all()]
    found += [
        f"output {name!r} holds no value at all; remove it from the record if it was not measured" for name in empty
    ]
    still = all(map(constant, inputs.values()))
    if outputs and not empty and all(map(constant, outputs.values())):
        dead = [*(inputs if still else ()), *outputs]
        what = "nothing moves" if still else "no output moves"
        found.append(
            f"{what}: {', '.join(map(repr, dead))} {'is' if len(dead) == 1 else 'are'} constant over the whole record;"
            " a record must show the plant in motion, check the sensors and the columns"
        )
    elif inputs and still and not allow_constant_input and not any(v[0] for v in inputs.values()):
        names = " and ".join(map(repr, inputs))
        found.append(
            f"constant input: {names} {'is' if len(inputs) == 1 else 'are'} 0 in every row, so the record"
            " does not excite the plant; check the column, or for a free decay say allow_constant_input=True"
            " (shell: --free-decay)"
        )
    return found


def remarks(time: np.ndarray, inputs: Mapping[str, np.ndarray], outputs: Mapping[str, np.ndarray]) -> Iterator[str]:
    """What is accepted but should be known: what is constant, sensors that stand still for a while, gaps."""
    for name, values in inputs.items():
        if constant(values):
            yield f"input {name!r} is constant at {values[0]:g}"
    for name, values in outputs.items():
        if constant(values):
            value = values[~np.isnan(values)][0]
            yield f"output {name!r} is constant at {value:g}: a sensor that never moves tells nothing; leave it out"
        elif frozen := _frozen(values, inputs):
            first, last = frozen
            yield (
                f"output {name!r} stands still at exactly {values[first]:g} for {last - first + 1} rows, from {time[first]:.6g} to"
                f" {time[last]:.6g} s, while the input moves, and comes or goes with a jump: if the sensor or the"
                " logger failed there, leave these fields empty"
            )
        elif (dead := _died(values, inputs)) is not None:
            yield (
                f"output {name!r} stands still at exactly {values[dead]:g} from {time[dead]:.6g} s to the end ({len(time) - dead}"
                " rows), while the input goes on moving: if the sensor or the logger failed there, leave these fields empty"
            )
        gaps = int(np.isnan(values).sum())
        if gaps:
            yield f"output {name!r} has {gaps} gap{'s' if gaps > 1 else ''} in {len(values)} rows"


def constant(values: np.ndarray) -> bool:
    """Whether every measured value is the same; gaps aside."""
    known = values[~np.isnan(values)]
    return bool(len(known) == 0 or np.all(known == known[0]))


def _frozen(values: np.ndarray, inputs: Mapping[str, np.ndarray]) -> tuple[int, int] | None:
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
    return None if all(constant(u[first:last]) for u in inputs.values()) else (first, last)


def _died(values: np.ndarray, inputs: Mapping[str, np.ndarray]) -> int | None:
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
    on = any(np.ptp(u[first:-1]) > AS_EVER * np.ptp(u[: first + 1]) for u in inputs.values())
    return first if on else None


def _time_problems(time: np.ndarray, places: Places) -> list[str]:
    found = _at("time is empty or NaN", np.isnan(time), places, "every row needs its time")
    found += _at("time is infinite", np.isinf(time), places, "every row needs its time")
    if found:
        return found
    step = np.diff(time)
    found += _at("time is repeated", np.append(False, step == 0), places, "time must increase from row to row", time)
    found += _at(
        "time goes back",
        np.append(False, step < 0),
        places,
        "time must increase from row to row; read separate runs from separate files",
        time,
    )
    return found


def _at(what: str, bad: np.ndarray, places: Places, rule: str, time: np.ndarray | None = None) -> list[str]:
    rows = np.flatnonzero(bad)
    if not len(rows):
        return []
    value = "" if time is None else f" ({time[rows[0]]:.12g} s after {time[rows[0] - 1]:.12g} s)"
    return [f"{what} at {places.say(rows)}{value}; {rule}"]
