"""How large a JSON file may be."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class JsonPolicy:
    """Limits that hold before a file is read."""

    largest_file: int = 1_000_000_000
    """Bytes of a file: the fit of a record of ten million rows."""


JSON_POLICY = JsonPolicy()
