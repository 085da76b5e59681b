"""Writing files: whole, or not at all; journals line by line. Every file goes through `write_file` or `append_line`.

A result replaces the one before it only when all of it is on the disk. A full disk, a folder that cannot be written, a killed
process or a power cut leave the file as it was.
"""

from __future__ import annotations

import contextlib
import errno
import filecmp
import hashlib
import itertools
import json
import os
import secrets
import stat
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import IO, Any, BinaryIO, Generic, TypeVar

from greybox.base.errors import DataError, GreyboxError, OutputError
from greybox.base.values import Finding, Severity

if sys.platform != "win32":
    import fcntl

# Name of a file that is being written, in the folder of the one it will replace; short enough beside any name.
PART = ".greybox-{}.part"

# A part that nobody has written to for so long belongs to a process that was killed.
LEFTOVER_SECONDS = 3600.0

# Permissions of a file for one user.
PRIVATE = stat.S_IRUSR | stat.S_IWUSR


# Files written since `watch_replaced` began, and the digest of what each held before; "" where it was not there or held the same.
_watched: ContextVar[dict[Path, str] | None] = ContextVar("watched", default=None)


@contextlib.contextmanager
def watch_replaced() -> Iterator[dict[Path, str]]:
    """The block whose files are watched: what is yielded holds the digest of what stood there before each, "" where that was the same."""
    watched: dict[Path, str] = {}
    token = _watched.set(watched)
    try:
        yield watched
    finally:
        _watched.reset(token)


# Written files of which is remembered what they held, those of some hundred commands; and where, in the folder of the cache.
MOST_REMEMBERED = 500
OUTPUTS_FOLDER = "outputs"


def list_foreign(written: Mapping[Path, str], command: str, memory: Path) -> list[Path]:
    """Of files that were ``written`` over something else those that were no earlier output of the same ``command``.

    ``written``: as `watch_replaced` gives it. What they hold now is kept in the folder ``memory``, each in a file of its own: commands that
    run at the same time forget nothing of each other. A file that is lost or damaged remembers nothing.
    """
    asked = _abbreviate(command)
    foreign = [path for path, before in written.items() if before and _recall(path, memory) != [before, asked]]
    with contextlib.suppress(OSError):
        memory.mkdir(parents=True, exist_ok=True)
        for path in written:
            if path.is_file():
                write_file(_find_memory(path, memory), f"{compute_digest(path)} {asked}", private=True)
        for old in sorted(memory.iterdir(), key=lambda entry: entry.stat().st_mtime_ns)[:-MOST_REMEMBERED]:
            old.unlink(missing_ok=True)
    return foreign


def is_output_of(path: Path, command: str, memory: Path) -> bool:
    """Whether a file holds what ``command`` wrote there, by what `list_foreign` keeps in ``memory``."""
    return _recall(path, memory) == [compute_digest(path), _abbreviate(command)]


def _find_memory(path: Path, memory: Path) -> Path:
    """The file in ``memory`` that remembers ``path``."""
    return memory / _abbreviate(os.path.realpath(path))


def _recall(path: Path, memory: Path) -> list[str]:
    """What a file held, and the command that wrote it; empty where that is not known."""
    with contextlib.suppress(OSError, ValueError):
        return _find_memory(path, memory).read_text(encoding="utf-8").split()
    return []


def _abbreviate(text: str) -> str:
    # A name of a file may hold what is no text.
    return hashlib.sha256(text.encode(errors="backslashreplace")).hexdigest()[:16]


