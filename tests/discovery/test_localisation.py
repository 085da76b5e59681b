"""Where, when and as a function of what the residual lives. The rig is simulated without greybox."""

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.values import with_code
from greybox.discovery.curve_shape import Parity, ShapeKind, classify_shape, rank_dependences
from greybox.discovery.disturbance_sites import linearise_run
from greybox.discovery.execution import RefitOutcome
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.localisation import (
    CONCENTRATED_TIME,
    LOCALISATION_WINDOWS,
    MisfitWindow,
    divide_misfit,
    find_concentration,
    find_worst_stretch,
    localise_residual,
)
from greybox.discovery.problem import DiscoveryProblem
from models.micro_actuator import micro_actuator
from tests.support.hidden_rigs import AT_REST, plain_model, simulate_records

MOTOR = Model(
    "motor",
    states=[State("y", "rad/s", role="velocity")],
    inputs=[Input("u", "V", role="drive")],
    outputs=[Output("y", "rad/s")],
    parameters=[Parameter("b", "rad/(V*s^2)", 5.0, (0.1, 100.0)), Parameter("a", "1/s", 3.0, (0.1, 100.0))],
    balances=lambda x, u, p: [Balance("torque", "rad/s^2", 1, "y", motor=p.b * u.u, drag=-p.a * x.y)],
)
NOISE = {"x": 2e-7, "i": 5e-3}


def localise(effects):
    train, _ = simulate_records(micro_actuator, effects, tuple(NOISE.values()), rows=1200)
    return localise_residual(gb.fit(plain_model(micro_actuator), train, noise=NOISE, options=AT_REST))


@pytest.mark.rest
def test_dry_friction_is_localised_in_the_force_balance_over_the_velocity():
    location = localise({"coulomb_friction": {"Fc": 0.05}})
    assert location.is_missing
    assert location.likeliest[0] == "balance force"
    assert location.dependences[0].variable == "v"
    assert location.dependences[0].shape.parity is Parity.ODD
    assert location.dependences[0].is_relevant
    assert sum(w.share for w in location.windows) == pytest.approx(1)
    # The friction has 0.05 N throughout; what a viscous damper could do of it is fitted already.
    assert 0.01 < location.sites[0].size < 0.05
    # Drive and voltage balance are one input direction: no sensor can ever tell them apart.
    gains = {site.label: site.gain for site in location.sites}
    assert gains["input u"] == pytest.approx(gains["balance voltage"])


def test_a_run_that_goes_astray_is_located_nowhere():
    """A growth without its limit: after 1 s the run is at exp(400), whose square is no number."""
    growth = Model(
        "growth",
        states=[State("x", "m", 1.0)],
        inputs=[],
        outputs=[Output("x", "m")],
        parameters=[Parameter("k", "1/s", 400.0, fixed=True)],
        balances=lambda x, u, p: [Balance("mass", "m/s", 1, "x", growth=p.k * x.x)],
    )
    time = np.linspace(0, 1, 200)
    record = gb.Experiment("logistic", time, {}, {"x": 100 / (1 + 99 * np.exp(-20 * time))})
    problem = DiscoveryProblem(growth, (record,), {"x": 0.01}, (), gb.FitOptions(at_rest=True))
    located = localise_residual(problem.restore(growth, RefitOutcome({"k": 400.0}, ((1.0,),), 0)))
    assert located.is_missing and not located.sites and not located.windows


def test_a_complete_model_leaves_nothing_to_localise():
    location = localise({})
    assert not location.is_missing
    assert location.sites == location.likeliest == location.dependences == ()
    assert location.timing is None


