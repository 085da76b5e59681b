"""A design keeps every limit, brings what it predicts, and refuses what cannot be."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import DataError, GreyboxError, ModelError
from greybox.base.json_shape import to_json_data
from greybox.data.noise.noise_model import DETECTION_RATIO, BoundDirection
from greybox.data.signals import SignalLimit
from greybox.extensions.design.adjoint import SensitivityRun
from greybox.extensions.design.goals import HiddenEffect, make_detection, make_discrimination, make_precision
from greybox.extensions.design.plant import make_plant
from greybox.extensions.design.problem import Design, DesignCode, DesignPolicy, DesignProblem, GoalName
from greybox.simulation.simulate import read_inputs
from tests.support.oscillator import oscillator
from tests.support.result_schema import strict_offences

REST = gb.FitOptions(at_rest=True)
POLICY = DesignPolicy()
QUICK = replace(
    POLICY,
    bands=2,
    iterations=6,
    rounds=2,
    starts=1,
    refined_scenarios=1,
    crest_iterations=40,
    scenarios=2,
)
PLANT = oscillator("rig", 1.0, 25.0, 500.0, 1.0)
ASKED = {"duration": 8.0, "sampling_time": 0.05, "noise": {"x": 1e-3}, "options": REST, "policy": QUICK}
LIMITS = {"u": SignalLimit(-2, 2, rate=20.0), "x": SignalLimit(-0.15, 0.15), "v": SignalLimit(-1, 1)}


@pytest.fixture(scope="module")
def plan() -> Design:
    return gb.design(PLANT, limits=LIMITS, **ASKED)


def test_limits_hold_at_the_best_constants_and_at_uncertain_ones(plan) -> None:
    generator = np.random.default_rng(5)
    u = plan.experiment.inputs["u"]
    assert np.abs(u).max() <= 2 and np.abs(np.diff(u)).max() / 0.05 <= 20 * (1 + 1e-9)
    for k in range(9):
        spread = 0.2 * generator.standard_normal(4) * (k > 0)
        values = {n: v * np.exp(s) for (n, v), s in zip(PLANT.values.items(), spread, strict=True)}
        run = gb.simulate(PLANT.start(**values), plan.experiment)
        share = 1.0 if k == 0 else 1.3  # a draw may be rarer than the margin
        assert np.abs(run.outputs["x"]).max() <= 0.15 * share and np.abs(run.states["v"]).max() <= 1.0 * share
    usages = {name: limit.usage for name, limit in plan.limits.items()}
    assert max(usages.values()) == pytest.approx(1.0, abs=0.05)


def test_it_begins_and_ends_at_rest(plan) -> None:
    u = plan.experiment.inputs["u"]
    assert u[0] == 0 and np.all(u[-2:] == 0) and np.abs(u[1]) < 0.5 * np.abs(u).max()


def test_it_brings_more_than_every_other_kind_of_input(plan) -> None:
    others = [a for a in plan.alternatives if a.kind == "input"]
    assert {"chirp", "PRBS", "steps", "multisine", "staircase"} <= {a.name for a in others} | {plan.kind}
    assert all(a.gain <= 1 for a in others)
    twice = next(a.gain for a in plan.alternatives if a.kind == "repeat")
    assert twice == pytest.approx(np.sqrt(2), rel=0.02)


@pytest.mark.rest
def test_the_predicted_width_is_that_of_simulated_experiments(plan) -> None:
    """Twenty simulated experiments, each fitted: the spread of the estimates is the predicted one within its own error."""
    names, estimates = list(plan.predicted), []
    run = gb.simulate(PLANT, plan.experiment)
    for seed in range(20):
        record = run.record({"x": 1e-3}, np.random.default_rng(seed))
        result = gb.fit(PLANT, record, noise={"x": 1e-3}, options=REST)
        estimates.append([result.parameters[n].value for n in names])
    spread = np.std(estimates, axis=0, ddof=1)
    predicted = np.array([plan.predicted[n].std_after for n in names])
    assert np.sqrt(np.mean((spread / predicted) ** 2)) == pytest.approx(1.0, abs=0.25)  # chance alone: 0.16 / sqrt(4)


def test_information_of_earlier_records_is_added() -> None:
    record = gb.simulate(PLANT, {"time": 0.05 * np.arange(160), "u": np.sin(0.05 * np.arange(160))})
    fit = gb.fit(PLANT, record.record({"x": 1e-3}, np.random.default_rng(1)), noise={"x": 1e-3}, options=REST)
    after = gb.design(fit, limits={"u": (-1, 1)}, policy=QUICK)
    for name, constant in after.predicted.items():
        white = fit.parameters[name].std / fit.uncertainty.inflation.get(name, 1.0)
        assert constant.std_before == pytest.approx(white, rel=0.01)
        assert constant.std_after < constant.std_before
    assert after.experiment.rows == 160 and after.experiment.sampling_time == pytest.approx(0.05)
    chosen = gb.design(fit, limits={"u": (-1, 1)}, constants=["d"], policy=QUICK)
    assert chosen.predicted["d"].std_after <= 1.02 * after.predicted["d"].std_after


def test_a_ceiling_of_the_noise_widens_nothing() -> None:
    """Where the records have no more than a ceiling of the noise, a fit whose error is below it tells more."""
    time = 0.1 * np.arange(200)
    steps = np.repeat(np.random.default_rng(3).choice([-1.0, 1.0], 100), 2)
    record = gb.simulate(PLANT, {"time": time, "u": steps}).record({"x": 1e-4}, np.random.default_rng(1))
    fit = gb.fit(PLANT, record, options=REST)
    assert fit.misfit["x"].direction is BoundDirection.AT_MOST and fit.noise.std["x"] > 2e-4
    plan = gb.design(fit, limits={"u": (-1, 1)}, policy=QUICK)
    for name, constant in plan.predicted.items():
        white = fit.parameters[name].std / fit.uncertainty.inflation.get(name, 1.0)
        assert constant.std_before == pytest.approx(white, rel=0.05)


def test_a_model_that_falls_short_is_known_as_its_fit_says_and_no_better() -> None:
    """What the fit prints as standard deviations is what the design begins with, though the sensor's noise is far smaller."""
    time = 0.05 * np.arange(160)
    record = gb.simulate(PLANT, {"time": time, "u": np.sin(time)})
    disturbed = record.record({"x": 1e-3}, np.random.default_rng(1))
    disturbed = disturbed.with_outputs({"x": disturbed.outputs["x"] + 4e-3 * np.sin(7 * time)})
    fit = gb.fit(PLANT.fix("c"), disturbed, noise={"x": 1e-3}, options=REST)
    assert fit.misfit["x"].noise_ratio > 2
    plan = gb.design(fit, limits={"u": (-1, 1)}, policy=QUICK)
    for name, constant in plan.predicted.items():
        assert constant.std_before == pytest.approx(fit.parameters[name].std, rel=1e-6)
        assert constant.std_after < constant.std_before


