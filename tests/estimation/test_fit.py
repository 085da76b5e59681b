"""Constants come back; what cannot be known is said."""

import re
from dataclasses import replace

import casadi as ca
import cloudpickle
import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from greybox.base.errors import DataError, FitError, ModelError
from greybox.base.values import Finding
from greybox.data.experiment import Experiment
from greybox.data.findings import RecordCode
from greybox.data.noise.noise_model import WHITE, BoundDirection, NoiseBound, NoiseModel, NoiseSource
from greybox.estimation.findings import EstimationCode
from greybox.estimation.fit import fit
from greybox.estimation.options import FitOptions
from greybox.estimation.result import load_fit
from greybox.estimation.validate import validate
from greybox.model.balance import Balance
from greybox.model.effects.catalogue import effect
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State
from greybox.show import text
from greybox.simulation.simulate import simulate
from models.emps import emps
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder
from tests.oracles.independent import experiment, linear_record, multisine, solved_record
from tests.support.explosive import explosive
from tests.support.findings import codes, find
from tests.support.linear_regression import LINE

REST = FitOptions(at_rest=True)


def actuator_input(seed, rows=2000):
    return multisine(np.random.default_rng(seed), rows, 2.5e-4, 5, 800, 3.0)


def valve_input(rows=2000):
    t = np.arange(rows) * 0.01
    return (
        1.25 * np.cos(0.1 * np.pi * t)
        + 1.25 * np.cos(0.4 * np.pi * t)
        + 2.0 * np.cos(1.6 * np.pi * t)
        + 0.5 * np.sign(np.sin(9.1 * t))
    )


def off(model, factor, *names):
    """Start values wrong by a factor."""
    return model.start(**{n: model.values[n] * (factor if k % 2 else 1 / factor) for k, n in enumerate(names)})


@pytest.mark.parametrize("factor", [0.5, 1.5])
@pytest.mark.parametrize("options", [REST, FitOptions()], ids=["at rest", "initial state estimated"])
def test_actuator_constants_come_back_from_noise_free_data(factor, options):
    truth = micro_actuator.fix("M")
    free = [q.name for q in truth.free_parameters]
    start = truth.start(**{n: truth.values[n] * factor for n in free})
    found = fit(start, linear_record(truth, actuator_input(1), 2.5e-4), options=options)
    assert found.success, found.solver.status_message
    for n in free:
        assert found.parameters[n].value == pytest.approx(truth.values[n], rel=1e-6), n


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_pneumatic_constants_come_back_from_noise_free_data(factor):
    truth = pneumatic_cylinder.free("V_total")
    start = truth.start(**{q.name: q.value * factor for q in truth.free_parameters})
    x0 = [0.0, 0.0, truth.values["P_S"] / 2, truth.values["P_S"] / 2]
    found = fit(start, linear_record(truth, valve_input(), 0.01, x0), options=REST)
    assert found.success, found.solver.status_message
    for q in truth.free_parameters:
        assert found.parameters[q.name].value == pytest.approx(q.value, rel=1e-6), q.name


def test_noisy_constants_lie_within_three_standard_deviations_and_the_noise_is_met():
    truth = micro_actuator.fix("M", "Ra")
    noise = {"x": 2e-7, "i": 5e-3}
    data = linear_record(truth, actuator_input(2, 6000), 2.5e-4, noise=noise, seed=3)
    start = off(truth, 1.4, "K", "B", "Kf", "Kv", "La")
    for given in (noise, None):
        found = fit(start, data, noise=given)
        assert found.success, found.solver.status_message
        for q in truth.free_parameters:
            estimate = found.parameters[q.name]
            assert abs(estimate.value - q.value) < 3 * estimate.std, q.name
            assert estimate.interval[0] < estimate.value < estimate.interval[1]
        assert all(0.95 < m.noise_ratio < 1.05 for m in found.misfit.values())


def test_the_fit_leaves_its_model_alone_and_repeats_to_the_bit():
    truth = micro_actuator.fix("M", "Ra")
    data = linear_record(truth, actuator_input(2), 2.5e-4, noise={"x": 2e-7, "i": 5e-3})
    start = off(truth, 1.3, "K", "B")
    before = dict(start.values)
    one, two = fit(start, data, options=REST), fit(start, data, options=REST)
    assert start.values == before
    assert one.model.values == two.model.values
    assert one.model.values["K"] != before["K"]


