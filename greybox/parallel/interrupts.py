"""Ctrl-C between jobs that run one after the other."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def note_interrupts() -> Iterator[Callable[[], bool]]:
    """Tells whether Ctrl-C came meanwhile; what it does otherwise stays as it is.

    What its handler raises is lost where the signal arrives inside a callback of a library, or while an object is deleted. The work would
    go on as if nobody had asked for an end.
    """
    before = signal.getsignal(signal.SIGINT)
    noted = threading.Event()
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield noted.is_set
        return

    def note(number: int, frame: FrameType | None) -> None:
        noted.set()
        before(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield noted.is_set
    finally:
        signal.signal(signal.SIGINT, before)