@pytest.mark.parametrize(
    "effect", [{"backlash": {"gap": 0.1}}, {"input_hysteresis": {"h": 0.1}}], ids=["output", "input"]
)
def test_play_does_not_hide_from_its_sensor_what_drives_it(effect):
    """The linearised response through play that slides is that of the motor without it, up to the first sample."""
    rows, rng = 400, np.random.default_rng(3)
    time = 0.01 * np.arange(rows)
    u = np.cumsum(rng.normal(size=rows)) / 10
    model = (MOTOR + gb.effect(next(iter(effect)))).start(**next(iter(effect.values())))
    run = gb.simulate(model, {"time": time, "u": u})
    record = gb.Experiment("run", time, {"u": u}, {"y": run.outputs["y"] + 1e-3 * rng.normal(size=rows)})
    candidate = DiscoveryProblem(model, (record,), {"y": 1e-3}, (), gb.FitOptions()).baseline
    line = linearise_run(candidate, 0, 0, rows)
    site = next(s for s in line.gamma if s.name == "u")
    response = np.zeros(len(line.x[0]))
    for k in range(20):  # an affine model has one entry for all samples
        response = line.phi[min(k, len(line.phi) - 1)] @ response + line.gamma[site][min(k, len(line.phi) - 1)]
    values = candidate.model.values
    expected = values["b"] / values["a"] * (1 - np.exp(-values["a"] * 0.2))
    assert line.c[-1, 0] @ response == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("curve", "parity", "kind", "position"),
    [
        (lambda z: np.sign(z), Parity.ODD, ShapeKind.STEP, None),
        (lambda z: 3 * z**2, Parity.EVEN, ShapeKind.SQUARE, None),
        (lambda z: 5 * z**3, Parity.ODD, ShapeKind.CUBIC, None),
        (lambda z: 4 * np.sign(z) * np.maximum(np.abs(z) - 0.6, 0), Parity.ODD, ShapeKind.FLAT_MIDDLE, 0.6),
        (lambda z: 3 * np.maximum(z - 0.5, 0), Parity.NEITHER, ShapeKind.BEND, 0.5),
        (lambda z: -np.sqrt(np.abs(z)), Parity.EVEN, ShapeKind.KINK, None),
        (lambda z: np.cos(2 * np.pi * z / 0.31), Parity.NEITHER, ShapeKind.PERIODIC, None),
    ],
)
def test_a_signal_depends_on_its_variable_with_its_shape(curve, parity, kind, position):
    rng = np.random.default_rng(1)
    t = np.arange(1500) * 2e-3
    z = np.cumsum(rng.normal(size=t.size))
    z = z - np.linspace(z[0], z[-1], t.size)
    z = np.sin(37 * t) * (1 + 0.3 * np.sin(5 * t)) + 0.05 * z / np.abs(z).max()
    w = curve(z) + 0.1 * rng.normal(size=t.size)
    best = rank_dependences(t, w, {"other": (rng.normal(size=t.size), "V"), "z": (z, "m")})[0]
    assert best.variable == "z"
    assert (best.shape.kind, best.shape.parity) == (kind, parity)
    assert best.shape.position == (None if position is None else pytest.approx(position, rel=0.05))
    assert best.period == (pytest.approx(0.31, rel=0.05) if kind is ShapeKind.PERIODIC else None)


@pytest.mark.parametrize(
    ("curve", "kind", "downwards", "position"),
    [
        (lambda z: z**2, ShapeKind.CURVED, False, None),
        (lambda z: -(z**2), ShapeKind.CURVED, True, None),
        (lambda z: np.maximum(z - 4, 0), ShapeKind.BEND, False, 4.12),
        (lambda z: 3 * z + 1, ShapeKind.STRAIGHT, False, None),
    ],
)
def test_a_curve_on_one_side_of_zero_bends_or_curves(curve, kind, downwards, position):
    z = np.linspace(0, 10, 30)
    values = curve(z)
    if kind is ShapeKind.STRAIGHT:
        values = np.zeros(30)
    shape = classify_shape(z, values, np.ones(30))
    assert (shape.kind, shape.downwards) == (kind, downwards)
    assert shape.position == (None if position is None else pytest.approx(position, abs=0.2))


def test_too_few_values_have_no_shape():
    assert classify_shape(np.arange(5.0), np.ones(5), np.ones(5)).kind is ShapeKind.TOO_FEW_VALUES


def test_a_tone_that_the_input_does_not_have_has_a_frequency():
    rng = np.random.default_rng(2)
    t = np.arange(4000) * 2.5e-4
    w = np.sin(2 * np.pi * 50 * t) + 0.3 * rng.normal(size=t.size)
    best = rank_dependences(t, w, {"x": (rng.normal(size=t.size), "m")})[0]
    assert best.tone == pytest.approx(50, abs=0.5)
    assert best.shape.kind is ShapeKind.TONE


