"""Codes of the findings of a journal; their sentences are in ``greybox.show.sentences.base``."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Generic, TypeVar

from greybox.base.errors import DataError
from greybox.base.files import append_line, cut_file, open_locked
from greybox.base.findings import Finding, Severity


class JournalCode(StrEnum):
    """Codes of the findings of a journal."""

    LAST_LINE_CUT = "journal_last_line_cut"
    LINES_SKIPPED = "journal_lines_skipped"


# A journal: what is finished, one JSON object a line, kept on the disk as it comes so that an interrupted run goes on.
#
# Several processes may add to one journal; each line is written under a lock that a dead process does not keep. A run that was
# killed, or a disk that was full, can leave a last line that is cut short: it is cut off when the journal is opened. Other lines
# that are no entries are skipped. Both are said.

Entry = TypeVar("Entry")


@dataclass(frozen=True)
class JournalContent(Generic[Entry]):
    """The entries of a journal, and what a reader should know about lines that are none."""

    entries: tuple[Entry, ...]
    findings: tuple[Finding, ...] = ()


def read_journal(path: Path, parse: Callable[[Mapping[str, Any]], Entry]) -> JournalContent[Entry]:
    """The entries of a journal; a last line that was cut short is cut off. No entries where there is no file yet.

    Parameters
    ----------
    path
        The file.
    parse
        Makes an entry of a JSON object; raises ValueError, KeyError, TypeError or another ordinary exception where it is none.

    Raises
    ------
    DataError
        If the file cannot be read, or is no journal: it has lines and none is an entry.
    """
    if not path.exists():
        return JournalContent(())
    if not path.is_file():
        raise DataError(f"{path}: not a file; delete it, or give another folder")
    entries: list[Entry] = []
    broken: dict[int, str] = {}
    findings: list[Finding] = []
    try:
        with open_locked(path) as file:
            *lines, tail = file.read().split(b"\n")
            end = file.tell() - len(tail)
            for number, line in enumerate([*lines, tail], 1):
                if not line.strip():
                    continue
                try:
                    entries.append(_parse_line(line, parse))
                except _NoEntryError as error:
                    broken[number] = str(error)
            if len(lines) + 1 in broken and tail.startswith(b"{"):
                del broken[len(lines) + 1]
                cut_file(file, end)
                findings.append(Finding(JournalCode.LAST_LINE_CUT, Severity.WARNING, path.name))
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}); give another folder") from error
    if broken and not entries:
        number, reason = next(iter(broken.items()))
        raise DataError(f"{path}: line {number} is not a journal entry ({reason}); delete the file to start again")
    if broken:
        values = {"lines": list(broken)[:5], "count": len(broken)}
        findings.append(Finding(JournalCode.LINES_SKIPPED, Severity.WARNING, path.name, values))
    return JournalContent(tuple(entries), tuple(findings))


def add_entry(path: Path, entry: Mapping[str, Any]) -> None:
    """Add one entry, on the disk when this returns. Raises OutputError."""
    append_line(path, json.dumps(entry))


class _NoEntryError(Exception):
    """A line of a journal that is no entry."""


def _parse_line(line: bytes, parse: Callable[[Mapping[str, Any]], Entry]) -> Entry:
    try:
        data = json.loads(line.decode())
        if not isinstance(data, dict):
            raise TypeError("not a JSON object")
        return parse(data)
    except Exception as error:  # of the decoder, of a number with thousands of digits, of a missing key ...
        raise _NoEntryError(f"{type(error).__name__}: {error}"[:100]) from error
