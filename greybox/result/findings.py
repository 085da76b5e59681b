"""Codes of what can be said of a result that was read; the sentences are in ``greybox.rendering.result``."""

from __future__ import annotations

from enum import StrEnum


class ResultCode(StrEnum):
    """Codes of the findings of a saved result."""

    FOREIGN_FINDING = "foreign_finding"
    """A finding in a file whose code or figures this version does not know."""
