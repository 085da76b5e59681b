"""A file as named columns that are turned into numbers only when asked for."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from greybox.experiment.problems import RowLabels, enumerate_first

_DATE = re.compile(r"\d+[-/.]\d+[-/.]\d+|\d+:\d\d")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(e[+-]?\d+)?", re.IGNORECASE)
_THOUSANDS = re.compile(r"[+-]?\d{1,3}([,.' ]\d{3})+([.,]\d+)?")


class DataTable(Protocol):
    """What every reader hands over: the ``headers`` in the order of the file, its ``comments``, and how its rows are called."""

    @property
    def headers(self) -> tuple[str, ...]:
        """One header for each column."""

    @property
    def comments(self) -> tuple[str, ...]:
        """Lines about the table that are not part of it."""

    @property
    def row_labels(self) -> RowLabels:
        """How rows are called in messages."""

    def values(self, positions: Sequence[int]) -> tuple[dict[int, np.ndarray], list[str]]:
        """Columns (N,) as float64 with NaN for gaps, and problems; with problems the columns are not to be used."""


def describe_non_numbers(header: str, rows: Sequence[int], texts: Sequence[str], labels: RowLabels) -> str:
    """Message for text in a number column; ``texts`` belong to the first of ``rows``."""
    quoted = enumerate_first([repr(t) for t in texts[:5]], len(rows))
    verb = "is not a number" if len(rows) == 1 else "are not numbers"
    return f"column {header!r}, {labels.describe(rows)}: {quoted} {verb}; {_suggest_number_format(texts)}"


def _suggest_number_format(texts: Sequence[str]) -> str:
    first = texts[0].strip() if len(texts) else ""
    if _DATE.search(first):
        return "write time as seconds from the start of the record"
    if _DECIMAL_COMMA.fullmatch(first):
        return "write decimal points, or ';' between the columns and no quotation marks"
    if _THOUSANDS.fullmatch(first):
        return "write the number without marks between its thousands"
    return "correct it, or leave the field empty if nothing was measured"
