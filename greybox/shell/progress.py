"""How far a long command is, with the time left: on a terminal one line with a bar, after a second; else a plain line now and then."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

from greybox.shell.terminal import print_note

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from greybox.base.parallel.jobs import JobProgressCallback
    from greybox.estimation.transcription.problem import FitProgress, FitProgressCallback


class ShowProgress(Protocol):
    """Shows a text, and how much of the work is done."""

    def __call__(self, text: str, share: float | None = None) -> None:
        """``share`` from 0 to 1; None if unknown; then no remaining time is printed."""


# Seconds before the line appears: short commands stay quiet.
PROGRESS_PATIENCE = 1.0
# Seconds between two lines where there is no terminal: a log says that the command lives, and is not filled.
LINE_SECONDS = 10.0


class ProgressLine:
    """What the line says, and the time left by what the work done so far took; a ``silent`` one says nothing."""

    def __init__(self, silent: bool = False) -> None:
        from rich.console import Console

        self.console = Console(stderr=True)
        self.silent = silent
        self.began = self.written = time.monotonic()
        self.bar: Bar | None = None

    def __call__(self, text: str, share: float | None = None) -> None:
        """Show ``text``; with the ``share`` of the work that is done also the bar and the time left."""
        if self.silent:
            return
        now = time.monotonic()
        elapsed = now - self.began
        left = time_left(elapsed, share)
        remaining = "" if left is None else f"about {format_duration(left)} left"
        if not self.console.is_terminal:
            if now - self.written >= LINE_SECONDS:
                self.written = now
                print_note("; ".join(part for part in (text, f"{format_duration(elapsed)} so far", remaining) if part))
            return
        if elapsed < PROGRESS_PATIENCE:
            return
        if self.bar is None:
            self.bar = _bar(self.console)
            self.bar.start()
        self.bar.update(
            self.bar.task_ids[0],
            description=text,
            total=None if share is None else 1.0,
            completed=share or 0.0,
            left=remaining,
        )

    def stop(self) -> None:
        """Take the line away."""
        if self.bar is not None:
            self.bar.stop()


def _bar(console: object) -> Bar:
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=20),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
    )
    bar = Bar(*columns, console=console, transient=True)  # type: ignore[arg-type]
    bar.add_task("", total=None, left="")
    return bar


@contextmanager
def show_progress(silent: bool = False) -> Iterator[ShowProgress]:
    """A function that shows a text, and a share done, in place of the last one; the line is gone at the end."""
    line = ProgressLine(silent)
    try:
        yield line
    finally:
        line.stop()


@contextmanager
def show_fit_progress(title: str, silent: bool = False) -> Iterator[FitProgressCallback]:
    """A function to report a fit's progress to; the line is gone at the end."""
    with show_progress(silent) as show:
        yield report_fit(title, show)


def report_fit(title: str, show: ShowProgress) -> FitProgressCallback:
    """What a fit reports to: ``show`` is told where it is."""

    def report(progress: FitProgress) -> None:
        place = f"stage {progress.stage} of {progress.stages}, iteration {progress.iteration}"
        show(f"{title}: {place}, misfit {progress.noise_ratio:.4g} x noise", share_done(progress))

    return report


def report_starts(title: str, show: ShowProgress) -> JobProgressCallback:
    """What a search from several starts reports to."""
    return lambda done, jobs: show(f"{title}: {done} of {jobs} starts done", done / jobs)


# Iterations that a stage of a fit usually takes.
USUAL_ITERATIONS = 15


def share_done(progress: FitProgress) -> float | None:
    """Share of a fit that is done, from the usual duration of each stage; None where that is no forecast any more."""
    within = expected_share(max(progress.iteration, 0), USUAL_ITERATIONS)
    # Later stages run over more of the record: of the last one nothing is known from those before.
    is_last = progress.stages > 1 and progress.stage >= progress.stages
    return None if within is None or is_last else (progress.stage - 1 + within) / max(progress.stages, progress.stage)


# Share of what is usual up to which it forecasts how much is left: what is not done by then often takes several times as long, and the
# last second would be told for a minute.
FORECAST_SHARE = 0.5


def expected_share(done: int, usual: int) -> float | None:
    """Share that is done of what takes ``usual`` steps as a rule; None from half of them on, where nothing says how many are left."""
    return done / usual if done <= FORECAST_SHARE * usual else None


# Refits that a discovery usually takes.
USUAL_REFITS = 40


@contextmanager
def show_search_progress() -> Iterator[tuple[Callable[[str], None], Callable[[int], None]]]:
    """For a discovery: what to say, a line at a time, and what to tell after each refit; the line below them is gone at the end."""
    last = ""
    with show_progress() as show:

        def say(text: str) -> None:
            nonlocal last
            last = text.strip()
            print_note(text)
            show(last)

        def report(done: int) -> None:
            show(f"{last}; refit {done}", expected_share(done, USUAL_REFITS))

        yield say, report


# Share that must be done before the time left is shown: below it the extrapolation is a guess.
MINIMUM_SHARE = 0.02


def time_left(elapsed: float, share: float | None) -> float | None:
    """Seconds to go, if the rest goes on as the share that took ``elapsed`` seconds; None where too little is done to say."""
    if share is None or not MINIMUM_SHARE <= share <= 1:
        return None
    return elapsed * (1 - share) / share


def format_duration(seconds: float) -> str:
    """``8 s``, ``3 min``, ``1 h 20 min``."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
