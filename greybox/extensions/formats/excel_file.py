"""Sheets of a workbook, through openpyxl: a row of headers, perhaps a row of units, then numbers. Values are read, formulas are not run."""

from __future__ import annotations

import datetime
import math
import re
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from greybox.base import DataError, Finding, Severity
from greybox.data.array_table import ArrayColumn, ArrayInfo, ArrayTable, describe_cells, read_cells, read_marks
from greybox.data.channels import Channel, ChannelTable
from greybox.data.columns import (
    THOUSANDS,
    WITHOUT_MARKS,
    check_size,
    check_width,
    find_dated_time,
    find_decimal_signs,
    find_open_points,
    is_gap,
    raise_limit,
)
from greybox.data.file_kinds import FileFormat
from greybox.data.findings import RecordCode
from greybox.data.headers import HEADER_LINES, find_table_head, is_row_of_units, join_units, parse_header
from greybox.data.notation import read_conversion
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.problems import RowLabels
from greybox.data.stamps import StampKind, StampReader, Stamps, Timeline, find_origin, is_stamp
from greybox.data.time_base import Samples


@dataclass(frozen=True)
class _Sheet:
    """Columns (N,) of one sheet with their ``headers``, of which several may be alike: numbers, dates, or cells as they are; ``signs``:
    the decimal signs that its texts show."""

    name: str
    headers: tuple[str, ...]
    columns: tuple[np.ndarray | Stamps, ...]
    findings: tuple[Finding, ...]
    signs: frozenset[str]

    def as_table(self, policy: ReadingPolicy) -> ArrayTable:
        """The sheet as the only one of its file."""
        # Headers that are alike get a number behind them as names of arrays, and stay as they are as headers.
        names = [
            f"{header} ({k + 1})" if header in self.headers[:k] else header for k, header in enumerate(self.headers)
        ]
        arrays = dict(zip(names, self.columns, strict=True))
        infos = {
            name: ArrayInfo((len(cells),), dated=not cells.whole_days if isinstance(cells, Stamps) else None)
            for name, cells in arrays.items()
        }
        table = ArrayTable.from_infos(
            infos, lambda wanted: {name: arrays[name] for name in wanted}, policy, self.findings
        )
        columns = tuple(ArrayColumn(*pair) for pair in zip(names, self.headers, strict=True))
        return replace(table, columns=columns, signs=self.signs)

    @property
    def clock(self) -> int | None:
        """Position of the time column: by its name, or by its dates or times of day."""
        columns = [parse_header(header, k) for k, header in enumerate(self.headers)]
        times = [column for column in columns if column.is_time]
        times = times or find_dated_time(columns, self.as_table(READING_POLICY))
        return next((column.position for column in times), None)

    @property
    def day(self) -> int | None:
        """Position of the only column of days, which a clock of times of day needs."""
        days = [k for k, cells in enumerate(self.columns) if isinstance(cells, Stamps) and cells.whole_days]
        clock = None if self.clock is None else self.columns[self.clock]
        return days[0] if len(days) == 1 and isinstance(clock, Stamps) and clock.kind is StampKind.CLOCK else None


# Bytes that a part of a workbook which is read as a whole (texts, formats, names) may unpack to, as a share of what may be unpacked at
# all: 16 MB of texts are a million short ones, three seconds and 200 MB.
SHARE_OF_TEXTS = 0.04
# What the list of its parts says of a sheet.
_SHEET_PART = re.compile(rb'PartName="/?([^"]+)"[^>]*worksheet\+xml|worksheet\+xml"[^>]*PartName="/?([^"]+)"')


def _check_parts(path: Path, policy: ReadingPolicy) -> bool:
    """Refuse a workbook that unpacks to more than the policy allows; what it unpacks to is known before. Whether a sheet has formulas.
    Raises DataError."""
    with zipfile.ZipFile(path) as archive:
        sizes = {member.filename: member.file_size for member in archive.infolist()}
        most = int(SHARE_OF_TEXTS * policy.largest_unpacked)
        with archive.open("[Content_Types].xml") as part:
            sheets = {name.decode() for pair in _SHEET_PART.findall(part.read(most)) for name in pair}
    unpacked = sum(sizes.values())
    limit = raise_limit("largest_unpacked")
    if unpacked > policy.largest_unpacked:
        raise DataError(
            f"the workbook unpacks to {unpacked / 1e6:.0f} MB, at most {policy.largest_unpacked / 1e6:.0f} MB are read; save the"
            f" needed sheet as CSV, or raise the limit {limit}"
        )
    # A sheet is read row by row, every other part at once, and becomes ten times as large in memory.
    large = {
        name: size
        for name, size in sizes.items()
        if name not in sheets and name.endswith((".xml", ".rels")) and size > most
    }
    if large:
        named = ", ".join(f"{name} ({size / 1e6:.0f} MB)" for name, size in large.items())
        raise DataError(
            f"the workbook holds {named} beside its sheets, at most {most / 1e6:.0f} MB of texts or formats are read; save the needed"
            f" sheet as CSV, or raise the limit {limit}"
        )
    with zipfile.ZipFile(path) as archive:
        return any(_holds_formula(archive, name) for name in sheets & sizes.keys())


