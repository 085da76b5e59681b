"""Which column of a file is which signal of the model: headers ``name [unit]`` matched by name, units by conversion."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np

from greybox.base import Finding, convert, unit_converter
from greybox.base.errors import DataError, ModelError, is_slip_of, nearest, shorten
from greybox.data.findings import RecordCode
from greybox.data.policy import ReadingPolicy
from greybox.data.problems import RowLabels, enumerate_first
from greybox.model import Model

# A file as named columns that are turned into numbers only when asked for.

_DATE = re.compile(r"\d+[-/.]\d+[-/.]\d+|\d+:\d\d")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(e[+-]?\d+)?", re.IGNORECASE)
_THOUSANDS = re.compile(r"[+-]?\d{1,3}([,.' ]\d{3})+([.,]\d+)?")


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

    def values(
        self, positions: Sequence[int]
    ) -> tuple[dict[int, np.ndarray], list[str]] | tuple[dict[int, np.ndarray], list[str], tuple[Finding, ...]]:
        """Columns (N,) as float64 with NaN for gaps, and problems; with problems the columns are not to be used. A table that has brought
        its signals to one time says what it did."""


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
        f"columns gives {len(names)} name{'s' * (len(names) != 1)} ({shorten(', '.join(names))}), the file has {columns}"
        f" column{'s' * (columns != 1)}; give one for each in their order, '-' for a column that is not wanted"
    )


def describe_non_numbers(header: str, rows: Sequence[int], texts: Sequence[str], labels: RowLabels) -> str:
    """Message for text in a number column; ``texts`` belong to the first of ``rows``."""
    quoted = enumerate_first([repr(shorten(t)) for t in texts[:5]], len(rows))
    verb = "is not a number" if len(rows) == 1 else "are not numbers"
    return f"column {shorten(header)!r}, {labels.describe(rows)}: {quoted} {verb}; {_suggest_number_format(texts)}"


def _suggest_number_format(texts: Sequence[str]) -> str:
    first = texts[0].strip() if len(texts) else ""
    if _DATE.search(first):
        return "write time as seconds from the start of the record"
    if _DECIMAL_COMMA.fullmatch(first):
        return "write decimal points, or ';' between the columns and no quotation marks"
    if _THOUSANDS.fullmatch(first):
        return "write the number without marks between its thousands"
    return "correct it, or leave the field empty if nothing was measured"


TIME = "time"  # the name of the time column
ColumnMapping = Mapping[str, str | int]
"""Signal -> header of its column, or its number counted from 1."""
_BRACKETS = re.compile(r"^(?P<name>[^\[\]]*?)\s*\[(?P<unit>[^\[\]]*)\]$")


class SignalKind(StrEnum):
    """What a column of a file is for."""

    TIME = "time"
    INPUT = "input"
    OUTPUT = "output"
    CONDITION = "condition"


@dataclass(frozen=True)
class Column:
    """A column of a file: the whole ``header``, its ``name``, ``unit`` ("" when none is stated) and ``position``."""

    header: str
    name: str
    unit: str
    position: int


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
    """A signal and the column that it is or may be; ``column`` is empty where none is likely, ``matched`` if it is by name."""

    signal: RequestedSignal
    column: str
    matched: bool


@dataclass(frozen=True)
class ColumnMatch:
    """Signals with their columns in the model's order, headers not asked for, outputs without a column, problems."""

    columns: Mapping[RequestedSignal, Column]
    ignored: tuple[str, ...]
    unmeasured: tuple[str, ...]
    problems: tuple[str, ...]

    @property
    def unitless(self) -> tuple[RequestedSignal, ...]:
        """Signals taken in the model's unit because the header states none."""
        return tuple(s for s, c in self.columns.items() if not c.unit and s.unit not in ("", "-", "1"))


# Characters of a header; in a longer one neither unit nor name are looked for.
LONGEST_HEADER = 200


def parse_header(header: str, position: int) -> Column:
    """``x [um]`` or ``x (um)`` as name and unit; parentheses without a unit (``Laser (ch1)``) belong to the name."""
    text = header.strip()
    if len(text) > LONGEST_HEADER:
        return Column(text, text, "", position)
    square = _BRACKETS.match(text)
    if square:
        return Column(text, square["name"].strip(), square["unit"].strip(), position)
    if text.endswith(")"):
        for at in (k for k, letter in enumerate(text) if letter == "(" and k):
            if _is_unit(text[at + 1 : -1]):
                return Column(text, text[:at].strip(), text[at + 1 : -1].strip(), position)
    return Column(text, text, "", position)


