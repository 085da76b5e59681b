"""Ctrl-C during a command: the search ends where it is, and what it has found is kept."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass
class Interrupt:
    """Whether Ctrl-C was ``requested`` for, and whether it still ``waits`` for the search to come by."""

    requested: bool = False
    waits: bool = False

    def pass_on(self) -> None:
        """Called from inside the search, which handles the signal itself: it stops after the present iteration."""
        if self.waits:
            self.waits = False
            signal.raise_signal(signal.SIGINT)


def treat_as_interrupts() -> None:
    """Take a request to end, as batch systems and ``kill`` send it, for Ctrl-C: what is finished is kept, workers end.

    A signal that is ignored stays ignored (``nohup``).
    """
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, lambda *_: signal.raise_signal(signal.SIGINT))


@contextmanager
def hold_interrupts() -> Iterator[Interrupt]:
    """Between two searches there is only work to lose, so Ctrl-C waits there. A second one ends at once."""
    state = Interrupt()
    if threading.current_thread() is not threading.main_thread():
        yield state
        return

    def ask(*_: object) -> None:
        if state.requested:
            raise KeyboardInterrupt
        state.requested = state.waits = True

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield state
    finally:
        signal.signal(signal.SIGINT, before)