def test_several_experiments_have_their_own_initial_states():
    truth = micro_actuator.fix("M", "Ra")
    noise = {"x": 2e-7, "i": 5e-3}
    starts = [[2e-5, 0.0, 0.05], [-1e-5, 0.02, 0.0], [0.0, 0.0, 0.0]]
    records = [
        linear_record(truth, actuator_input(s, 1500), 2.5e-4, x0, noise, seed=s, name=f"run {s}")
        for s, x0 in enumerate(starts)
    ]
    found = fit(off(truth, 1.3, "K", "B", "Kf"), records, noise=noise)
    assert found.success
    for trace, x0 in zip(found.traces, starts, strict=True):
        assert trace.initial_state["x"] == pytest.approx(x0[0], abs=1e-6)
        assert trace.initial_state["v"] == pytest.approx(x0[1], abs=3e-3)
    assert all(
        abs(found.parameters[q.name].value - q.value) < 3 * found.parameters[q.name].std for q in truth.free_parameters
    )


SQUARED = Model(
    "squared",
    states=[State("x", "m", 1.0, (-5.0, 5.0))],
    inputs=[Input("u", "m/s")],
    outputs=[Output("y", "m**2", lambda x, u, p: x.x**2)],
    parameters=[Parameter("k", "1/s", 2.0, (0.1, 10.0), source="a test")],
    balances=lambda x, u, p: [Balance("rate", "m/s", 1, "x", decay=-p.k * x.x, drive=u.u)],
)


def decaying(*starts):
    """Records of y = x^2, x = x0 exp(-3 t), in closed form: the sign of x0 cannot be seen."""
    t = np.arange(120) * 0.01
    return [
        Experiment.from_arrays(t, {"u": 0 * t}, {"y": (x0 * np.exp(-3 * t)) ** 2}, allow_constant_input=True)
        for x0 in starts
    ]


def test_a_fit_begins_at_the_initial_states_it_is_given():
    records, noise = decaying(2.0, 0.5), {"y": 1e-3}
    declared = fit(SQUARED, records, noise=noise)
    given = fit(SQUARED, records, noise=noise, initial=[{"x": -1.0}, {}])
    for found, signs in ((declared, (1, 1)), (given, (-1, 1))):
        assert found.parameters["k"].value == pytest.approx(3.0, rel=1e-8)
        begins = [t.initial_state["x"] for t in found.traces]
        assert begins == pytest.approx([2.0 * signs[0], 0.5 * signs[1]], rel=1e-8)
    again = fit(
        given.model,
        records,
        noise=noise,
        initial=[t.initial_state for t in given.traces],
        options=FitOptions(progressive=False),
    )
    assert again.traces[0].initial_state["x"] == pytest.approx(-2.0, rel=1e-8)
    assert again.solver.statistics["passes"] < given.solver.statistics["passes"]


WIDTH = Parameter("w", "m", 0.1, fixed=True, source="a test")


def test_a_constant_that_acts_far_from_the_records_is_not_determined():
    far = replace(
        SQUARED,
        name="far",
        parameters=[*SQUARED.parameters, Parameter("c", "m/s", 0.1, source="a test"), WIDTH],
        balances=lambda x, u, p: [
            Balance("rate", "m/s", 1, "x", decay=-p.k * x.x, drive=u.u, bump=p.c * ca.exp(-((x.x / p.w - 35) ** 2)))
        ],
    )
    found = fit(far, decaying(1.6, 1.4), noise={"y": 1e-3})
    assert found.parameters["k"].value == pytest.approx(3.0, rel=1e-6)
    assert found.parameters["c"].std is None or found.parameters["c"].std > 1e10


@pytest.mark.parametrize(
    ("initial", "options", "said"),
    [
        ([{"z": 1.0}], FitOptions(), r"squared has no state 'z'; known: x"),
        ([{"x": 1.0}] * 2, FitOptions(), "2 mappings for 1 experiment: give a sequence with one mapping"),
        ({"x": 1.0}, FitOptions(), "a bare mapping for 1 experiment: give a sequence"),
        ([{"x": 7.0}], FitOptions(), r"x = 7 m of experiment 1 \(bounds \[-5, 5\]\): give finite values within"),
        ([{"x": np.nan}], FitOptions(), "x = nan m of experiment 1"),
        ([{"x": 1.0}], REST, "at_rest=True begins 'x' at the value that the model declares; leave out one"),
    ],
)
def test_initial_states_that_do_not_go_with_the_model_are_refused(initial, options, said):
    with pytest.raises(ModelError, match=said):
        fit(SQUARED, decaying(2.0), noise={"y": 1e-3}, initial=initial, options=options)


