"""A file as named columns that are turned into numbers only when asked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from greybox.experiment.checks import SHOWN, Places, enumerated


class Table(Protocol):
    """What every reader hands over: the ``headers`` in the order of the file, and how its rows are called."""

    @property
    def headers(self) -> tuple[str, ...]:
        """One header for each column."""

    @property
    def places(self) -> Places:
        """How rows are called in messages."""

    def values(self, positions: Sequence[int]) -> tuple[dict[int, np.ndarray], list[str]]:
        """Columns (N,) as float64 with NaN for gaps, and problems; with problems the columns are not to be used."""


def not_numbers(header: str, rows: Sequence[int], texts: Sequence[str], places: Places) -> str:
    """Message for text in a number column; ``texts`` belong to the first of ``rows``."""
    quoted = enumerated([repr(t) for t in texts[:SHOWN]], len(rows))
    verb = "is not a number" if len(rows) == 1 else "are not numbers"
    remedy = "correct it, or leave the field empty if nothing was measured"
    return f"column {header!r}, {places.say(rows)}: {quoted} {verb}; {remedy}"
