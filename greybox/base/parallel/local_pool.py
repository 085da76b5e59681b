"""Processes of this machine that end with the process that started them, however that ends."""

from __future__ import annotations

import ctypes
import hashlib
import io
import multiprocessing
import os
import platform
import signal
import sys
import sysconfig
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import cache, lru_cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from multiprocessing.connection import Connection, wait
from types import MappingProxyType, ModuleType
from typing import Any

import cloudpickle

from greybox.base.values import ReadOnly

# Values as bytes for another process of the same version.
#
# A model is made of functions, often lambdas, which `pickle` refuses; `cloudpickle` (small, and what Dask itself uses) sends
# them by value, so a worker needs greybox but not the user's project. CasADi expressions are not sent: a model is stated anew
# where it arrives. Such bytes travel between processes of one user only; nothing of the kind is read from a file.


def pack(value: Any) -> bytes:
    """``value`` as bytes; functions of the user's project travel by value."""
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


def unpack(data: bytes) -> Any:
    """The value that was packed."""
    return cloudpickle.loads(data)


@lru_cache(maxsize=2)
def unpack_shared(data: bytes) -> Any:
    """What all jobs share, unpacked once in each worker."""
    return cloudpickle.loads(data)


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


class _Pickler(cloudpickle.Pickler):
    """Read-only mappings as mappings, models as they were stated; `pickle` refuses both."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, MappingProxyType):
            return MappingProxyType, (dict(obj),)
        if isinstance(obj, ReadOnly):
            return ReadOnly.__reduce__(obj)
        # A `MadeOfFunctions`, by what it does: that module imports this one.
        if hasattr(type(obj), "restate"):
            return obj.restate()
        return super().reducer_override(obj)


def _local_packages() -> list[ModuleType]:
    """Top packages of the user's project (models/, fits/, a script): their functions travel by value."""
    result = []
    for name, module in list(sys.modules.items()):
        if "." in name or name in ("__main__", "__mp_main__", "greybox"):
            continue
        file = getattr(module, "__file__", None) or next(iter(getattr(module, "__path__", ())), None)
        if file and _is_of_project(file):
            result.append(module)
    return result


# What a run is called with is packed at each: where hundreds of modules lie is found once.
@cache
def _is_of_project(file: str) -> bool:
    """Whether a module in ``file`` is neither installed nor Python's own."""
    if "site-packages" in file or "dist-packages" in file:
        return False
    standard = tuple({os.path.realpath(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib")})
    return not os.path.realpath(file).startswith(standard)


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