# What begins a formula in a sheet, and bytes of it that are looked at together.
_FORMULA = re.compile(rb"<(\w+:)?f[\s>/]")
_BYTES = 1 << 20


def _holds_formula(archive: zipfile.ZipFile, name: str) -> bool:
    with archive.open(name) as part:
        end = b""
        while block := part.read(_BYTES):
            if _FORMULA.search(end + block):
                return True
            end = block[-20:]
    return False


def read_excel(path: Path, policy: ReadingPolicy = READING_POLICY) -> ArrayTable | ChannelTable:
    """The sheet with numbers; where several have a time column of their own, all of them as channels. Other sheets are not read."""
    from openpyxl import load_workbook

    has_formulas = _check_parts(path, policy)
    # Rows as they come, values in the place of formulas.
    book = load_workbook(path, read_only=True, data_only=True)
    # Without these openpyxl rounds dates and times of day to the millisecond, and takes those of 1904 behind midnight for dates.
    book._date_formats = book._timedelta_formats = frozenset()
    written = load_workbook(path, read_only=True) if has_formulas else None
    try:
        pages = [(page, None if written is None else written[page.title]) for page in book.worksheets]
        sheets = [sheet for page in pages if (sheet := _read_sheet(*page, policy)) is not None]
    finally:
        book.close()
        if written is not None:
            written.close()
    if not sheets:
        raise DataError("no sheet has a row of headers above rows of numbers; save the record as CSV")
    # Those with a clock, or the first that has numbers.
    kept = [sheet for sheet in sheets if sheet.clock is not None] or sheets[:1]
    table = _join_sheets(kept, policy) if len(kept) > 1 else kept[0].as_table(policy)
    about, read = {"read": kept[0].name}, {sheet.name for sheet in kept}
    left = [Finding(RecordCode.SHEET_NOT_READ, subject=s.name, values=about) for s in sheets if s.name not in read]
    return replace(table, findings=(*table.findings, *left))


def _join_sheets(sheets: Sequence[_Sheet], policy: ReadingPolicy) -> ChannelTable:
    """Each sheet with a clock of its own: its columns are channels, stamped in seconds of one origin."""
    channels: list[Channel] = []
    samples: list[Samples] = []
    times = {sheet.name: _read_clock(sheet) for sheet in sheets}
    origin, after = find_origin({name: time.start for name, time in times.items()})
    findings = [f for sheet in sheets for f in (*sheet.findings, *times[sheet.name].findings)]
    findings += [Finding(RecordCode.CLOCK_START, subject=n, values={"start": s}) for n, s in after.items() if s]
    for sheet in sheets:
        seconds = times[sheet.name].seconds + after[sheet.name]
        known = np.isfinite(seconds)
        clock, day = sheet.clock, sheet.day
        for k, (header, cells) in enumerate(zip(sheet.headers, sheet.columns, strict=True)):
            if k not in (clock, day):
                column = parse_header(header, 0)
                is_number = isinstance(cells, np.ndarray) and cells.dtype != object
                holds = "" if is_number else "text or dates"
                if isinstance(cells, np.ndarray) and not is_number:
                    reason = describe_cells(header, cells, RowLabels(), sheet.signs)
                    if WITHOUT_MARKS in reason:
                        holds = "texts with marks between thousands"
                        count = sum(value is not None for value in read_cells(cells, sheet.signs))
                        about = {"count": count, "rows": len(cells), "reason": reason}
                        findings.append(Finding(RecordCode.COLUMN_WITH_TEXT, Severity.WARNING, header, about))
                channels.append(Channel(column.name, column.unit, sheet.name, sheet.name, int(known.sum()), holds))
                values = cells[known] if isinstance(cells, np.ndarray) and is_number else np.zeros(0)
                samples.append(Samples(seconds[known], values))
    return ChannelTable.from_channels(
        channels, lambda wanted: {k: samples[k] for k in wanted}, policy, findings, origin
    )


