"""A fit or a discovery in a process of its own: it tells how far it is, and can be stopped without losing what it has.

The process ends with the one that started it, however that ends.
"""

from __future__ import annotations

import _thread
import math
import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from multiprocessing.connection import Connection
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

from greybox.base import GreyboxError
from greybox.base.packing import pack, unpack
from greybox.base.parallel.local_pool import quiet_children
from greybox.estimation.options import FitOptions
from greybox.extensions.app.session import Session
from greybox.shell.own_effects import find_own_effects


class JobKind(StrEnum):
    """What is computed."""

    FIT = "fit"
    DISCOVER = "discover"


class JobNews(StrEnum):
    """What a process has to say."""

    PROGRESS = "progress"
    MESSAGE = "message"
    REFIT = "refit"
    DONE = "done"
    STOPPED = "stopped"
    FAILED = "failed"


LAST_NEWS = (JobNews.DONE, JobNews.STOPPED, JobNews.FAILED)
"""After which nothing comes."""


@dataclass(frozen=True, eq=False)
class JobEvent:
    """One piece of news, with what it says: figures of the progress, a text, a result."""

    news: JobNews
    content: Any = None


JobListener = Callable[[JobEvent], None]


# Seconds in which a fit or a discovery that is told to end at once may do so by itself, before its process is killed.
APP_GRACE_SECONDS = 3.0


class Job:
    """A running fit or discovery.

    Parameters
    ----------
    kind
        Which of them.
    session
        Model, records and options.
    journal
        Where a discovery keeps its finished refits.
    workers
        Processes that a discovery may use; 0 for one a core.
    listener
        Called with every event, in a thread of the job; the last one is done, stopped or failed.
    """

    def __init__(
        self, kind: JobKind, session: Session, *, journal: Path, workers: int = 0, listener: JobListener
    ) -> None:
        self.kind, self.session = kind, session
        self._listener = listener
        self._stops = 0
        # A process that begins empty: a fork would take the threads' locks of the server with it.
        context = multiprocessing.get_context("spawn")
        self._connection, far_end = context.Pipe()
        # What `greybox.fit` is called with, or `greybox.discover` as the command of that name calls it.
        arguments: dict[str, Any] = {
            "model": session.model_to_fit if kind is JobKind.FIT else session.model,
            "records": session.estimation,
            "validation": session.validation,
            "noise": dict(session.noise),
            "quiet": session.quiet,
            "skip": session.skip,
            "beginning": session.beginning,
            "options": session.options,
        }
        if kind is JobKind.DISCOVER:
            options = FitOptions(at_rest=session.options.at_rest)
            arguments |= {"options": options, "journal": journal, "workers": workers, "beside": find_own_effects()}
        payload = pack(arguments)
        self._process = context.Process(target=_run, args=(far_end, kind, payload))
        with quiet_children():
            self._process.start()
        # Its other end belongs to the process alone: so it reads an end of file where that is gone.
        far_end.close()
        self._reader = threading.Thread(target=self._listen, daemon=True)
        self._reader.start()

    def stop(self) -> None:
        """Ask it to end: a fit keeps its best point, a discovery its finished refits. Asked again, it ends at once."""
        self._stops += 1
        if self._stops > 1:
            self.end()
            return
        try:
            self._connection.send("stop")
        except OSError:  # it has ended meanwhile
            return

    def end(self) -> None:
        """End the process now."""
        if self._process.is_alive():
            # First as somebody who asks; a process inside a compiled solver may not hear it.
            self._process.terminate()
            self._process.join(APP_GRACE_SECONDS)
        if self._process.is_alive():
            self._process.kill()
        self._process.join()

    def join(self, seconds: float) -> None:
        """Wait until its last news has been told."""
        self._reader.join(seconds)

    def _listen(self) -> None:
        # The last news is told when the process is gone, so that the next one may begin.
        last: JobEvent | None = None
        while last is None:
            try:
                news, content = self._connection.recv()
            except (EOFError, OSError, ValueError, UnpicklingError):  # gone, or cut short while it was telling
                self.end()
                # Silence after a request to stop is its answer; without one the process has crashed.
                news, content = (JobNews.STOPPED, None) if self._stops else (JobNews.FAILED, "")
            # A result comes packed: only one of this program's own processes can have sent it.
            event = JobEvent(JobNews(news), unpack(content) if news == JobNews.DONE else content)
            if event.news in LAST_NEWS:
                last = event
            else:
                self._listener(event)
        self._process.join(APP_GRACE_SECONDS)
        self._listener(last)


def _run(connection: Connection, kind: JobKind, payload: bytes) -> None:
    """The process: compute, tell, end."""
    stop = threading.Event()
    news: JobNews
    content: bytes | str | None
    try:
        # Requests are heard beside the computation, which does not return until it is done. One may come as soon as this thread listens.
        threading.Thread(target=_hear, args=(connection, stop, kind is JobKind.DISCOVER), daemon=True).start()
        arguments = unpack(payload)
        compute = _fit if kind is JobKind.FIT else _discover
        news, content = JobNews.DONE, pack(compute(connection, stop, **arguments))
    except KeyboardInterrupt:
        news, content = JobNews.STOPPED, None
    except GreyboxError as error:
        news, content = JobNews.FAILED, str(error)
    # A bug ends this process with all of it on the terminal, and the page must hear that.
    except Exception as error:
        traceback.print_exc(file=sys.stderr)
        news, content = JobNews.FAILED, f"{type(error).__name__}: {error}"
    connection.send((str(news), content))


def _hear(connection: Connection, stop: threading.Event, interrupts: bool) -> None:
    """Wait for a request to stop; end where the process that asked for the work is gone."""
    try:
        connection.recv()
    except (EOFError, OSError):
        os._exit(1)
    # Whoever asked is there: the first message is a request to stop.
    stop.set()
    # A fit looks at the request after each iteration; a discovery is interrupted wherever it is.
    if interrupts:
        _thread.interrupt_main()
    try:
        connection.recv()
    except (EOFError, OSError):
        os._exit(1)


def _fit(connection: Connection, stop: threading.Event, model: Any, records: Any, **options: Any) -> Any:
    from greybox.estimation.fit import fit
    from greybox.estimation.transcription.problem import FitProgress

    passed_on = False

    def report(progress: FitProgress) -> None:
        nonlocal passed_on
        ratio = progress.noise_ratio
        figures = {
            "stage": progress.stage,
            "stages": progress.stages,
            "iteration": max(progress.iteration, 0),
            "noise_ratio": ratio if math.isfinite(ratio) else None,
        }
        connection.send((str(JobNews.PROGRESS), figures))
        if stop.is_set() and not passed_on:
            passed_on = True
            signal.raise_signal(signal.SIGINT)  # heard by the search itself, which ends with its best point

    return fit(model, records, report=report, **options)


def _discover(connection: Connection, stop: threading.Event, model: Any, records: Any, **options: Any) -> Any:
    from greybox.discovery.pipeline import discover

    def tell(news: JobNews, content: Any) -> None:
        connection.send((str(news), content))
        if stop.is_set():  # an interrupt that arrives inside a callback of a library is lost
            raise KeyboardInterrupt

    return discover(
        model,
        records,
        on_message=lambda text: tell(JobNews.MESSAGE, text.strip()),
        on_refit=lambda count: tell(JobNews.REFIT, count),
        **options,
    )
