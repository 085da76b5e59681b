"""A Dask cluster: joining it, and noticing that it is lost. Dask itself waits for a scheduler for ever."""

from __future__ import annotations

import logging
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from typing import Any

from greybox.base.errors import GreyboxError
from greybox.base.parallel.local_pool import count_cores, quiet_children

# The address of a cluster that is started on this machine, to try.
LOCAL = "local"


# Seconds without an answer of the scheduler after which it is lost. A scheduler that is busy answers within a few.
SILENCE_SECONDS = 20.0
# Seconds without any worker: a worker that is started anew takes three to ten, and thirty on a machine with far more to do than it can.
EMPTY_SECONDS = 40.0
# Seconds that one call of the scheduler may take.
CALL_SECONDS = 5.0
# Seconds between two calls: a worker that lives for a shorter time is not counted.
LOOK_SECONDS = 1.0
# Seconds between two looks at the heartbeats of the workers.
LISTEN_SECONDS = 4.0
# Seconds without a heartbeat after which a worker is done without; one beats twice a second in a small cluster, and on a machine with far
# more to do than it can every ten.
FROZEN_SECONDS = 25.0
# Seconds without a heartbeat for each worker of a large cluster: a thousand of them beat every six seconds only.
FROZEN_SECONDS_PER_WORKER = 0.03
# Workers that may die one after another while no job is finished: one bad job kills four before Dask gives it up.
LEAST_LOSSES = 6
# Workers that may die so for each one of a large cluster, which may lose many at once when a machine goes.
LOSSES_PER_WORKER = 3
# Seconds without a finished job after which a cluster that has lost more workers than it ever had at a time is given up: where workers
# begin slowly and die, their number alone would take minutes to tell.
FRUITLESS_SECONDS = 40.0


class DaskHealth:
    """Whether it makes sense to wait for workers any longer: the scheduler's answers, and the workers that come and go."""

    def __init__(self, client: Any) -> None:
        self._client = client
        now = time.monotonic()
        self._looked = self._answered = self._staffed = self._listened = self._worked = now
        self._heartbeats: dict[str, tuple[Any, float]] = {}
        self._finished = 0
        self._present: set[str] = set()
        self._most_present = self._lost = 0

    def find_fault(self, finished: int, is_alone: bool = False) -> str:
        """Why waiting is in vain: a client that is closed, a scheduler that does not answer, workers that die one after another.

        Empty where it is not. ``finished`` counts the jobs that workers have done; ``is_alone``: one is left to do. Workers that die
        then may die of it: Dask gives it up, and it is named.
        """
        now = time.monotonic()
        if self._client.status in ("closed", "closing"):
            return "the connection to its scheduler is closed"
        if finished > self._finished:
            self._finished, self._lost, self._worked = finished, 0, now
        if now - self._looked < LOOK_SECONDS:
            return ""
        # The addresses of the workers; None where the scheduler does not answer.
        workers = self._call("ncores") if self._client.status == "running" else None
        present = None if workers is None else set(workers)
        self._looked = now = time.monotonic()
        if present is None:
            silent = now - self._answered
            return f"its scheduler has not answered for {silent:.0f} s" if silent > SILENCE_SECONDS else ""
        self._answered = now
        self._lost += len(self._present - present)
        self._present, self._most_present = present, max(self._most_present, len(present))
        if present:
            self._staffed = now
        if now - self._listened > LISTEN_SECONDS:
            self._listened = now
            self._remove_frozen(now)
        if now - self._staffed > EMPTY_SECONDS:
            return f"it has had no worker for {now - self._staffed:.0f} s"
        is_fruitless = now - self._worked > FRUITLESS_SECONDS and self._lost > self._most_present
        are_many = self._lost > max(LEAST_LOSSES, LOSSES_PER_WORKER * self._most_present)
        if not is_alone and (are_many or is_fruitless):
            return f"{self._lost} workers have died one after another without finishing a job"
        return ""

    def _remove_frozen(self, now: float) -> None:
        """Have the scheduler give the jobs of workers without a heartbeat to others. It would do so by itself after five minutes.

        A worker that computes goes on beating: the solvers and the compiled kernels let its other threads run.
        """
        workers = (self._call("identity", n_workers=-1) or {}).get("workers", {})
        limit = max(FROZEN_SECONDS, FROZEN_SECONDS_PER_WORKER * len(workers))
        for address, worker in workers.items():
            beat = worker.get("last_seen")
            last, since = self._heartbeats.get(address, (None, now))
            if beat is None or beat != last:
                self._heartbeats[address] = (beat, now)
            elif now - since > limit:
                self._call("unregister", address=address, stimulus_id="greybox-frozen")

    def _call(self, name: str, **arguments: Any) -> Any:
        """A call of the scheduler; None where it does not answer."""
        try:
            call = getattr(self._client.scheduler, name)
            return self._client.sync(call, callback_timeout=CALL_SECONDS, **arguments)
        # Only Dask runs here: of the network in as many kinds as there are transports, or of the scheduler. Each means no answer.
        except Exception:
            return None