@pytest.mark.rest
def test_gaps_and_irregular_time_do_not_move_the_constants():
    rng = np.random.default_rng(5)
    truth = micro_actuator.fix("M", "Ra")
    time = np.cumsum(rng.uniform(1.5e-4, 4e-4, 700))
    u = 2 * np.sign(np.sin(2 * np.pi * 60 * time)) + rng.normal(0, 0.5, len(time))
    data = solved_record(truth, u, time, np.zeros(3))
    outputs = {n: np.where(rng.random(len(time)) < 0.2, np.nan, y) for n, y in data.outputs.items()}
    gappy = experiment(truth, time, u[:, None], np.column_stack([outputs["x"], outputs["i"]]))
    found = fit(off(truth, 1.3, "K", "B", "Kf", "Kv", "La"), gappy, options=REST)
    assert found.success, found.solver.status_message
    assert "RK4" in found.discretisation.label
    for q in truth.free_parameters:
        assert found.parameters[q.name].value == pytest.approx(q.value, rel=2e-4), q.name
    assert found.misfit["x"].samples == np.isfinite(outputs["x"]).sum()


@pytest.mark.slow
def test_a_first_order_input_is_integrated_as_such():
    truth = micro_actuator.fix("M", "Ra") + effect("cubic_stiffness")
    truth = truth.start(K3=3e11)
    time = np.arange(500) * 2.5e-4
    data = solved_record(truth, actuator_input(3, 500), time, np.zeros(3), hold="first")
    start = truth.start(K3=0.0, K=truth.values["K"] * 1.3)
    found = fit(start, data, options=REST)
    assert found.parameters["K3"].value == pytest.approx(3e11, rel=1e-3)
    assert found.parameters["K"].value == pytest.approx(truth.values["K"], rel=1e-4)
    held = fit(start, data.with_hold("zero"), options=REST)
    assert held.misfit["x"].rmse > 100 * found.misfit["x"].rmse


def test_what_the_data_do_not_determine_is_named():
    """From u to x and i six of the seven constants are determined: M, B, K, Kf scale together."""
    data = linear_record(micro_actuator, actuator_input(1), 2.5e-4, noise={"x": 2e-7, "i": 5e-3})
    found = fit(micro_actuator, data, options=REST)
    direction = find(found.findings, EstimationCode.DIRECTION_UNDETERMINED).values["direction"]
    assert {"M", "B", "K", "Kf"} <= set(direction) and "Ra" not in direction
    assert found.parameters["M"].std is None and found.parameters["Ra"].std < 1e-2 * found.parameters["Ra"].value


def test_a_bound_that_stops_a_constant_is_reported():
    truth = micro_actuator.fix("M", "Ra")
    data = linear_record(truth, actuator_input(1), 2.5e-4)
    found = fit(truth.start(K=5000).bound(K=(10.0, 5500.0)), data, options=REST)
    assert found.parameters["K"].at_bound and found.parameters["K"].value == 5500.0
    assert "K" in find(found.findings, EstimationCode.STOPPED_BY_BOUND).values["parameters"]


def bounded_line(low=1.0):
    """A record of the line over inputs from ``low`` on, its design, and the fit with ``b`` stopped at zero."""
    u = np.random.default_rng(3).uniform(low, 2.0, 60)
    design = np.column_stack([u, u**2, np.ones(60)])
    y = design @ [1.2, -0.4, 0.7] + 0.01 * np.random.default_rng(4).normal(size=60)
    data = Experiment("line", np.arange(60) * 0.1, {"u": u}, {"y": y})
    return design, fit(LINE.start(b=0.1).bound(b=(0.0, 10.0)), data, noise={"y": 0.01}, options=REST)


def test_a_bound_that_narrows_the_other_intervals_is_told_with_the_factor():
    """Beside a free curvature the slope is known much less well than with the curvature held at zero: as the normal equations say."""
    design, found = bounded_line()
    assert found.parameters["b"].at_bound
    narrowed = find(found.findings, EstimationCode.NARROWED_BY_BOUND)
    free, held = np.linalg.inv(design.T @ design), np.linalg.inv(design[:, [0, 2]].T @ design[:, [0, 2]])
    expected = {"a": np.sqrt(free[0, 0] / held[0, 0]), "c": np.sqrt(free[2, 2] / held[1, 1])}
    assert narrowed.subject == "b" and expected["a"] > 5
    assert dict(narrowed.values["growth"]) == pytest.approx(expected, rel=1e-4)


