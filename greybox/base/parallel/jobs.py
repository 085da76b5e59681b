"""A list of independent jobs on many cores or many machines, through any `concurrent.futures.Executor`."""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from greybox.base.errors import GreyboxError, WorkersLostError, is_numerical
from greybox.base.interrupts import hold_interrupts
from greybox.base.packing import pack, unpack, unpack_shared
from greybox.base.parallel.cluster import DaskHealth, adopt_executor, open_cluster, watch_executor
from greybox.base.parallel.local_pool import LocalPool, count_cores, describe_version, open_local_pool


@dataclass(frozen=True)
class JobResult:
    """One job: its ``value``, or in ``error`` why there is none; ``seconds`` it took where it ran."""

    value: Any = None
    error: str = ""
    seconds: float = 0.0


JobProgressCallback = Callable[[int, int], None]
"""Called with the jobs that are finished and all jobs."""

JobResultCallback = Callable[[int, JobResult], None]
"""Called with the number of a job and its result."""


def run_jobs(
    job: Callable[[Any, Any], Any],
    common: Any,
    items: Sequence[Any],
    *,
    executor: Executor | None = None,
    workers: int = 0,
    report: JobProgressCallback | None = None,
    receive: JobResultCallback | None = None,
    deadline: float = math.inf,
) -> tuple[list[JobResult | None], bool]:
    """``job(common, item)`` for every item.

    Parameters
    ----------
    job
        What to do. What a model, a solver or a compiler raises in it is its result; any other error ends the run here.
    common
        What all jobs share; sent to each worker once.
    items
        What each job is about.
    executor
        Where to run, for example ``Client.get_executor()`` of Dask; None for processes of this machine.
    workers
        Processes of this machine, 0 for one on each core; with one the jobs run right here.
    report
        Called after each job with how many are finished.
    receive
        Called with the number of a job and its result as soon as it is there.
    deadline
        Value of ``time.perf_counter()`` after which no job begins; what runs elsewhere by then is given up.

    Returns
    -------
    list
        Results in the order of ``items``; None for a job that was not done. A worker that dies loses nothing that is finished: its
        job is tried again, see `RetryPolicy`.
    bool
        Whether Ctrl-C ended it early.

    Raises
    ------
    WorkersLostError
        If the cluster is lost or its workers are of another version, with what is finished.
    """
    workers = min(workers or count_cores(), max(len(items), 1))
    book = _Book(job, common, items, report, receive, deadline)
    try:
        if executor is not None:
            book.run_through(adopt_executor(executor))
        elif workers == 1:
            book.run_here()
        else:
            with open_local_pool(workers) as pool:
                book.run_through(pool)
    except KeyboardInterrupt:
        return book.results, True
    return book.results, False


@contextmanager
def open_workers(workers: int = 0, cluster: str = "") -> Iterator[Executor | None]:
    """Where jobs run: on the cluster at an address, or, with None, in processes of this machine. Raises GreyboxError."""
    if not cluster:
        yield None
        return
    with open_cluster(cluster, workers) as executor:
        yield executor


# A job whose worker died is tried once more, and then alone: only a job that kills its own worker is given up.
RETRY_TRIES = 2
# Seconds between looks at the jobs, so that Ctrl-C is heard.
WAKE_SECONDS = 0.5


