"""A search that ends when its time is over: the best answer so far, given as such, and nothing in it as certain."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import DataError
from greybox.base.parallel.jobs import run_jobs
from greybox.discovery.execution import FailureLog, RefitExecutor
from greybox.discovery.findings import DiscoveryCode
from greybox.model.effects.catalogue import effect
from tests.support.stage import STAGE

NOISE = {"x": 1e-5}


def record(seed: int) -> gb.Experiment:
    rng = np.random.default_rng(seed)
    time_axis, force = 5e-3 * np.arange(100), np.repeat(rng.normal(0, 6, 10), 10)
    run = gb.simulate((STAGE + effect("coulomb_friction")).start(Fc=1.0), {"time": time_axis, "F": force})
    return gb.Experiment(f"run {seed}", time_axis, {"F": force}, {"x": run.outputs["x"] + 1e-5 * rng.normal(size=100)})


@pytest.mark.rest
def test_a_search_without_time_says_so_and_calls_nothing_established() -> None:
    found = gb.discover(STAGE, record(1), validation=record(2), noise=NOISE, time_limit=1e-9, workers=1)
    (over,) = [f for f in found.findings if f.code is DiscoveryCode.TIME_OVER]
    assert over.values["seconds"] == 1e-9 and over.values["skipped"] > 0
    assert found.verdict == "unknown"
    assert found.not_tried["coulomb_friction"].code is DiscoveryCode.NOT_REACHED
    assert found.base.misfit["x"].rmse > 10 * 1e-5


@pytest.mark.slow
def test_what_was_found_by_then_is_the_answer_and_no_effect_of_it_is_established(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    names = ["coulomb_friction", "quadratic_damping"]
    shared = {"validation": record(2), "noise": NOISE, "effects": [effect(n) for n in names], "workers": 1}
    whole = gb.discover(STAGE, record(1), **shared)
    assert whole.verdict == "named" and not [f for f in whole.findings if f.code is DiscoveryCode.TIME_OVER]
    # The time is over when every effect was refitted once.
    monkeypatch.setattr(RefitExecutor, "is_late", property(lambda refits: refits.finished >= len(names)))
    found = gb.discover(STAGE, record(1), time_limit=60.0, **shared)
    assert found.effects[0]["name"] == "coulomb_friction" and found.effects[0]["grade"] != "established"
    assert found.verdict != "named"
    assert [f.values["seconds"] for f in found.findings if f.code is DiscoveryCode.TIME_OVER] == [60.0]


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_a_time_limit_is_above_zero(limit: float) -> None:
    with pytest.raises(DataError, match="give a number of seconds above 0"):
        gb.discover(STAGE, record(1), validation=record(2), time_limit=limit)


def test_no_job_begins_after_the_deadline() -> None:
    results, interrupted = run_jobs(
        lambda common, item: item, None, [1, 2], workers=1, deadline=time.perf_counter() - 1
    )
    assert results == [None, None] and not interrupted


def test_a_late_refit_is_no_failure_of_its_candidate() -> None:
    problem, refits = SimpleNamespace(failures=FailureLog()), RefitExecutor(deadline=0.0)
    assert refits.run(problem, [None, None]) == [None, None]
    assert refits.skipped == 2 and not problem.failures.entries