def test_a_model_that_does_not_follow_its_records_is_no_guard_of_limits() -> None:
    time = 0.05 * np.arange(160)
    record = gb.simulate(PLANT, {"time": time, "u": np.sin(time)}).record({"x": 1e-3}, np.random.default_rng(1))
    moved = record.outputs["x"]
    for disturbance, warned in ((0.0, False), (3.0, True)):
        stranger = record.with_outputs({"x": moved + disturbance * np.std(moved) * np.sin(2.3 * time)})
        fit = gb.fit(PLANT.fix("c"), stranger, noise={"x": 1e-3}, options=REST)
        plan = gb.design(fit, limits={"u": (-1, 1)}, policy=QUICK)
        assert any(f.code == DesignCode.MODEL_FALLS_SHORT for f in plan.findings) is warned


def test_rivals_are_told_apart_better_than_by_the_other_kinds() -> None:
    soft = PLANT.start(c=1e-3, k=28.0).fix("c")
    plan = gb.design(
        PLANT,
        rivals=[soft],
        limits=LIMITS,
        goal="discrimination",
        **ASKED,
    )
    assert plan.goal == "discrimination" and len(plan.separation) == 1
    assert all(a.gain <= 1 for a in plan.alternatives if a.kind == "input")


def test_small_amounts_are_seen() -> None:
    model = gb.Model(
        "mass",
        [gb.State("x", "m", role="displacement"), gb.State("v", "m/s", role="velocity")],
        [gb.Input("F", "N", role="drive")],
        [gb.Output("x", "m")],
        [gb.Parameter("m", "kg", 1.0, (0.1, 10.0), role="mass"), gb.Parameter("d", "N*s/m", 0.5, (1e-3, 10.0)),
         gb.Parameter("k", "N/m", 10.0, (0.1, 100.0), role="stiffness")],
        lambda x, u, p: [
            gb.Balance("position", "m/s", 1, "x", velocity=x.v),
            gb.Balance("force", "N", p.m, "v", drive=u.F, damping=-p.d * x.v, spring=-p.k * x.x),
        ],
    )  # fmt: skip
    plan = gb.design(
        model, goal="detection", effects=["cubic_stiffness"], limits={"F": (-1, 1), "x": (-0.2, 0.2)}, **ASKED
    )
    found_amount = plan.detection["cubic_stiffness"]
    assert found_amount.unit == "N/m^3" and found_amount.before is None
    # What is predicted is what a fit of the model with that effect says of it.
    extended = model + gb.effect("cubic_stiffness")
    name = (
        extended.bound_effects[-1].model_names[found_amount.parameter]
        if found_amount.parameter not in extended.values
        else found_amount.parameter
    )
    truth = extended.start(**{name: 2 * found_amount.after})
    record = gb.simulate(truth, plan.experiment).record({"x": 1e-3}, np.random.default_rng(3))
    fit = gb.fit(truth, record, noise={"x": 1e-3}, options=REST)
    assert DETECTION_RATIO * fit.parameters[name].std == pytest.approx(found_amount.after, rel=0.3)


