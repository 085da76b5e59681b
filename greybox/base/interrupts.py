"""Ctrl-C while work is under way: it is noted, and heard where the work can end.

What a signal's handler raises arrives wherever the program happens to be. Inside a callback of a library, or while an object is deleted, it
is lost; inside CasADi, which asks Python objects whether they are numbers, it is taken for *no*, and the call gives something else than it
was asked for. So nothing is raised: a search stops after its present iteration, and what is between two searches comes to the next one,
or to its end, first. Whoever cannot wait presses a second time.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol


class Stoppable(Protocol):
    """Something that looks at its flag from time to time."""

    stop: bool


class HeldInterrupt:
    """A handler of Ctrl-C that notes whether it was ``requested``, and asks a ``search`` to stop; the second one ends at once.

    What is noted inside is noted around it, in the handler ``before`` this one; what was noted there is heard inside at once.
    """

    def __init__(self, before: Any = None, search: Stoppable | None = None) -> None:
        self.requested = False
        self._around = before if isinstance(before, HeldInterrupt) else None
        self._search = search
        if self._around is not None and self._around.requested:
            self._note()

    def __call__(self, *_: object) -> None:
        """As Python calls a handler. Raises KeyboardInterrupt the second time."""
        if self.requested:
            raise KeyboardInterrupt
        self._note()

    def _note(self) -> None:
        self.requested = True
        if self._search is not None:
            self._search.stop = True
        if self._around is not None and not self._around.requested:
            self._around._note()


@contextmanager
def hold_interrupts(search: Stoppable | None = None) -> Iterator[HeldInterrupt]:
    """Within it Ctrl-C is only noted, once; a ``search`` is asked to stop (its ``stop`` is set).

    Only in the main thread: elsewhere signals are not ours. One that is ignored, or heard outside of Python, stays as it is.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield HeldInterrupt()
        return
    held = HeldInterrupt(before, search)
    signal.signal(signal.SIGINT, held)
    try:
        yield held
    finally:
        signal.signal(signal.SIGINT, before)
