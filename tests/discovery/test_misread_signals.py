"""What a record has wrong is no effect of the plant: a reversed wire, an input a row late or early, on rigs simulated without greybox."""

from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.model.effects.catalogue import applicable_effects
from models.micro_actuator import micro_actuator
from tests.support.first_order import first_order

PERIOD, ROWS = 0.02, 300


def motor():
    return Model(
        "motor",
        states=[State("i", "A"), State("w", "rad/s")],
        inputs=[Input("u", "V")],
        outputs=[Output("i", "A"), Output("w", "rad/s")],
        parameters=[
            Parameter("L", "H", 0.05, (1e-4, 1)),
            Parameter("R", "ohm", 2.0, (0.1, 20)),
            Parameter("k", "N*m/A", 0.05, (1e-3, 1)),
            Parameter("J", "kg*m^2", 4e-4, (1e-6, 1e-1)),
            Parameter("b", "N*m*s/rad", 1e-3, (1e-6, 1)),
        ],
        balances=lambda x, u, p: [
            Balance("winding", "V", p.L, "i", supply=u.u, resistance=-p.R * x.i, emf=-p.k * x.w),
            Balance("force", "N*m", p.J, "w", torque=p.k * x.i, damping=-p.b * x.w),
        ],
    )


def stage():
    """A spring that is stiffer on one side: its readings from both sides of a mirror are not the same."""
    return Model(
        "stage",
        states=[State("x", "m"), State("v", "m/s")],
        inputs=[Input("F", "N")],
        outputs=[Output("x", "m")],
        parameters=[
            Parameter("m", "kg", 0.5, (0.01, 10)),
            Parameter("b", "N*s/m", 3.0, (0.01, 100)),
            Parameter("k", "N/m", 60.0, (1, 1e4)),
            Parameter("k2", "N/m^2", 100.0, (0, 1e5)),
        ],
        balances=lambda x, u, p: [
            Balance("path", "m/s", 1, "x", speed=x.v),
            Balance("force", "N", p.m, "v", drive=u.F, damping=-p.b * x.v, spring=-p.k * x.x, one_side=-p.k2 * x.x**2),
        ],
    )


def heater():
    return Model(
        "heater",
        states=[State("T", "K")],
        inputs=[Input("P", "W"), Input("Ta", "K")],
        outputs=[Output("T", "K")],
        parameters=[Parameter("C", "J/K", 2.0, (0.01, 100)), Parameter("h", "W/K", 1.0, (0.01, 100))],
        balances=lambda x, u, p: [Balance("heat", "W", p.C, "T", heating=u.P, loss=-p.h * (x.T - u.Ta))],
    )


RATES = {
    "motor": lambda x, u: [(u[0] - 2.4 * x[0] - 0.06 * x[1]) / 0.03, (0.06 * x[0] - 8e-4 * x[1]) / 3e-4],
    "stage": lambda x, u: [x[1], (u[0] - 2.2 * x[1] - 75.0 * x[0] - 150.0 * x[0] ** 2) / 0.4],
    "heater": lambda x, u: [(u[0] - 1.4 * (x[0] - u[1])) / 1.5],
}
SIZES = {"motor": (6.0,), "stage": (3.0,), "heater": (5.0, 2.0)}
NOISE = {"motor": (2e-3, 5e-2), "stage": (2e-4,), "heater": (5e-3,)}


def runge_kutta(rate, x, h):
    """What a classic step of length ``h`` adds to ``x``."""
    a = rate(x)
    b = rate(x + h / 2 * a)
    c = rate(x + h / 2 * b)
    return h / 6 * (a + 2 * b + 2 * c + rate(x + h * c))


