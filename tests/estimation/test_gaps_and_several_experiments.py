"""Gaps, irregular time and several experiments with first states of their own, on every path from record to verdict."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from greybox import FitOptions, fit
from greybox.estimation.check import check
from greybox.estimation.findings import EstimationCode
from greybox.estimation.residuals import residual_tests
from greybox.estimation.score import score
from greybox.estimation.uncertainty import bootstrap, profile
from greybox.show import text
from tests.support.findings import codes, find
from tests.support.pushed_mass import INTENSITY, LEVEL, MASS, STARTS, irregular, record, three, with_gaps

PUSHED = MASS.with_process_noise(v=INTENSITY)
TRUTH = {"B": 0.4, "K": 4.0, "noise_v": INTENSITY}


# path -> model, what is special about the records, what the fit is told
PATHS = {
    "free run": (MASS, {}, {"noise": LEVEL}),
    "noise from differences": (MASS, {}, {}),
    "known process noise": (PUSHED, {"intensity": INTENSITY}, {"noise": LEVEL}),
    "estimated process noise": (MASS.with_process_noise("v"), {"intensity": INTENSITY}, {}),
    "huber": (MASS, {}, {"noise": LEVEL, "options": FitOptions(loss="huber")}),
    "student": (MASS, {}, {"noise": LEVEL, "options": FitOptions(loss="student")}),
    "prior": (MASS.prior(K=(4.001, 0.002)), {}, {"noise": LEVEL}),
    "sandwich": (MASS, {"rho": 0.8}, {}),
    "whitened": (MASS, {"rho": 0.8}, {"colour": "residual"}),
    "multiple shooting": (MASS, {}, {"noise": LEVEL, "options": FitOptions(transcription="multiple")}),
}
EXACT = ("free run", "known process noise", "huber", "student", "prior")
every_path = pytest.mark.parametrize("path", PATHS)


@cache
def found_on(path):
    model, special, told = PATHS[path]
    return fit(model, three(**special), **told)


@pytest.mark.crossed(3)
@every_path
def test_constants_and_first_states_come_back(path):
    found = found_on(path)
    assert found.success, found.solver.status_message
    for name in found.uncertainty.free:
        stated = found.parameters[name]
        assert abs(stated.value - TRUTH[name]) < 4 * stated.std
        assert stated.interval[0] < TRUTH[name] * 1.2 and stated.interval[1] > TRUTH[name] / 1.2
        assert stated.std < 0.05 * stated.value or name in ("B", "noise_v")
    for trace, start in zip(found.traces, STARTS, strict=True):
        assert [trace.initial_state[n] for n in LEVEL] == pytest.approx(start, abs=0.15)
    assert (found.uncertainty.kind == "sandwich") == (path == "sandwich")
    assert EstimationCode.PARAMETER_NOT_CONSTANT not in codes(found.findings)


@pytest.mark.parametrize("path", EXACT)
def test_gaps_and_irregular_time_are_the_same_to_it(path):
    """Rows in which nothing was measured and the input stayed as it was may be there or not."""
    model, special, told = PATHS[path]
    data = record(1, x0=STARTS[1], **special)
    one, other = fit(model, with_gaps(data), **told), fit(model, irregular(data), **told)
    for name in one.uncertainty.free:
        assert one.parameters[name].value == pytest.approx(other.parameters[name].value, rel=1e-7)
        assert one.parameters[name].std == pytest.approx(other.parameters[name].std, rel=1e-4)
    assert one.solver.cost == pytest.approx(other.solver.cost, rel=1e-5 if path in ("huber", "student") else 1e-9)
    assert one.misfit["x"].samples == other.misfit["x"].samples == np.isfinite(with_gaps(data).outputs["x"]).sum()


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize("path", ["free run", "known process noise", "huber"])
def test_constants_of_each_experiment_are_those_of_a_fit_of_it_alone(path):
    model, special, told = PATHS[path]
    data = three(**special)
    together = fit(model, data, per_experiment=["B", "K"], **told)
    for experiment in data:
        alone = fit(model, experiment, **told)
        for name in "BK":
            mine = together.constraints.per_experiment[name][experiment.name]
            assert mine.value == pytest.approx(alone.parameters[name].value, rel=2e-3 if path == "huber" else 1e-5)
            assert mine.std == pytest.approx(alone.parameters[name].std, rel=0.1)


@pytest.mark.crossed(3)
@pytest.mark.rest
@every_path
def test_profile_and_bootstrap_meet_the_interval(path):
    found = found_on(path)
    again = bootstrap(found, np.random.default_rng(1), replicates=200)
    for name in found.uncertainty.free:
        low, high = found.parameters[name].interval
        reach = 0.25 if path == "sandwich" else 0.1
        if name != "noise_v" or path == "estimated process noise":
            assert profile(found, name).interval == pytest.approx((low, high), abs=reach * (high - low))
        assert again.std[name] == pytest.approx(found.parameters[name].std, rel=0.4 if path == "sandwich" else 0.25)


@pytest.mark.rest
@every_path
def test_the_residual_is_tested(path):
    found = residual_tests(found_on(path))
    assert len(found.tests) == 16
    assert all(np.isfinite(t.statistic) and 0 <= t.p_value <= 1 for t in found.tests)
    whiteness = [t.alarm for t in found.tests if t.kind == "whiteness"]
    assert all(whiteness) if path == "sandwich" else sum(whiteness) <= 1
    assert sum(t.alarm for t in found.tests if t.kind != "whiteness") <= 1


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize("path", ["free run", "known process noise", "huber", "sandwich", "multiple shooting"])
def test_free_run_and_prediction_are_scored_side_by_side(path):
    found = found_on(path)
    other = with_gaps(record(7, x0=[0.3, 0.3], **PATHS[path][1]))
    for table in (score(found, steps=(1, 5)), score(found, other, steps=(1, 5))):
        for name, outcome in table.outputs.items():
            ahead, far = outcome.ahead[1], outcome.ahead[5]
            assert 0.5 * LEVEL[name] < ahead <= 1.05 * far <= 1.1**2 * outcome.rmse
            assert (ahead < 0.85 * outcome.rmse) == (path in ("sandwich", "known process noise"))


def test_what_can_be_expected_is_what_a_fit_gives():
    expected = check(MASS, three(), noise=LEVEL).constants
    for name, stated in found_on("free run").parameters.items():
        if not stated.fixed:
            assert expected[name].std == pytest.approx(stated.std, rel=0.1)


@pytest.mark.crossed(3)
@pytest.mark.parametrize("path", ["free run", "known process noise", "estimated process noise"])
def test_a_constant_that_differs_between_such_experiments_is_named(path):
    """The spring of the second day is stiffer by a tenth, or by a quarter where chance hides more."""
    model, special, told = PATHS[path]
    one, _, whole = three(**special)
    other = 4.4 if path == "free run" else 5.0
    stiff = irregular(record(1, x0=STARTS[1], name="day 2", stiffness=other, **special))
    shifts = find(fit(model, [one, stiff, whole], **told).findings, EstimationCode.PARAMETER_NOT_CONSTANT).values[
        "shifts"
    ]
    (shift,) = [s for s in shifts if s["name"] == "K"]
    assert "experiment:'day 2'" in shift["parts"]


def dead(rows):
    """A record whose second sensor reads 3 m/s throughout."""
    data = record(1, rows=rows)
    return replace(data, outputs={**data.outputs, "v": np.full(rows, 3.0)})


@pytest.mark.crossed(3)
@pytest.mark.parametrize("path", ["noise from differences", "huber", "estimated process noise"])
@pytest.mark.parametrize("rows", [15, 240])
def test_a_dead_sensor_beside_a_moving_one_counts_for_nothing(path, rows):
    """Its differences are zero, and so would be the noise that they tell: everything would follow the dead sensor."""
    model, _, told = PATHS[path]
    choice = {k: v for k, v in told.items() if k != "noise"}
    data = dead(rows)
    found = fit(model, data, **choice)
    alone = fit(model, replace(data, outputs={"x": data.outputs["x"]}), **choice)
    assert list(found.misfit) == list(found.noise.std) == ["x"]
    for n in "BK":
        assert found.parameters[n].value == pytest.approx(alone.parameters[n].value, rel=1e-6)
        assert found.parameters[n].std == pytest.approx(alone.parameters[n].std, rel=1e-4)
    assert find(found.findings, EstimationCode.CONSTANT_OUTPUT_EXCLUDED).values["outputs"] == ["v"]
    assert list(check(MASS, data).noise) == ["x"] and "excluded: v" in text(check(MASS, data), details=True)


def test_a_dead_sensor_whose_noise_is_given_counts():
    assert fit(MASS, dead(240), noise=LEVEL).misfit["v"].noise_ratio > 30
