"""The command `greybox`: a small file for each of its commands, heavy imports only where a command needs them."""

from __future__ import annotations

import gc
import signal
import sys
from io import TextIOWrapper
from typing import NoReturn

from greybox.base.errors import ExitCode


def main() -> None:
    """Run the command; the process ends with 0, 1 (no success), 2 (bad input) or 130 (Ctrl-C)."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a terminal that does not know a letter shows its number
            stream.reconfigure(errors="backslashreplace")
    # From here on: what is imported first takes a fifth of a second, in which Ctrl-C would show a traceback.
    before = signal.signal(signal.SIGINT, _exit_on_interrupt)
    # What a command makes is needed to its end; looking for garbage less often saves a tenth of its time.
    gc.set_threshold(50_000, *gc.get_threshold()[1:])
    try:
        from greybox.shell.commands import run

        run()
    finally:
        signal.signal(signal.SIGINT, before)


def _exit_on_interrupt(*_: object) -> NoReturn:
    sys.stderr.write("error: interrupted\n")
    raise SystemExit(ExitCode.INTERRUPTED)
