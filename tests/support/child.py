"""A function in a process of its own, which may crash or be limited without harm to the run of the tests."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
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