def match_columns(
    table: DataTable,
    model: Model,
    mapping: ColumnMapping | None,
    conditions: Sequence[RequestedSignal] = (),
    *,
    has_clock: bool = False,
    inputs_only: bool = False,
) -> ColumnMatch:
    """Find time and the model's inputs and outputs among the headers of ``table``; ``mapping`` (signal -> header) goes first.

    An output may be missing as long as another is there, and so may ``conditions``. With ``has_clock`` the rows have a known
    sampling time: then the table must have no time column. With ``inputs_only`` no outputs are looked for.
    """
    columns = [parse_header(h, k) for k, h in enumerate(table.headers)]
    clock = RequestedSignal(SignalKind.TIME, TIME, "s")
    signals = [] if has_clock else [clock]
    signals += [RequestedSignal(SignalKind.INPUT, i.name, i.unit) for i in model.inputs]
    if not inputs_only:
        signals += [RequestedSignal(SignalKind.OUTPUT, o.name, o.unit) for o in model.outputs]
    signals += conditions
    known = [s.name for s in signals]
    optional = {o.name for o in model.outputs} if inputs_only else set()
    mapping = {name: header for name, header in (mapping or {}).items() if name in known or name not in optional}
    problems = [
        f"columns names {n!r}, which model {model.name!r} does not have; {nearest(n, known)}"
        for n in mapping
        if n not in known and n != TIME
    ]
    matched, free = _apply_mapping(columns, signals, mapping, table.numbered, problems)
    missing: list[RequestedSignal] = []
    for signal in signals:
        if signal.name in mapping:
            continue
        hits = [c for c in free if _is_for(c, signal)]
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
    if has_clock:
        times = [repr(shorten(c.header)) for c in free if _is_for(c, clock)]
        times += [repr(mapping[TIME])] if TIME in mapping else []
        if times:
            problems.append(
                f"the file has a time column, {times[0]}, and a sampling time is given; leave one of them out"
                " (sampling_time; shell: --sampling-time)"
            )
    elif table.headless and not mapping:
        raise DataError(
            f"line {table.header_line} holds numbers where the header should be; begin the file with a line of names and units"
            " such as 'time [s],u [V],x [um]', or name the columns in their order, columns=['time', 'u', 'x'] (shell: --columns"
            " time,u,x)"
        )
    problems += _describe_missing(missing, model, spare, inputs_only)
    return ColumnMatch(
        {s: matched[s] for s in signals if s in matched},
        tuple(shorten(c.header) for c in spare),
        tuple(s.name for s in missing if s.kind is SignalKind.OUTPUT),
        tuple(problems),
    )


def propose_columns(
    table: DataTable, model: Model, mapping: ColumnMapping | None = None, *, has_clock: bool = False
) -> tuple[tuple[str, ...], tuple[ColumnChoice, ...]] | None:
    """For a table that lacks columns of the model: its columns as a mapping names them, and which each signal may be.

    None where no choice of columns would help.
    """
    known = {TIME, *(i.name for i in model.inputs), *(o.name for o in model.outputs)}
    columns = [parse_header(h, k) for k, h in enumerate(table.headers)]
    kept = {n: h for n, h in (mapping or {}).items() if n in known and _find_columns(columns, h, table.numbered)}
    if table.headless or not any(c.header for c in columns):
        return None
    match = match_columns(table, model, kept, has_clock=has_clock)
    if not match.problems and kept == dict(mapping or {}):
        return None
    headers = [c.header for c in columns]
    names = {
        c.position: c.header if headers.count(c.header) == 1 else str(table.numbered.index(c.position) + 1)
        for c in columns
        if c.header and (headers.count(c.header) == 1 or c.position in table.numbered)
    }
    used = {c.position for c in match.columns.values()}
    spare = [c for c in columns if c.position not in used and c.position in names]
    signals = [] if has_clock else [RequestedSignal(SignalKind.TIME, TIME, "s")]
    signals += [RequestedSignal(SignalKind.INPUT, i.name, i.unit) for i in model.inputs]
    signals += [RequestedSignal(SignalKind.OUTPUT, o.name, o.unit) for o in model.outputs]
    choices = []
    for signal in signals:
        at = match.columns.get(signal)
        likely = [] if at else _find_of_unit(signal, spare)
        column = names.get(at.position, "") if at else names[likely[0].position] if likely else ""
        choices.append(ColumnChoice(signal, column, at is not None and signal.name not in kept))
    return tuple(names.values()), tuple(choices)


