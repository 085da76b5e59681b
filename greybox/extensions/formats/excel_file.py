"""Sheets of a workbook, through openpyxl: a row of headers, perhaps a row of units, then numbers. Values are read, formulas are not run."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from greybox.base import DataError, Finding, Severity
from greybox.data.array_table import ArrayInfo, ArrayTable, describe_cells, read_cells, read_marks
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
from greybox.data.headers import HEADER_LINES, find_table_head, join_units, parse_header
from greybox.data.notation import read_conversion
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.problems import RowLabels
from greybox.data.stamps import StampKind, StampReader, Stamps, Timeline, find_origin, is_stamp
from greybox.data.time_base import Samples


@dataclass(frozen=True)
class _Sheet:
    """Headers and columns (N,) of one sheet: numbers, dates, or cells as they are; ``signs``: the decimal signs that its texts show."""

    name: str
    columns: Mapping[str, np.ndarray | Stamps]
    findings: tuple[Finding, ...]
    signs: frozenset[str]

    def as_table(self, policy: ReadingPolicy) -> ArrayTable:
        """The sheet as the only one of its file."""
        infos = {
            header: ArrayInfo((len(cells),), dated=not cells.whole_days if isinstance(cells, Stamps) else None)
            for header, cells in self.columns.items()
        }
        table = ArrayTable.from_infos(
            infos, lambda names: {name: self.columns[name] for name in names}, policy, self.findings
        )
        return replace(table, signs=self.signs)

    @property
    def clock(self) -> str | None:
        """Header of the time column: by its name, or by its dates or times of day."""
        columns = [parse_header(header, k) for k, header in enumerate(self.columns)]
        times = [column for column in columns if column.is_time]
        times = times or find_dated_time(columns, self.as_table(READING_POLICY))
        return next((column.header for column in times), None)

    @property
    def day(self) -> str | None:
        """Header of the only column of days, which a clock of times of day needs."""
        days = [h for h, cells in self.columns.items() if isinstance(cells, Stamps) and cells.whole_days]
        clock = self.columns[str(self.clock)]
        return days[0] if len(days) == 1 and isinstance(clock, Stamps) and clock.kind is StampKind.CLOCK else None


# Bytes that a part of a workbook which is read as a whole (texts, formats, names) may unpack to, as a share of what may be unpacked at
# all: 16 MB of texts are a million short ones, three seconds and 200 MB.
SHARE_OF_TEXTS = 0.04
# What the list of its parts says of a sheet.
_SHEET_PART = re.compile(rb'PartName="/?([^"]+)"[^>]*worksheet\+xml|worksheet\+xml"[^>]*PartName="/?([^"]+)"')


def _check_parts(path: Path, policy: ReadingPolicy) -> None:
    """Refuse a workbook that unpacks to more than the policy allows; what it unpacks to is known before. Raises DataError."""
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


def read_excel(path: Path, policy: ReadingPolicy = READING_POLICY) -> ArrayTable | ChannelTable:
    """The sheet with numbers; where several have a time column of their own, all of them as channels. Other sheets are not read."""
    from openpyxl import load_workbook

    _check_parts(path, policy)
    # Rows as they come, values in the place of formulas.
    book = load_workbook(path, read_only=True, data_only=True)
    try:
        sheets = [sheet for page in book.worksheets if (sheet := _read_sheet(page, policy)) is not None]
    finally:
        book.close()
    if not sheets:
        raise DataError("no sheet has a row of headers above rows of numbers; save the record as CSV")
    # Those with a clock, or the first that has numbers.
    kept = [sheet for sheet in sheets if sheet.clock] or sheets[:1]
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
        for header, cells in sheet.columns.items():
            if header not in (sheet.clock, sheet.day):
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
    column = parse_header(str(sheet.clock), 0)
    cells = sheet.columns[str(sheet.clock)]
    if isinstance(cells, Stamps):
        days = sheet.columns[sheet.day] if sheet.day else None
        cells = cells.on_days(days) if isinstance(days, Stamps) else cells
        return cells.count_seconds(f"{sheet.name}.{sheet.clock}", column.unit)
    if cells.dtype == object:
        raise DataError(f"sheet {sheet.name!r}: {describe_cells(str(sheet.clock), cells, RowLabels(), sheet.signs)}")
    return Timeline(read_conversion(column.unit, "s")(cells) if column.unit else cells)


def _read_sheet(page: Any, policy: ReadingPolicy) -> _Sheet | None:
    """The first block of a sheet: headers, then rows until one is empty. None where there is none."""
    rows = iter(page.iter_rows(values_only=True))
    ahead = list(islice(rows, HEADER_LINES))
    place = find_table_head([list(map(_to_word, row)) for row in ahead])
    if place is None:
        return None
    head = ahead[place.names]
    for k in place.below:
        head = join_units(head, ahead[k])
    following = chain(ahead[place.first + 1 :], rows)
    percents = _find_percents(page, place.first + 1, len(head))
    return _read_block(page.title, head, ahead[place.first], following, policy, percents)


def _to_word(cell: Any) -> str | None:
    """A cell as `find_table_head` takes it: numbers and dates kept as text are values, whatever their marks mean."""
    text = cell.strip() if isinstance(cell, str) else ""
    if _is_value(cell) or THOUSANDS.fullmatch(text):
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
    columns: dict[str, np.ndarray | Stamps] = {}
    for k, column in cells.items():
        numbers, header = _to_column(column, signs), parse_header(named[k], k)
        # The number that is shown, in percent, unless the header states another unit for the one that is kept.
        if k in percents and header.unit in ("", "%") and isinstance(numbers, np.ndarray) and numbers.dtype != object:
            columns[named[k] if header.unit else f"{named[k]} [%]"] = 100 * numbers
        else:
            columns[named[k]] = numbers
    return _Sheet(title, columns, tuple(findings), signs)


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
