"""A list of independent jobs on many cores or many machines, through any `concurrent.futures.Executor`.

A model is made of functions, often lambdas, which `pickle` refuses; `cloudpickle` (small, and what Dask itself uses) sends
them by value, so a worker needs greybox but not the user's project. CasADi expressions are not sent: a model is stated anew
where it arrives.
"""

from __future__ import annotations

import io
import multiprocessing
import os
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import lru_cache
from types import MappingProxyType, ModuleType
from typing import Any

import cloudpickle

from greybox.errors import GreyboxError
from greybox.model import Model

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


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


@dataclass(frozen=True)
class RetryPolicy:
    """What happens to a job whose worker dies, and how often jobs are looked at."""

    tries: int = 2
    """A job whose worker died is tried once more, and then alone: only a job that kills its own worker is given up."""

    wake_seconds: float = 0.5
    """Seconds between looks at the jobs, so that Ctrl-C is heard."""


RETRY_POLICY = RetryPolicy()


def run_jobs(
    job: Callable[[Any, Any], Any],
    common: Any,
    items: Sequence[Any],
    *,
    executor: Executor | None = None,
    workers: int = 0,
    report: JobProgressCallback | None = None,
    receive: JobResultCallback | None = None,
) -> tuple[list[JobResult | None], bool]:
    """``job(common, item)`` for every item; results in the order of ``items``, and whether Ctrl-C ended it early (None: not done).

    ``executor``: where to run, for example ``Client.get_executor()`` of Dask; None for processes of this machine, ``workers`` of
    them (0: one for each core; with one the jobs run right here). An exception in a job is its result. A worker that dies
    loses nothing that is finished: its job is tried again, see `RetryPolicy`. ``report`` is called after each job, ``receive`` with
    its number and its result as soon as it is there.
    """
    workers = min(workers or count_cores(), max(len(items), 1))
    book = _Book(job, common, items, report, receive)
    try:
        if executor is not None:
            book.through(executor)
        elif workers == 1:
            book.here()
        else:
            with _quiet_children():
                book.locally(workers)
    except KeyboardInterrupt:
        return book.results, True
    return book.results, False


@contextmanager
def open_local_pool(workers: int) -> Iterator[Executor]:
    """Processes of this machine for several calls of `run`, with one BLAS thread each; ended with the block."""
    with _quiet_children(), ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        yield pool


def count_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Book:
    """Which jobs are done, and how often the others were tried."""

    def __init__(
        self,
        job: Callable[[Any, Any], Any],
        common: Any,
        items: Sequence[Any],
        report: JobProgressCallback | None,
        receive: JobResultCallback | None,
    ) -> None:
        self.job, self.common, self.items, self.report, self.receive = job, common, items, report, receive
        self.results: list[JobResult | None] = [None] * len(items)
        self.tries = [0] * len(items)

    @property
    def open(self) -> list[int]:
        """Jobs without a result."""
        return [k for k, done in enumerate(self.results) if done is None]

    def enter(self, k: int, done: JobResult) -> None:
        """A result."""
        self.results[k] = done
        if self.receive:
            self.receive(k, done)
        if self.report:
            self.report(len(self.items) - len(self.open), len(self.items))

    def here(self) -> None:
        """All jobs one after the other in this process."""
        for k in self.open:
            self.enter(k, _timed(self.job, self.common, self.items[k]))

    def locally(self, workers: int) -> None:
        """Local processes; a pool that broke is replaced, and who was in it twice runs alone."""
        while pending := self.open:
            suspects = [k for k in pending if self.tries[k] >= RETRY_POLICY.tries]
            group = suspects[:1] or pending
            with ProcessPoolExecutor(1 if suspects else workers, multiprocessing.get_context("spawn")) as pool:
                broken = self.submit(pool, group)
            if broken and suspects:
                self.enter(
                    group[0], JobResult(error="its worker process died, also when it ran alone (out of memory?)")
                )

    def through(self, executor: Executor) -> None:
        """An executor from outside, which is not ours to replace."""
        while pending := self.open:
            if self.submit(executor, pending):
                for k in self.open:
                    if self.tries[k] >= RETRY_POLICY.tries:
                        self.enter(k, JobResult(error="its worker died, or the executor broke"))

    def submit(self, executor: Executor, group: Sequence[int]) -> bool:
        """Run some jobs; whether any of them was lost with its worker."""
        payload = _packed((self.job, self.common))
        waiting: dict[Future, int] = {}
        lost = False
        try:
            for k in group:
                try:
                    waiting[executor.submit(_work, payload, _packed(self.items[k]))] = k
                except (BrokenProcessPool, RuntimeError):  # broken while we were still handing out jobs
                    self.tries[k] += 1
                    lost = True
            while waiting:
                finished, _ = wait(waiting, timeout=RETRY_POLICY.wake_seconds, return_when=FIRST_COMPLETED)
                for future in finished:
                    k = waiting.pop(future)
                    self.tries[k] += 1
                    try:
                        result = _unpacked(future.result())
                    except Exception:  # jobs return their exceptions: this one is the executor's
                        lost = True
                    else:
                        self.enter(k, result)
        except BaseException:
            for future in waiting:
                future.cancel()
            raise
        return lost