GOALS = {
    "precision": lambda q, step: make_precision(q, 1, step),
    "discrimination": lambda q, step: make_discrimination(q, 1, step),
    "detection": lambda q, step: make_detection(q, [HiddenEffect("c", PLANT, "c", "1")], 1, step),
}


@pytest.mark.parametrize("kernel", ["", "interpreted"])
@pytest.mark.parametrize("goal", GOALS)
def test_the_gradient_of_a_goal_is_that_of_finite_differences(goal: str, kernel: str, monkeypatch) -> None:
    monkeypatch.setenv("GREYBOX_KERNEL", kernel)
    from greybox.extensions.design.adjoint import make_loops

    make_loops.cache_clear()
    rival = PLANT.start(c=0.5, d=1.4)
    asked = DesignProblem(
        (PLANT, rival),
        {"u": SignalLimit(-2, 2)},
        2.0,
        0.05,
        {"x": 1e-3},
        goal=GoalName(goal),
        options=REST,
        policy=QUICK,
    )
    made = GOALS[goal](asked, None)
    u = np.random.default_rng(2).uniform(-1, 1, asked.rows)

    def value(signal):
        return made.value([SensitivityRun(p, {"u": signal}) for p in made.plants])

    runs = [SensitivityRun(p, {"u": u}) for p in made.plants]
    told, slopes_of_runs = made.differentiate(runs)
    assert told == made.value(runs)
    gradient = sum(
        run.gradient(y, slopes, np.zeros(run.states.shape))[0]
        for run, (y, slopes) in zip(runs, slopes_of_runs, strict=True)
    )
    for k in (0, 11, asked.rows - 3):
        step = 1e-4 * (np.arange(asked.rows) == k)
        assert gradient[k] == pytest.approx((value(u + step) - value(u - step)) / 2e-4, rel=1e-4, abs=1e-6)


