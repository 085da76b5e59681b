"""The table of `docs/studies/reliability.md`: what was tried, how often, and what failed. Studies write rows, and read sizes."""

from __future__ import annotations

import os
import re
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "studies" / "reliability.md"
SIZE, WRITE = "RELIABILITY_SIZE", "RELIABILITY_WRITE"


def size_of(usual: int) -> int:
    """How many trials a study makes: its usual number times the factor in the environment variable RELIABILITY_SIZE."""
    return max(1, round(usual * float(os.environ.get(SIZE, "1"))))


def note_row(what: str, tried: int, failed: int, figures: str, page: Path = PAGE) -> None:
    """Put a row into the table of the page, in the place of an older one, if the environment variable RELIABILITY_WRITE is set."""
    if not os.environ.get(WRITE):
        return
    text = page.read_text(encoding="utf-8")
    row = f"| {what} | {tried} | {failed} | {figures} |"
    pattern = re.compile(rf"^\| {re.escape(what)} \|.*$", re.MULTILINE)
    text = pattern.sub(lambda _: row, text) if pattern.search(text) else f"{text.rstrip()}\n{row}\n"
    page.write_text(text, encoding="utf-8")
