"""Independent jobs on other processes: nothing finished is lost, whoever dies."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

from greybox.base.errors import DataError
from greybox.base.parallel.jobs import run_jobs
from greybox.estimation.fit import fit
from greybox.model.balance import Balance
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State
from tests.oracles.independent import linear_record


def lag(name="lag"):
    """A model of lambdas, which pickle refuses."""
    return Model(
        name,
        [State("x", "m")],
        [Input("u", "m")],
        [Output("x", "m")],
        [Parameter("T", "s", 0.1, (1e-3, 10.0))],
        lambda x, u, p: [Balance("lag", "m", p.T, "x", drive=u.u, own=-x.x)],
    )


def squared(common, item):
    return common + item**2


def dies_once(folder, item):
    """Kills its worker the first time that item 3 is tried."""
    flag = folder / "died"
    if item == 3 and not flag.exists():
        flag.touch()
        os._exit(9)
    return item, os.getpid()


def always_dies(common, item):
    if item == 1:
        os._exit(9)
    return item


def refuses(common, item):
    if item == 1:
        raise DataError("record 'a': too short")
    return 1 / item


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_items(workers):
    calls = []
    results, interrupted = run_jobs(
        squared, 10, range(5), workers=workers, report=lambda done, jobs: calls.append((done, jobs))
    )
    assert [r.value for r in results] == [10, 11, 14, 19, 26]
    assert not interrupted
    assert calls == [(k, 5) for k in range(1, 6)]


def test_an_exception_is_the_result_of_its_job_alone():
    results, _ = run_jobs(refuses, None, [2, 1, 0, 4], workers=2)
    assert [r.value for r in results] == [0.5, None, None, 0.25]
    assert results[1].error == "record 'a': too short"
    assert results[2].error == "ZeroDivisionError: division by zero"


@pytest.mark.parametrize("workers", [1, 2])
def test_a_bug_in_a_job_ends_the_run(workers):
    """It must not pass for a job that failed: a search would count it as a model that does not fit."""
    with pytest.raises(TypeError, match="unsupported operand") as caught:
        run_jobs(refuses, None, [2, "3", 4], workers=workers)
    if workers > 1:
        assert "in refuses" in str(caught.value.__cause__)


class Unreadable:
    """A result that cannot be made again from its bytes."""

    def __reduce__(self):
        return divmod, (1, 0)


def answers_unreadably(common, item):
    return Unreadable()


def test_a_result_that_cannot_be_read_ends_the_run():
    """Its worker has not died, and to try the job again changes nothing."""
    with ThreadPoolExecutor(1) as threads, pytest.raises(ZeroDivisionError):
        run_jobs(answers_unreadably, None, [1], executor=threads)


def test_a_worker_that_dies_loses_no_finished_job(tmp_path):
    results, _ = run_jobs(dies_once, tmp_path, range(6), workers=2)
    assert (tmp_path / "died").exists()
    assert [r.value[0] for r in results] == list(range(6))
    assert os.getpid() not in {r.value[1] for r in results}


def test_a_job_that_always_kills_its_worker_is_named_and_the_others_are_kept():
    results, _ = run_jobs(always_dies, None, range(4), workers=2)
    assert [r.value for r in results] == [0, None, 2, 3]
    assert "worker process died" in results[1].error


def test_any_executor_will_do():
    with ThreadPoolExecutor(2) as threads:
        assert [r.value for r in run_jobs(squared, 1, [1, 2], executor=threads)[0]] == [2, 5]


def test_an_executor_from_outside_that_breaks_keeps_what_was_finished():
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        results, _ = run_jobs(always_dies, None, range(3), executor=pool)
    assert results[0].value == 0
    assert all("worker died" in r.error for r in results[1:])


@pytest.mark.slow
def test_a_model_of_lambdas_is_fitted_elsewhere_to_the_same_bit():
    model = lag()
    rng = np.random.default_rng(1)
    data = linear_record(model, rng.normal(size=400), 0.01, noise={"x": 1e-3})
    results, _ = run_jobs(
        lambda common, start: fit(common[0].start(T=start), common[1]).model.values,
        (model, data),
        [0.2, 0.05],
        workers=2,
    )
    assert [r.error for r in results] == ["", ""]
    for start, r in zip([0.2, 0.05], results, strict=True):
        assert r.value == fit(model.start(T=start), data).model.values


def test_ctrl_c_keeps_what_is_finished():
    def report(done, jobs):
        if done == 2:
            threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()

    results, interrupted = run_jobs(
        lambda common, item: time.sleep(item) or item, None, [0, 0, 60, 60, 60, 60], workers=2, report=report
    )
    assert interrupted
    assert [r.value for r in results[:2]] == [0, 0]
    assert None in results[2:]


def test_a_script_without_main_guard_works(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from greybox.base.parallel.jobs import run_jobs\nresults, _ = run_jobs(lambda c, i: c * i, 2, [1, 2, 3], workers=2)\n"
        "print([r.value for r in results])\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.getcwd()}
    command = [sys.executable, str(script)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, env=environment)
    assert done.stdout == "[2, 4, 6]\n", done.stderr