def test_a_run_is_that_of_the_kernel() -> None:
    asked = DesignProblem((PLANT,), {"u": SignalLimit(-2, 2)}, 2.0, 0.05, {"x": 1e-3}, options=REST)
    plant = make_plant(asked, PLANT)
    u = {"u": np.random.default_rng(2).uniform(-1, 1, asked.rows)}
    run, same = SensitivityRun(plant, u), plant.run(u)
    np.testing.assert_allclose(run.slopes, same.slopes, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(run.states, same.states, rtol=1e-9, atol=1e-15)


def test_its_files_are_as_the_schema_says_and_can_be_played(plan, tmp_path) -> None:
    written = plan.save(tmp_path / "next")
    assert strict_offences(json.loads(written.read_text()), Design) == []
    data = to_json_data(plan)
    assert data["input"] == "input.csv" and set(data["predicted"]["k"]) == {"value", "std_before", "std_after", "unit"}
    played = read_inputs(tmp_path / "next" / "input.csv", PLANT)
    np.testing.assert_array_equal(played.inputs["u"], plan.experiment.inputs["u"])
    page = gb.report(plan, tmp_path / "page.html").read_text(encoding="utf-8")
    assert "The next record of rig" in page and "Twice as much means" in page


@pytest.mark.rest
def test_the_same_question_has_the_same_answer() -> None:
    one, other = (gb.design(PLANT, limits={"u": (-1, 1)}, **ASKED) for _ in range(2))
    np.testing.assert_array_equal(one.experiment.inputs["u"], other.experiment.inputs["u"])


BAD = [
    ({"limits": {}}, DataError, "input 'u' has no limits"),
    ({"limits": {"u": (-1, 1), "z": (0, 1)}}, ModelError, "limit of 'z': no such signal"),
    ({"limits": {"u": (1, 1)}}, DataError, "no input may move"),
    ({"limits": {"u": (-1, 1), "x": (0.1, 0.2)}}, DataError, "limit of 'x': the plant starts at 0, outside"),
    ({"limits": {"u": (-1, 1), "x": SignalLimit(-1, 1, 5.0)}}, ModelError, "rate of 'x': only an input"),
    ({"limits": {"u": (0.5, 1), "x": (-1e-6, 1e-6)}}, DataError, "limit of 'x': no input keeps"),
    (
        {"limits": {"u": (-1, 1), "x": (-math.inf, -1e-6)}},
        DataError,
        "the plant starts at 0, outside at most -1e-06; no input",
    ),
    ({"duration": 0.5}, DataError, "0.5 s every 0.05 s are 10 rows; give 40 to"),
    ({"duration": 1e9}, DataError, "rows; give 40 to 200000"),
    ({"noise": {}}, DataError, "the noise of no output is known"),
    ({"noise": {"y": 1.0}}, ModelError, "noise of 'y'"),
    ({"noise": {"x": -1.0}}, DataError, "noise of 'x': -1 is no standard deviation"),
    ({"constants": ["q"]}, ModelError, "constant 'q': not among the free ones"),
    ({"goal": "speed"}, ModelError, "'speed' is unknown"),
    ({"goal": "discrimination"}, DataError, "discrimination needs two explanations"),
    ({"goal": "discrimination", "rivals": ["cubic_stiffness"]}, DataError, "there are none; give records or a fit"),
    ({"goal": "detection", "effects": ["chamber_leakage"]}, GreyboxError, "chamber_leakage"),
]


@pytest.mark.parametrize(("change", "error", "message"), BAD, ids=[message[:30] for *_, message in BAD])
def test_what_cannot_be_is_refused_in_one_sentence(change, error, message) -> None:
    asked = {"limits": {"u": (-1, 1)}, **ASKED, **change}
    with pytest.raises(error, match=message) as caught:
        gb.design(PLANT, **asked)
    assert "\n" not in str(caught.value)
