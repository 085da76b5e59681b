"""Processes of this machine that end with the process that started them, however that ends."""

from __future__ import annotations

import ctypes
import hashlib
import multiprocessing
import os
import platform
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import lru_cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from multiprocessing.connection import Connection, wait
from typing import Any


@lru_cache
def describe_version() -> str:
    """Python and greybox as two processes must agree on them: the version, and the text of the program."""
    python = ".".join(platform.python_version_tuple()[:2])
    digest = hashlib.sha256()
    _add_texts(digest, files("greybox"))
    return f"Python {python}, greybox {digest.hexdigest()[:12]}"


def _add_texts(digest: Any, folder: Traversable) -> None:
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir() and not entry.name.startswith("_"):
            _add_texts(digest, entry)
        elif entry.name.endswith((".py", ".c", ".h")):
            digest.update(entry.name.encode() + b"\0" + entry.read_bytes())


# Number of the Linux call that asks for a signal when the parent ends.
PR_SET_PDEATHSIG = 1
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def count_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def open_local_pool(workers: int) -> Iterator[Executor]:
    """Processes of this machine for several calls of `run_jobs`, with one BLAS thread each; ended with the block."""
    with quiet_children():
        pool = LocalPool(workers)
        try:
            yield pool
        except BaseException:  # raised again
            pool.abandon()
            raise
        pool.shutdown()


# Seconds in which a worker that is told to end may do so by itself, before it is killed.
RETRY_GRACE_SECONDS = 2.0


class LocalPool(Executor):
    """Worker processes; those that died are replaced.

    Every worker holds one end of a pipe whose other end only this process has. When this process ends, also killed, or calls
    `abandon`, the pipe is closed and the worker ends, whatever it is doing. Ctrl-C is heard by this process alone.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._context = multiprocessing.get_context("spawn")
        self._start()

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future:
        """Run ``function`` in a worker; in new ones if the old ones have died."""
        try:
            return self._pool.submit(function, *arguments, **options)
        except BrokenProcessPool:
            self.abandon()
            self._start()
            return self._pool.submit(function, *arguments, **options)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers when they have done what was submitted."""
        self._pool.shutdown(wait=wait, cancel_futures=cancel_futures)
        self._close_pipe()

    def abandon(self) -> None:
        """End the workers now, also those that a long computation keeps from hearing it."""
        self._close_pipe()
        pids = set()
        with suppress(OSError, EOFError):
            while self._announced.poll():
                pids.add(self._announced.recv())
        workers = [worker for worker in multiprocessing.active_children() if worker.pid in pids]
        deadline = time.monotonic() + RETRY_GRACE_SECONDS
        for worker in workers:
            worker.join(max(0.0, deadline - time.monotonic()))
            if worker.is_alive():
                worker.kill()
        self._pool.shutdown(wait=True)

    def _start(self) -> None:
        self._leash, self._hand = self._context.Pipe(duplex=False)
        self._announced, announce = self._context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(
            self._workers, self._context, initializer=_end_with_parent, initargs=(self._leash, announce)
        )

    def _close_pipe(self) -> None:
        self._hand.close()
        self._leash.close()


def _end_with_parent(leash: Connection, announce: Connection) -> None:
    """Begin a worker: it ends at once when its parent is gone or lets go of the ``leash``; ``announce`` hears its process id."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_watch, args=(leash,), daemon=True).start()
    if sys.platform == "linux":  # also where a long computation does not let the thread run
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL))
    announce.send(os.getpid())


def _watch(leash: Connection) -> None:
    parent = multiprocessing.parent_process()
    with suppress(OSError, EOFError):
        wait([leash, *([parent.sentinel] if parent is not None else [])])
    os._exit(1)


@contextmanager
def quiet_children() -> Iterator[None]:
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