class DaskExecutor(Executor):
    """Jobs on a Dask cluster, each of which gets an answer.

    Dask's own executor gives a job that is handed out again the failure of the first time, and no answer to one that the scheduler
    cancels.
    """

    def __init__(self, client: Any) -> None:
        self.client = client

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future:
        """Run ``function`` on a worker."""
        answer: Future = Future()
        asked = self.client.submit(function, *arguments, **options, pure=False)
        answer.add_done_callback(lambda done: asked.cancel() if done.cancelled() else None)
        self.client.loop.add_callback(_hand_over, asked, answer)
        return answer


async def _hand_over(asked: Any, answer: Future) -> None:
    """Wait for what Dask was ``asked``, on its own thread, and give it to whoever waits for the ``answer``."""
    try:
        value = await asked
    # Only Dask runs here: of the job's worker, of the connection, or that it is cancelled. Whoever waits for the answer must hear of it.
    except BaseException as error:
        lost = error if isinstance(error, Exception) else CancelledError(str(error))
        if answer.set_running_or_notify_cancel():
            answer.set_exception(lost)
        return
    if answer.set_running_or_notify_cancel():
        answer.set_result(value)


def adopt_executor(executor: Executor) -> Executor:
    """An executor whose jobs all get an answer: Dask's own is replaced."""
    client = getattr(executor, "_client", None)
    return DaskExecutor(client) if type(executor).__module__.startswith("distributed") and client else executor


def watch_executor(executor: Executor) -> DaskHealth | None:
    """How to notice that an executor is lost; None where it tells itself, as processes of this machine do."""
    return DaskHealth(executor.client) if isinstance(executor, DaskExecutor) else None


# Workers of a local cluster that may die of a job before it is tried alone: each takes seconds to replace.
LOCAL_FAILURES = 1
# Seconds in which a scheduler must answer the first call: whoever waits must hear within a minute that a cluster is lost.
CONNECT_SECONDS = 20.0


@contextmanager
def open_cluster(address: str, workers: int = 0, connect_seconds: float = CONNECT_SECONDS) -> Iterator[Executor]:
    """An executor on a Dask cluster.

    Parameters
    ----------
    address
        Of the scheduler, such as ``tcp://10.0.0.5:8786``; ``local`` starts a cluster of processes on this machine.
    workers
        Processes of a local cluster; 0 for one on each core.
    connect_seconds
        Seconds in which the scheduler must answer the first call.

    Yields
    ------
    Executor
        The cluster, until the block ends.

    Raises
    ------
    GreyboxError
        If Dask is not installed, or no scheduler answers at the address.
    """
    try:
        distributed = import_module("distributed")  # of the extra `dask`
    except ImportError as error:
        raise GreyboxError(
            f"cluster {address}: Dask is not installed ({error}); pip install 'greybox-sysid[dask]'"
        ) from None
    with ExitStack() as stack:
        stack.enter_context(quiet_children())
        logger = logging.getLogger("distributed")
        stack.callback(logger.setLevel, logger.level)
        logger.setLevel(logging.CRITICAL)  # a loss is told once, by us
        try:
            if address == LOCAL:
                failures = {"distributed.scheduler.allowed-failures": LOCAL_FAILURES}
                stack.enter_context(import_module("dask.config").set(failures))
                folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="greybox-", ignore_cleanup_errors=True))
                cluster = distributed.LocalCluster(
                    n_workers=workers or count_cores(),
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address="127.0.0.1:0",  # any port, and for this machine alone
                    local_directory=folder,
                    silence_logs=logging.CRITICAL,
                )
                stack.callback(_close, cluster)
            client = distributed.Client(cluster if address == LOCAL else address, timeout=connect_seconds)
        except (OSError, ValueError, RuntimeError, TimeoutError) as error:
            reason = str(error) or type(error).__name__
            raise GreyboxError(
                f"cluster {address}: no scheduler answers ({reason}); give the address of one"
            ) from error
        stack.callback(_close, client)
        yield DaskExecutor(client)


# Seconds that closing may take.
CLOSE_SECONDS = 5.0


def _close(value: Any) -> None:
    # Only Dask runs here: a cluster that is lost already fails in as many kinds as it can be lost, and its loss was told.
    with suppress(Exception):
        value.close(timeout=CLOSE_SECONDS)
