"""The kinds of files that records are read from, and what every one of them is guarded against.

A further format is one more `FileFormat`, found through an entry point of the group ``greybox.readers``: a function that opens a file as
a table of named columns. Its library is imported when a file of the kind is opened.
"""

from __future__ import annotations

import difflib
import logging
import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from greybox.base import DataError, Finding, GreyboxError, shorten
from greybox.base.errors import is_own_bug
from greybox.base.extensions import ExtensionKind, describe_failures, load_extensions
from greybox.data import channels, columns, text_table, time_base
from greybox.data.input_course import Hold
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.problems import enumerate_first
from greybox.data.stamps import StampKind, Stamps


@dataclass(frozen=True)
class FileFormat:
    """One kind of file.

    Attributes
    ----------
    name
        What messages call it.
    suffixes
        Endings of its files, in small letters.
    open
        Opens a file as a table; any exception of its library may come out.
    packages
        Package -> extra of this one that installs it, where one may be missing.
    remedy
        What to do about a file that is damaged.
    """

    name: str
    suffixes: tuple[str, ...]
    open: Callable[[Path, ReadingPolicy], columns.DataTable]
    remedy: str
    packages: tuple[tuple[str, str], ...] = ()


# The kind that needs no extension.
TEXT = FileFormat("text", (".csv", ".tsv", ".txt", ".dat"), text_table.read_text, "save it again as UTF-8")


@cache
def file_formats() -> tuple[FileFormat, ...]:
    """The kinds of files that can be read, text first: those of `ExtensionKind.READERS` follow."""
    return (TEXT, *load_extensions(ExtensionKind.READERS).values())


@cache
def record_suffixes() -> tuple[str, ...]:
    """Endings of the files that can be read, in the order in which messages list them."""
    return tuple(dict.fromkeys(suffix for kind in file_formats() for suffix in kind.suffixes))


# Endings of texts that hold no table: programs, studies, results, pages.
NO_TABLES = frozenset(
    (
        ".py",
        ".ipynb",
        ".toml",
        ".yaml",
        ".yml",
        ".ini",
        ".json",
        ".xml",
        ".html",
        ".htm",
        ".md",
        ".rst",
        ".c",
        ".h",
        ".mo",
        ".tex",
        ".svg",
    )
)


def find_format(file: Path) -> FileFormat | None:
    """The kind of a file: by its ending, or text where it has another ending (``.log``) or none and is one. None for no record."""
    suffix = file.suffix.lower()
    for kind in file_formats():
        if suffix in kind.suffixes:
            return kind
    return TEXT if suffix not in NO_TABLES and file.is_file() and text_table.is_text(file) else None


class ColumnValues(NamedTuple):
    """Position -> column of numbers, the problems met, what is to be said of clocks and rates; position -> column of dates, and
    the position of the column with the day of a time of day."""

    arrays: dict[int, np.ndarray]
    problems: list[str]
    findings: tuple[Finding, ...] = ()
    stamps: Mapping[int, Stamps] = MappingProxyType({})
    day: int | None = None


@dataclass(frozen=True)
class RecordFile:
    """A file that is there, opened as a table."""

    path: Path
    kind: FileFormat
    table: columns.DataTable = field(repr=False)

    def values(self, positions: Sequence[int], times: Sequence[int] = ()) -> ColumnValues:
        """Columns (N,) as float64 with NaN for gaps; those at ``times`` may hold dates instead. Raises DataError for a damaged file."""
        # A time of day belongs to the day that stands in a column beside it.
        days = [k for k, has_clock in self.table.dated.items() if not has_clock and k not in positions]
        beside = days[0] if len(days) == 1 and any(map(self.table.dated.get, times)) else None
        with _guarded(self.path, self.kind):
            columns, problems, *findings = self.table.values([*positions, *([] if beside is None else days)])
        stamps = {k: c for k, c in columns.items() if isinstance(c, Stamps)}
        day = None if beside is None else stamps.pop(beside, None)
        if day is not None and day.whole_days:
            clocks = [k for k in times if k in stamps and stamps[k].kind is StampKind.CLOCK]
            stamps |= {k: stamps[k].on_days(day) for k in clocks}
        problems += [
            f"column {shorten(self.table.headers[k])!r} holds dates{f' ({c.example})' if c.example else ''}; only the time can"
            for k, c in stamps.items()
            if k not in times
        ]
        arrays = {k: np.zeros(0) if isinstance(c, Stamps) else c for k, c in columns.items() if k != beside}
        return ColumnValues(arrays, problems, findings[0] if findings else (), stamps, beside)

    def rename(self, names: Sequence[str]) -> RecordFile:
        """The file with these names of its columns in the place of its own; ``-`` for one that is not wanted. Raises DataError."""
        with _guarded(self.path, self.kind):
            return replace(self, table=self.table.rename(["" if n.strip() == "-" else n.strip() for n in names]))

    def for_signals(
        self, match: columns.ColumnMatch, common: Hold, named: Mapping[str, Hold], step: float | None
    ) -> channels.ChannelTable:
        """The table of channels that knows which is which signal, as `ChannelTable.for_signals`. Raises DataError for a damaged file."""
        assert isinstance(self.table, channels.ChannelTable)
        # A course that the readings decide needs them.
        with _guarded(self.path, self.kind):
            return self.table.for_signals(match, common, named, step)

    def load_channel(self, index: int) -> time_base.Samples:
        """The samples of one channel of a file whose signals have stamps of their own. Raises DataError for a damaged file."""
        table = self.table
        assert isinstance(table, channels.ChannelTable)
        with _guarded(self.path, self.kind):
            columns.check_size(2 * table.channels[index].rows, 1, table.policy)
            return table.load([index])[index]