def _read_clock(sheet: _Sheet) -> Timeline:
    """The time column of a sheet in seconds. Raises DataError for one that holds a text."""
    clock, day = sheet.clock, sheet.day
    assert clock is not None
    header, cells = sheet.headers[clock], sheet.columns[clock]
    column = parse_header(header, 0)
    if isinstance(cells, Stamps):
        days = None if day is None else sheet.columns[day]
        cells = cells.on_days(days) if isinstance(days, Stamps) else cells
        return cells.count_seconds(f"{sheet.name}.{header}", column.unit)
    if cells.dtype == object:
        raise DataError(f"sheet {sheet.name!r}: {describe_cells(header, cells, RowLabels(), sheet.signs)}")
    return Timeline(read_conversion(column.unit, "s")(cells) if column.unit else cells)


def _read_sheet(page: Any, formulas: Any, policy: ReadingPolicy) -> _Sheet | None:
    """The first block of a sheet: headers, then rows until one is empty. None where there is none.

    ``formulas``: the same sheet with its formulas in the place of their values; None where it has none.
    """
    # What a sheet states of its size may be that of another one: its cells say it.
    page.reset_dimensions()
    rows = _read_rows(page, formulas)
    ahead = list(islice(rows, HEADER_LINES))
    place = find_table_head([list(map(_to_word, row)) for row in ahead])
    if place is None:
        return None
    head: Sequence[Any] = ahead[place.names]
    # Of several rows of texts below the names some may describe them, in another language; those of units count.
    units = [k for k in place.below if is_row_of_units([str(cell or "") for cell in ahead[k]])]
    for k in units or place.below:
        head = join_units(head, ahead[k])
    following = chain(ahead[place.first + 1 :], rows)
    percents = _find_percents(page, place.first + 1, len(head))
    return _read_block(page.title, head, ahead[place.first], following, policy, percents)


def _read_rows(page: Any, formulas: Any) -> Iterator[tuple[Any, ...]]:
    """The values of the rows; a formula that has none stands as its text."""
    epoch = page.parent.epoch
    if formulas is None:
        for row in page.iter_rows():
            yield tuple(_read_cell(cell, epoch) for cell in row)
        return
    formulas.reset_dimensions()
    for row, written in zip(page.iter_rows(), formulas.iter_rows(), strict=True):
        yield tuple(
            # Its sign of equality tells it from a header and from a text.
            f"={str(formula.value).removeprefix('=')}"
            if cell.value is None and cell.data_type == "n" and formula.data_type == "f"
            else _read_cell(cell, epoch)
            for cell, formula in zip(row, written, strict=True)
        )


# Days of a date before which it is a time of day that goes on behind midnight: nobody recorded in 1900, or in 1904.
FIRST_DATE = 366
# Days from the beginning of a workbook's count, the last of which is in the year 9999.
LAST_DATE = 2_900_000
# Microseconds to which a stamp is rounded: the first that is within what a double in days holds.
ROUNDINGS = (1000, 100, 10)
MICROSECONDS_A_DAY = 86400 * 10**6
# Steps between doubles by which a stamp may be beside a round one: that of its own rounding, and of the sum that made it.
STEPS_BESIDE = 2.0


def _read_cell(cell: Any, epoch: datetime.datetime) -> Any:
    """The value of a cell; a number that is shown as a date, a time of day or a length of time becomes one, to the microsecond."""
    value = cell.value
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return value
    shown = _read_format(cell.number_format)
    if not shown or not abs(value) < LAST_DATE:
        return value
    exact = value * MICROSECONDS_A_DAY
    beside = STEPS_BESIDE * math.ulp(value) * MICROSECONDS_A_DAY
    rounding = next((r for r in ROUNDINGS if abs(exact - r * round(exact / r)) <= beside), 1)
    length = datetime.timedelta(microseconds=rounding * round(exact / rounding))
    if shown is StampKind.DURATION:
        return length
    if value >= FIRST_DATE:
        return epoch + length
    # Midnight of no day; `greybox.data.stamps` knows a later one by its year.
    midnight = datetime.datetime(1899, 12, 31)
    return (midnight + length).time() if 0 <= value < 1 and length.days == 0 else midnight + length


@lru_cache(maxsize=256)
def _read_format(text: str | None) -> StampKind | None:
    """What a number in a cell of this format is shown as; None for a number."""
    from openpyxl.styles.numbers import is_date_format, is_timedelta_format

    if not is_date_format(text):
        return None
    return StampKind.DURATION if is_timedelta_format(text) else StampKind.DATE


