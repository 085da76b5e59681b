"""Many starts: the optimum that most of them find, and how many did."""

import numpy as np
import pytest

from greybox import GreyboxError
from greybox.errors import ModelError
from greybox.estimation import FitOptions, multistart
from greybox.estimation.multistart import describe_starts, draw_starts, group_by_optimum
from greybox.result import StartResult
from models.emps import emps
from models.micro_actuator import micro_actuator
from tests.oracles.independent import linear_record, multisine

REST = FitOptions(at_rest=True)


def start_results(*ratios):
    return [StartResult({}, {"a": 1.0} if np.isfinite(r) else {}, r, "converged") for r in ratios]


def test_the_waterfall_says_how_many_starts_ended_where():
    assert describe_starts(start_results(1.0, 1.001, 3.4, 1.0, 3.41, 9.0, np.inf)) == (
        "3 of 7 starts ended at the best optimum (misfit 1 x noise), 2 at a worse one (3.4 x), 1 at a worse one (9 x), 1 led nowhere"
    )
    many = describe_starts(start_results(1, 2, 3, 4, 5, 6))
    assert many.endswith("1 at a worse one (4 x), 2 at still worse ones (from 5 x)")
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
    assert found.waterfall.startswith("12 of 12 starts ended at the best optimum (misfit 0.99")
    assert found.best.notes[0] == found.waterfall and found.waterfall in str(found)
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
    from tests.estimation.test_fit import experiment, explosive

    t = np.arange(100) * 0.1
    model = explosive()
    data = experiment(model, t, np.ones((100, 1)), np.cos(t)[:, None])
    with pytest.raises(GreyboxError, match="none of 3 starts led anywhere"):
        multistart(model, data, starts=3, options=REST, workers=1)