def test_a_bound_that_the_other_intervals_do_not_rest_on_is_not_told():
    """Over inputs to both sides slope and curvature are told apart by themselves."""
    _, found = bounded_line(low=-2.0)
    assert found.parameters["b"].at_bound
    growth = find(found.findings, EstimationCode.NARROWED_BY_BOUND)
    assert growth is None or "a" not in growth.values["growth"]


def test_a_wrong_model_says_so_beside_its_status():
    t = np.arange(3000) * 1e-3
    u = 2.5 * np.sin(2 * np.pi * 0.5 * t) + np.sin(2 * np.pi * 1.7 * t)
    data = linear_record(emps, u, 1e-3, noise={"q": 1e-5})
    good = fit(emps, data)
    assert good.misfit["q"].noise_ratio < 1.1
    bad = fit(emps.fix(M=150.0), data)
    assert bad.success and bad.misfit["q"].noise_ratio > 5
    (ratio,) = bad.solver.details
    assert (ratio.code, ratio.subject) == (EstimationCode.MISFIT_RATIO, "q")
    assert ratio.values["ratio"] == bad.misfit["q"].noise_ratio
    assert {EstimationCode.MISFIT_ABOVE_NOISE, EstimationCode.RESIDUAL_CORRELATED} <= codes(bad.findings)


def sprung_mass():
    """A mass on a spring and damper whose displacement and speed are measured, and 12 s of steps of force."""

    def balances(x, u, p):
        return [
            Balance("pos", "m/s", 1, "x", v=x.v),
            Balance("force", "N", p.M, "v", drive=u.F, spring=-p.K * x.x, damping=-p.B * x.v),
        ]

    states = [State("x", "m"), State("v", "m/s")]
    outputs = [Output("x", "m"), Output("v", "m/s", lambda x, u, p: x.v)]
    parameters = [Parameter("M", "kg", 1.0, fixed=True), Parameter("B", "N*s/m", 2.0), Parameter("K", "N/m", 20.0)]
    model = Model("sprung_mass", states, [Input("F", "N")], outputs, parameters, balances)
    rng = np.random.default_rng(3)
    record = Experiment("r", 0.002 * np.arange(6000), {"F": np.repeat(rng.normal(size=30), 200)}, {})
    return model, record.with_outputs(simulate(model, record).outputs), rng


def test_a_true_model_of_a_filtered_record_lacks_nothing():
    model, clean, rng = sprung_mass()
    # A filter of 5 Hz, far below half the sampling rate, over signal and noise.
    filtered = sosfiltfilt(butter(4, 5, fs=500, output="sos"), clean.outputs["x"] + 5e-3 * rng.normal(size=6000))
    record = clean.with_outputs({"x": filtered, "v": clean.outputs["v"] + 0.02 * rng.normal(size=6000)})
    found = fit(model.start(B=1.0, K=15.0), record, options=FitOptions(at_rest=True))
    assert found.misfit_at_least["x"] < 1.3
    wrong = {EstimationCode.MISFIT_ABOVE_NOISE, EstimationCode.MISFIT_ABOVE_DIFFERENCE_NOISE}
    assert not (wrong | {EstimationCode.PARAMETER_NOT_CONSTANT}) & codes(found.findings)


def test_the_worst_output_is_the_one_with_the_largest_ratio_that_is_told():
    model, clean, rng = sprung_mass()
    noisy = {name: clean.outputs[name] + std * rng.normal(size=6000) for name, std in {"x": 0.01, "v": 0.02}.items()}
    # Of x no more than a ceiling is known: it is weighed with a fifth of its noise, which is 0.8 of the ceiling.
    bounds = {"x": NoiseBound(0.0125, BoundDirection.AT_MOST, NoiseSource.SPECTRUM)}
    sources = {"x": NoiseSource.SPECTRUM, "v": NoiseSource.FLAT_PIECES}
    noise = NoiseModel(("x", "v"), np.array([0.002, 0.022]), sources, (WHITE, WHITE), False, bounds)
    found = fit(model, clean.with_outputs(noisy), noise=noise, options=FitOptions(at_rest=True))
    (ratio,) = found.solver.details
    assert ratio.subject == "v" and ratio.values["ratio"] == pytest.approx(0.909, rel=0.05)
    assert found.misfit_at_least["x"] == found.misfit["x"].noise_ratio == pytest.approx(0.8, rel=0.05)
    assert found.misfit["x"].rmse > 4 * found.noise.std["x"]