def compute_digest(path: Path) -> str:
    """16 hex digits of the SHA-256 of what a file holds."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def write_file(
    path: str | os.PathLike[str],
    content: str | bytes | Iterable[str] | Callable[[BinaryIO], object],
    *,
    private: bool = False,
) -> Path:
    """Write a file so that it holds all of ``content``, or what it held before.

    Parameters
    ----------
    path
        The file; missing folders are made. A link keeps pointing to its target, which is replaced. A device or a pipe
        is written to as it is.
    content
        Text (written as UTF-8), bytes, parts of a text, or a function that writes to the binary file it is given.
    private
        For the eyes of this user alone. Else the permissions of the file that was there stay.

    Returns
    -------
    Path
        ``path``.

    Raises
    ------
    OutputError
        If the file cannot be written, with the name of the file. What was there stands.
    """
    target = Path(path)
    final = Path(os.path.realpath(target))
    part: Path | None = None
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        mode = final.stat().st_mode if final.exists() else None
        if mode is not None and not stat.S_ISREG(mode):
            if stat.S_ISDIR(mode):
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            with open(final, "wb") as device:
                _fill(device, content)
            return target
        if mode is not None and not os.access(final, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        # What killed processes left behind.
        with contextlib.suppress(OSError):  # not there, not ours, or gone meanwhile
            for old in final.parent.glob(PART.format("*")):
                if time.time() - old.stat().st_mtime > LEFTOVER_SECONDS:
                    old.unlink()
        part = final.parent / PART.format(secrets.token_hex(8))
        with open(part, "xb") as file:
            if private or mode is not None:
                with contextlib.suppress(OSError):  # a file system without modes
                    os.chmod(part, PRIVATE if private else stat.S_IMODE(mode or 0))
            _fill(file, content)
            file.flush()
            os.fsync(file.fileno())
        # Of a file that is written twice in the block the first content counts: the second is no older one.
        if (watched := _watched.get()) is not None and target not in watched:
            is_other = mode is not None and not filecmp.cmp(part, final, shallow=False)
            watched[target] = compute_digest(final) if is_other else ""
        # On Windows another program may hold the old file for a moment.
        for pause in (0.05, 0.2, 1.0, 0.0) if sys.platform == "win32" else (0.0,):
            try:
                os.replace(part, final)
                break
            except PermissionError:
                if not pause:
                    raise
                time.sleep(pause)
        part = None
        # The renaming itself goes to the disk as well, where the system can.
        if sys.platform != "win32":
            with contextlib.suppress(OSError):  # some file systems refuse to sync a folder
                descriptor = os.open(final.parent, os.O_RDONLY)
                try:
                    os.fsync(descriptor)
                finally:
                    os.close(descriptor)
    except OSError as error:
        if isinstance(error, BrokenPipeError):  # the reader of the pipe has gone, which is no fault of the file
            raise
        raise OutputError(error.errno, error.strerror or str(error), str(target)) from error
    except UnicodeEncodeError as error:
        raise OutputError(errno.EILSEQ, f"a text in it is not valid Unicode: {error.reason}", str(target)) from error
    finally:
        if part is not None:
            with contextlib.suppress(OSError):
                part.unlink()
    return target


# Names that Windows keeps for devices, whatever their ending; a folder may be copied there.
DEVICE_NAMES = frozenset({"con", "prn", "aux", "nul", *(f"{port}{k}" for port in ("com", "lpt") for k in range(10))})


def find_free_path(path: Path, like: Path | None = None, taken: Collection[Path] = ()) -> Path:
    """``path``, or ``name-2``, ``name-3`` beside it: the first that is not there, not ``taken``, or holds already what ``like`` holds."""
    stem = f"{path.stem}_" if path.stem.partition(".")[0].strip().lower() in DEVICE_NAMES else path.stem
    for count in itertools.count(1):
        target = path.with_name(f"{stem}{f'-{count}' if count > 1 else ''}{path.suffix}")
        # A link that leads nowhere is there, too: whoever writes to it writes somewhere else.
        is_there = os.path.lexists(target)
        is_same = like is not None and target.is_file() and filecmp.cmp(target, like, shallow=False)
        if target not in taken and (not is_there or is_same):
            return target
    raise AssertionError("there is no end of numbers")


def append_line(path: str | os.PathLike[str], line: str) -> None:
    """Add a line to the end of a file that several processes may add to; on the disk when this returns.

    A last line that was cut short stays a line by itself: whoever reads the file can skip it.

    Raises
    ------
    OutputError
        If the line cannot be written; then nothing of it is left.
    """
    target = Path(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with open(target, "a+b", buffering=0) as file, locked(file):
            end = file.seek(0, os.SEEK_END)
            data = line.encode() + b"\n"
            if end:
                file.seek(end - 1)
                data = data if file.read(1) == b"\n" else b"\n" + data
            try:
                if file.write(data) != len(data):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                os.fsync(file.fileno())
            except BaseException:  # raised again
                with contextlib.suppress(OSError):
                    os.ftruncate(file.fileno(), end)
                raise
    except OSError as error:
        raise OutputError(error.errno, error.strerror or str(error), str(target)) from error


@contextlib.contextmanager
def locked(file: IO[bytes]) -> Iterator[None]:
    """The block in which this process alone writes to ``file``. The system takes the lock from a process that has died.

    Without effect where the system has no such locks.
    """
    if sys.platform == "win32":
        yield
        return
    held = False
    with contextlib.suppress(OSError):  # some network folders have no locks
        fcntl.flock(file, fcntl.LOCK_EX)
        held = True
    try:
        yield
    finally:
        if held:
            fcntl.flock(file, fcntl.LOCK_UN)


@contextlib.contextmanager
def hold_file(path: str | os.PathLike[str]) -> Iterator[BinaryIO | None]:
    """A file that this process alone holds until the block ends; None where another does.

    A program that inherits the open file holds it as long as it runs, also when this process was killed. The file stays, empty.
    Without effect where the system has no such locks.

    Raises
    ------
    OutputError
        If the file cannot be made.
    """
    target = Path(path)
    with contextlib.ExitStack() as stack:
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(open(target, "ab"))
        except OSError as error:
            raise OutputError(error.errno, error.strerror or str(error), str(target)) from error
        if sys.platform != "win32":
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                yield None
                return
            except OSError:  # some network folders have no locks
                pass
        yield file


def _fill(file: BinaryIO, content: str | bytes | Iterable[str] | Callable[[BinaryIO], object]) -> None:
    if callable(content):
        content(file)
    elif isinstance(content, str | bytes):
        file.write(content.encode() if isinstance(content, str) else content)
    else:
        for part in content:
            file.write(part.encode())


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


# What reading a line raises that is no entry: of the decoder (text, JSON, its depth), and of a parser that meets other keys or types. Any
# other error is a bug, and must not pass for a damaged file that a person is told to delete.
NO_ENTRY = (GreyboxError, ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError)


def read_journal(path: Path, parse: Callable[[Mapping[str, Any]], Entry]) -> JournalContent[Entry]:
    """The entries of a journal; a last line that was cut short is cut off. No entries where there is no file yet.

    Parameters
    ----------
    path
        The file.
    parse
        Makes an entry of a JSON object; raises one of `NO_ENTRY` where it is none.

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
        # Nobody adds a line while the file is read, and a last one that was cut short cut off.
        with open(path, "r+b") as file, locked(file):
            *lines, tail = file.read().split(b"\n")
            end = file.tell() - len(tail)
            for number, line in enumerate([*lines, tail], 1):
                if not line.strip():
                    continue
                try:
                    data = json.loads(line.decode())
                    if not isinstance(data, dict):
                        raise TypeError("not a JSON object")
                    entries.append(parse(data))
                except NO_ENTRY as error:
                    broken[number] = f"{type(error).__name__}: {error}"[:100]
            if len(lines) + 1 in broken and tail.startswith(b"{"):
                del broken[len(lines) + 1]
                file.truncate(end)
                os.fsync(file.fileno())
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
