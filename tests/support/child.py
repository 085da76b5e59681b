"""Processes beside the run of the tests: a function in one of its own, which may crash or be limited without harm; whether one is alive."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any


def run_in_child(function: Callable[[], Any]) -> Any:
    """What ``function()`` gives in a forked process; the number of the signal (int) that ended it where one did.

    Raises RuntimeError with the text of an exception that came out of it.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        try:
            answer: tuple[str, Any] = ("result", function())
        except BaseException as error:
            answer = ("error", f"{type(error).__name__}: {error}")
        with os.fdopen(writing, "wb") as pipe:
            pickle.dump(answer, pipe)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        data = pipe.read()
    status = os.waitpid(child, 0)[1]
    if os.WIFSIGNALED(status):
        return os.WTERMSIG(status)
    kind, value = pickle.loads(data)
    if kind == "error":
        raise RuntimeError(value)
    return value


def is_alive(pid: int) -> bool:
    """Whether a process is at work: one that has ended and that nobody has asked for its status is not."""
    stat = Path(f"/proc/{pid}/stat")
    try:
        os.kill(pid, 0)
        return not Path("/proc/self/stat").exists() or stat.read_text().rpartition(")")[2].split()[0] != "Z"
    except (ProcessLookupError, FileNotFoundError):  # it may end between any two of these
        return False