class _Book:
    """Which jobs are done, and how often the others were tried."""

    def __init__(
        self,
        job: Callable[[Any, Any], Any],
        common: Any,
        items: Sequence[Any],
        report: JobProgressCallback | None,
        receive: JobResultCallback | None,
        deadline: float,
    ) -> None:
        self.job, self.common, self.items, self.report, self.receive = job, common, items, report, receive
        self.deadline = deadline
        self.results: list[JobResult | None] = [None] * len(items)
        self.tries = [0] * len(items)
        self.losses = [""] * len(items)
        self.done_by_workers = 0

    @property
    def open(self) -> list[int]:
        """Jobs without a result."""
        return [k for k, done in enumerate(self.results) if done is None]

    @property
    def is_late(self) -> bool:
        """Whether the time is over."""
        return time.perf_counter() >= self.deadline

    def enter(self, k: int, done: JobResult) -> None:
        """A result."""
        self.results[k] = done
        if self.receive:
            self.receive(k, done)
        if self.report:
            self.report(len(self.items) - len(self.open), len(self.items))

    def run_here(self) -> None:
        """All jobs one after the other in this process."""
        with hold_interrupts() as interrupt:
            for k in self.open:
                if self.is_late:
                    return
                self.enter(k, _run_timed(self.job, self.common, self.items[k]))
                if interrupt.requested:
                    raise KeyboardInterrupt

    def run_through(self, executor: Executor) -> None:
        """All jobs in workers; a job that was lost twice with its worker runs alone, and is given up if that kills its worker."""
        health = watch_executor(executor)
        while (pending := self.open) and not self.is_late:
            # Only a job that runs alone can be told from its neighbours as what kills a worker.
            suspects = [k for k in pending if self.tries[k] >= RETRY_TRIES]
            group = suspects[:1] or pending
            self.submit(executor, group, health)
            if suspects and self.results[group[0]] is None:
                alone = "process died, also when it ran alone (out of memory?)"
                reason = alone if isinstance(executor, LocalPool) else "died, or the executor broke"
                self.enter(group[0], JobResult(error=f"its worker {reason}: {self.losses[group[0]]}"))

    def submit(self, executor: Executor, group: Sequence[int], health: DaskHealth | None) -> None:
        """Run some jobs. Those that were lost with their workers have no result, and one more try."""
        payload = pack((self.job, self.common))
        waiting: dict[Future, int] = {}
        try:
            for k in group:
                item = pack(self.items[k])
                # A user's executor, which may be broken or closed while jobs are still handed out, in errors of its own.
                try:
                    waiting[executor.submit(_work, describe_version(), payload, item)] = k
                except Exception as error:
                    self.lose(k, error)
            while waiting and not self.is_late:
                finished, _ = wait(waiting, timeout=WAKE_SECONDS, return_when=FIRST_COMPLETED)
                for future in finished:
                    self.take(waiting.pop(future), future, is_alone=len(group) == 1)
                self.check(health, waiting)
            self.check(health, waiting)
            for future in waiting:  # too late for them
                future.cancel()
        except WorkersLostError:  # nobody is there who could be told to stop
            raise
        except BaseException:  # raised again
            if not isinstance(executor, LocalPool):  # its processes are ended
                for future in waiting:
                    future.cancel()
            raise

    def take(self, k: int, future: Future, is_alone: bool) -> None:
        """What came of a job, which ``is_alone`` or ran beside others. Raises WorkersLostError where workers cannot do any job."""
        # Jobs return their exceptions: an error here is the executor's, or says that the worker cannot read the job.
        try:
            packed = future.result()
        except Exception as error:
            self.lose(k, error)
            if type(error).__name__ == "KilledWorker":
                # Dask tried it several times, but counts the deaths by its neighbours as well: it is tried alone.
                self.tries[k] = RETRY_TRIES
                if is_alone:
                    self.enter(
                        k,
                        JobResult(error=f"its worker died again and again, also when it ran alone ({self.losses[k]})"),
                    )
            return
        result = unpack(packed)
        if isinstance(result, _OtherVersion):
            fault = f"a worker has {result.version}, and this process {describe_version()}; install the same version on both"
            raise WorkersLostError(fault, self.results)
        if isinstance(result, _Bug):
            raise result.error from RuntimeError(f"in a worker:\n{result.trace}")
        self.done_by_workers += 1
        self.enter(k, result)

    def lose(self, k: int, error: Exception) -> None:
        """A job was lost with its worker."""
        self.tries[k] += 1
        self.losses[k] = f"{type(error).__name__}: {error}"[:200]

    def check(self, health: DaskHealth | None, waiting: Collection[Future]) -> None:
        """Raise WorkersLostError where waiting is in vain."""
        fault = health.find_fault(self.done_by_workers, is_alone=len(waiting) <= 1) if health else ""
        if fault and self.open:
            raise WorkersLostError(f"the cluster is given up, {fault}", self.results)


@dataclass(frozen=True)
class _OtherVersion:
    """What a worker of another version answers."""

    version: str


@dataclass(frozen=True)
class _Bug:
    """What a worker answers whose job raised an error that no model, solver or compiler does, with where it was."""

    error: Exception
    trace: str


def _work(version: str, payload: bytes, item: bytes) -> bytes:
    """One job, where it runs."""
    if version != describe_version():
        return pack(_OtherVersion(describe_version()))
    job, common = unpack_shared(payload)
    try:
        return pack(_run_timed(job, common, unpack(item)))
    except Exception as error:  # raised again where the results are collected
        return pack(_Bug(error, traceback.format_exc()))


def _run_timed(job: Callable[[Any, Any], Any], common: Any, item: Any) -> JobResult:
    began = time.perf_counter()
    try:
        return JobResult(job(common, item), "", time.perf_counter() - began)
    except Exception as error:
        if not is_numerical(error):
            raise
        text = str(error) if isinstance(error, GreyboxError) else f"{type(error).__name__}: {error}"
        return JobResult(None, text, time.perf_counter() - began)
