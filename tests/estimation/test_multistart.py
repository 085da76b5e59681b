"""Many starts: the optimum that most of them find, and how many did."""

import numpy as np
import pytest

from greybox import GreyboxError
from greybox.base.errors import ModelError
from greybox.estimation.multistart import draw_starts, group_by_optimum, multistart, summarise_starts
from greybox.estimation.options import FitOptions
from greybox.estimation.result_parts import StartResult
from models.emps import emps
from models.micro_actuator import micro_actuator
from tests.oracles.independent import experiment, linear_record, multisine
from tests.support.explosive import explosive

REST = FitOptions(at_rest=True)


def start_results(*ratios):
    return [StartResult({}, {"a": 1.0} if np.isfinite(r) else {}, r, "converged") for r in ratios]


def test_starts_are_counted_by_the_optimum_that_they_reach():
    summary = summarise_starts(start_results(1.0, 1.001, 3.4, 1.0, 3.41, 9.0, np.inf))
    assert summary.values == {"counts": [3, 2, 1], "ratios": [1.0, 3.4, 9.0], "without_result": 1}
    assert [len(g) for g in group_by_optimum(start_results(1e-9, 1e-5, 0.5))] == [2, 1]  # data without noise


def test_random_starts_are_log_uniform_within_factor_and_bounds():
    model = micro_actuator.fix("M", "Ra").bound(K=(5000.0, 7000.0))
    starts = draw_starts(model, 2000, seed=1, factor=3.0)
    assert starts == draw_starts(model, 2000, seed=1, factor=3.0) != draw_starts(model, 2000, seed=2, factor=3.0)
    share = np.log([s["B"] / model.values["B"] for s in starts]) / np.log(3.0)
    assert np.histogram(share, 4, (-1, 1))[0] == pytest.approx(500, abs=80)
    assert all(5000 <= s["K"] <= 7000 for s in starts)
    with pytest.raises(ModelError, match="factor 1 of the random starts"):
        draw_starts(model, 3, factor=1.0)


@pytest.mark.parametrize("value", [-2.0, 0.0])
def test_constants_of_either_sign_keep_theirs_and_zero_stays_where_it_has_no_size(value):
    model = emps.bound(Fv=(-np.inf, np.inf)).start(Fv=value)
    drawn = [s["Fv"] for s in draw_starts(model, 50)]
    assert all(-6 <= v <= -2 / 3 for v in drawn) if value else set(drawn) == {0.0}
    bounded = [s["Fv"] for s in draw_starts(emps.bound(Fv=(0.0, 1e5)).start(Fv=0.0).bound(Fv=(0.0, 8.0)), 50)]
    assert min(bounded) < 1 and max(bounded) > 7


def test_every_start_of_the_actuator_ends_at_the_optimum():
    truth = micro_actuator.fix("M", "Ra", "Kv")
    u = multisine(np.random.default_rng(4), 2500, 2.5e-4, 5, 800, 3.0)
    noise = {"x": 2e-7, "i": 5e-3}
    data = linear_record(truth, u, 2.5e-4, noise=noise)
    found = multistart(truth, data, starts=12, seed=2, noise=noise, options=REST, workers=1)
    assert found.best_optimum_count == len(found.start_results) == 12
    assert found.summary.values["counts"] == [12]
    assert found.best.findings[0] == found.summary and str(found.summary) in str(found)
    for q in truth.free_parameters:
        assert abs(found.best.parameters[q.name].value - q.value) < 4 * found.best.parameters[q.name].std


def test_processes_find_what_one_process_finds():
    truth = micro_actuator.fix("M", "Ra", "Kv", "Kf")
    data = linear_record(
        truth, multisine(np.random.default_rng(4), 1000, 2.5e-4, 5, 800, 3.0), 2.5e-4, noise={"x": 2e-7, "i": 5e-3}
    )
    seen = []
    here, there = (
        multistart(truth, data, starts=4, options=REST, workers=w, report=lambda done, of: seen.append((done, of)))
        for w in (1, 2)
    )
    assert [e.values for e in here.start_results] == [e.values for e in there.start_results]
    assert here.best.model.values == there.best.model.values
    assert seen == [(k, 4) for k in range(1, 5)] * 2


def test_a_model_that_can_be_simulated_from_no_start_says_so():
    t = np.arange(100) * 0.1
    model = explosive()
    data = experiment(model, t, np.ones((100, 1)), np.cos(t)[:, None])
    with pytest.raises(GreyboxError, match="none of 3 starts has a result"):
        multistart(model, data, starts=3, options=REST, workers=1)