@pytest.mark.rest
def test_a_column_in_another_unit_or_of_the_other_sign_is_no_plant_of_this_model():
    record = linear_record(micro_actuator, actuator_input(3), 2.5e-4, noise={"x": 1e-7, "i": 1e-3}, seed=3)
    free = micro_actuator.fix("M", "Ra")
    assert EstimationCode.MODEL_DOES_NOT_FOLLOW not in codes(fit(free, record).findings)
    for wrong in (1e6, -1.0):
        other = replace(record, outputs={"x": wrong * record.outputs["x"], "i": record.outputs["i"]})
        assert EstimationCode.MODEL_DOES_NOT_FOLLOW in codes(fit(free, other).findings)


def test_validation_estimates_only_the_initial_state_from_the_first_rows():
    truth = micro_actuator.fix("M", "Ra")
    noise = {"x": 2e-7, "i": 5e-3}
    other = linear_record(truth, actuator_input(8), 2.5e-4, [3e-5, 0.0, 0.1], noise, seed=9)
    judged = validate(truth, other, noise=noise, skip=40)
    assert judged.misfit["x"].noise_ratio == pytest.approx(1, abs=0.1)
    assert judged.misfit["x"].samples == 2000 - 40
    resting = validate(truth, other, noise=noise, options=REST)
    assert resting.misfit["x"].noise_ratio > 3
    with pytest.raises(DataError, match="skip: 5000 rows, but the shortest validation record has 2000"):
        validate(truth, other, skip=5000)


@pytest.mark.parametrize(("low", "high", "beyond"), [(-1, 1, 0.0), (-0.9, 1.05, 0.0), (1.2, 3, 1.0), (-1, 3, 0.45)])
def test_an_error_on_records_that_reach_where_none_was_fitted_is_said_to_be_that(low, high, beyond):
    rng, time = np.random.default_rng(3), np.arange(400) * 0.1

    def record(name, start, stop, scale=1.0):
        u = np.linspace(start, stop, 400)
        # An exponential curve, which the parabola of the model follows where it was fitted, and nowhere else.
        return Experiment(name, time, {"u": u}, {"y": scale * np.exp(2 * u) + rng.normal(0, 0.2, 400)})

    judging = record("other", low, high, scale=1.0 if beyond else 0.3)
    answer = fit(LINE, record("r", -1, 1), validation=judging, noise={"y": 0.2}, options=FitOptions(at_rest=True))
    assert EstimationCode.VALIDATION_ERROR_LARGER in codes(answer.findings)
    if not beyond:  # here the plant has changed
        assert EstimationCode.VALIDATION_BEYOND_RANGE not in codes(answer.findings)
        return
    found = find(answer.findings, EstimationCode.VALIDATION_BEYOND_RANGE)
    # Of u beyond 1.2, of y beyond exp(2) and a tenth: u = 1.05.
    assert found.values["share"] == pytest.approx(beyond, abs=0.06)
    assert found.values["most"] > found.values["high"]


def test_a_fit_is_saved_and_loaded_without_loss(tmp_path):
    truth = micro_actuator.fix("M", "Ra") + effect("constant_load")
    data = linear_record(truth, actuator_input(1, 400), 2.5e-4, noise={"x": 2e-7, "i": 5e-3})
    found = fit(truth, data, validation=data)
    again = load_fit(found.save(tmp_path / "a" / "fit.json"), truth)
    assert again.model.values == found.model.values
    assert again.validation.misfit == found.validation.misfit and again.uncertainty.kind == found.uncertainty.kind
    for name in (
        "parameters",
        "misfit",
        "solver",
        "noise",
        "discretisation",
        "provenance",
        "constraints",
        "robust",
        "findings",
    ):
        assert getattr(again, name) == getattr(found, name), name
    assert np.array_equal(again.uncertainty.covariance, found.uncertainty.covariance, equal_nan=True)
    assert np.array_equal(again.traces[0].simulated["x"], found.traces[0].simulated["x"])
    with pytest.raises(DataError, match="belongs to the model micro_actuator \\+ constant_load, not to micro_actuator"):
        load_fit(tmp_path / "a" / "fit.json", micro_actuator)


