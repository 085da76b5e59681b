"""Whether two records are the same measurement, wholly or in part: by their readings, whatever the clock, the digits and the file.

Two experiments alike give readings that differ by noise; a copy gives the same ones, but for the digits in which it was written. So two
records are one measurement where all readings of one follow one another in the other, or where the end of one is the beginning of the
other, each as it was rounded. What a repetition would read as well is no evidence: readings that move by a digit or two (constant, coarse),
that are smooth (a simulation without noise), that recur within the record; nor are readings that part later (runs that begin alike).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from greybox.base import TINY, DataError, Finding, Severity
from greybox.data.experiment import Experiment, find_usual_interval
from greybox.data.findings import RecordCode

# Readings that nothing leads to expect and that must be the same in a part of two records: of a repetition each agrees by chance once in a
# few times at most, and there are as many places to begin as rows.
EVENTS = 20
# Changes of so many digits from row to row that must be the same where all rows of both records agree, their inputs too: there is one place
# to begin. A coarse reading that follows a signal by one digit at a time would do so again.
CHANGES_OF_WHOLE, CHANGE_DIGITS = 8, 2.5
# A reading is unexpected where its fourth difference is so large a share of the second ones, each over that of white noise of one level
# (sqrt(70), sqrt(6)): about 1 for noise, and the less for a signal the smoother it is ...
UNEXPECTED = 0.3
# ... and so many digits: those of a coarse reading that moves by one digit now and then reach six, of one that rounds a line eight.
EVENT_DIGITS = 8.0
# Values of which the digit is found; with fewer in a range of a factor of two that of the next larger range stands for it.
DIGIT_VALUES, FEWEST_GAPS = 5000, 8
# A digit below this share of another was rounded for itself: the halves of both count.
MUCH_FINER = 0.3
# Smallest digit over the largest value: what is below it is the arithmetic of converted units.
FINEST_DIGIT = 1e-10
# A difference is a whole multiple of a digit to this share of it; and the multiples from which the digit is found, step by step.
WHOLE, MULTIPLES = 0.02, (30.0, 1e3, 3e4, 1e6, np.inf)


@dataclass(frozen=True)
class SharedReadings:
    """Readings that two records have in common.

    Attributes
    ----------
    first, second
        The records.
    rows
        How many rows they share.
    start, second_start
        The row of each where these begin, counted from 0.
    every
        The row of the finer record, counted from there, that the other one kept: 1 where it kept all.
    """

    first: Experiment
    second: Experiment
    rows: int
    start: int = 0
    second_start: int = 0
    every: int = 1

    @property
    def place(self) -> str:
        """``the same data as a.csv``, or which rows of it."""
        name = self.first.source or self.first.name
        if name == self.second.source and self.first.name == self.second.name:
            return "given twice"
        if self.every > 1:
            finer, coarser = sorted((self.first, self.second), key=lambda e: -e.rows)
            one, other = (e.source or e.name for e in (coarser, finer))
            return f"{one} is one in {self.every} rows of {other}"
        if self.rows == self.first.rows == self.second.rows:
            return f"the same data as {name}"
        mine, theirs = (f"{start + 1} to {start + self.rows}" for start in (self.second_start, self.start))
        return f"rows {mine} are the readings of rows {theirs} of {name}"


def find_shared_readings(
    records: Sequence[Experiment], others: Sequence[Experiment] | None = None
) -> Iterator[SharedReadings]:
    """Pairs of records that are the same measurement, wholly or in part.

    Parameters
    ----------
    records
        Compared with one another, or each, as the second of a pair, with ``others``.
    others
        The first of each pair; None for the earlier ones of ``records``.
    """
    known = {id(e): _Readings(e) for e in (*records, *(others or ()))}
    pairs = combinations(records, 2) if others is None else ((b, a) for a in records for b in others)
    for first, second in pairs:
        shared = _compare(known[id(first)], known[id(second)])
        if shared is not None:
            yield shared


def refuse_repeated(records: Iterable[Experiment]) -> None:
    """Refuse records of which some are the same measurement. Raises DataError with the first pair."""
    for shared in find_shared_readings(list(records)):
        name = shared.second.source or shared.second.name
        raise DataError(
            f"{name}: {shared.place}; its data would count twice, and intervals be too narrow; leave one out"
        )


def mark_fitted(validation: Iterable[Experiment], estimation: Sequence[Experiment]) -> tuple[Experiment, ...]:
    """The validation records, each with a finding where it is a measurement that is fitted too."""
    marked = []
    for record in validation:
        shared = next(find_shared_readings([record], estimation), None)
        if shared is not None and RecordCode.ALSO_FITTED not in [finding.code for finding in record.findings]:
            values = {"record": shared.first.source or shared.first.name, "place": shared.place}
            finding = Finding(RecordCode.ALSO_FITTED, Severity.WARNING, values=values)
            record = replace(record, findings=(*record.findings, finding))
        marked.append(record)
    return tuple(marked)


def _compare(first: _Readings, second: _Readings) -> SharedReadings | None:
    a, b = first.experiment, second.experiment
    if a is b:
        return SharedReadings(a, b, a.rows)
    if a.rows == b.rows and first.is_like(second):
        # Runs of one file may be alike: a program without noise wrote them.
        return None if a.source and a.source == b.source and a.name != b.name else SharedReadings(a, b, a.rows)
    start = second.find_in(first)
    if start is not None:
        return SharedReadings(a, b, min(a.rows - start, b.rows), start)
    start = first.find_in(second)
    if start is not None:
        return SharedReadings(a, b, min(b.rows - start, a.rows), 0, start)
    return _compare_thinned(first, second)


def _compare_thinned(first: _Readings, second: _Readings) -> SharedReadings | None:
    """What two records share of which one has a row for several of the other, as a measurement that was resampled has."""
    steps = [find_usual_interval([r.experiment]) for r in (first, second)]
    finer, coarser = (first, second) if steps[0] < steps[1] else (second, first)
    every = round(max(steps) / max(min(steps), TINY)) if min(steps) > 0 else 1
    if not 1 < every <= finer.experiment.rows / EVENTS:
        return None
    for offset in range(every):
        start = coarser.find_in(_Readings(_thin(finer.experiment, every, offset)))
        if start is not None:
            return SharedReadings(first.experiment, second.experiment, coarser.experiment.rows, every=every)
    return None


def _thin(experiment: Experiment, every: int, offset: int) -> Experiment:
    """One in ``every`` rows of a record, from row ``offset``."""
    rows = slice(offset, None, every)
    inputs, outputs = ({n: v[rows] for n, v in group.items()} for group in (experiment.inputs, experiment.outputs))
    noise = {n: v[rows] for n, v in experiment.noise.items()}
    return replace(experiment, time=experiment.time[rows], inputs=inputs, outputs=outputs, noise=noise)


@dataclass(frozen=True, eq=False)
class _Readings:
    """The signals of a record, with the digits in which they were written."""

    experiment: Experiment

    @cached_property
    def signals(self) -> dict[str, np.ndarray]:
        """Every signal by its name."""
        return {**self.experiment.inputs, **self.experiment.outputs}

    @cached_property
    def digits(self) -> dict[str, np.ndarray]:
        """Signal -> digit (N,) of each value."""
        return {name: _find_digits(values) for name, values in self.signals.items()}

    @cached_property
    def events(self) -> dict[str, np.ndarray]:
        """Output -> rows whose reading is not what those before it lead to expect."""
        rows_of = {}
        for name, values in self.experiment.outputs.items():
            second, fourth = np.abs(np.diff(values, 2)), np.abs(np.diff(values, 4))
            around = np.maximum(np.maximum(second[:-2], second[1:-1]), second[2:])
            with np.errstate(invalid="ignore"):
                is_rough = fourth / np.sqrt(70) > UNEXPECTED * around / np.sqrt(6)
                rows_of[name] = np.flatnonzero(is_rough & (fourth > EVENT_DIGITS * self.digits[name][4:])) + 4
        return rows_of

    def is_like(self, other: _Readings) -> bool:
        """Whether all rows agree with those of another record of as many, and some of them change."""
        outputs = [name for name in self.experiment.outputs if name in other.experiment.outputs]
        rows = np.arange(self.experiment.rows)
        common = [name for name in self.signals if name in other.signals]
        if not outputs or not all(self._agrees(other, name, rows, rows).all() for name in common):
            return False
        return any(self._changes(name) for name in outputs)

    def _changes(self, name: str) -> bool:
        """Whether a signal has changes that a repetition would not have in the same rows: by several digits, or to and fro."""
        changes = np.diff(self.signals[name])
        changes, digits = (values[np.isfinite(changes)] for values in (changes, self.digits[name][1:]))
        moves = np.sign(changes[np.abs(changes) > 0.5 * digits])
        large = int((np.abs(changes) > CHANGE_DIGITS * digits).sum())
        return large >= CHANGES_OF_WHOLE or int((moves[1:] != moves[:-1]).sum()) >= EVENTS

    def find_in(self, other: _Readings, least: int = 0) -> int | None:
        """The row of ``other``, ``least`` at least, from which it reads as this record from its first row to the end of one of them."""
        common = [name for name in self.events if name in other.experiment.outputs]
        if not common:
            return None
        telling = max(common, key=lambda name: len(self.events[name]))
        events, rows = self.events[telling][:EVENTS], other.experiment.rows
        if len(events) < EVENTS:
            return None
        starts = np.arange(least, rows - events[-1])
        for row in events:
            starts = starts[self._agrees(other, telling, row, starts + row)]
            if not len(starts):
                return None
        for start in map(int, starts):
            count = min(rows - start, self.experiment.rows)
            mine = np.arange(count)
            if all(self._agrees(other, name, mine, start + mine).all() for name in common):
                return start if least or not self._recurs(count) else None
        return None

    def _agrees(self, other: _Readings, name: str, mine: np.ndarray | int, theirs: np.ndarray) -> np.ndarray:
        """Whether values at rows of this record and of another are one, as each was rounded; what one of them lacks agrees."""
        one, two = self.digits[name][mine], other.digits[name][theirs]
        coarse, fine = np.maximum(one, two), np.minimum(one, two)
        within = 0.5 * (1 + 1e-6) * (coarse + np.where(fine < MUCH_FINER * coarse, fine, 0.0))
        return ~(np.abs(self.signals[name][mine] - other.signals[name][theirs]) > within)

    def _recurs(self, rows: int) -> bool:
        """Whether the first rows read a second time what they read before: then a repetition would as well."""
        part = _Readings(self.experiment.window(0, rows))
        again = part.find_in(part, 1)
        return again is not None and again <= rows // 2


def _find_digits(values: np.ndarray) -> np.ndarray:
    """The digit (N,) in which each value was written: decimals, significant digits or bits, whatever unit it was converted to."""
    sizes = np.abs(np.nan_to_num(values))
    largest = float(sizes.max(initial=0.0))
    if not largest:
        return np.zeros(len(values))
    finest = FINEST_DIGIT * largest
    of_all = _common_divisor(values[np.isfinite(values)][:DIGIT_VALUES], largest)
    # Significant digits grow with the value: of each range of a factor of two its own, not smaller than the digit of all.
    octaves = np.floor(np.log2(np.maximum(sizes, finest))).astype(int)
    octaves -= octaves.min()
    digits = np.full(int(octaves.max()) + 1, np.nan)
    for octave in np.unique(octaves):
        inside = sizes[octaves == octave][:DIGIT_VALUES]
        if len(np.unique(inside)) > FEWEST_GAPS:
            digits[octave] = max(of_all, _common_divisor(inside, largest))
    known = np.flatnonzero(np.isfinite(digits))
    if not len(known):
        return np.full(len(values), of_all)
    # The next larger range where there is one; a converted unit moves a power of ten into the middle of a range, so that the coarser
    # digit of two neighbours counts. Above all known ones there may be one digit less.
    places = np.searchsorted(known, octaves)
    inside_range, above = (digits[known[np.minimum(places + k, len(known) - 1)]] for k in (0, 1))
    return np.where(places < len(known), np.maximum(inside_range, above), 10 * inside_range)


def _common_divisor(values: np.ndarray, largest: float) -> float:
    """The largest step of which all differences of values are whole multiples, by Euclid's algorithm on all of them at once."""
    finest = FINEST_DIGIT * largest
    gaps = np.diff(np.unique(values))
    gaps = gaps[gaps > finest]
    step = float(gaps.min(initial=np.inf))
    while finest < step < np.inf:  # at infinity no rest is left, and no step fits
        exact = step
        for most in MULTIPLES:  # an error of the step grows with its multiples: first from the small ones
            near = gaps[gaps < most * exact]
            if len(near):
                exact = float(near.sum() / np.maximum(np.round(near / exact), 1.0).sum())
        if (np.abs(gaps - exact * np.round(gaps / exact)) < WHOLE * exact).all():
            return exact
        rest = np.abs(gaps - step * np.round(gaps / step))
        step = float(rest[rest > finest].min(initial=np.inf))
    return finest
