"""Which column of a file is which signal of the model: headers ``name [unit]`` matched by name, units by conversion."""

from __future__ import annotations

import difflib
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Protocol

import numpy as np

from greybox.base import Finding, Severity
from greybox.base.errors import DataError, ModelError, is_slip_of, nearest, shorten
from greybox.base.texts import to_word
from greybox.base.units import Conversion, unit_converter
from greybox.data.findings import RecordCode
from greybox.data.headers import LONGEST_HEADER, TIME, Column, UnitSource, parse_header, read_endings, read_time
from greybox.data.notation import WORDS, converts, find_other_cases, is_count, read_conversion, read_notation
from greybox.data.policy import ReadingPolicy
from greybox.data.problems import RowLabels, enumerate_first
from greybox.data.stamps import MISSING, Stamps, from_digits
from greybox.model import Model

# A file as named columns that are turned into numbers only when asked for.

_DATE = re.compile(r"\d+[-/.]\d+[-/.]\d+|\d+:\d\d")
DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(e[+-]?\d+)?", re.IGNORECASE)
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}([,.' ]\d{3})+([.,]\d+)?")
# A number with one mark that may be a decimal sign: 1.5, ,5, 1,250, 12.e3.
_MARKED = re.compile(r"[+-]?(?=[.,]?\d)\d*([.,])\d*(e[+-]?\d+)?", re.IGNORECASE)
# Whole numbers from here on have a mark between thousands wherever others of the column have.
THOUSAND = 1000
WITHOUT_MARKS = "the number without marks between its thousands"
# What German, French, Spanish, Italian and Dutch tables, which write a decimal comma, call their columns.
_COMMA_WORDS = (
    *(
        "zeit",
        "druck",
        "kraft",
        "weg",
        "strom",
        "spannung",
        "drehzahl",
        "temperatur",
        "leistung",
        "durchfluss",
        "drehmoment",
    ),
    *("winkel", "strecke", "masse", "gewicht", "dichte", "wert", "feuchte", "menge", "pression", "courant", "vitesse"),
    *(
        "puissance",
        "tiempo",
        "presion",
        "fuerza",
        "corriente",
        "pressione",
        "forza",
        "corrente",
        "coppia",
        "tijd",
        "kracht",
        "stroom",
    ),
)


class Marks:
    """What a column shows of the marks in its numbers: those that are a decimal sign, and those that may stand between thousands."""

    def __init__(self, texts: Iterable[str] = ()) -> None:
        self.decimal, self.between = set[str](), dict[str, str]()
        self.short: float | None = None
        self.is_long = False
        self.add(texts, np.zeros(0))

    def add(self, texts: Iterable[str], numbers: np.ndarray) -> None:
        """Further fields: texts, and those without a mark as ``numbers`` (N,)."""
        for text in map(str.strip, texts):
            if not (mark := _MARKED.fullmatch(text)):
                continue
            if THOUSANDS.fullmatch(text):
                self.between.setdefault(mark[1], text)
            else:
                self.decimal.add(mark[1])
        whole = numbers[np.isfinite(numbers) & (numbers == np.round(numbers))]
        short = whole[np.abs(whole) < THOUSAND]
        self.is_long = self.is_long or len(short) < len(whole)
        if self.short is None and len(short):
            self.short = float(short[0])

    def are_thousands(self, sign: str) -> bool:
        """Whether the column alone shows that ``sign`` stands between its thousands."""
        # Three decimals would be written of whole numbers, too, or the zeros at the end of others left out.
        is_open = sign in self.between and sign not in self.decimal
        return is_open and self.short is not None and not self.is_long


def find_decimal_signs(texts: Iterable[str]) -> frozenset[str]:
    """The decimal signs, comma or point, that the fields of a table show: marks that cannot stand between thousands."""
    return frozenset(Marks(texts).decimal)


def find_open_points(header: str, marks: Marks, headers: Iterable[str]) -> list[Finding]:
    """A column whose every number may have points between thousands, in a table whose words are of a language with a decimal comma."""
    if "." not in marks.between or marks.decimal or marks.is_long or marks.short is not None:
        return []
    letters = (unicodedata.normalize("NFKD", parse_header(h, 0).name.lower()) for h in headers)
    words = [word for text in letters for word in re.findall(r"[a-z]+", text.encode("ascii", "ignore").decode())]
    about = {"text": marks.between["."]}
    is_foreign = any(word.endswith(_COMMA_WORDS) for word in words)
    return [Finding(RecordCode.POINTS_OPEN, Severity.WARNING, header, about)] if is_foreign else []


TableColumn = np.ndarray | Stamps
"""What a column holds: numbers, or dates and times of day."""


class DataTable(Protocol):
    """What every reader hands over: the ``headers`` in the order of the file, its ``comments``, and how its rows are called."""

    @property
    def headers(self) -> tuple[str, ...]:
        """One header for each column."""

    @property
    def header_line(self) -> int:
        """Line of the header, or of the first row where there is none; counted from 1."""

    @property
    def headless(self) -> bool:
        """Whether the file names no columns, so that the headers are their numbers."""

    @property
    def numbered(self) -> tuple[int, ...]:
        """Positions of the columns that a number or a list of names counts, in their order."""

    def rename(self, names: Sequence[str]) -> DataTable:
        """The table with a name for each counted column. Raises DataError for another number of names."""

    @property
    def comments(self) -> tuple[str, ...]:
        """Lines about the table that are not part of it."""

    @property
    def row_labels(self) -> RowLabels:
        """How rows are called in messages."""

    @property
    def dated(self) -> Mapping[int, bool]:
        """Position of each column of dates or times of day -> whether it has a time of day."""

    def values(
        self, positions: Sequence[int]
    ) -> tuple[dict[int, TableColumn], list[str]] | tuple[dict[int, TableColumn], list[str], tuple[Finding, ...]]:
        """Columns (N,) as float64 with NaN for gaps, those of dates as stamps, and problems; with problems the columns are not to be used.
        A table that has brought its signals to one time, or left some of its rows out, says so."""


def check_width(columns: int, policy: ReadingPolicy) -> None:
    """Refuse a table of more columns than the policy allows, before anything of it is read. Raises DataError."""
    if columns > policy.most_columns:
        raise DataError(
            f"{columns} columns, at most {policy.most_columns} are read; export the needed ones, or raise the limit"
            f" {raise_limit('most_columns')}"
        )


def check_size(rows: int, columns: int, policy: ReadingPolicy) -> None:
    """Refuse columns that would take more memory than the policy allows, before they are read. Raises DataError."""
    if 8 * rows * columns > policy.largest_unpacked:
        raise DataError(
            f"{columns} columns of {rows} rows take {8e-6 * rows * columns:.0f} MB, at most {policy.largest_unpacked / 1e6:.0f} MB are"
            f" read; cut the record, or raise the limit {raise_limit('largest_unpacked')}"
        )


def raise_limit(name: str) -> str:
    """How a limit of the reader is raised."""
    return f"(reading=ReadingPolicy({name}=...); shell: --read-limit FACTOR)"


def describe_wrong_count(names: Sequence[str], columns: int) -> str:
    """Message for a list of column names of the wrong length."""
    return (
        f"columns gives {len(names)} name{'s' * (len(names) != 1)} ({shorten(', '.join(n or '-' for n in names))}), the file has {columns}"
        f" column{'s' * (columns != 1)}; give one for each in their order, '-' for a column that is not wanted"
    )


# What stands in a field where nothing was measured, besides nan in any spelling.
GAPS = ("", "NA", "N/A", "#N/A", "n/a", "null", "NULL", "None")
# Loggers and process-control systems write dashes as well.
_NOT_MEASURED = re.compile(r"nan|-+", re.IGNORECASE)


def is_gap(text: str) -> bool:
    """Whether a field says that nothing was measured."""
    return text in GAPS or _NOT_MEASURED.fullmatch(text) is not None


def describe_non_numbers(
    header: str, rows: Sequence[int], texts: Sequence[str], labels: RowLabels, separator: str = ""
) -> str:
    """Message for text in a number column; ``texts`` belong to the first of ``rows``, ``separator`` stands between the columns."""
    quoted = enumerate_first([repr(shorten(t)) for t in texts[:5]], len(rows))
    verb = "is not a number" if len(rows) == 1 else "are not numbers"
    return f"column {shorten(header)!r}, {labels.describe(rows)}: {quoted} {verb}; {_suggest_number_format(texts, separator)}"


def _suggest_number_format(texts: Sequence[str], separator: str) -> str:
    first = texts[0].strip() if len(texts) else ""
    is_marked = THOUSANDS.fullmatch(first) is not None
    if DECIMAL_COMMA.fullmatch(first):
        between = ", or ';' between the columns and no quotation marks" if separator == "," else " in all rows"
        return f"write decimal points{between}{f', and {WITHOUT_MARKS}' if is_marked else ''}"
    if is_marked:
        return f"write {WITHOUT_MARKS}"
    if first.startswith("="):
        return "the program that wrote the workbook has not computed its formulas: open and save it in a spreadsheet program"
    if _DATE.search(first):
        return "write every row of a column of dates alike, as in 2024-03-31 13:30:00.25 or 31.03.2024 13:30, or seconds from the start"
    return "correct it, or leave the field empty if nothing was measured"


ColumnMapping = Mapping[str, str | int]
"""Signal -> header of its column, or its number counted from 1; ``time [ms]`` says the unit of the column, too."""


class SignalKind(StrEnum):
    """What a column of a file is for."""

    TIME = "time"
    INPUT = "input"
    OUTPUT = "output"
    CONDITION = "condition"


@dataclass(frozen=True)
class RequestedSignal:
    """A signal wanted from a file: ``kind`` is time, input, output or condition; ``unit`` is the model's."""

    kind: SignalKind
    name: str
    unit: str

    @property
    def label(self) -> str:
        """How messages call it: ``input 'u' [V]``."""
        return f"time [{self.unit}]" if self.kind is SignalKind.TIME else f"{self.kind} {self.name!r} [{self.unit}]"


@dataclass(frozen=True)
class ColumnChoice:
    """A signal and the column that it is or may be: empty where none is likely, ``matched`` if it is by name.

    ``unit`` is that of the column where somebody has to say it.
    """

    signal: RequestedSignal
    column: str
    matched: bool
    unit: str = ""


@dataclass(frozen=True)
class ColumnMatch:
    """Signals with their columns in the model's order, headers not asked for, outputs without a column, problems.

    ``unmeasured``: output -> header of the spare column that its unit fits, "" where there is none or several.
    ``conversions`` turn the numbers of a column into the model's unit; ``unit_problems`` say where no unit is known. ``clocks``: columns
    that would be the time if their numbers count up, of rows with a known sampling time.
    """

    columns: Mapping[RequestedSignal, Column]
    conversions: Mapping[RequestedSignal, Conversion]
    ignored: tuple[str, ...]
    unmeasured: Mapping[str, str]
    problems: tuple[str, ...]
    unit_problems: tuple[str, ...]
    clocks: tuple[Column, ...] = ()

    @property
    def unitless(self) -> tuple[RequestedSignal, ...]:
        """Signals taken in the model's unit because the header states none."""
        return tuple(s for s, c in self.columns.items() if not c.unit and s.unit not in ("", "-", "1"))

    def with_stamps(self, arrays: Mapping[int, np.ndarray], problems: list[str]) -> ColumnMatch:
        """The match where stamps since 1970 have the unit that their size tells; one that is stated otherwise goes to ``problems``.

        ``arrays``: position -> column (N,) as it stands in the file.
        """
        signal, column = next(((s, c) for s, c in self.columns.items() if s.kind is SignalKind.TIME), (None, None))
        if signal is None or column is None or not len(arrays[column.position]):
            return self
        unit = find_stamp_unit(arrays[column.position])
        if column.unit in ("", "s") and from_digits(arrays[column.position]):
            return self
        if not unit and column.known is not UnitSource.TOLD:
            seconds = self.conversions[signal](arrays[column.position])
            if likely := find_likely_unit(seconds, stated=bool(column.unit)):
                remedies = [
                    _explain_mapping(signal, replace(column, unit=unit)) for unit in (likely, column.unit or "s")
                ]
                problems.append(
                    f"column {shorten(column.header)!r}: taken for {column.unit or 's'} its rows are {measure_step(seconds):.4g} s"
                    f" apart; if it is in {likely}, {remedies[0]}; if it is not, {remedies[1]}"
                )
        if not unit or (column.unit and self.conversions[signal](np.nanmax(arrays[column.position])) <= STAMPS[1]):
            return self
        stamped = replace(column, unit=unit, known=UnitSource.SIZE)
        if column.unit:
            problems.append(
                f"column {shorten(column.header)!r} is stated in {column.unit}, and its numbers are those of {unit} since 1970;"
                f" {_explain_mapping(signal, stamped)}"
            )
        conversion = read_conversion(unit, signal.unit)
        return replace(
            self, columns={**self.columns, signal: stamped}, conversions={**self.conversions, signal: conversion}
        )

    def ask_points(self, findings: Iterable[Finding]) -> list[str]:
        """Questions to columns whose points may stand between thousands, unless their unit is told."""
        texts = {f.subject: f.values["text"] for f in findings if f.code is RecordCode.POINTS_OPEN}
        questions = []
        for signal, column in self.columns.items():
            if column.header in texts and column.known is not UnitSource.TOLD:
                unit = column.unit or signal.unit or "1"
                both = (_explain_mapping(signal, replace(column, unit=u)) for u in (f"1000 {unit}", unit))
                questions.append(
                    f"column {shorten(column.header)!r}: has {texts[column.header]!r} a point between thousands? {next(both)}; if it is a"
                    f" decimal point, {next(both)}"
                )
        return questions

    def describe_units(self) -> list[list[str]]:
        """Header, unit and reason of each column whose unit was read otherwise than it is written."""
        readings = []
        for signal, column in self.columns.items():
            unit = read_notation(column.unit, signal.unit, is_told=column.known is UnitSource.TOLD)
            stated = parse_header(column.header, 0).unit
            if column.known is UnitSource.TOLD and stated not in ("", column.unit):
                reason = "told"
            elif self.conversions[signal].note:
                reason = str(self.conversions[signal].note)
            elif column.known in (UnitSource.NAME, UnitSource.SIZE):
                reason = str(column.known)
            elif unit != column.unit and not _is_same(unit, column.unit):
                reason = "notation"
            else:
                continue
            readings.append([shorten(column.header), unit, reason])
        return readings


# Seconds since 1970 that stamps of a record can be: the years 2000 to 2050, before and after which a counter is likelier.
STAMPS = (9.46e8, 2.53e9)


def find_stamp_unit(values: np.ndarray) -> str:
    """The unit in which stamps (N,) count from 1970 to a day of a record; "" where they do not."""
    known = values[np.isfinite(values)]
    for unit, factor in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        if len(known) and STAMPS[0] <= factor * known.min() and factor * known.max() <= STAMPS[1]:
            return unit
    return ""


# A clock that counts days: its step is round in seconds of a day, and not in what it is taken for. Below this rate (Hz), and where the
# rate is round (48 kHz), it may be a rate as well (144 Hz, ten minutes), unless its numbers are those of days of this half-century, as
# Excel, modified Julian dates, MATLAB and Julian dates count them.
DAY_RATE = 1000.0
DAYS_SINCE = ((36526, 54789), (51544, 69808), (730486, 748749), (2451544, 2469808))
DAY_SECONDS = 86400.0
# Seconds of a century: no record lasts so long.
CENTURY = 3.2e9


def measure_step(time: np.ndarray) -> float:
    """The mean step of a clock (N,) that is even, else its median step."""
    steps = np.diff(time[np.isfinite(time)])
    if not len(steps):
        return 0.0
    usual = float(np.median(steps))
    is_even = bool(np.all(np.abs(steps - usual) < 0.01 * abs(usual)))
    return float(np.mean(steps)) if is_even else usual


def _is_round(number: float, digits: int) -> bool:
    """Whether a number has so many significant digits, to a ten-thousandth of itself."""
    return bool(number) and abs(float(f"{number:.{digits - 1}e}") / number - 1) < 1e-4


def find_likely_unit(seconds: np.ndarray, *, stated: bool = False) -> str:
    """The unit that a clock (N,) is likelier in than in seconds, for which it is taken; "" where seconds may be right.

    ``stated``: the file says so itself; then only days, which no digit of it agrees with, are doubted.
    """
    known = seconds[np.isfinite(seconds)]
    step = measure_step(seconds)
    if len(known) < 3 or step <= 0:
        return ""
    if not stated and (years := (known[-1] - known[0]) / CENTURY) > 1:
        return next((unit for unit, factor in (("ms", 1e-3), ("us", 1e-6)) if years * factor < 1e-3), "ns")
    counts_dates = any(first <= known[0] and known[-1] <= last for first, last in DAYS_SINCE)
    is_rate = step * DAY_RATE > 1 or _is_round(1 / step, 2)
    is_part_of_day = _is_round(DAY_SECONDS * step, 2) and not _is_round(step, 3)
    return "d" if is_part_of_day and (counts_dates or not is_rate) else ""


def _is_same(unit: str, text: str) -> bool:
    """Whether a text is the unit to every reader."""
    try:
        return unit_converter(text, unit).identical
    except ModelError:
        return False


def split_signal(key: str) -> tuple[str, str]:
    """Name and unit of a signal as a mapping states them: ``time [ms]``; the unit is "" where it states none."""
    column = parse_header(key, 0)
    return (column.name, column.unit) if key.rstrip().endswith("]") else (key, "")


def merge_mappings(first: Mapping[str, str], second: Mapping[str, str]) -> dict[str, str]:
    """Both, of which the second says what each of its signals is."""
    names = {split_signal(key)[0] for key in second}
    return {key: header for key, header in first.items() if split_signal(key)[0] not in names} | dict(second)


def _list_signals(model: Model) -> list[RequestedSignal]:
    inputs = [RequestedSignal(SignalKind.INPUT, i.name, i.unit) for i in model.inputs]
    return inputs + [RequestedSignal(SignalKind.OUTPUT, o.name, o.unit) for o in model.outputs]


def match_columns(
    table: DataTable,
    model: Model,
    mapping: ColumnMapping | None,
    conditions: Sequence[RequestedSignal] = (),
    *,
    has_clock: bool = False,
    inputs_only: bool = False,
    are_named: bool = False,
) -> ColumnMatch:
    """Find time and the model's inputs and outputs among the headers of ``table``; ``mapping`` (signal -> header) goes first.

    An output may be missing as long as another is there, and so may ``conditions``. With ``has_clock`` the rows have a known
    sampling time: then the table must have no time column. With ``inputs_only`` no outputs are looked for. The headers are those of
    the caller where they ``are_named``. A unit that no header states and a name suggests is a problem, which says how to state it.
    """
    columns = [parse_header(h, k) for k, h in enumerate(table.headers)]
    clock = RequestedSignal(SignalKind.TIME, TIME, "s")
    signals = [] if has_clock else [clock]
    signals += [s for s in _list_signals(model) if s.kind is SignalKind.INPUT or not inputs_only]
    signals += conditions
    known = [s.name for s in signals]
    optional = {o.name for o in model.outputs} if inputs_only else set()
    named = [(*split_signal(key), header) for key, header in (mapping or {}).items()]
    named = [entry for entry in named if entry[0] in known or entry[0] not in optional]
    mapping = {name: header for name, _, header in named}
    problems = [
        f"columns names {n!r}, which model {model.name!r} does not have; {nearest(n, known)}"
        for n in mapping
        if n not in known and n != TIME
    ]
    twice = [n for n in mapping if [name for name, *_ in named].count(n) > 1]
    problems += [f"columns names {n!r} more than once; keep one" for n in twice]
    matched, free = _apply_mapping(columns, signals, mapping, table.numbered, problems)
    units = {name: unit for name, unit, _ in named if unit}
    matched = {
        s: replace(c, unit=units[s.name], known=UnitSource.TOLD) if s.name in units else c for s, c in matched.items()
    }
    missing: list[RequestedSignal] = []
    for signal in signals:
        if signal.name in mapping:
            continue
        hits = find_times(free, table) if signal.kind is SignalKind.TIME else _find_named(free, signal)
        if hits:
            matched[signal] = hits[0]
        else:
            missing.append(signal)
        if len(hits) > 1:
            several = " and ".join(repr(shorten(c.header)) for c in hits[:5])
            problems.append(
                f"{signal.label} has {len(hits)} columns, {several}; keep one, or {_explain_mapping(signal)}"
            )
    used = {c.position for c in matched.values()}
    spare = [c for c in columns if c.position not in used and c.header]
    clocks: list[Column] = []
    if has_clock:
        if times := find_times(free, table):
            problems.append(describe_second_time(times[0]))
        elif TIME in mapping:
            problems.append(
                f"columns maps time to {mapping[TIME]!r}, and a sampling time is given; leave one of them out (sampling_time; shell:"
                " --sampling-time)"
            )
        else:
            clocks = find_likely_times(free, table)
    elif table.headless and not mapping:
        raise DataError(
            f"line {table.header_line} holds numbers where the header should be; begin the file with a line of names and units"
            " such as 'time [s],u [V],x [um]', or name the columns in their order, columns=['time', 'u', 'x'] (shell: --columns"
            " time,u,x)"
        )
    problems += _describe_missing(missing, model, spare, inputs_only, are_named)
    if are_named:  # whoever names the columns in their order says their units, too
        matched = {s: replace(c, known=UnitSource.TOLD) if c.unit else c for s, c in matched.items()}
    doubts: list[str] = []
    # Dates need no unit; the one of their column may say how they are written.
    matched = {
        s: matched[s]
        if matched[s].position in table.dated
        else _settle_unit(matched[s], s, s.name in mapping, are_named, doubts)
        for s in signals
        if s in matched
    }
    conversions = {
        s: find_conversion(replace(c, unit="") if c.position in table.dated else c, s, are_named, doubts)
        for s, c in matched.items()
    }
    return ColumnMatch(
        matched,
        conversions,
        tuple(shorten(c.header) for c in spare),
        {
            s.name: next((shorten(c.header) for c in _find_called(s, spare) or _find_of_unit(s, spare)), "")
            for s in missing
            if s.kind is SignalKind.OUTPUT
        },
        tuple(problems),
        tuple(doubts),
        tuple(clocks),
    )


def _find_named(columns: Sequence[Column], signal: RequestedSignal) -> list[Column]:
    """The columns with the name of a signal, or else those that say it together with a unit of the signal: ``t in ms``."""
    return [c for c in columns if _is_for(c, signal)] or [
        reading
        for c in columns
        for reading in read_endings(c)
        if reading.known is UnitSource.NAME and _is_for(reading, signal) and converts(reading.unit, signal.unit)
    ]


def find_times(columns: Sequence[Column], table: DataTable) -> list[Column]:
    """The columns that are taken for the time unless something else is told: by their name, or else by their dates."""
    by_name = [c for c in columns if c.is_time]
    return (
        by_name or find_dated_time(columns, table) or _find_named(columns, RequestedSignal(SignalKind.TIME, TIME, "s"))
    )


def find_likely_times(columns: Sequence[Column], table: DataTable) -> list[Column]:
    """The columns that are the time if their numbers count up: those of dates, and those whose name or unit is that of a time."""
    times = ((c, c if c.position in table.dated else read_time(c)) for c in columns if c.header)
    return [time for _, time in times if time is not None]


# Share of the steps of a clock that go up at least, of those that are not zero: it may start anew for a further run.
COUNTING_UP = 0.9


def counts_up(values: np.ndarray | Stamps) -> bool:
    """Whether the values (N,) of a column are those of a clock, which a duration (``cycle_time``) is not."""
    if isinstance(values, Stamps):
        values = np.where(values.nanoseconds == MISSING, np.nan, values.nanoseconds.astype(np.float64))
    steps = np.diff(values[np.isfinite(values)])
    return bool(np.any(steps)) and float(np.mean(steps[steps != 0] > 0)) >= COUNTING_UP


def describe_second_time(column: Column) -> str:
    """Message for a time column of rows that have a sampling time: one of the two is left out, and only the user knows which."""
    signal = RequestedSignal(SignalKind.TIME, TIME, "s")
    # One that only looks like the time by its ending is not taken before somebody says so.
    how = f" and {_explain_mapping(signal, column)}" if column.known is UnitSource.ENDING else ""
    return (
        f"the file has a time column, {shorten(column.header)!r}, and a sampling time is given, which would take its place; leave out"
        f" sampling_time (shell: --sampling-time){how}, or, to count the rows instead, leave out the column: '-' in its place among"
        " the names of all columns, columns=['-', 'u', ...] (shell: --columns=-,u,...)"
    )


def find_dated_time(columns: Sequence[Column], table: DataTable) -> list[Column]:
    """The only column of dates, which is the time whatever it is called; those with a time of day go first. None of several."""
    wanted = [c for c in columns if c.header]
    dated = [c for c in wanted if table.dated.get(c.position)] or [c for c in wanted if c.position in table.dated]
    return dated if len(dated) == 1 else []


def propose_columns(
    table: DataTable, model: Model, mapping: ColumnMapping | None = None, *, has_clock: bool = False
) -> tuple[tuple[str, ...], tuple[ColumnChoice, ...]] | None:
    """For a table that lacks columns of the model: its columns as a mapping names them, and which each signal may be.

    None where no choice of columns would help.
    """
    known = {TIME, *(i.name for i in model.inputs), *(o.name for o in model.outputs)}
    columns = [parse_header(h, k) for k, h in enumerate(table.headers)]
    kept = {
        n: h
        for n, h in (mapping or {}).items()
        if split_signal(n)[0] in known and _find_columns(columns, h, table.numbered)
    }
    if table.headless or not any(c.header for c in columns):
        return None
    match = match_columns(table, model, kept, has_clock=has_clock)
    if not (match.problems or match.unit_problems) and kept == dict(mapping or {}):
        return None
    headers = [c.header for c in columns]
    names = {
        c.position: c.header if headers.count(c.header) == 1 else str(table.numbered.index(c.position) + 1)
        for c in columns
        if c.header and (headers.count(c.header) == 1 or c.position in table.numbered)
    }
    used = {c.position for c in match.columns.values()}
    spare = [c for c in columns if c.position not in used and c.position in names]
    signals = [*([] if has_clock else [RequestedSignal(SignalKind.TIME, TIME, "s")]), *_list_signals(model)]
    chosen = {split_signal(key)[0] for key in kept}
    choices = []
    for signal in signals:
        at = match.columns.get(signal)
        likely = [] if at else _find_called(signal, spare) or _find_of_unit(signal, spare)
        column = names.get(at.position, "") if at else names[likely[0].position] if likely else ""
        asked = [c for c in ([at] if at else likely[:1]) if c.known in (UnitSource.ENDING, UnitSource.TOLD)]
        is_matched = at is not None and signal.name not in chosen and not asked
        unit = read_notation(asked[0].unit, signal.unit) if asked else ""
        choices.append(ColumnChoice(signal, column, is_matched, unit))
    return tuple(names.values()), tuple(choices)


# Words that say of a name that its numbers count something (adc_counts): no reading in volts is called so.
_COUNTS, _ROWS = (
    frozenset(words.split())
    for words in (
        "count counts cnt cnts cts tick ticks pulses lsb lsbs adc adu inc incs codes digits px pixel pixels",
        # ... and of a time, that it counts rows.
        "frame frames sample samples index idx row rows record scan step steps n nr no id",
    )
)
# Endings that are words of names as well (x_min, p_bar): they ask nothing where they are of another quantity.
_WORDS = frozenset(("min", "bar", "rad", "pa", "as", "day", "knot"))


def _settle_unit(
    column: Column, signal: RequestedSignal, is_chosen: bool, are_named: bool, problems: list[str]
) -> Column:
    """The column with the unit that its name states; one that it only suggests, and that changes numbers, goes to ``problems``."""
    if column.unit:
        return column
    readings = read_endings(column)
    for reading in readings:
        if converts(reading.unit, signal.unit):
            if reading.known is UnitSource.NAME or read_conversion(reading.unit, signal.unit).identical:
                return reading
            unit, how = read_notation(reading.unit, signal.unit), _explain_mapping(signal, reading, are_named)
            problems.append(
                f"column {shorten(column.header)!r} for {signal.label} names a unit: is it in {unit}? {how}, or with"
                f" [{signal.unit or 1}] if its numbers are in {signal.unit or 1}"
            )
            return reading
    endings = [r.unit for r in readings if column.name.lower().endswith(r.unit.lower()) or r.unit in "%‰"]
    other = [unit for unit in endings if unit.lower() not in _WORDS and (len(unit) > 1 or unit in "%°‰")]
    counted = ""
    if not converts("1", signal.unit):
        counts = _COUNTS | _ROWS if signal.kind is SignalKind.TIME else _COUNTS
        counted = next((word for word in re.split(r"[\W_\d]+", column.name.lower()) if word in counts), "")
    if is_chosen and (other or counted):
        how = _explain_mapping(signal, replace(column, unit=signal.unit or "1"), are_named)
        share = _explain_share(signal, column, "0.01", are_named) if counted and not other else ""
        problems.append(
            f"column {shorten(column.header)!r} for {signal.label} names {[*other, counted][0]}, a unit of another quantity; choose"
            f" another column, or {how} if its numbers are in {signal.unit or 1}"
            + (f"; if one is 0.01 {signal.unit}, {share}" if share else "")
            + (_explain_per_cent(signal, column, are_named) if "%" in other else "")
        )
    return column


def _explain_share(signal: RequestedSignal, column: Column, one: str, are_named: bool) -> str:
    """How to say that ``one`` of the signal's unit is what a number of the column counts."""
    return _explain_mapping(signal, replace(column, unit=f"{one} {signal.unit}"), are_named)


def _explain_per_cent(signal: RequestedSignal, column: Column, are_named: bool) -> str:
    """How to say of what a column is per cent: a duty cycle of the supply, a valve of its travel."""
    return f"; if 100 % is 12 {signal.unit}, {_explain_share(signal, column, '0.12', are_named)}"


def find_conversion(column: Column, signal: RequestedSignal, are_named: bool, problems: list[str]) -> Conversion:
    """How the numbers of a column become those of a signal.

    Parameters
    ----------
    column, signal
        The column with its unit, and what it is read for.
    are_named
        Whether the names of all columns are told, so that a unit is stated among them.
    problems
        Takes the message for a unit that does not convert; the numbers then stay as they are.

    Returns
    -------
    Conversion
        From the unit of the column to that of the signal.
    """
    as_it_is = Conversion(lambda values: values, True)
    if not column.unit:
        return as_it_is
    try:
        return read_conversion(column.unit, signal.unit, is_told=column.known is UnitSource.TOLD)
    except ModelError as error:
        if is_count(column.unit):
            # What one count is, the rig says: an encoder's lines a turn, a converter's range over its steps.
            is_angle = converts("turn/4096", signal.unit, is_told=True)
            turn = _explain_mapping(signal, replace(column, unit="turn/4096"), are_named)
            how = turn if is_angle else _explain_share(signal, column, "0.001", are_named)
            example = "with 4096 counts a turn" if is_angle else f"with 0.001 {signal.unit} a count"
            problems.append(
                f"column {shorten(column.header)!r} holds counts, and {signal.label} is wanted: say what one count is;"
                f" {example}, {how}"
            )
            return as_it_is
        if cases := find_other_cases(column.unit, signal.unit):
            # The numbers are hardly those of the signal's own unit: a remedy that takes them so would be wrong by a prefix.
            remedies = (
                f"if it is in {c}, {_explain_mapping(signal, replace(column, unit=c), are_named)}" for c in cases
            )
            problems.append(
                f"column {shorten(column.header)!r} in {shorten(column.unit)} does not convert to {signal.label}: {error}; capital and"
                f" small letters are different units: {'; '.join(remedies)}"
            )
            return as_it_is
        how, count = _explain_mapping(signal, replace(column, unit=signal.unit or "1"), are_named), ""
        if converts(column.unit, signal.unit, is_told=True):
            count = f"; if that is one count, {_explain_mapping(signal, column, are_named)}"
        problems.append(
            f"column {shorten(column.header)!r} in {shorten(column.unit)} does not convert to {signal.label}: {error}; to take its"
            f" numbers as {signal.unit or 1}, {how}{count}"
            + (
                _explain_per_cent(signal, column, are_named)
                if WORDS.get(column.unit.lower(), column.unit) == "%"
                else ""
            )
        )
        return as_it_is


def _apply_mapping(
    columns: list[Column],
    signals: list[RequestedSignal],
    mapping: ColumnMapping,
    numbered: Sequence[int],
    problems: list[str],
) -> tuple[dict[RequestedSignal, Column], list[Column]]:
    """Columns that ``mapping`` names, and those left for matching by name."""
    matched: dict[RequestedSignal, Column] = {}
    for signal in signals:
        header = mapping.get(signal.name)
        if header is None:
            continue
        hits = _find_columns(columns, header, numbered)
        taken = [s for s, c in matched.items() if c in hits]
        if not hits:
            problems.append(
                f"columns maps {signal.name!r} to {header!r}, which the file does not have;"
                f" {nearest(str(header), _list_headers(columns))}"
            )
        elif len(hits) > 1:
            problems.append(
                f"columns maps {signal.name!r} to {header!r}, which the file has {len(hits)} times;"
                " make the headers distinct, or give the number of the column"
            )
        elif taken:
            problems.append(
                f"columns maps both {taken[0].name!r} and {signal.name!r} to {header!r};"
                " each signal needs its own column"
            )
        else:
            matched[signal] = hits[0]
    used = {c.position for c in matched.values()}
    return matched, [c for c in columns if c.position not in used]


def _find_columns(columns: list[Column], header: str | int, numbered: Sequence[int]) -> list[Column]:
    """The columns with this header, or else with this name, or else with this number, counted from 1."""
    text = str(header).strip()
    hits = (
        []
        if isinstance(header, int)
        else [c for c in columns if c.header == text] or [c for c in columns if c.name == text]
    )
    if not hits and text.isdecimal() and 1 <= int(text[:9]) <= len(numbered):
        return [columns[numbered[int(text[:9]) - 1]]]
    return hits


def _is_for(column: Column, signal: RequestedSignal) -> bool:
    return column.is_time if signal.kind is SignalKind.TIME else column.name == signal.name


def _describe_missing(
    missing: Sequence[RequestedSignal], model: Model, spare: Sequence[Column], inputs_only: bool, are_named: bool
) -> list[str]:
    """Problems with the signals that no column is for; an output may be missing, but not all of them."""
    needed = [s for s in missing if s.kind in (SignalKind.TIME, SignalKind.INPUT)]
    clock = "; where rows have no time, give sampling_time=<seconds> (shell: --sampling-time SECONDS)"
    problems = [
        f"no column for {s.label}; {_suggest_headers(s, spare, are_named)}{clock if s.kind is SignalKind.TIME else ''}"
        for s in needed
    ]
    outputs = [s for s in missing if s.kind is SignalKind.OUTPUT]
    if len(outputs) == len(model.outputs) and not inputs_only:
        labels = ", ".join(s.label for s in outputs)
        what = f"any output of model {model.name!r} ({labels}), at least one is needed"
        problems.append(f"no column for {what}; {_suggest_headers(outputs[0], spare, are_named)}")
    return problems


def _suggest_headers(signal: RequestedSignal, spare: Sequence[Column], are_named: bool) -> str:
    wanted = signal.name.lower()
    spare = [c for c in spare if len(c.name) <= LONGEST_HEADER]
    close = difflib.get_close_matches(wanted, [c.name.lower() for c in spare], n=3, cutoff=0.5)
    near = [
        repr(shorten(c.header))
        for c in spare
        if c.name.lower() in close or wanted in re.split(r"[\W_]+", c.name.lower())
    ]
    near = near or [repr(shorten(c.header)) for c in _find_of_unit(signal, spare)]
    called = _find_called(signal, spare)
    if called:
        unit = read_notation(called[0].unit, signal.unit)
        return f"is it {shorten(called[0].header)!r}, in {unit}? {_explain_mapping(signal, called[0], are_named)}"
    guess = f"did you mean {' or '.join(near[:3])}? " if near else ""
    listing = ", ".join(_list_headers(spare))
    if not listing:
        return f"every other column is in use; add a column for it, or {_explain_mapping(signal)}"
    return f"{guess}unused headers: {listing}; rename one, or {_explain_mapping(signal)}"


def _find_called(signal: RequestedSignal, spare: Sequence[Column]) -> list[Column]:
    """Columns that are called like the signal and end like a unit of it: ``x_mm`` for ``x`` in m."""
    if signal.kind is SignalKind.TIME:
        return [r for c in spare if not c.unit and (r := read_time(c)) is not None and r.unit]
    readings = [r for c in spare for r in read_endings(c)]
    return [r for r in readings if r.name.lower() == signal.name.lower() and converts(r.unit, signal.unit)]


def _find_of_unit(signal: RequestedSignal, spare: Sequence[Column]) -> list[Column]:
    """The only column of a unit, stated or at the end of its name, that converts to the signal's; none where there are several."""
    hits = [c for c in spare if any(r.unit and converts(r.unit, signal.unit) for r in (c, *read_endings(c)))]
    return hits if len(hits) == 1 else []


def _explain_mapping(signal: RequestedSignal, column: Column | None = None, are_named: bool = False) -> str:
    """How to choose a column by hand, in Python and in the shell; with the unit of the ``column`` where one is to be stated."""
    if column is None:
        return f"set columns={{{signal.name!r}: <header>}} (shell: --column {signal.name}=<header>)"
    unit = read_notation(column.unit, signal.unit, is_told=True)
    key, header = f"{signal.name} [{unit}]", shorten(column.header)
    if are_named:
        return f"write {key!r} for {header!r} in columns (shell: --columns)"
    return f"write columns={{{key!r}: {header!r}}} (shell: --column {to_word(f'{key}={header}')})"


def _list_headers(columns: Sequence[Column], shown: int = 12) -> list[str]:
    headers = [shorten(c.header, 40) for c in columns if c.header]
    return headers[:shown] + ([f"... {len(headers) - shown} more"] if len(headers) > shown else [])


# Operating conditions that a file states itself: in a comment line, or in a column that does not move.

# ``# P_S = 801.3 kPa`` or ``# P_S [kPa]: 801.3``
_COMMENT = re.compile(r"^[#\s]*(?P<header>[^:=]+?)\s*[:=]\s*(?P<value>[^\s]+)\s*(?P<unit>.*?)\s*$")


def request_conditions(model: Model, names: Sequence[str]) -> list[RequestedSignal]:
    """The conditions ``names`` as signals to look for, in the units of the model's constants; others as they stand in the file.

    Raises ModelError for a name that is nearly that of a constant.
    """
    known = {q.name: q.unit for q in model.stated_parameters}
    return [
        RequestedSignal(SignalKind.CONDITION, name, model.parameter(name).unit)
        if name in known or is_slip_of(name, known)
        else RequestedSignal(SignalKind.CONDITION, name, "")
        for name in names
    ]


def read_conditions(
    conditions: Sequence[RequestedSignal],
    columns: Mapping[str, np.ndarray],
    comments: Sequence[str],
    problems: list[str],
) -> tuple[dict[str, float], list[Finding]]:
    """The value of each condition, and a finding with its source; missing or invalid values go to ``problems``.

    ``columns``: values (N,) of those that have a column, in the model's units; the mean is taken. Else a line of ``comments``.
    """
    values: dict[str, float] = {}
    findings: list[Finding] = []
    for signal in conditions:
        has_column = signal.name in columns
        value = (
            _average_column(signal, columns[signal.name], problems)
            if has_column
            else _find_in_comments(signal, comments, problems)
        )
        if value is not None:
            values[signal.name] = value
            figures = {"value": value, "unit": signal.unit, "source": "column" if has_column else "comment"}
            findings.append(Finding(RecordCode.CONDITION_READ, subject=signal.name, values=figures))
    return values, findings


def read_before(model: Model, comments: Sequence[str], problems: list[str]) -> tuple[dict[str, float], list[Finding]]:
    """What a file says that its inputs were before its first row, ``# before u = 1.5 V``, and a finding for each."""
    named = {parse_header(line["header"], 0).name for line in map(_COMMENT.match, comments) if line}
    wanted = [RequestedSignal(SignalKind.CONDITION, f"before {i.name}", i.unit) for i in model.inputs]
    values, findings = read_conditions([s for s in wanted if s.name in named], {}, comments, problems)
    return {name.removeprefix("before "): value for name, value in values.items()}, findings


# Largest standard deviation of a column over its mean for its mean to be a condition of the whole record.
CONDITION_SPREAD = 0.05


def _average_column(signal: RequestedSignal, values: np.ndarray, problems: list[str]) -> float | None:
    known = values[np.isfinite(values)]
    if not len(known):
        problems.append(f"{signal.label}: its column holds no number; fill it, or give the value")
        return None
    mean = float(known.mean())
    if known.std() > CONDITION_SPREAD * abs(mean):
        problems.append(
            f"{signal.label}: its column runs from {known.min():.6g} to {known.max():.6g} {signal.unit}, so it is no condition of the"
            " whole record; give one value, or declare it as an input that a constant follows (Model.schedule)"
        )
        return None
    return mean


def _find_in_comments(signal: RequestedSignal, comments: Sequence[str], problems: list[str]) -> float | None:
    lines = [
        line for line in map(_COMMENT.match, comments) if line and parse_header(line["header"], 0).name == signal.name
    ]
    if len(lines) != 1:
        what = "has several comment lines" if lines else "has neither a column nor a comment line"
        problems.append(
            f"{signal.label} {what}; write one such as '# {signal.name} = 1.5 {signal.unit}', or give the value"
            f" (shell: --condition {signal.name}=<value>)"
        )
        return None
    (line,) = lines
    unit = line["unit"].strip("[]() ") or parse_header(line["header"], 0).unit or signal.unit
    try:
        return float(read_conversion(unit, signal.unit)([float(line["value"])])[0])
    except (ValueError, ModelError) as error:
        problems.append(f"{signal.label}: the comment line {line[0].strip()!r} is not understood ({error})")
        return None