def _work(payload: bytes, item: bytes) -> bytes:
    """One job, where it runs."""
    job, common = _common(payload)
    return _packed(_timed(job, common, cloudpickle.loads(item)))


def _timed(job: Callable[[Any, Any], Any], common: Any, item: Any) -> JobResult:
    began = time.perf_counter()
    try:
        return JobResult(job(common, item), "", time.perf_counter() - began)
    except Exception as error:
        text = str(error) if isinstance(error, GreyboxError) else f"{type(error).__name__}: {error}"
        return JobResult(None, text, time.perf_counter() - began)


@lru_cache(maxsize=2)
def _common(payload: bytes) -> Any:
    """What all jobs share, unpacked once in each worker."""
    return cloudpickle.loads(payload)


class _Pickler(cloudpickle.Pickler):
    """Models as what they were stated with, read-only mappings as mappings."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, Model):
            return _restated, (type(obj), {f.name: getattr(obj, f.name) for f in fields(obj) if f.init})
        if isinstance(obj, MappingProxyType):
            return MappingProxyType, (dict(obj),)
        return super().reducer_override(obj)


def _restated(kind: type, stated: dict[str, Any]) -> Any:
    return kind(**stated)


def _packed(value: Any) -> bytes:
    modules = _local_packages()
    for module in modules:
        cloudpickle.register_pickle_by_value(module)
    try:
        buffer = io.BytesIO()
        _Pickler(buffer).dump(value)
        return buffer.getvalue()
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)


def _unpacked(data: bytes) -> Any:
    return cloudpickle.loads(data)


def _local_packages() -> list[ModuleType]:
    """Top packages of the user's project (models/, fits/, a script): their functions travel by value."""
    standard = tuple({os.path.realpath(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib")})
    result = []
    for name, module in list(sys.modules.items()):
        if "." in name or name in ("__main__", "__mp_main__", "greybox"):
            continue
        file = getattr(module, "__file__", None) or next(iter(getattr(module, "__path__", ())), None)
        installed = file is None or "site-packages" in file or "dist-packages" in file
        if file and not installed and not os.path.realpath(file).startswith(standard):
            result.append(module)
    return result


@contextmanager
def _quiet_children() -> Iterator[None]:
    """Child processes with one BLAS thread each that do not run the main script again (a script without ``__main__`` guard is fine)."""
    environment = {name: os.environ.get(name) for name in ONE_THREAD}
    main = sys.modules["__main__"]
    hidden = {name: getattr(main, name) for name in ("__file__", "__spec__") if hasattr(main, name)}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        main.__spec__ = None
        if "__file__" in hidden:
            del main.__file__
        yield
    finally:
        for name, value in hidden.items():
            setattr(main, name, value)
        for name, before in environment.items():
            if before is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = before
