"""A line that says what a long command is doing; only on a terminal, and only after a second."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from greybox.cli.progress import PATIENCE

if TYPE_CHECKING:
    from rich.status import Status


@contextmanager
def ticker() -> Iterator[Callable[[str], None]]:
    """A function that shows a text in place of the last one; the line is gone at the end."""
    from rich.console import Console
    from rich.status import Status

    console = Console(stderr=True)
    status: Status | None = None
    began = time.monotonic()

    def show(text: str) -> None:
        nonlocal status
        if not console.is_terminal or time.monotonic() - began < PATIENCE:
            return
        if status is None:
            status = Status(text, console=console)
            status.start()
        status.update(text)

    try:
        yield show
    finally:
        if status is not None:
            status.stop()
