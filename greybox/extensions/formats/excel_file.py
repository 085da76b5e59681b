"""Sheets of a workbook, through openpyxl: a row of headers, perhaps a row of units, then numbers. Values are read, formulas are not run."""

from __future__ import annotations

import datetime
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from greybox.base import DataError
from greybox.data.array_table import ArrayInfo, ArrayTable
from greybox.data.channels import Channel, ChannelTable
from greybox.data.columns import check_size, check_width, raise_limit
from greybox.data.file_kinds import FileFormat
from greybox.data.headers import join_units, parse_header
from greybox.data.notation import read_conversion
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.time_base import Samples


@dataclass(frozen=True)
class _Sheet:
    """Headers and columns (N,) of one sheet."""

    name: str
    columns: Mapping[str, np.ndarray]

    @property
    def clock(self) -> str | None:
        """Header of the time column."""
        return next((header for header in self.columns if parse_header(header, 0).is_time), None)


def read_excel(path: Path, policy: ReadingPolicy = READING_POLICY) -> ArrayTable | ChannelTable:
    """The sheet with numbers; where several have a time column of their own, all of them as channels. Other sheets are not read."""
    from openpyxl import load_workbook

    # A workbook is an archive: what it unpacks to is known before it is unpacked.
    with zipfile.ZipFile(path) as archive:
        unpacked = sum(member.file_size for member in archive.infolist())
    if unpacked > policy.largest_unpacked:
        raise DataError(
            f"the workbook unpacks to {unpacked / 1e6:.0f} MB, at most {policy.largest_unpacked / 1e6:.0f} MB are read; save the"
            f" needed sheet as CSV, or raise the limit {raise_limit('largest_unpacked')}"
        )
    # Rows as they come, values in the place of formulas.
    book = load_workbook(path, read_only=True, data_only=True)
    try:
        sheets = [sheet for page in book.worksheets if (sheet := _read_sheet(page, policy)) is not None]
    finally:
        book.close()
    if not sheets:
        raise DataError("no sheet has a row of headers above rows of numbers; save the record as CSV")
    timed = [sheet for sheet in sheets if sheet.clock]
    if len(timed) > 1:
        # Each sheet with a clock of its own: its columns are channels, stamped in seconds.
        channels: list[Channel] = []
        samples: list[Samples] = []
        for sheet in timed:
            time, unit = sheet.columns[str(sheet.clock)], parse_header(str(sheet.clock), 0).unit
            known = np.isfinite(time)
            seconds = read_conversion(unit, "s")(time[known]) if unit else time[known]
            for header, values in sheet.columns.items():
                if header != sheet.clock:
                    column = parse_header(header, 0)
                    channels.append(Channel(column.name, column.unit, sheet.name, sheet.name, int(known.sum())))
                    samples.append(Samples(seconds, values[known]))
        return ChannelTable.from_channels(channels, lambda wanted: {k: samples[k] for k in wanted}, policy)
    # One sheet: the one with a clock, or the first that has numbers.
    columns = (timed or sheets)[0].columns
    infos = {header: ArrayInfo(values.shape) for header, values in columns.items()}
    return ArrayTable.from_infos(infos, lambda names: {name: columns[name] for name in names}, policy)


def _read_sheet(page: Any, policy: ReadingPolicy) -> _Sheet | None:
    """The first block of a sheet: headers, then rows until one is empty. None where there is none."""
    rows = iter(page.iter_rows(values_only=True))
    head: Sequence[Any] | None = None
    for row in rows:
        texts = sum(isinstance(cell, str) and bool(cell.strip()) for cell in row)
        # A row of texts alone is one of headers; the fuller one counts, and a shorter one below it holds units.
        if texts and texts == sum(cell is not None for cell in row):
            if head is None or texts > sum(c is not None for c in head):
                head = row
                continue
            head = join_units(head, row)
        elif head is not None and any(_to_number(cell) is not None for cell in row):
            return _read_block(page.title, head, row, rows, policy)
    return None


def _read_block(
    title: str, head: Sequence[Any], first: Sequence[Any], rows: Iterator[Sequence[Any]], policy: ReadingPolicy
) -> _Sheet:
    # A column without a header holds remarks, sums or nothing.
    named = {k: str(cell).strip() for k, cell in enumerate(head) if cell is not None and str(cell).strip()}
    check_width(len(named), policy)
    cells: dict[int, list[float]] = {k: [] for k in named}
    row: Sequence[Any] | None = first
    count = 0
    while row is not None and any(cell is not None for cell in row):
        count += 1
        # Checked on the way: nobody knows beforehand how long a sheet is.
        if count % policy.rows_per_chunk == 0:
            check_size(count, len(named), policy)
        for k, column in cells.items():
            cell = row[k] if k < len(row) else None
            # An empty cell is a gap; a text among numbers is a mistake that is named.
            number = float("nan") if cell is None or cell == "" else _to_number(cell)
            if number is None:
                raise DataError(
                    f"sheet {title!r}, column {named[k]!r}, row {count} below the headers: {str(cell)[:40]!r} is not a number; correct"
                    " it, or leave the cell empty if nothing was measured"
                )
            column.append(number)
        row = next(rows, None)
    columns: dict[str, np.ndarray] = {}
    for k, header in named.items():
        values = np.array(cells[k])
        # A record begins at zero: dates count from its first one.
        if isinstance(first[k] if k < len(first) else None, datetime.datetime) and len(values):
            values = values - values[0]
        columns[header] = values
    return _Sheet(title, columns)


def _to_number(cell: Any) -> float | None:
    """A number; dates and times of day in seconds; None for a text."""
    if isinstance(cell, (bool, int, float)):
        return float(cell)
    if isinstance(cell, datetime.datetime):
        return cell.replace(tzinfo=datetime.UTC).timestamp()
    if isinstance(cell, datetime.time):
        return cell.hour * 3600.0 + cell.minute * 60.0 + cell.second + cell.microsecond * 1e-6
    if isinstance(cell, datetime.timedelta):
        return cell.total_seconds()
    return None


EXCEL = FileFormat("Excel", (".xlsx", ".xlsm"), read_excel, "save the sheet as CSV", (("openpyxl", "excel"),))