@cache
def run(name, seed):
    """Inputs (N, nu) in steps and outputs (N, ny) with noise, by Runge-Kutta steps a tenth as long as a row."""
    rng = np.random.default_rng(seed)
    model = MODELS[name]
    u = np.column_stack([np.repeat(rng.uniform(-s, s, ROWS // 10), 10) for s in SIZES[name]])
    x = np.zeros((ROWS, len(model.states)))
    for k in range(ROWS - 1):
        x[k + 1] = x[k]
        for _ in range(10):
            x[k + 1] += runge_kutta(lambda z, k=k: np.array(RATES[name](z, u[k])), x[k + 1], PERIOD / 10)
    y = x[:, : len(model.outputs)]
    return u, y + np.array(NOISE[name]) * rng.standard_normal(y.shape)


MODELS = {"motor": motor(), "stage": stage(), "heater": heater()}


def record(name, seed, reversed_signals=(), late=0):
    model = MODELS[name]
    u, y = run(name, seed)
    # The first input as a logger that is so many rows late has it.
    u = np.column_stack([u[np.clip(np.arange(ROWS) - late, 0, ROWS - 1), 0], u[:, 1:]])
    sign = dict.fromkeys(reversed_signals, -1.0)
    inputs = {i.name: sign.get(i.name, 1.0) * u[:, k] for k, i in enumerate(model.inputs)}
    outputs = {o.name: sign.get(o.name, 1.0) * y[:, k] for k, o in enumerate(model.outputs)}
    return gb.Experiment.from_arrays(PERIOD * np.arange(ROWS), inputs, outputs, name=f"run {seed}")


def search(name, reversed_signals=(), late=0, among=()):
    """Among the whole catalogue, or what may be reversed and these effects."""
    named = [e for e in applicable_effects(MODELS[name]) if e.name in among or e.name.startswith("reversed_")]
    noise = {o.name: n for o, n in zip(MODELS[name].outputs, NOISE[name], strict=True)}
    learnt, judged = (record(name, seed, reversed_signals, late) for seed in (1, 2))
    return gb.discover(MODELS[name], learnt, validation=judged, noise=noise, effects=named if among else None)


# What a reversed wire looks like most.
LIKE_A_WIRE = ("gain_by_sign", "input_offset", "sensor_gain", "transport_delay", "cubic_stiffness")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "signal", "effect", "among"),
    [
        ("motor", "w", "reversed_reading_at_w", ()),
        ("stage", "x", "reversed_reading", ()),
        ("stage", "x", "reversed_reading", LIKE_A_WIRE),
        ("stage", "F", "reversed_input", ()),
        ("heater", "P", "reversed_input", ()),
        ("heater", "Ta", "reversed_input_at_Ta", ()),
    ],
)
def test_the_reversed_signal_is_named(name, signal, effect, among):
    found = search(name, (signal,), among=among)
    assert [e["name"] for e in found.effects] == [effect]
    assert found.effects[0]["grade"] == "established"


# What an input in another row looks like most.
LIKE_ANOTHER_ROW = (
    "late_row",
    "early_row",
    "transport_delay",
    "drive_lag",
    "sensor_lag",
    "input_offset",
    "sensor_gain",
)


@pytest.mark.rest
@pytest.mark.parametrize(
    ("name", "late", "among"),
    [
        *(pytest.param(*case, (), marks=pytest.mark.slow) for case in (("motor", 1), ("stage", 1), ("heater", -1))),
        pytest.param("stage", 1, LIKE_ANOTHER_ROW, marks=pytest.mark.slow),
        ("heater", -1, LIKE_ANOTHER_ROW),
    ],
)
def test_an_input_that_is_written_in_another_row_is_named(name, late, among):
    found = search(name, late=late, among=among)
    (effect,) = found.effects
    # Written early by one row, an input is late by one: a delay of just that is the same.
    assert effect["name"] in (("late_row",) if late > 0 else ("early_row", "transport_delay"))
    assert not any("lag" in c.name for c in found.claims if c.grade == "established")


@pytest.mark.slow
def test_two_reversed_readings_are_one_reversed_input():
    """On a linear plant they are the same, and one wire is the simpler answer."""
    assert [e["name"] for e in search("motor", ("i", "w"), among=LIKE_A_WIRE).effects] == ["reversed_input"]


@pytest.mark.slow
def test_where_input_and_reading_may_be_reversed_alike_neither_is_certain():
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(-1, 1, 60), 10)
    # A first-order lag under a held input, its step in closed form.
    kept = np.exp(-PERIOD / 0.3)
    y = -lfilter([0.0, 2.0 * (1 - kept)], [1.0, -kept], u) + 0.01 * rng.normal(size=len(u))
    mirrored = gb.Experiment("mirrored", PERIOD * np.arange(len(u)), {"u": u}, {"y": y})
    model = first_order()
    found = gb.discover(model, mirrored.window(0, 400), validation=mirrored.window(400, 600), noise={"y": 0.01})
    assert found.verdict == "ambiguous"
    assert found.effects[0]["name"] in ("reversed_input", "reversed_reading")
    assert "reversed_input" in str(found) and "reversed_reading" in str(found)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["heater", "stage", "motor"])
def test_right_signs_are_left_alone(name):
    assert search(name).verdict == "complete"


def test_a_model_that_lists_what_its_plant_may_lack_is_asked_for_its_wires_too():
    names = {e.name for e in applicable_effects(micro_actuator)}
    assert {"reversed_input", "reversed_reading", "reversed_reading_at_i"} <= names