def test_a_model_that_cannot_be_simulated_from_its_start_says_where():
    model = explosive()
    t = np.arange(100) * 0.1
    data = experiment(model, t, np.ones((100, 1)), np.cos(t)[:, None])
    alone = replace(REST, other_starts=0)  # from another start it can
    found = fit(model, data, options=alone)
    assert not found.success and found.status == "no_start"
    (failure,) = found.solver.details
    assert failure.code in (EstimationCode.TERM_NOT_FINITE, EstimationCode.STATES_DIVERGE)
    assert (failure.values["time"], failure.values["row"]) == (0.0, 1)
    with pytest.raises(FitError, match="cannot be simulated from the start values"):
        fit(model, data, options=alone, raise_on_failure=True)


def test_bad_arguments_are_refused_in_words():
    data = linear_record(micro_actuator, actuator_input(1, 200), 2.5e-4)
    with pytest.raises(ModelError, match=r"noise of 'y': the model has no such output; .*x"):
        fit(micro_actuator, data, noise={"y": 1.0})
    with pytest.raises(ModelError, match="not a positive standard deviation"):
        fit(micro_actuator, data, noise={"x": 0.0})
    with pytest.raises(DataError, match="no experiment"):
        fit(micro_actuator, [])


def test_a_fit_is_read_only_and_can_be_copied():
    truth = micro_actuator.fix("M", "Ra")
    data = linear_record(truth, actuator_input(1, 400), 2.5e-4, noise={"x": 2e-7, "i": 5e-3})
    found = fit(truth, data)
    for mapping in (
        found.parameters,
        found.misfit,
        found.provenance.options,
        found.solver.statistics,
        found.traces[0].simulated,
    ):
        with pytest.raises(TypeError, match="does not support item assignment"):
            mapping["K"] = 1.0
    for array in (found.uncertainty.covariance, found.traces[0].time, found.traces[0].simulated["x"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    again = cloudpickle.loads(cloudpickle.dumps(found.traces[0]))
    assert again.fingerprint == found.traces[0].fingerprint
    np.testing.assert_array_equal(again.simulated["x"], found.traces[0].simulated["x"])
    with pytest.raises(TypeError, match="does not support item assignment"):
        again.simulated["x"] = 0.0
    assert dict(found.provenance.options) | {"at_rest": True} == {**found.provenance.options, "at_rest": True}


def test_what_is_odd_about_a_record_stands_in_the_fit():
    truth = micro_actuator.fix("M", "Ra")
    remark = (Finding(RecordCode.COLUMNS_IGNORED, values={"columns": ["temp"]}),)
    odd = [
        replace(
            linear_record(truth, actuator_input(1, 400), 2.5e-4, noise={"x": 2e-7, "i": 5e-3}, seed=seed),
            name=name,
            findings=remark,
        )
        for seed, name in enumerate("ab")
    ]
    remark = fit(truth, odd, options=REST).findings[-1]
    assert remark.code == RecordCode.COLUMNS_IGNORED and list(remark.values["records"]) == ["a", "b"]


@pytest.mark.parametrize("kind", ["decay", "drift"])
def test_what_records_do_not_determine_is_told_in_words_and_not_as_a_number_that_is_none(kind):
    """Without input its gain has no influence: no interval, nothing widened "up to nan times"."""
    rig = Model(
        "rig",
        [State("x", "m", 1.0)],
        [Input("u", "m")],
        [Output("x", "m")],
        [Parameter("T", "s", 0.1, (1e-3, 10.0)), Parameter("a", "1", 1.0, (1e-3, 1e3))],
        lambda x, u, p: [Balance("lag", "m", p.T, "x", drive=p.a * u.u, own=-x.x)],
    )
    rng, t = np.random.default_rng(0), 0.01 * np.arange(200)
    noise = rng.normal(size=200)
    answer = np.exp(-t / 0.1) + 1e-3 * noise if kind == "decay" else np.cumsum(noise)
    said = text(fit(rig, Experiment("free", t, {"u": 0 * t}, {"x": answer})), details=True)
    assert "a has no influence" in said
    assert not re.search(r"\b(nan|inf)\b", said)
