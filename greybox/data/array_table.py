"""Tables in files of named arrays: MATLAB, NumPy, HDF5, Parquet. Shapes are known at once, numbers are loaded when they are wanted."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np

from greybox.base import DataError, Finding, shorten
from greybox.data.columns import (
    Marks,
    check_size,
    check_width,
    describe_non_numbers,
    describe_wrong_count,
    find_open_points,
    is_gap,
)
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.problems import RowLabels
from greybox.data.stamps import StampReader, Stamps, from_datetimes, is_stamp

Arrays = Mapping[str, np.ndarray | Stamps]
ArrayLoader = Callable[[Sequence[str]], Arrays]
"""Gives the arrays of these names."""


@dataclass(frozen=True)
class ArrayInfo:
    """What is known of an array before it is loaded: its ``shape``, what it ``holds`` if neither numbers nor stamps, and whether it is
    ``dated``: None for numbers, else as of `DataTable`."""

    shape: tuple[int, ...]
    holds: str = ""
    dated: bool | None = None

    @property
    def is_matrix(self) -> bool:
        """Whether it has several columns of numbers."""
        return len(self.shape) == 2 and min(self.shape) > 1 and not self.holds

    @property
    def is_vector(self) -> bool:
        """Whether it is one column of several numbers."""
        return not self.holds and len(self.shape) in (1, 2) and max(self.shape) > 1 and not self.is_matrix


@dataclass(frozen=True)
class ArrayColumn:
    """One column of a table: an array, or in a matrix its column (or row, if it has more columns than rows) ``index``."""

    array: str
    header: str
    index: int | None = None


@dataclass(frozen=True)
class ArrayTable:
    """Named arrays of a file; rows are counted from 1. The columns of a matrix ``data`` are called ``data(:,1)``, ``data(:,2)``, ...

    Parameters
    ----------
    infos
        The arrays of the file, in their order.
    load
        Loads some of them.
    columns
        The columns of the table.
    policy
        How much may be loaded.
    findings
        What is to be said of the file.
    signs
        Decimal signs that its texts show, beside those of the columns that are loaded.
    """

    infos: Mapping[str, ArrayInfo]
    load: ArrayLoader = field(repr=False)
    columns: tuple[ArrayColumn, ...]
    policy: ReadingPolicy = field(default=READING_POLICY, repr=False)
    findings: tuple[Finding, ...] = ()
    signs: frozenset[str] = frozenset()
    headless = False
    header_line = 1

    @classmethod
    def from_infos(
        cls,
        infos: Mapping[str, ArrayInfo],
        load: ArrayLoader,
        policy: ReadingPolicy = READING_POLICY,
        findings: Sequence[Finding] = (),
    ) -> ArrayTable:
        """The table of a file's arrays. Raises DataError for more columns than the policy allows."""
        check_width(sum(min(i.shape) if i.is_matrix else 1 for i in infos.values()), policy)
        columns: list[ArrayColumn] = []
        for name, info in infos.items():
            if not info.is_matrix:
                columns.append(ArrayColumn(name, name))
                continue
            written = "{}(:,{})" if info.shape[0] >= info.shape[1] else "{}({},:)"
            columns += [ArrayColumn(name, written.format(name, k + 1), k) for k in range(min(info.shape))]
        return cls(infos, load, tuple(columns), policy, tuple(findings))

    @property
    def headers(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(column.header for column in self.columns)

    @property
    def comments(self) -> tuple[str, ...]:
        """None: such files have no lines."""
        return ()

    @property
    def row_labels(self) -> RowLabels:
        """Rows are called by their number."""
        return RowLabels()

    @property
    def numbered(self) -> tuple[int, ...]:
        """Positions of the columns of the only matrix, or of all vectors where there is no matrix."""
        matrices = [name for name, info in self.infos.items() if info.is_matrix]
        if matrices:
            return tuple(
                k for k, column in enumerate(self.columns) if len(matrices) == 1 and column.array == matrices[0]
            )
        return tuple(k for k, column in enumerate(self.columns) if self.infos[column.array].is_vector)

    @property
    def dated(self) -> Mapping[int, bool]:
        """As of `DataTable`."""
        dated = ((k, self.infos[column.array].dated) for k, column in enumerate(self.columns))
        return {k: has_clock for k, has_clock in dated if has_clock is not None}

    def rename(self, names: Sequence[str]) -> ArrayTable:
        """The table with a name for each counted column; the others have none. Raises DataError for another number of names."""
        if not self.numbered:
            matrices = [shorten(name) for name, info in self.infos.items() if info.is_matrix]
            what = f"the matrices {', '.join(matrices)}" if matrices else "no columns of numbers"
            raise DataError(f"the file has {what}; choose columns by their headers, as in columns={{'u': 'data(:,2)'}}")
        if len(names) != len(self.numbered):
            raise DataError(describe_wrong_count(names, len(self.numbered)))
        named = dict(zip(self.numbered, names, strict=True))
        return replace(
            self, columns=tuple(replace(column, header=named.get(k, "")) for k, column in enumerate(self.columns))
        )

    def values(self, positions: Sequence[int]) -> tuple[dict[int, np.ndarray | Stamps], list[str], tuple[Finding, ...]]:
        """Columns (N,) as float64 with NaN for gaps, or as stamps, the problems met, and what is to be said of the file."""
        wanted = {k: self.columns[k] for k in positions}
        problems = [
            f"column {shorten(column.header)!r} holds {info.holds}, not real numbers; write numbers (time in seconds)"
            for column in wanted.values()
            if (info := self.infos[column.array]).holds
        ]
        if problems:
            return {k: np.zeros(0) for k in positions}, problems, ()
        names = list(dict.fromkeys(column.array for column in wanted.values()))
        check_size(sum(int(np.prod(self.infos[name].shape, dtype=object)) for name in names), 1, self.policy)
        arrays = self.load(names)
        marks = {name: read_marks(a) for name, a in arrays.items() if not isinstance(a, Stamps)}
        signs = self.signs.union(*(shown.decimal for shown in marks.values()))
        columns = {
            k: _to_column(column, arrays[column.array], self.row_labels, problems, signs)
            for k, column in wanted.items()
        }
        rows = {len(values) for values in columns.values()}
        if not problems and len(rows) > 1:
            lengths = ", ".join(f"{shorten(self.headers[k])!r} {len(v)}" for k, v in columns.items())
            problems.append(f"columns differ in length ({lengths} rows); each needs one value for each time")
        headers = () if signs else self.headers
        points = (find_open_points(name, shown, headers) for name, shown in marks.items())
        return columns, problems, (*self.findings, *chain.from_iterable(points))


def _to_column(
    column: ArrayColumn, array: np.ndarray | Stamps, labels: RowLabels, problems: list[str], signs: frozenset[str]
) -> np.ndarray | Stamps:
    header = shorten(column.header)
    if isinstance(array, Stamps):
        return array
    if column.index is not None and array.ndim == 2:
        array = array[:, column.index] if array.shape[0] >= array.shape[1] else array[column.index]
    if array.ndim == 2 and 1 in array.shape:
        array = array.ravel()
    if array.ndim != 1:
        problems.append(f"column {header!r} has shape {array.shape}; it needs one number for each row")
    elif array.dtype.kind in "biuf":
        # A column of its own is not copied; one of a matrix would keep the whole matrix alive.
        return array if array.dtype == np.float64 and array.flags.owndata else array.astype(np.float64)
    elif array.dtype.kind in "Mm":
        return from_datetimes(array)
    elif array.dtype.kind in "OU" and is_stamp(next((v for v in array if v is not None and v != ""), None)):
        reader = StampReader()
        bad = reader.add(array.tolist())
        if not bad:
            return reader.finish()
        problems.append(describe_non_numbers(header, bad, [str(array[k])[:200] for k in bad[:5]], labels))
    elif array.dtype.kind in "OUS":
        values = read_cells(array, signs)
        if None in values:
            problems.append(describe_cells(header, array, labels, signs))
        return np.array(values, dtype=np.float64)  # None becomes NaN
    else:
        problems.append(f"column {header!r} holds {array.dtype}, not real numbers; write numbers (time in seconds)")
    return np.zeros(0)


def describe_cells(
    header: str, cells: Sequence[Any] | np.ndarray, labels: RowLabels, signs: frozenset[str] = frozenset()
) -> str:
    """Message for ``cells`` (N,) of which some are no number; ``signs`` as of `read_cells`."""
    bad = [k for k, value in enumerate(read_cells(cells, signs)) if value is None]
    return describe_non_numbers(header, bad, [str(cells[k])[:200] for k in bad[:5]], labels)


# A number as a program writes it into a text.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)
_WHOLE = re.compile(r"\s*[+-]?[0-9]+\s*")


def read_marks(cells: Sequence[Any] | np.ndarray) -> Marks:
    """What the texts and numbers of a column show of their marks."""
    texts = _list_texts(cells)
    if not texts:
        return Marks()
    plain = [
        cell for cell in cells if isinstance(cell, (int, float)) or (isinstance(cell, str) and _WHOLE.fullmatch(cell))
    ]
    marks = Marks()
    marks.add(texts, np.array(plain, dtype=np.float64))
    return marks


def _list_texts(cells: Sequence[Any] | np.ndarray) -> list[str]:
    is_numeric = isinstance(cells, np.ndarray) and (cells.ndim != 1 or cells.dtype.kind not in "OUS")
    return [] if is_numeric else [cell for cell in cells if isinstance(cell, str)]


def read_cells(cells: Sequence[Any] | np.ndarray, signs: frozenset[str] = frozenset()) -> list[float | None]:
    """The numbers of a column, also of those that are kept as text: NaN for an empty cell, None for anything else.

    The decimal sign is the one that the column shows, else the one of ``signs``, which the rest of the table shows, else a point.
    Where the rest shows both, a mark that may stand between thousands is refused; so is one that stands there by what the column shows.
    """
    marks = read_marks(cells)
    of_column = frozenset(marks.decimal)
    # Where a column shows both, its commas are what is to be corrected.
    decimal = (of_column if len(of_column) < 2 else frozenset(".")) or signs or frozenset(".")
    if not of_column and not signs and marks.are_thousands("."):
        decimal = frozenset()

    def read(cell: Any) -> float | None:
        if cell is None:
            return float("nan")
        if isinstance(cell, str):
            text = cell.strip()
            if is_gap(text):
                return float("nan")
            is_clear = all(decimal == {mark} for mark in ".," if mark in text)
            text = text.replace(",", ".")
            return float(text) if is_clear and _NUMBER.fullmatch(text) else None
        return float(cell) if isinstance(cell, (int, float, np.number)) and not isinstance(cell, complex) else None

    return [read(cell) for cell in cells]
