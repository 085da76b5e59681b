"""What a record must satisfy; a message names all offending rows at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.base import DataError
from greybox.base.numerics import LARGEST_VALUE, SMALLEST_VALUE


@dataclass(frozen=True)
class RowLabels:
    """How rows are called in messages: ``line 17`` of a text file, ``row 16`` of anything else (counted from 1)."""

    word: str = "row"
    numbers: Sequence[int] | np.ndarray | None = None

    def select(self, rows: slice) -> RowLabels:
        """The same for these rows alone, which are counted from 0 again."""
        numbers = range(1, (rows.stop or 0) + 1) if self.numbers is None else self.numbers
        return RowLabels(self.word, numbers[rows])

    def without(self, left: np.ndarray) -> RowLabels:
        """The same without the rows where ``left`` (N,)."""
        numbers = np.arange(1, len(left) + 1) if self.numbers is None else np.asarray(self.numbers)
        return RowLabels(self.word, numbers[: len(left)][~left])

    def describe(self, rows: Sequence[int] | np.ndarray, shown: int = 5) -> str:
        """Name the rows (counted from 0): ``line 17`` or ``lines 17, 18, 19, 20, 21 and 40 more``."""
        named = [str(int(r) + 1 if self.numbers is None else int(self.numbers[r])) for r in rows[:shown]]
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
    time: np.ndarray, inputs: Mapping[str, np.ndarray], outputs: Mapping[str, np.ndarray], labels: RowLabels
) -> list[str]:
    """Problems that make arrays of equal length unusable as any record, whole or part."""
    problems: list[str] = []
    if len(time) < 2:
        problems.append(f"{len(time)} rows; a record needs at least 2")
    problems += find_time_problems(time, labels)
    for name, values in inputs.items():
        problems += _find_rows(
            f"input {name!r} is empty or NaN",
            np.isnan(values),
            labels,
            "an input must be known at every row; fill it or cut the record there",
        )
    for kind, signals in (("input", inputs), ("output", outputs)):
        for name, values in signals.items():
            empty = ", or leave it empty" if kind == "output" else ""
            problems += _find_rows(
                f"{kind} {name!r} is infinite", np.isinf(values), labels, f"write a finite number{empty}"
            )
            problems += _find_rows(
                f"{kind} {name!r} is beyond {LARGEST_VALUE:g}",
                np.isfinite(values) & (np.abs(values) > LARGEST_VALUE),
                labels,
                f"the squares of such numbers overflow; correct it{empty}",
            )
    return problems


# Rows below which nothing is a record: two are one step of time. Textbook problems have six, and whether they determine the
# constants is what a fit's intervals say.
FEWEST_ROWS = 2
# Rows of a piece between gaps in time below which it is left out, and of a record below which it is told how little it carries.
FEW_ROWS = 10


def find_measurement_problems(
    inputs: Mapping[str, np.ndarray], outputs: Mapping[str, np.ndarray], rows: int, allow_constant_input: bool
) -> list[str]:
    """Problems of a measured record from which nothing can be learnt."""
    problems: list[str] = []
    if rows < FEWEST_ROWS:
        problems.append(f"{rows} rows; a record needs at least {FEWEST_ROWS}")
    if not outputs:
        problems.append("no output; a record needs at least one measured output")
    # Whether anything moves is no question for so few.
    if rows < FEWEST_ROWS:
        return problems
    empty = [name for name, values in outputs.items() if np.isnan(values).all()]
    problems += [
        f"output {name!r} holds no value at all; remove it from the record if it was not measured" for name in empty
    ]
    for kind, signals in (("input", inputs), ("output", outputs)):
        for name, values in signals.items():
            largest = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
            if 0 < largest < SMALLEST_VALUE:
                problems.append(
                    f"{kind} {name!r} never exceeds {largest:.3g}, and the squares of such numbers vanish; check its unit"
                )
    inputs_rest = all(map(is_constant, inputs.values()))
    if outputs and not empty and all(map(is_constant, outputs.values())):
        constant = [*(inputs if inputs_rest else ()), *outputs]
        what = "nothing moves" if inputs_rest else "no output moves"
        problems.append(
            f"{what}: {', '.join(map(repr, constant))} {'is' if len(constant) == 1 else 'are'} constant over the whole record;"
            " a record must show the plant in motion: check the sensors and the columns"
        )
    elif inputs and inputs_rest and not allow_constant_input and not any(v[0] for v in inputs.values()):
        names = " and ".join(map(repr, inputs))
        problems.append(
            f"constant input: {names} {'is' if len(inputs) == 1 else 'are'} 0 in every row, so the record"
            " does not excite the plant; check the column, or for a free decay set allow_constant_input=True"
            " (shell: --free-decay)"
        )
    return problems


def find_repeats(time: np.ndarray, columns: Iterable[np.ndarray]) -> np.ndarray:
    """Rows (N,) that say once more what the row before says, at the same time: a logger that wrote it twice. None where others differ."""
    repeats = np.append(False, np.diff(time) == 0)
    rows = np.flatnonzero(repeats)
    for values in columns if len(rows) else ():
        if len(values) != len(time) or not np.array_equal(values[rows], values[rows - 1], equal_nan=True):
            return np.zeros(len(time), bool)
    return repeats


def is_constant(values: np.ndarray) -> bool:
    """Whether every measured value is the same; gaps aside."""
    known = values[~np.isnan(values)]
    return bool(len(known) == 0 or np.all(known == known[0]))


def find_time_problems(time: np.ndarray, labels: RowLabels) -> list[str]:
    """Why these seconds (N,) are no time of a record: every row needs one, and each is later than that before."""
    unknown = _find_rows("time is empty or NaN", np.isnan(time), labels, "every row needs its time")
    unknown += _find_rows("time is infinite", np.isinf(time), labels, "every row needs its time")
    huge = np.isfinite(time) & (np.abs(time) > LARGEST_VALUE)
    unknown += _find_rows(f"time is beyond {LARGEST_VALUE:g}", huge, labels, "the squares of such numbers overflow")
    if unknown:
        return unknown
    step = np.diff(time)
    repeated, backwards = np.append(False, step == 0), np.append(False, step < 0)
    rule = "time must increase from row to row"
    replicates = (
        "of other readings at the same time make a record for each replicate (rep1.csv rep2.csv), or a second output"
        + _describe_coarse_clock(step)
    )
    remedy = (
        "the newest row comes first: sort the rows by their time"
        if backwards[1:].all()
        else "read separate runs from separate files, or split there (shell: --split-holes)"
    )
    return [
        *_find_rows("time is repeated", repeated, labels, f"{rule}; {replicates}", time),
        *_find_rows("time goes back", backwards, labels, f"{rule}; {remedy}", time),
    ]


# Steps of a clock from which it is told by them, and how many rows two of them may differ by.
FEWEST_TICKS, UNEVEN_ROWS = 3, 1
# Share of a step of the clock by which two of them may differ: times of day in seconds have lost their last digits.
CLOCK_ROUNDING = 1e-6


def _describe_coarse_clock(step: np.ndarray) -> str:
    """What to do with times (N - 1 steps) of a clock that moves once in several rows; "" where they are of no such clock."""
    ticks = np.flatnonzero(step)
    if len(ticks) < FEWEST_TICKS or step.min() < 0:
        return ""
    rows, (shortest, longest) = np.diff(ticks), (step[ticks].min(), step[ticks].max())
    if longest - shortest > CLOCK_ROUNDING * longest or np.ptp(rows) > UNEVEN_ROWS or rows.min() == 1:
        return ""
    # Rows between the first tick and the last: whole steps of the clock.
    period = longest * len(rows) / (ticks[-1] - ticks[0])
    return (
        f"; of rows that come faster than the clock counts, {(ticks[-1] - ticks[0]) / len(rows):.3g} in {longest:.6g} s, leave the column"
        f" out, '-' in its place among the names of all columns, columns=['-', 'u', ...] (shell: --columns=-,u,...), and give"
        f" sampling_time={period:.6g} (shell: --sampling-time {period:.6g})"
    )


def _find_rows(what: str, bad: np.ndarray, labels: RowLabels, rule: str, time: np.ndarray | None = None) -> list[str]:
    """One problem that names the rows where ``bad`` (N,), and none if there is no such row."""
    rows = np.flatnonzero(bad)
    if not len(rows):
        return []
    value = "" if time is None else f" ({time[rows[0]]:.12g} s after {time[rows[0] - 1]:.12g} s)"
    return [f"{what} at {labels.describe(rows)}{value}; {rule}"]