def open_record_file(path: str | os.PathLike[str], *, policy: ReadingPolicy = READING_POLICY) -> RecordFile:
    """Open a file of any known kind.

    Parameters
    ----------
    path
        The file.
    policy
        How large it may be.

    Raises
    ------
    DataError
        For a file that is missing (with the nearest names), of no known kind, empty, too large or damaged.
    """
    file = _find_file(Path(path))
    size = file.stat().st_size
    if not size:
        raise DataError(f"{file.name}: the file is empty; it needs a header line and rows of numbers")
    if size > policy.largest_file:
        raise DataError(
            f"{file.name}: {size / 1e6:.0f} MB, files of at most {policy.largest_file / 1e6:.0f} MB are read; cut the record, or raise"
            f" the limit {columns.raise_limit('largest_file')}"
        )
    kind = find_format(file)
    if kind is None:
        raise DataError(
            f"{file.name}: files of type {file.suffix or '(no suffix)'!r} cannot be read unless they are tables of text;"
            f" export it as one of {', '.join(record_suffixes())}{describe_failures(ExtensionKind.READERS)}"
        )
    with _guarded(file, kind):
        return RecordFile(file, kind, kind.open(file, policy))


def list_record_files(paths: Sequence[str | os.PathLike[str]]) -> list[Path]:
    """The files, and in the place of each folder the records in it, in the order of their names, numbers by their size.

    Raises DataError for a folder without a record.
    """
    files: list[Path] = []
    for path in map(Path, paths):
        if not path.is_dir():
            files.append(path)
            continue
        inside = sorted(
            (p for p in path.iterdir() if p.is_file() and p.suffix.lower() in record_suffixes()), key=_by_number
        )
        if not inside:
            raise DataError(f"{path}: a folder without records; give a folder with CSV, MAT or other record files")
        files += inside
    return files


def _by_number(path: Path) -> list[tuple[int, str]]:
    """A name in pieces, so that day 10 comes after day 9."""
    return [(int(piece), "") if piece.isdecimal() else (-1, piece) for piece in re.split(r"(\d+)", path.name)]


@contextmanager
def _guarded(file: Path, kind: FileFormat) -> Iterator[None]:
    """Whatever the library of a format raises, warns or logs becomes one sentence with the name of the file."""
    level = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except GreyboxError as error:
        text = str(error)
        raise DataError(text if text.startswith(f"{file.name}: ") else f"{file.name}: {text}") from error
    except ModuleNotFoundError as error:
        for package, extra in kind.packages:
            if package == (error.name or "").partition(".")[0]:
                raise DataError(
                    f"{file.name}: reading it needs the package {package}; install it with: pip install 'greybox-sysid[{extra}]', or"
                    " export the record as CSV"
                ) from error
        raise
    except PermissionError as error:
        raise DataError(f"{file}: cannot be read ({error.strerror})") from error
    except MemoryError as error:
        raise DataError(f"{file.name}: not enough memory to read it, or it is damaged; {kind.remedy}") from error
    # Of the library of a format, or of a stranger's reader, on bytes that it did not expect, in as many kinds as there are libraries.
    except Exception as error:
        if is_own_bug(error):
            raise
        reason = shorten(str(error), 120) or type(error).__name__
        raise DataError(f"{file.name}: not a readable {kind.name} file ({reason}); {kind.remedy}") from error
    finally:
        logging.disable(level)


def _find_file(file: Path) -> Path:
    if file.is_dir():
        raise DataError(f"{file} is a folder; give a file in it ({', '.join(record_suffixes())})")
    if file.exists() and not file.is_file():
        raise DataError(f"{file} is a pipe or a device; write what comes out of it to a file, and give that")
    if file.is_file():
        return file
    if not file.parent.is_dir():
        raise DataError(f"{file}: file not found, there is no folder {str(file.parent)!r}")
    beside = sorted(f.name for f in file.parent.iterdir() if f.suffix.lower() in record_suffixes() and f.is_file())
    close = difflib.get_close_matches(file.name, beside, n=3, cutoff=0.5)
    remedy = (
        f"did you mean {' or '.join(map(repr, close))}?"
        if close
        else f"records there: {enumerate_first(beside[:8], len(beside)) or 'none'}"
    )
    raise DataError(f"{file}: file not found; {remedy}")
