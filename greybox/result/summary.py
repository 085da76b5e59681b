"""Numbers and tables in plain text, for results whose text is not yet in `greybox.rendering`."""

from __future__ import annotations

from collections.abc import Sequence


def format_number(value: float, digits: int = 5) -> str:
    """A number for people: ``digits`` significant digits, short."""
    return f"{value:.{digits}g}"


def format_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table, indented by two; each column as wide as it must be."""
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    return [
        "  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in [head, *rows]
    ]
