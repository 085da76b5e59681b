"""Codes of the findings of a journal; their sentences are in ``greybox.rendering.journal``."""

from __future__ import annotations

from enum import StrEnum


class JournalCode(StrEnum):
    """Codes of the findings of a journal."""

    LAST_LINE_CUT = "journal_last_line_cut"
    LINES_SKIPPED = "journal_lines_skipped"
