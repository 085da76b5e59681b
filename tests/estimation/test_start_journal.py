"""Starts that are finished are kept: the same call goes on from them."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from greybox.base.errors import WorkersLostError
from greybox.estimation.multistart import StartJournal, multistart
from tests.base.parallel.test_jobs import lag
from tests.oracles.independent import linear_record

module = sys.modules["greybox.estimation.multistart"]


@pytest.fixture
def record():
    return linear_record(lag(), np.random.default_rng(1).normal(size=300), 0.01, noise={"x": 1e-3})


@pytest.fixture
def begun(monkeypatch) -> list[float]:
    """The start values of the starts that are computed."""
    starts: list[float] = []
    original = module._fit_from

    def count(common, begin):
        starts.append(begin["T"])
        return original(common, begin)

    monkeypatch.setattr(module, "_fit_from", count)
    return starts


def run(record, path, **more):
    return multistart(lag(), record, starts=5, workers=1, journal=path, noise={"x": 1e-3}, **more)


def test_an_interrupted_multi_start_goes_on(tmp_path, record, begun):
    def interrupt(done, starts):
        if done == 3:
            raise KeyboardInterrupt

    path = tmp_path / "starts.jsonl"
    first = run(record, path, report=interrupt)
    assert first.interrupted and len(first.start_results) == 3 and len(begun) == 3
    calls = []
    second = run(record, path, report=lambda *counts: calls.append(counts))
    assert len(begun) == 5 and calls == [(4, 5), (5, 5)]
    whole = multistart(lag(), record, starts=5, workers=1, noise={"x": 1e-3})
    assert second.best.model.values == whole.best.model.values
    assert [r.values for r in second.start_results] == [r.values for r in whole.start_results]


def test_other_records_options_or_noise_are_other_starts(tmp_path, record, begun):
    path = tmp_path / "starts.jsonl"
    run(record, path)
    run(record, path)
    assert len(begun) == 5
    multistart(lag(), record, starts=5, workers=1, journal=path, noise={"x": 2e-3})
    assert len(begun) == 10
    run(linear_record(lag(), np.random.default_rng(2).normal(size=300), 0.01, noise={"x": 1e-3}), path)
    assert len(begun) == 15
    run(record, path, seed=3)
    assert len(begun) == 19  # the model's own start is the same


@pytest.mark.parametrize(
    "damage", ['{"key": "x"}\n', "[]\n", '{"key": 1, "values": "ab", "ratio": 1, "status": "", "seconds": 0}\n', '{"ke']
)
def test_damaged_lines_are_skipped(tmp_path, record, begun, damage):
    path = tmp_path / "starts.jsonl"
    run(record, path)
    with path.open("a") as file:
        file.write(damage)
    run(record, path)
    assert len(begun) == 5


def test_a_start_without_a_finite_end_is_kept_as_such(tmp_path):
    from greybox.base.parallel.jobs import JobResult

    journal = StartJournal(tmp_path / "starts.jsonl")
    journal.add("a", JobResult(({}, float("inf"), "overflow"), "", 1.0))
    assert json.loads((tmp_path / "starts.jsonl").read_text())["ratio"] is None
    assert StartJournal(tmp_path / "starts.jsonl").known["a"].value == ({}, float("inf"), "overflow")


def test_a_lost_cluster_leaves_the_finished_starts_in_the_journal(tmp_path, record, begun, monkeypatch):
    from concurrent.futures import ThreadPoolExecutor

    from greybox.base.parallel import jobs

    class Lost:
        def find_fault(self, finished, is_alone=False):
            return "it burnt down" if finished >= 2 else ""

    path = tmp_path / "starts.jsonl"
    monkeypatch.setattr(jobs, "watch_executor", lambda executor: Lost())
    with ThreadPoolExecutor(1) as threads, pytest.raises(WorkersLostError) as caught:
        multistart(lag(), record, starts=5, executor=threads, journal=path, noise={"x": 1e-3})
    done = sum(r is not None for r in caught.value.results)
    assert done == len(path.read_text().splitlines()) >= 2
    assert len(run(record, path).start_results) == 5
