"""Dates and times of day, as files write them: every format hands its raw stamps here, and gets seconds from one origin.

A stamp is kept in whole nanoseconds, because seconds since 1970 leave a double a quarter of a microsecond. With a time zone it counts in
UTC; without one it counts as it is written, and an hour that the clock was put forward or back is taken out. A date carries its unit: the
one in its header does not hold for it.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from greybox.base import DataError, Finding, Severity, shorten
from greybox.data.findings import RecordCode

# Nanoseconds.
SECOND = 10**9
DAY = 86400 * SECOND
# The integer that NumPy keeps for a stamp that is not there.
MISSING = np.iinfo(np.int64).min
# Days from 1970 that nanoseconds in 64 bits reach, 1678 to 2262.
MOST_DAYS = 106_751


class StampKind(StrEnum):
    """What a column of stamps counts from."""

    DATE = "date"
    """A day of the calendar."""
    CLOCK = "clock"
    """Midnight of a day that nobody wrote down."""
    DURATION = "duration"
    """The beginning of the record: a length of time."""


class Start(NamedTuple):
    """When a record begins, in nanoseconds; two can be compared that count from the same."""

    kind: StampKind
    zoned: bool
    nanoseconds: int

    def seconds_after(self, other: Start) -> float:
        """How much later this is."""
        return (self.nanoseconds - other.nanoseconds) / SECOND

    def __str__(self) -> str:
        when = str(np.datetime64(self.nanoseconds, "ns")).rstrip("0").rstrip(".").replace("T", " ")
        return when[11:] if self.kind is StampKind.CLOCK else f"{when} UTC" if self.zoned else when


# A recorder whose clock nobody has set states the beginning of its own count: 1904, 1970 or 1980.
FIRST_YEAR = np.datetime64("1990-01-01", "ns").astype(np.int64)


def start_at(nanoseconds: int, *, zoned: bool = True) -> Start | None:
    """The start of a recording, so many nanoseconds after 1970; None of a clock that was never set."""
    return Start(StampKind.DATE, zoned, nanoseconds) if nanoseconds >= FIRST_YEAR else None


class Timeline(NamedTuple):
    """Seconds (N,) from ``start``, NaN where there is no stamp, and what was made of the stamps."""

    seconds: np.ndarray
    start: Start | None = None
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Stamps:
    """A column of stamps in ``nanoseconds`` (N,).

    ``swapped`` are the same with day and month exchanged, where each of them can be read either way; ``example`` is one of them.
    """

    nanoseconds: np.ndarray
    kind: StampKind
    zoned: bool = False
    swapped: np.ndarray | None = None
    example: str = ""

    def __len__(self) -> int:
        return len(self.nanoseconds)

    @property
    def whole_days(self) -> bool:
        """Whether these are dates alone, which need the time of day of another column."""
        known = self.nanoseconds[self.nanoseconds != MISSING]
        return self.kind is StampKind.DATE and not (known % DAY).any()

    def on_days(self, days: Stamps) -> Stamps:
        """These times of day on the ``days`` of another column."""
        missing = (self.nanoseconds == MISSING) | (days.nanoseconds == MISSING)
        both = [
            None if d is None else np.where(missing, MISSING, d + self.nanoseconds)
            for d in (days.nanoseconds, days.swapped)
        ]
        assert both[0] is not None
        return Stamps(both[0], StampKind.DATE, days.zoned, both[1], days.example)

    def count_seconds(self, header: str, order: str = "") -> Timeline:
        """The stamps as seconds from the first of them.

        Parameters
        ----------
        header
            What a message calls the column.
        order
            ``dd/mm/yyyy`` or ``mm/dd/yyyy``, ``hh:mm`` or ``mm:ss``, where somebody says what a number is; any other text says nothing.

        Raises
        ------
        DataError
            Where every date can be read either way, and nobody says which.
        """
        moments, day_first = self.nanoseconds, read_order(order)
        if self.swapped is not None:
            if day_first is None and self.kind is StampKind.CLOCK:
                raise DataError(
                    f"column {shorten(header)!r}: is {self.example!r} hours:minutes or minutes:seconds? All its times can be read both"
                    f" ways; say it as the unit of the time: columns={{'time [mm:ss]': {header!r}}} or 'time [hh:mm]' (shell: --column"
                    f" 'time [mm:ss]={header}')"
                )
            if day_first is None:
                raise DataError(
                    f"column {shorten(header)!r}: is {self.example!r} day/month or month/day? All its dates can be read both ways; say it"
                    f" as the unit of the time: columns={{'time [dd/mm/yyyy]': {header!r}}} or 'time [mm/dd/yyyy]' (shell: --column"
                    f" 'time [dd/mm/yyyy]={header}')"
                )
            moments = moments if day_first else self.swapped
        known = moments != MISSING
        if self.kind is StampKind.DURATION or not known.any():
            return Timeline(np.where(known, moments / SECOND, np.nan))
        findings: list[Finding] = []
        if not self.zoned:
            moments = moments.copy()
            moments[known], seen = _undo_clock_changes(moments[known], self.kind)
            findings += [Finding(code, Severity.WARNING, header, values) for code, values in seen]
        first = int(moments[known][0])
        start = Start(self.kind, self.zoned, first)
        seconds = np.full(len(moments), np.nan)
        # Differences in whole nanoseconds, then one division: no digit is lost to the distance from 1970.
        seconds[known] = (moments[known] - first) / SECOND
        findings.insert(
            0, Finding(RecordCode.DATES_READ, subject=header, values={"start": str(start), "kind": str(self.kind)})
        )
        return Timeline(seconds, start, tuple(findings))


def read_order(text: str) -> bool | None:
    """Whether ``dd/mm/yyyy`` puts the day first, or ``hh:mm`` hours; None for a text that is no order of a date or of a time of day."""
    # Letters once each, in their order: tt.mm.jjjj is German.
    letters = "".join(dict.fromkeys(c for c in text.lower() if c.isalpha()))
    return {"dmy": True, "mdy": False, "tmj": True, "hm": True, "hms": True, "ms": False}.get(letters)


# Summer time begins and ends on a Sunday between midnight and four, in spring and autumn of either half of the earth.
_CHANGE_MONTHS = (3, 4, 9, 10, 11)
_LATEST_CHANGE = 4 * 3600 * SECOND
_HOUR = 3600 * SECOND
# A step back by more than half a day is one past midnight.
_HALF_DAY = DAY // 2


def _undo_clock_changes(
    moments: np.ndarray, kind: StampKind
) -> tuple[np.ndarray, list[tuple[RecordCode, dict[str, Any]]]]:
    """Stamps (N,) without a zone as a clock that nobody puts forward or back would have them, and what was found."""
    step = np.diff(moments)
    if not len(step):
        return moments, []
    if kind is StampKind.CLOCK:
        nights = step < -_HALF_DAY
        moments = moments + np.append(0, np.cumsum(nights)) * DAY
        return moments, [(RecordCode.MIDNIGHT_PASSED, {"nights": int(nights.sum())})] if nights.any() else []
    usual = int(np.median(step))
    # In autumn an hour is counted twice, in spring one is left out: but for an hour the step is the usual one. A step is a changed one
    # only where that is nearer than no change, which of rows hours apart, or of days, half a step would not tell.
    nearest = min(usual, _HOUR) // 2
    back, ahead = (np.abs(step - usual - change) <= nearest for change in (-_HOUR, _HOUR))
    back |= (step > -_HOUR) & (step < 0)
    shift, changes = np.zeros(len(moments), np.int64), list[tuple[RecordCode, dict[str, Any]]]()
    for k in np.flatnonzero(back | ahead):
        later = moments[k : k + 2].max()
        if usual > 0 and _is_change_hour(int(later)):
            shift[k + 1 :] += _HOUR if back[k] else -_HOUR
            values = {"at": str(Start(kind, False, int(moments[k + 1]))), "hours": 1 if back[k] else -1}
            changes.append((RecordCode.SUMMER_TIME, values))
    return moments + shift, changes


def _is_change_hour(nanoseconds: int) -> bool:
    day, rest = divmod(nanoseconds, DAY)
    date = datetime.date(1970, 1, 1) + datetime.timedelta(days=day)
    return date.weekday() == 6 and date.month in _CHANGE_MONTHS and rest <= _LATEST_CHANGE


# Texts.

_MONTHS = {
    name: month
    for month, names in enumerate(
        ["jan jän", "feb", "mar mär mrz", "apr", "may mai", "jun", "jul", "aug", "sep", "oct okt", "nov", "dec dez"], 1
    )
    for name in names.split()
}
# Hours ahead of UTC of the zones that are written as letters.
_ZONES = {
    "Z": 0,
    "UTC": 0,
    "GMT": 0,
    "CET": 1,
    "MEZ": 1,
    "CEST": 2,
    "MESZ": 2,
    "EST": -5,
    "EDT": -4,
    "PST": -8,
    "PDT": -7,
}
_STAMP = re.compile(
    r"""(?P<date>\d{4}(?P<mark>[-/.])\d{1,2}(?P=mark)\d{1,2}      # 2024-03-31
            |\d{8}(?=T\d)                                       # 20240331T0130
            |\d{1,2}(?P<between>[-/.])\d{1,2}(?P=between)(\d{4}|(?<=[./])\d\d)  # 31.03.2024, 3/31/24
            |\d{1,2}\.?[-\s]?[^\W\d_]{3,9}\.?[-\s,]+\d{4}       # 31-Mar-2024, 31. März 2024
            |[^\W\d_]{3,9}\.?\s+\d{1,2},?\s+\d{4})?             # Mar 31, 2024
        (?(date)(?:\s*[Tt,;_]\s*|\s+|:(?=\d\d:)|$))
        (?P<clock>(?P<hours>\d{1,4}):?(?P<minutes>(?<=:)\d\d|(?<=T\d\d)\d\d)(?::?(?P<seconds>\d\d))?(?:[.,:](?P<fraction>\d{1,9})\d*)?
            (?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?)?
        \s*(?P<zone>[A-Z]{1,4}|[-+]\d\d(?::?\d\d)?)?(?:\[[\w/+-]+\])?""",
    re.VERBOSE,
)


@lru_cache(maxsize=4096)
def _read_date(text: str) -> tuple[int, int] | None:
    """Days since 1970 of a date, the day first and the month first; -1e9 for a reading that is no date. None for another text."""
    numbers = list(map(int, re.findall(r"\d+", text)))
    name = re.search(r"[^\W\d_]{3,}", text)
    if name:
        month = _MONTHS.get(name[0][:3].lower(), 0)
        readings = [(numbers[1], month, numbers[0])] * 2
    elif len(numbers) == 1:
        readings = [(numbers[0] // 10000, numbers[0] // 100 % 100, numbers[0] % 100)] * 2
    elif text[:4].isdigit():
        readings = [(numbers[0], numbers[1], numbers[2])] * 2
    else:
        first, second, year = numbers
        year += (2000 if year < 70 else 1900) if year < 100 else 0
        # Nobody puts the month first and points between.
        readings = [(year, second, first), (year, second, first) if "." in text else (year, first, second)]
    return _to_days(*readings[0]), _to_days(*readings[1])


# Days of a date that the calendar does not have.
_NO_DAY = -(10**9)


def _to_days(year: int, month: int, day: int) -> int:
    try:
        days = datetime.date(year, month, day).toordinal() - datetime.date(1970, 1, 1).toordinal()
    except ValueError:
        return _NO_DAY
    return days if abs(days) < MOST_DAYS else _NO_DAY


class StampReader:
    """Takes the texts, or the dates and times of another library, of one column, block by block."""

    def __init__(self, gaps: Sequence[str] = ("",)) -> None:
        self._gaps = frozenset(gaps)
        self._blocks: list[tuple[np.ndarray, np.ndarray]] = []
        self._form: tuple[StampKind, bool] | None = None
        self._example = ""

    def add(self, values: Sequence[Any]) -> list[int]:
        """Take a block; returns the rows in it that are neither a gap nor a stamp of the same kind as the first."""
        first, second = (np.full(len(values), MISSING, np.int64) for _ in range(2))
        wrong = []
        for k, value in enumerate(values):
            if value is None or (isinstance(value, str) and (value in self._gaps or value.lower() == "nan")):
                continue
            stamp = _read(value)
            if stamp is None or (self._form or stamp[:2]) != stamp[:2]:
                wrong.append(k)
                continue
            if self._form is None:
                self._form, self._example = stamp[:2], str(value)
            first[k], second[k] = stamp[2:]
        self._blocks.append((first, second))
        return wrong

    def finish(self) -> Stamps:
        """The whole column, in the order of day and month, or of hours, minutes and seconds, that all of it can have."""
        first, second = (np.concatenate(blocks) for blocks in zip(*self._blocks, strict=True))
        kind, zoned = self._form or (StampKind.DATE, False)
        if kind is StampKind.CLOCK and not np.array_equal(first, second):
            whole = (first == second) & (first >= _HOUR) & (first != MISSING)
            if whole.any():  # 59:59, then 1:00:00
                return Stamps(second, kind, zoned)
            if first[first != MISSING][0] >= _HOUR:  # a record in minutes and seconds begins near zero
                return Stamps(first, kind, zoned)
        possible = [not (moments == _IMPOSSIBLE).any() for moments in (first, second)]
        if all(possible) and not np.array_equal(first, second):
            return Stamps(first, kind, zoned, second, self._example)
        chosen = first if possible[0] else second
        if (chosen == _IMPOSSIBLE).any():
            raise DataError(
                f"its dates are day/month in one row and month/day in another ({self._example!r} is the first); write one order"
            )
        return Stamps(chosen, kind, zoned, example=self._example)


# A reading of a date that the calendar does not have, such as month 31.
_IMPOSSIBLE = MISSING + 1


def is_stamp(value: Any) -> bool:
    """Whether a cell or a text is a date, a time of day or a length of time."""
    return not isinstance(value, (bool, int, float)) and _read(value) is not None


def _read(value: Any) -> tuple[StampKind, bool, int, int] | None:
    """Kind, whether it has a zone, and nanoseconds of one stamp with the day first and with the month first. None for anything else."""
    if isinstance(value, str):
        return _read_text(value.strip())
    if isinstance(value, datetime.datetime):
        if value.year <= 1900:
            # What a workbook makes of a time of day that goes on behind midnight.
            return _twice(StampKind.CLOCK, False, _count(value.replace(tzinfo=None) - datetime.datetime(1899, 12, 31)))
        zoned = value.tzinfo is not None
        return _twice(StampKind.DATE, zoned, _count(value.replace(tzinfo=value.tzinfo or datetime.UTC) - _EPOCH))
    if isinstance(value, datetime.date):
        return _twice(StampKind.DATE, False, (value - _EPOCH.date()).days * DAY)
    if isinstance(value, datetime.time):
        midnight = datetime.datetime.combine(_EPOCH.date(), value.replace(tzinfo=None))
        return _twice(StampKind.CLOCK, False, _count(midnight.replace(tzinfo=datetime.UTC) - _EPOCH))
    if isinstance(value, datetime.timedelta):
        return _twice(StampKind.DURATION, False, _count(value))
    return None


_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)


def _twice(kind: StampKind, zoned: bool, nanoseconds: int) -> tuple[StampKind, bool, int, int]:
    return kind, zoned, nanoseconds, nanoseconds


def _count(length: datetime.timedelta) -> int:
    """Nanoseconds in a length of time, without a float between."""
    return (length // datetime.timedelta(microseconds=1)) * 1000


def _read_text(text: str) -> tuple[StampKind, bool, int, int] | None:
    match = _STAMP.fullmatch(text)
    if match is None or not (match["date"] or match["clock"]):
        return None
    nanoseconds, zone = 0, match["zone"]
    if match["clock"]:
        hours, minutes, seconds = int(match["hours"]), int(match["minutes"]), match["seconds"]
        if match["half"]:
            hours = hours % 12 + 12 * (match["half"] in "Pp")
        fraction = int((match["fraction"] or "").ljust(9, "0"))
        if seconds is None and match["fraction"]:
            # 30:15.2 are minutes and seconds.
            hours, minutes, seconds = 0, hours, match["minutes"]
            minutes, hours = minutes % 60, minutes // 60
        nanoseconds = ((hours * 60 + minutes) * 60 + int(seconds or 0)) * SECOND + fraction
        if minutes > 59 or int(seconds or 0) > 60 or (match["date"] and hours > 24):
            return None
    if zone:
        if zone in _ZONES:
            ahead = _ZONES[zone] * 60
        elif zone[0] in "+-":
            ahead = int(zone[0] + zone[1:3]) * 60 + int(zone[0] + (zone[3:].lstrip(":") or "0"))
        else:
            return None
        nanoseconds -= ahead * 60 * SECOND
    if not match["date"]:
        # 0:30 is half an hour, or half a minute.
        is_short = (
            bool(match["clock"]) and match["seconds"] is None and not (match["fraction"] or match["half"] or zone)
        )
        return StampKind.CLOCK, False, nanoseconds, nanoseconds // 60 if is_short else nanoseconds
    days = _read_date(match["date"])
    if days is None or days == (_NO_DAY, _NO_DAY):
        return None
    first, second = (_IMPOSSIBLE if d == _NO_DAY else d * DAY + nanoseconds for d in days)
    return StampKind.DATE, bool(zone), first, second


def from_datetimes(array: np.ndarray, *, zoned: bool = False) -> Stamps:
    """Stamps from NumPy's dates or lengths of time. Raises DataError for dates that nanoseconds do not reach."""
    kind = StampKind.DATE if array.dtype.kind == "M" else StampKind.DURATION
    known = ~np.isnat(array)
    days = array[known].astype(f"{array.dtype.kind}8[D]").astype(np.int64)
    if (np.abs(days) >= MOST_DAYS).any():
        raise DataError("dates before 1678 or after 2262 are not read; correct them")
    nanoseconds = array.astype(f"{array.dtype.kind}8[ns]").astype(np.int64)
    return Stamps(nanoseconds, kind, zoned)


def from_epoch(seconds: np.ndarray) -> Stamps:
    """Stamps from seconds (N,) since 1970, of which a double holds the microseconds."""
    known = np.isfinite(seconds)
    nanoseconds = np.full(len(seconds), MISSING)
    nanoseconds[known] = np.round(seconds[known] * 1e6).astype(np.int64) * 1000
    return Stamps(nanoseconds, StampKind.DATE, zoned=True)


# Rows from which numbers that are all dates of this century are no counter: of a counter one row in thirty is one.
LEAST_DATES = 5
_CENTURY = 20


def from_digits(numbers: np.ndarray) -> Stamps | None:
    """Stamps from dates (N,) that are each one number, ``20240331``, ``202403310130`` or ``20240331013000``; None where one is none."""
    known = numbers[np.isfinite(numbers)]
    # Looked at as numbers first: of a long record most columns are no dates, and texts are dear.
    if len(known) < LEAST_DATES or np.any(known % 1 > 0):
        return None
    digits = next((n for n in (8, 12, 14) if known.min() >= 10 ** (n - 1) and known.max() < 10**n), 0)
    if not digits or known[0] // 10 ** (digits - 2) != _CENTURY:
        return None
    texts = [f"{number:.0f}" for number in known]
    reader = StampReader()
    written = iter([f"{text[:8]}T{text[8:] or '00:00'}" for text in texts])
    wrong = reader.add([next(written) if np.isfinite(number) else None for number in numbers])
    return None if wrong else reader.finish()


def find_origin(starts: Mapping[str, Start | None]) -> tuple[Start | None, dict[str, float]]:
    """The earliest of several starts, and how many seconds after it each of them is.

    Those that do not count from the same (a date and a time of day, with a zone and without) are left where they are.
    """
    known = [start for start in starts.values() if start is not None]
    if not known:
        return None, dict.fromkeys(starts, 0.0)
    origin = min((s for s in known if s[:2] == known[0][:2]), key=lambda s: s.nanoseconds)
    return origin, {
        name: s.seconds_after(origin) if s is not None and s[:2] == origin[:2] else 0.0 for name, s in starts.items()
    }
