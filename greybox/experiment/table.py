"""A file as named columns that are turned into numbers only when asked for."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from greybox.errors import DataError, shorten
from greybox.experiment.policy import ReadingPolicy
from greybox.experiment.problems import RowLabels, enumerate_first
from greybox.findings import Finding

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
