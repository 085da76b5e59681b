"""Constants by record and the conditions of the records: against simulated records of a known law, drawn by an independent integrator."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from greybox import Balance, Experiment, Input, Model, Output, Parameter, State, fit, load_fit
from greybox.base.errors import ModelError
from greybox.estimation.findings import EstimationCode
from greybox.estimation.record_trends import TrendKind, find_trend

NOISE = 2e-3


def slide():
    return Model(
        "slide",
        states=[State("v", "m/s", role="velocity")],
        inputs=[Input("F", "N", role="drive")],
        outputs=[Output("v", "m/s")],
        parameters=[
            Parameter("M", "kg", 1.0, (1e-3, 1e3), fixed=True),
            Parameter("B", "N*s/m", 1.0, (1e-3, 1e3)),
            Parameter("F0", "N", 0.1, (-100.0, 100.0)),
        ],
        balances=lambda x, u, p: [Balance("force", "N", p.M, "v", drive=u.F, drag=-p.B * x.v, load=-p.F0)],
    )


def run(name, seed, damping, offset, **conditions):
    """Speed under a held random force, by SciPy's integrator of variable step, with sensor noise."""
    generator, dt = np.random.default_rng(seed), 0.05
    time, force = dt * np.arange(200), np.repeat(generator.normal(size=40), 5)
    speed, path = 0.0, []
    for k in range(len(time)):
        path.append(speed)
        rate = lambda t, v, held=force[k]: held - damping * v - offset  # noqa: E731
        speed = solve_ivp(rate, (0, dt), [speed], rtol=1e-9, atol=1e-12).y[0, -1]
    shown = np.array(path) + NOISE * generator.normal(size=len(path))
    return Experiment(name, time, {"F": force}, {"v": shown}, conditions=conditions)


def trends(found):
    return {f.subject: f for f in found.findings if f.code == EstimationCode.VALUES_BY_RECORD}


def test_a_constant_that_grows_with_the_load_is_said_to_and_one_that_does_not_is_one_value(tmp_path):
    loads = (1.0, 2.0, 4.0, 6.1)
    records = [run(f"run {k}", k, 0.8, 0.1 * load, load=load) for k, load in enumerate(loads)]
    found = fit(slide(), records, noise={"v": NOISE}, per_experiment=["B", "F0"])
    said = trends(found)
    assert said["B"].values["kind"] == TrendKind.ALIKE and said["B"].values["at"][0] == pytest.approx(0.8, rel=0.02)
    values = said["F0"].values
    assert values["kind"] == TrendKind.PROPORTIONAL and values["condition"] == "load"
    assert values["ratio"] == pytest.approx(6.1, rel=0.05)
    assert "F0 grows in proportion to load: 6." in str(said["F0"]) and "at 6.1 times the load" in str(said["F0"])
    assert "one value of B does for all 4 records: 0.8" in str(said["B"])
    assert [f.subject for f in found.findings if f.code == EstimationCode.CONDITION_OF_RECORDS] == ["load"]
    again = load_fit(found.save(tmp_path / "fit.json"), slide())
    assert {n: str(f) for n, f in trends(again).items()} == {n: str(f) for n, f in said.items()}


def test_a_constant_that_follows_no_condition_is_said_to_differ():
    given = zip((0.2, 0.5, 0.1, 0.6, 0.3), (1.0, 2.0, 3.0, 4.0, 5.0), strict=True)
    records = [run(f"run {k}", k, 0.8, load, temperature=t) for k, (load, t) in enumerate(given)]
    said = trends(fit(slide(), records, noise={"v": NOISE}, per_experiment=["F0"]))
    assert said["F0"].values["kind"] == TrendKind.DIFFERENT and not said["F0"].values["condition"]
    assert "follows no condition" in str(said["F0"])


def test_two_records_show_that_a_constant_differs_and_no_law():
    records = [run(f"run {k}", k, 0.8, 0.1 * load, load=load) for k, load in enumerate((1.0, 3.0))]
    said = trends(fit(slide(), records, noise={"v": NOISE}, per_experiment=["F0"]))["F0"]
    assert said.values["kind"] == TrendKind.PAIR and said.values["ratio"] == pytest.approx(3.0, rel=0.1)
    assert "two records show no more than that they differ" in str(said)


def test_a_condition_that_is_nearly_a_constant_of_the_model_is_a_mistake():
    records = [run(f"run {k}", k, 0.8, 0.1, f0=1.0) for k in range(2)]
    with pytest.raises(ModelError, match="condition 'f0' is not a parameter of slide; did you mean 'F0'"):
        fit(slide(), records, noise={"v": NOISE})


@pytest.mark.slow
def test_equal_values_are_said_to_differ_and_to_follow_a_condition_as_often_as_stated():
    generator, load = np.random.default_rng(5), np.arange(6.0)
    kinds = []
    for _ in range(2000):
        spread = generator.uniform(0.05, 0.2, size=6)
        trend = find_trend(1 + spread * generator.normal(size=6), np.diag(spread**2), {"load": load})
        kinds.append(trend.kind)
    assert np.mean([k is not TrendKind.ALIKE for k in kinds]) == pytest.approx(0.01, abs=0.007)
    # Values that differ from record to record by more than their intervals follow a condition by chance as often.
    kinds = [find_trend(1 + generator.normal(size=6), 0.05**2 * np.eye(6), {"load": load}).kind for _ in range(2000)]
    assert np.mean([k in (TrendKind.LINEAR, TrendKind.PROPORTIONAL) for k in kinds]) == pytest.approx(0.01, abs=0.007)


def test_levels_that_were_repeated_show_what_rises_on_no_line():
    voltage = np.repeat([0.0, 1.0, 2.0, 3.0], 3)
    values = np.array([1.0, 1.1, 1.2, 1.9, 2.0, 2.1, 2.0, 2.1, 2.2, 40.0, 41.0, 42.0])
    trend = find_trend(values, 0.05**2 * np.eye(12), {"voltage": voltage})
    assert trend.kind == TrendKind.LINEAR and trend.condition == "voltage"
    together = find_trend(2 * voltage, 0.05**2 * np.eye(12), {"voltage": voltage, "day": 3 * voltage + 1})
    assert {together.condition, *together.also} == {"voltage", "day"}
