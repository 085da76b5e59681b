"""A line that says how far a long fit is; only on a terminal, and only after a second."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from greybox.cli.interrupt import Interrupt

if TYPE_CHECKING:
    from greybox.fitting.options import Progress, Report

PATIENCE = 1.0  # seconds before the line appears


@contextmanager
def meter(title: str, interrupt: Interrupt) -> Iterator[Report]:
    """A function to report progress to, which also hands on a waiting Ctrl-C; the line is gone at the end."""
    from rich.console import Console
    from rich.status import Status

    console = Console(stderr=True)
    status: Status | None = None
    began = time.monotonic()

    def report(progress: Progress) -> None:
        nonlocal status
        interrupt.pass_on()
        if not console.is_terminal or time.monotonic() - began < PATIENCE:
            return
        text = (
            f"{title}: stage {progress.stage} of {progress.stages}, iteration {progress.iteration},"
            f" misfit {progress.noise_ratio:.4g} x noise"
        )
        if status is None:
            status = Status(text, console=console)
            status.start()
        status.update(text)

    try:
        yield report
    finally:
        if status is not None:
            status.stop()