def convert_column(values: np.ndarray, signal: RequestedSignal, column: Column, problems: list[str]) -> np.ndarray:
    """``values`` (N,) in the signal's unit; a unit that does not convert is added to ``problems``."""
    if not column.unit or column.unit == signal.unit:
        return values
    try:
        return np.asarray(convert(values, column.unit, signal.unit), dtype=np.float64)
    except ModelError as error:
        problems.append(
            f"column {shorten(column.header)!r} in {shorten(column.unit)} does not convert to {signal.label}: {error}"
        )
        return values


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
    if signal.kind is not SignalKind.TIME:
        return column.name == signal.name
    return column.name == "t" or column.name.lower() == TIME  # "T" is a temperature


def _describe_missing(
    missing: Sequence[RequestedSignal], model: Model, spare: Sequence[Column], inputs_only: bool
) -> list[str]:
    """Problems with the signals that no column is for; an output may be missing, but not all of them."""
    needed = [s for s in missing if s.kind in (SignalKind.TIME, SignalKind.INPUT)]
    clock = "; where rows have no time, give sampling_time=<seconds> (shell: --sampling-time SECONDS)"
    problems = [
        f"no column for {s.label}; {_suggest_headers(s, spare)}{clock if s.kind is SignalKind.TIME else ''}"
        for s in needed
    ]
    outputs = [s for s in missing if s.kind is SignalKind.OUTPUT]
    if len(outputs) == len(model.outputs) and not inputs_only:
        labels = ", ".join(s.label for s in outputs)
        what = f"any output of model {model.name!r} ({labels}), at least one is needed"
        problems.append(f"no column for {what}; {_suggest_headers(outputs[0], spare)}")
    return problems


def _suggest_headers(signal: RequestedSignal, spare: Sequence[Column]) -> str:
    wanted = signal.name.lower()
    spare = [c for c in spare if len(c.name) <= LONGEST_HEADER]
    close = difflib.get_close_matches(wanted, [c.name.lower() for c in spare], n=3, cutoff=0.5)
    near = [
        repr(shorten(c.header))
        for c in spare
        if c.name.lower() in close or wanted in re.split(r"[\W_]+", c.name.lower())
    ]
    near = near or [repr(shorten(c.header)) for c in _find_of_unit(signal, spare)]
    guess = f"did you mean {' or '.join(near[:3])}? " if near else ""
    listing = ", ".join(_list_headers(spare))
    if not listing:
        return f"every other column is in use; add a column for it, or {_explain_mapping(signal)}"
    return f"{guess}unused headers: {listing}; rename one, or {_explain_mapping(signal)}"


def _find_of_unit(signal: RequestedSignal, spare: Sequence[Column]) -> list[Column]:
    """The only column of a unit that converts to the signal's; none where there are several."""
    hits = [c for c in spare if c.unit and _converts(c.unit, signal.unit)]
    return hits if len(hits) == 1 else []


def _converts(source: str, target: str) -> bool:
    try:
        unit_converter(source, target)
    except ModelError:
        return False
    return True


def _explain_mapping(signal: RequestedSignal) -> str:
    """How to choose a column by hand, in Python and in the shell."""
    return f"set columns={{{signal.name!r}: <header>}} (shell: --column {signal.name}=<header>)"


def _list_headers(columns: Sequence[Column], shown: int = 12) -> list[str]:
    headers = [shorten(c.header, 40) for c in columns if c.header]
    return headers[:shown] + ([f"... {len(headers) - shown} more"] if len(headers) > shown else [])


def _is_unit(text: str) -> bool:
    if text.strip() == "-":
        return True
    if not any(letter.isalpha() or letter in "%°" for letter in text):
        return False  # channel numbers: Laser (1)
    try:
        unit_converter(text, text)
    except ModelError:
        return False
    return True


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
        return float(np.asarray(convert([float(line["value"])], unit, signal.unit))[0])
    except (ValueError, ModelError) as error:
        problems.append(f"{signal.label}: the comment line {line[0].strip()!r} is not understood ({error})")
        return None
