"""What a record must satisfy, said for all offending rows at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.errors import DataError

FEWEST_ROWS = 10  # of a measured record
SHOWN = 5  # rows named in a message before "and 40 more"


@dataclass(frozen=True)
class RowLabels:
    """How rows are called in messages: ``line 17`` of a text file, ``row 16`` of anything else (counted from 1)."""

    word: str = "row"
    numbers: np.ndarray | None = None

    def of(self, rows: slice) -> RowLabels:
        """The same for these rows alone, which are counted from 0 again."""
        numbers = np.arange(1, (rows.stop or 0) + 1) if self.numbers is None else self.numbers
        return RowLabels(self.word, numbers[rows])

    def say(self, rows: Sequence[int] | np.ndarray) -> str:
        """Name the rows (counted from 0): ``line 17`` or ``lines 17, 18, 19, 20, 21 and 40 more``."""
        named = [str(int(r) + 1 if self.numbers is None else int(self.numbers[r])) for r in rows[:SHOWN]]
        word = self.word if len(rows) == 1 else f"{self.word}s"
        return f"{word} {enumerate_first(named, len(rows))}"


def enumerate_first(shown: Sequence[str], total: int) -> str:
    """``a, b, c and 40 more`` of ``total`` things."""
    return ", ".join(shown) + (f" and {total - len(shown)} more" if total > len(shown) else "")


def raise_problems(subject: str, problems: Sequence[str]) -> None:
    """Raise one DataError that lists every problem of ``subject``; nothing happens without problems."""
    if len(problems) == 1:
        raise DataError(f"{subject}: {problems[0]}")
    if problems:
        raise DataError(f"{subject}: {len(problems)} problems:\n" + "\n".join(f"  - {p}" for p in problems))


def find_array_problems(
    time: np.ndarray, inputs: Mapping[str, np.ndarray], outputs: Mapping[str, np.ndarray], places: RowLabels
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


def find_measurement_problems(
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
    still = all(map(is_constant, inputs.values()))
    if outputs and not empty and all(map(is_constant, outputs.values())):
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


def is_constant(values: np.ndarray) -> bool:
    """Whether every measured value is the same; gaps aside."""
    known = values[~np.isnan(values)]
    return bool(len(known) == 0 or np.all(known == known[0]))


def _time_problems(time: np.ndarray, places: RowLabels) -> list[str]:
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
        "time must increase from row to row; read separate runs from separate files, or split there (shell: --split-holes)",
        time,
    )
    return found


def _at(what: str, bad: np.ndarray, places: RowLabels, rule: str, time: np.ndarray | None = None) -> list[str]:
    rows = np.flatnonzero(bad)
    if not len(rows):
        return []
    value = "" if time is None else f" ({time[rows[0]]:.12g} s after {time[rows[0] - 1]:.12g} s)"
    return [f"{what} at {places.say(rows)}{value}; {rule}"]
