"""The command `greybox`: a small file for each of its commands, heavy imports only where a command needs them."""

from __future__ import annotations

import gc
import signal
import sys
from typing import NoReturn

INTERRUPTED = 130
# New objects from which Python looks for garbage: what a command makes is needed to its end, and looking costs a tenth of its time.
GARBAGE_THRESHOLD = 50_000


def main() -> None:
    """Run the command; the process ends with 0, 1 (no success), 2 (bad input) or 130 (Ctrl-C)."""
    # From here on: what is imported first takes a fifth of a second, in which Ctrl-C would show a traceback.
    before = signal.signal(signal.SIGINT, _exit_on_interrupt)
    gc.set_threshold(GARBAGE_THRESHOLD, *gc.get_threshold()[1:])
    try:
        from greybox.cli.app import run

        run()
    finally:
        signal.signal(signal.SIGINT, before)


def _exit_on_interrupt(*_: object) -> NoReturn:
    sys.stderr.write("error: interrupted\n")
    raise SystemExit(INTERRUPTED)