def test_a_tone_that_the_input_has_is_none():
    t = np.arange(4000) * 2.5e-4
    w = np.sin(2 * np.pi * 50 * t)
    assert rank_dependences(t, w, {"u": (np.sin(2 * np.pi * 50 * t + 1), "V")})[0].tone is None


def test_a_site_without_variables_shows_a_tone_or_nothing():
    t = np.arange(4000) * 2.5e-4
    (tone,) = rank_dependences(t, np.sin(2 * np.pi * 50 * t), {})
    assert tone.tone == pytest.approx(50, abs=0.5)
    assert rank_dependences(t, np.random.default_rng(3).normal(size=t.size), {}) == []


def test_the_stretch_is_where_the_misfit_varies_and_not_where_it_stands_still():
    residual = np.full((1000, 1), 0.1)
    residual[:300] = 50.0  # at an end of the range
    residual[600:700, 0] = 60 * np.sin(np.arange(100))
    record, first, rows = find_worst_stretch([np.zeros((50, 1)), residual], 100)
    assert (record, rows) == (1, 100)
    assert first == pytest.approx(600, abs=2)
    short = find_worst_stretch([np.full((40, 2), 1e8)], 100)  # nothing varies, and nothing is rounded away
    assert short == (0, 0, 40)


def test_windows_share_out_the_misfit():
    r = np.ones((1000, 1))
    r[200:300] = 10.0
    windows = divide_misfit(["a"], [np.arange(1000) * 0.01], [r], LOCALISATION_WINDOWS)
    assert len(windows) == 20
    assert sum(w.share for w in windows if 1.99 < w.start < 3) == pytest.approx(1, abs=0.01)
    timing = find_concentration(windows)
    assert [name for name, *_ in timing.stretches] == ["a"]
    assert timing.time_share <= CONCENTRATED_TIME


@pytest.mark.parametrize(("share", "stretches"), [(0.0, None), (0.05, 0)])
def test_a_misfit_that_is_nowhere_or_everywhere_is_not_concentrated(share, stretches):
    timing = find_concentration([MisfitWindow("a", k, k + 1.0, share, 2.0) for k in range(20)])
    assert (None if timing is None else len(timing.stretches)) == stretches


def in_a_loop(name: str, seed: int, rows: int) -> gb.Experiment:
    """``x' = 5 x + u``, exact over a held input that a controller makes of x, with a push that nobody measured."""
    rng, x, u, step = np.random.default_rng(seed), [0.1], np.zeros(rows), 0.01
    for k in range(rows - 1):
        u[k] = -9.0 * x[-1] + 0.5 * rng.standard_normal()
        x.append(x[-1] * np.exp(5 * step) + u[k] * (np.exp(5 * step) - 1) / 5 + 1e-4 * rng.standard_normal())
    return gb.Experiment(name, np.arange(rows) * step, {"u": u}, {"x": np.array(x) + 1e-3 * rng.standard_normal(rows)})


@pytest.mark.rest
@pytest.mark.parametrize(("rows", "is_told"), [(400, True), (50, False)])
def test_a_record_over_which_an_unstable_plant_loses_its_free_run_is_told(rows, is_told):
    plant = gb.Model(
        "plant",
        [gb.State("x", "m")],
        [gb.Input("u", "m/s")],
        [gb.Output("x", "m")],
        [gb.Parameter("a", "1/s", 4.0, (0.1, 50.0))],
        lambda x, u, p: [gb.Balance("motion", "m/s", 1, "x", own=p.a * x.x, push=u.u)],
    )
    learnt, chosen = (in_a_loop(name, seed, rows) for seed, name in enumerate(("one", "other")))
    found = gb.discover(
        plant, learnt, validation=chosen, noise={"x": 1e-3}, effects=[gb.effect("input_offset")], workers=1
    )
    told = with_code(found.findings, DiscoveryCode.ERRORS_GROW)
    assert bool(told) is is_told
    if told:  # e^(5 t) is 20 after 0.6 s, and e after 0.2 s: 4 s are searched in 20 stretches or one more, of one plant
        assert told[0].values["longest"] == pytest.approx(0.6, rel=0.05)
        assert told[0].values["stretch"] == pytest.approx(0.2, rel=0.05)
        rate = found.base.parameters["a"]
        assert len(found.base.traces) in (20, 21) and abs(rate.value - 5.0) < 3 * rate.std < 0.5