def _to_word(cell: Any) -> str | None:
    """A cell as `find_table_head` takes it: numbers and dates kept as text are values, whatever their marks mean."""
    text = cell.strip() if isinstance(cell, str) else ""
    if _is_value(cell) or THOUSANDS.fullmatch(text) or _is_formula(text):
        return None
    if is_gap(text):
        return text if text == "-" else ""
    return text if read_cells([text]) == [None] else None


def _find_percents(page: Any, first: int, columns: int) -> set[int]:
    """Positions of the ``columns`` whose first numbers, from row ``first`` on, are shown as percent: 50 % is kept as 0.5."""
    formats: dict[int, str] = {}
    for row in page.iter_rows(min_row=first, max_col=columns):
        for k, cell in enumerate(row):
            if cell.value is not None:
                formats.setdefault(k, cell.number_format if isinstance(cell.value, (int, float)) else "")
        # The first cells of a column may be empty; a row that is empty ends the block.
        if len(formats) == columns or all(cell.value is None for cell in row):
            break
    # A sign in quotation marks or behind a backslash is only written beside the number.
    return {k for k, text in formats.items() if "%" in re.sub(r'"[^"]*"|\\.', "", text)}


def _is_formula(text: str) -> bool:
    return text.startswith("=") and len(text) > 1


def _is_value(cell: Any) -> bool:
    return isinstance(cell, (bool, int, float)) or is_stamp(cell)


def _read_block(
    title: str,
    head: Sequence[Any],
    first: Sequence[Any],
    rows: Iterator[Sequence[Any]],
    policy: ReadingPolicy,
    percents: set[int],
) -> _Sheet:
    # A column without a header holds remarks, sums or nothing, or an index: it is one if its first row is a number or a date.
    named = {k: str(cell).strip() for k, cell in enumerate(head) if cell is not None and str(cell).strip()}
    named |= {k: f"column {k + 1}" for k, cell in enumerate(first) if k not in named and _is_value(cell)}
    check_width(len(named), policy)
    cells: dict[int, list[Any]] = {k: [] for k in sorted(named)}
    row: Sequence[Any] | None = first
    count = 0
    while row is not None and any(cell is not None for cell in row):
        count += 1
        # Checked on the way: nobody knows beforehand how long a sheet is.
        if count % policy.rows_per_chunk == 0:
            check_size(count, len(named), policy)
        for k, column in cells.items():
            column.append(row[k] if k < len(row) and row[k] != "" else None)
        row = next(rows, None)
    left = sum(any(cell is not None for cell in below) for below in rows)
    values = {"row": count + 1, "rows": left}
    findings = [Finding(RecordCode.ROWS_BELOW_TABLE, Severity.WARNING, title, values)] * bool(left)
    signs = find_decimal_signs(cell for column in cells.values() for cell in column if isinstance(cell, str))
    marks = {} if signs else {named[k]: read_marks(column) for k, column in cells.items()}
    findings += [f for header, shown in marks.items() for f in find_open_points(header, shown, named.values())]
    headers: list[str] = []
    columns: list[np.ndarray | Stamps] = []
    for k, column in cells.items():
        numbers, header = _to_column(column, signs), parse_header(named[k], k)
        # The number that is shown, in percent, unless the header states another unit for the one that is kept.
        if k in percents and header.unit in ("", "%") and isinstance(numbers, np.ndarray) and numbers.dtype != object:
            headers.append(named[k] if header.unit else f"{named[k]} [%]")
            columns.append(100 * numbers)
        else:
            headers.append(named[k])
            columns.append(numbers)
    return _Sheet(title, tuple(headers), tuple(columns), tuple(findings), signs)


def _to_column(cells: list[Any], signs: frozenset[str]) -> np.ndarray | Stamps:
    """Numbers (N,) with NaN for empty cells, or stamps; cells as they are where they are neither, for a message."""
    if all(cell is None or isinstance(cell, (bool, int, float)) for cell in cells):
        return np.array([np.nan if cell is None else float(cell) for cell in cells])
    reader = StampReader()
    if not reader.add(cells):
        return reader.finish()
    numbers = read_cells(cells, signs)
    if None not in numbers:
        return np.array(numbers, dtype=np.float64)
    mixed = np.empty(len(cells), dtype=object)
    mixed[:] = cells
    return mixed


EXCEL = FileFormat("Excel", (".xlsx", ".xlsm"), read_excel, "save the sheet as CSV", (("openpyxl", "excel"),))
