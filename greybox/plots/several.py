"""Several pictures at a time: half of them in a copy of this process, where there is a core for it."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from greybox.parallel import count_cores

THREADS = Path("/proc/self/task")  # of this process, one entry each: Linux has it


def both(jobs: Sequence[Callable[[], None]]) -> None:
    """Do every job; every second one in a copy of this process, if it may be copied. An exception in a job is raised here.

    The jobs write files and nothing else: what they change in memory is lost with the copy.
    """
    copied = _copied() if len(jobs) > 1 else None
    if copied is None:
        for job in jobs:
            job()
        return
    if copied == 0:
        _end_after(jobs[1::2])
    failed = True
    try:
        for job in jobs[::2]:
            job()
    finally:
        failed = os.waitpid(copied, 0)[1] != 0
    if failed:
        for job in jobs[1::2]:  # here, where what is wrong can be told
            job()


def _copied() -> int | None:
    """The copy's number, or 0 in the copy itself; None where there is a single core, or threads that a copy would be without."""
    if count_cores() < 2 or not THREADS.is_dir() or len(list(THREADS.iterdir())) > 1:
        return None
    return os.fork()


def _end_after(jobs: Sequence[Callable[[], None]]) -> None:
    """Do the jobs and end this process, without what the first one does at its end."""
    code = 1
    try:
        for job in jobs:
            job()
        code = 0
    finally:
        os._exit(code)
