"""Jobs on a Dask cluster: faults are survived, or told within a minute with what is finished."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from greybox.base.errors import GreyboxError, WorkersLostError
from greybox.base.parallel import cluster, jobs
from greybox.base.parallel.cluster import DaskHealth, open_cluster
from greybox.base.parallel.jobs import run_jobs
from greybox.estimation.fit import fit
from greybox.estimation.multistart import multistart
from tests.base.parallel.test_jobs import dies_once, lag
from tests.oracles.independent import linear_record
from tests.support.reliability import note_row

needs_dask = pytest.mark.skipif(find_spec("distributed") is None, reason="the extra 'dask' is not installed")
ANSWER_SECONDS = 60.0
FAULTS = 12
"""Faults that the slow tests of this file make."""


@dataclass
class Trial:
    """One fault: the seconds until its answer, and whether the test found nothing wrong."""

    seconds: float = 0.0
    passed: bool = False

    def note_answer(self, lost_at: float) -> None:
        """The answer is there; ``lost_at``: the moment of the fault."""
        self.seconds = time.monotonic() - lost_at

    def pass_in_time(self) -> None:
        """The last line of a test."""
        assert 0 < self.seconds < ANSWER_SECONDS
        self.passed = True


@pytest.fixture(scope="module")
def trials() -> Iterator[list[Trial]]:
    """All faults; the row of the page when there were as many as there are tests."""
    made: list[Trial] = []
    yield made
    if len(made) >= FAULTS:
        longest = max(trial.seconds for trial in made)
        figures = f"the longest wait for an answer was {longest:.0f} s; what was finished is in the error or the result"
        note_row("faults of a Dask cluster of two workers", len(made), sum(not t.passed for t in made), figures)


@pytest.fixture
def trial(trials: list[Trial]) -> Trial:
    """Where a test notes when its answer was there."""
    trials.append(Trial())
    return trials[-1]


def work(folder: Path, item: int) -> tuple[int, int]:
    """A job of half a second that says which process does it."""
    (folder / f"worker-{os.getpid()}").touch()
    time.sleep(0.5)
    return item, os.getpid()


def long_work(folder: Path, item: int) -> None:
    """A job that no worker lives long enough for."""
    (folder / f"worker-{os.getpid()}").touch()
    time.sleep(10)


def worker_pids(folder: Path) -> list[int]:
    return [int(path.name.partition("-")[2]) for path in folder.glob("worker-*")]


def kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


@contextmanager
def in_background(action, *arguments) -> Iterator[None]:
    """``action`` in a thread, which has ended when the block has."""
    stop = threading.Event()
    thread = threading.Thread(target=action, args=(stop, *arguments), daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(10)


@contextmanager
def separate_cluster(folder: Path, workers: int = 2) -> Iterator[tuple[str, subprocess.Popen, list[subprocess.Popen]]]:
    """A scheduler and workers as processes of their own: the address and the processes."""
    file = folder / "scheduler.json"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (os.getcwd(), *filter(None, sys.path))))}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment, "cwd": folder}
    base = [sys.executable, "-m", "distributed.cli.dask_{}", "--scheduler-file", str(file)]

    def start(kind: str, *more: str) -> subprocess.Popen:
        return subprocess.Popen([part.format(kind) for part in base] + list(more), **quiet)

    scheduler = start("scheduler", "--port", "0", "--dashboard-address", ":0")
    processes = [start("worker", "--nthreads", "1", "--no-dashboard") for _ in range(workers)]
    try:
        deadline = time.monotonic() + 60
        while not file.exists() or not file.read_text():
            assert time.monotonic() < deadline
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        if workers:
            import distributed

            with distributed.Client(address, timeout=60) as client:
                client.wait_for_workers(workers, timeout=120)
        yield address, scheduler, processes
    finally:
        for process in (*processes, scheduler):
            process.terminate()
        for process in (*processes, scheduler):
            with suppress(subprocess.TimeoutExpired):
                process.wait(10)
            process.kill()
            process.wait()


def work_after_a_death(folder: Path, item: int) -> tuple[int, int]:
    """A job that nobody ends before a worker was killed."""
    (folder / f"worker-{os.getpid()}").touch()
    while not (folder / "killed").exists():
        time.sleep(0.02)
    return item, os.getpid()


@pytest.mark.slow
@needs_dask
def test_a_local_cluster_of_two_processes_survives_the_death_of_one(tmp_path):
    killed: list[int] = []

    def kill_one(stop: threading.Event) -> None:
        while not stop.wait(0.02):
            if pids := worker_pids(tmp_path):
                killed.append(pids[0])
                kill(pids[0])
                (tmp_path / "killed").touch()
                return

    with open_cluster("local", 2) as executor, in_background(kill_one):
        results, interrupted = run_jobs(work_after_a_death, tmp_path, range(8), executor=executor)
    assert not interrupted
    assert [r.value[0] for r in results] == list(range(8))
    # By the other one, or by who replaced the dead one.
    assert not {os.getpid(), *killed} & {r.value[1] for r in results} and len(killed) == 1


@pytest.mark.slow
@needs_dask
def test_a_model_is_fitted_on_a_cluster_as_here(tmp_path):
    model = lag()
    data = linear_record(model, np.random.default_rng(1).normal(size=300), 0.01, noise={"x": 1e-3})
    with open_cluster("local", 2) as executor:

        def job(common, start):
            return os.getpid(), fit(common[0].start(T=start), common[1]).model.values["T"]

        results, _ = run_jobs(job, (model, data), [0.05, 0.2, 0.3], executor=executor)
        assert [r.error for r in results] == ["", "", ""]
        assert os.getpid() not in {r.value[0] for r in results}
        assert all(r.value[1] == pytest.approx(0.1, rel=1e-2) for r in results)
        assert [r.value[0] for r in run_jobs(dies_once, tmp_path, range(4), executor=executor)[0]] == [0, 1, 2, 3]


@needs_dask
@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("fault", ["scheduler killed", "scheduler stopped", "scheduler ended"])
def test_a_lost_scheduler_is_told_within_a_minute_with_what_is_finished(tmp_path, fault, trial):
    number = {
        "scheduler killed": signal.SIGKILL,
        "scheduler stopped": signal.SIGSTOP,
        "scheduler ended": signal.SIGTERM,
    }
    with separate_cluster(tmp_path) as (address, scheduler, _), open_cluster(address) as executor:
        lost_at: list[float] = []

        def lose(done: int, _: int) -> None:
            if done == 3:
                scheduler.send_signal(number[fault])
                lost_at.append(time.monotonic())

        with pytest.raises(WorkersLostError, match="the cluster is given up") as caught:
            run_jobs(work, tmp_path, range(100), executor=executor, report=lose)
        trial.note_answer(lost_at[0])
        scheduler.send_signal(signal.SIGCONT)
        scheduler.kill()
        assert sum(r is not None for r in caught.value.results) >= 3
        trial.pass_in_time()


@needs_dask
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_closed_client_is_told_with_what_is_finished(tmp_path, trial):
    import distributed

    with (
        distributed.LocalCluster(
            2, threads_per_worker=1, dashboard_address="127.0.0.1:0", local_directory=tmp_path
        ) as local,
        distributed.Client(local) as client,
    ):
        lost_at: list[float] = []
        threads: list[threading.Thread] = []

        def close(done: int, _: int) -> None:
            if done == 3:  # from another thread, as a program with several does
                lost_at.append(time.monotonic())
                threads.append(threading.Thread(target=client.close))
                threads[0].start()

        with pytest.raises(WorkersLostError) as caught:
            run_jobs(work, tmp_path, range(100), executor=client.get_executor(), report=close)
        trial.note_answer(lost_at[0])
        assert 3 <= sum(r is not None for r in caught.value.results) < 100
        trial.pass_in_time()
        threads[0].join()


@needs_dask
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_workers_that_are_killed_again_and_again_are_told_within_a_minute(tmp_path, trial):
    def kill_all(stop: threading.Event) -> None:
        while not stop.wait(0.1):
            for pid in worker_pids(tmp_path):
                kill(pid)
                (tmp_path / f"worker-{pid}").unlink()

    with open_cluster("local", 2) as executor, in_background(kill_all):
        began = time.monotonic()
        with suppress(WorkersLostError):
            results, _ = run_jobs(long_work, tmp_path, range(12), executor=executor)
            assert all(r.error for r in results)
        trial.note_answer(began)
    trial.pass_in_time()


@needs_dask
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_cluster_without_workers_is_told_within_a_minute(tmp_path, trial):
    with separate_cluster(tmp_path, workers=0) as (address, *_), open_cluster(address) as executor:
        began = time.monotonic()
        with pytest.raises(WorkersLostError, match="no worker"):
            run_jobs(work, tmp_path, range(3), executor=executor)
        trial.note_answer(began)
    trial.pass_in_time()


@needs_dask
@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP])
def test_one_worker_that_is_lost_for_ever_is_done_without(tmp_path, number, trial):
    """A machine that is switched off: nobody starts the worker anew."""
    with separate_cluster(tmp_path) as (address, _, workers), open_cluster(address) as executor:
        lost_at: list[float] = []

        def lose(done: int, _: int) -> None:
            if done == 3:
                workers[0].send_signal(number)
                lost_at.append(time.monotonic())

        try:
            results, _ = run_jobs(work, tmp_path, range(12), executor=executor, report=lose)
        except WorkersLostError as error:
            results = list(error.results)
        finally:
            workers[0].send_signal(signal.SIGCONT)
        trial.note_answer(lost_at[0])
    finished = [r.value[0] for r in results if r is not None]
    assert finished == list(range(12)) or (number is signal.SIGSTOP and len(finished) >= 3)
    trial.pass_in_time()


@needs_dask
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_jobs_of_a_frozen_worker_are_done_by_another(tmp_path, trial):
    """A process that neither works nor ends, as on a machine whose disk hangs."""
    frozen: list[int] = []
    lost_at: list[float] = []

    def freeze_one(stop: threading.Event) -> None:
        while not stop.wait(0.05):
            if len(pids := worker_pids(tmp_path)) == 2:
                frozen.append(pids[0])
                os.kill(pids[0], signal.SIGSTOP)
                lost_at.append(time.monotonic())
                return

    with separate_cluster(tmp_path) as (address, *_), open_cluster(address) as executor, in_background(freeze_one):
        try:
            results, _ = run_jobs(work, tmp_path, range(40), executor=executor)
            trial.note_answer(lost_at[0])
        finally:
            for pid in frozen:
                os.kill(pid, signal.SIGCONT)
    assert [r.value[0] for r in results] == list(range(40))
    trial.pass_in_time()


@needs_dask
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_all_workers_killed_once_are_replaced(tmp_path, trial):
    lost_at: list[float] = []

    def kill_all_once(stop: threading.Event) -> None:
        while not stop.wait(0.05):
            if len(pids := worker_pids(tmp_path)) == 2:
                for pid in pids:
                    kill(pid)
                lost_at.append(time.monotonic())
                return

    with open_cluster("local", 2) as executor, in_background(kill_all_once):
        results, _ = run_jobs(work, tmp_path, range(40), executor=executor)
        trial.note_answer(lost_at[0])
    assert [r.value[0] for r in results] == list(range(40))
    trial.pass_in_time()


@needs_dask
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_job_that_kills_its_workers_is_named_and_the_others_are_done(tmp_path, trial):
    def job(common, item):
        if item == 1:
            os._exit(9)
        return item

    with open_cluster("local", 2) as executor:
        began = time.monotonic()
        results, _ = run_jobs(job, None, range(6), executor=executor)
        trial.note_answer(began)
    assert [r.value for r in results] == [0, None, 2, 3, 4, 5]
    assert "worker" in results[1].error
    trial.pass_in_time()


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://x", "127.0.0.1:notaport", ""])
@needs_dask
def test_an_address_where_no_scheduler_answers_is_told(monkeypatch, address):
    began = time.monotonic()
    with (
        pytest.raises(GreyboxError, match="no scheduler answers"),
        open_cluster(address or "tcp://", connect_seconds=1.0),
    ):
        pass
    assert time.monotonic() - began < 20


def test_without_dask_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(GreyboxError, match="pip install"), open_cluster("local"):
        pass


def test_workers_of_another_version_are_told_at_once(monkeypatch):
    versions = iter(["Python 3.11, greybox aaaa"] + ["Python 3.11, greybox bbbb"] * 99)
    monkeypatch.setattr(jobs, "describe_version", lambda: next(versions))
    with ThreadPoolExecutor(1) as threads, pytest.raises(WorkersLostError, match="install the same version") as caught:
        run_jobs(lambda common, item: item, None, [1], executor=threads)
    assert caught.value.results == (None,)


class FakeClient:
    """A client whose scheduler answers as told."""

    def __init__(self) -> None:
        self.status = "running"
        self.workers: set[str] | None = {"a", "b"}
        self.scheduler = self
        self.beats: dict[str, float] = defaultdict(itertools.count(1.0).__next__)
        self.removed: list[str] = []

    def ncores(self):
        return dict.fromkeys(self.workers, 1)

    def identity(self, **_):
        return {"workers": {worker: {"last_seen": self.beats[worker]} for worker in self.workers}}

    def unregister(self, address, **_):
        self.removed.append(address)

    def sync(self, call, callback_timeout, **arguments):
        if self.workers is None:
            raise OSError("no answer")
        return call(**arguments)


@pytest.fixture
def clock(monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(cluster.time, "monotonic", lambda: now[0])
    return now


def faults(health: DaskHealth, clock: list[float], seconds: int, finished: int = 0) -> list[str]:
    """What is found in so many looks, a second apart."""
    texts = []
    for _ in range(seconds):
        clock[0] += 1.5
        texts.append(health.find_fault(finished))
    return texts


def test_a_scheduler_that_is_silent_for_a_moment_is_waited_for(clock):
    client = FakeClient()
    health = DaskHealth(client)
    client.workers = None
    assert not any(faults(health, clock, 10))
    client.workers = {"a"}
    assert not any(faults(health, clock, 10))
    client.workers = None
    assert any("has not answered" in text for text in faults(health, clock, 20))


def test_workers_that_come_and_go_are_counted_until_a_job_is_finished(clock):
    client = FakeClient()
    health = DaskHealth(client)
    for k in range(4):
        client.workers = {f"a{k}", f"b{k}"}
        (text,) = faults(health, clock, 1)
        assert (k == 4) == bool(text)
    client.workers = {"a4", "b4"}
    assert "died one after another" in faults(health, clock, 1)[0]
    assert not faults(health, clock, 1, finished=1)[0]


def test_workers_that_die_of_the_last_job_are_left_to_dask_which_names_it(clock):
    client = FakeClient()
    health = DaskHealth(client)
    for k in range(30):
        client.workers = {f"a{k}"}
        clock[0] += 1.5
        assert not health.find_fault(0, is_alone=True)
    clock[0] += 1.5
    assert "died one after another" in health.find_fault(0)


def test_workers_that_begin_slowly_and_die_are_told_by_the_time_as_well(clock):
    client = FakeClient()
    health = DaskHealth(client)
    texts = []
    for k in range(3):  # one of two dies every fifteen seconds: too few to be told by their number
        client.workers = {f"a{k}", "b"}
        texts += faults(health, clock, 10)
    assert not any(texts)
    client.workers = {"a3", "b"}
    assert "died one after another" in faults(health, clock, 1)[0]
    assert not any(faults(health, clock, 20, finished=1))


def test_a_worker_without_a_heartbeat_is_removed(clock):
    client = FakeClient()
    health = DaskHealth(client)
    for second in range(30):
        client.beats["a"] = float(second)
        faults(health, clock, 1)
        assert second < 24 or client.removed
    assert {*client.removed} == {"b"}


def test_a_closed_client_is_a_fault_at_once():
    client = FakeClient()
    client.status = "closed"
    assert "closed" in DaskHealth(client).find_fault(0)


def test_multistart_tells_what_is_finished(monkeypatch):
    model = lag()
    data = linear_record(model, np.random.default_rng(1).normal(size=100), 0.01, noise={"x": 1e-3})

    class Lost:
        def find_fault(self, finished: int, is_alone: bool = False) -> str:
            return "it burnt down" if finished else ""

    monkeypatch.setattr(jobs, "watch_executor", lambda executor: Lost())
    with ThreadPoolExecutor(1) as threads, pytest.raises(WorkersLostError, match="burnt down") as caught:
        multistart(model, data, starts=4, executor=threads)
    assert sum(r is not None for r in caught.value.results) >= 1
