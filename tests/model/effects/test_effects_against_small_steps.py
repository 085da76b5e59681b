"""Effects of contact, sign and flow against Runge-Kutta steps written out here, on plants with nothing else in them."""

from functools import cache
from math import copysign, pi, sqrt

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.model.effects.catalogue import effect

PERIOD, ROWS, FINE = 5e-3, 150, 200
MASS, DAMPING, STIFFNESS = 0.5, 2.0, 300.0


def _body(x, u, p):
    return [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        Balance("force", "N", p.M, "v", drive=u.P, viscous=-p.B * x.v, spring=-p.K * x.x),
    ]


BODY = Model(
    "body",
    states=[State("x", "m"), State("v", "m/s")],  # no roles: the units and the balances say which is which
    inputs=[Input("P", "N")],
    outputs=[Output("x", "m")],
    parameters=[Parameter("M", "kg", MASS), Parameter("B", "N*s/m", DAMPING), Parameter("K", "N/m", STIFFNESS)],
    balances=_body,
)


def _volume(x, u, p):
    return [Balance("flow", "m^3/s", p.C, "q", pump=p.k * u.u, leak=-p.l * x.q)]


VOLUME = Model(
    "volume",
    states=[State("q", "Pa", role="pressure")],
    inputs=[Input("u", "V")],
    outputs=[Output("q", "Pa")],
    parameters=[
        Parameter("C", "m^3/Pa", 1e-11),
        Parameter("k", "m^3/(s*V)", 2e-5),
        Parameter("l", "m^3/(s*Pa)", 5e-12),
    ],
    balances=_volume,
)


def held(rows=ROWS):
    rng = np.random.default_rng(4)
    return np.repeat(rng.uniform(-12, 12, rows // 15), 15)


def run_body(u, force=None, drive=None, friction=None, shown=None, pace=1.0):
    """Displacement of the body by steps of pace PERIOD / FINE: extra ``force(x, v)``, ``drive(u)``, Coulomb ``friction(v, F, x)``."""
    x = v = 0.0
    h, y = pace * PERIOD / FINE, []
    for sample in u:
        y.append(x if shown is None else shown(x))
        f = sample if drive is None else drive(sample)

        def rate(x, v, f=f):
            return f - DAMPING * v - STIFFNESS * x + (force(x, v) if force else 0.0)

        for _ in range(FINE):
            k1 = (v, rate(x, v) / MASS)
            k2 = (v + h / 2 * k1[1], rate(x + h / 2 * k1[0], v + h / 2 * k1[1]) / MASS)
            k3 = (v + h / 2 * k2[1], rate(x + h / 2 * k2[0], v + h / 2 * k2[1]) / MASS)
            k4 = (v + h * k3[1], rate(x + h * k3[0], v + h * k3[1]) / MASS)
            x += h / 6 * (k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0])
            v += h / 6 * (k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1])
            if friction:  # an impulse that takes away speed and never turns it round
                forward, backward = friction(f, x)
                v = (
                    v - h * forward / MASS
                    if v > h * forward / MASS
                    else min(v + h * backward / MASS, 0.0)
                    if v < 0
                    else 0.0
                )
    return np.array(y)


@cache
def run_plain():
    """The body without any effect under `held`."""
    return run_body(held())


class Play:
    """An input that follows with play, written as a rule and not as a formula."""

    def __init__(self, half):
        self.half, self.at = half, 0.0

    def __call__(self, u):
        if u - self.at > self.half:
            self.at = u - self.half
        elif self.at - u > self.half:
            self.at = u + self.half
        return self.at


def simulate(model, u, substeps=40):
    time = PERIOD * np.arange(len(u))
    return gb.simulate(model, {"time": time, model.inputs[0].name: u}, substeps=substeps)


CASES = {
    "end_stops": (
        {"kc": 900.0, "gap": 0.015},
        {"force": lambda x, v: -900.0 * max(abs(x) - 0.015, 0.0) * copysign(1.0, x)},
    ),
    "end_stop": (
        {"kc": 900.0, "gap": 0.01},
        {"force": lambda x, v: -900.0 * (x - 0.01) if x > 0.01 else 0.0},
    ),
    "cogging": (
        {"F": 1.0, "Fq": -0.6, "pitch": 0.02},
        {"force": lambda x, v: 1.0 * np.sin(2 * pi * x / 0.02) - 0.6 * np.cos(2 * pi * x / 0.02)},
    ),
    "input_gain": ({"g": -0.2}, {"drive": lambda u: 0.8 * u}),
    "sensor_gain": ({"g": 0.15}, {"shown": lambda x: 1.15 * x}),
    "clock_skew": ({"e": 0.05}, {"pace": 1.05}),
    "gain_by_sign": ({"g": 0.4}, {"drive": lambda u: u if u > 0 else 0.6 * u}),
    "input_hysteresis": ({"h": 3.0}, {"drive": Play(3.0)}),
    "rectified_reading": ({"r": 1.0}, {"shown": abs}),
    "load_dependent_friction": (
        {"Fc": 0.3, "mu": 0.1},
        {"friction": lambda f, x: 2 * (0.3 + 0.1 * (abs(f) + abs(STIFFNESS * x)),)},
    ),
    "asymmetric_friction": ({"Fp": 1.5, "Fm": 0.5}, {"friction": lambda f, x: (1.5, 0.5)}),
}
# An impulse after each small step is off by its square root: friction is compared less sharply.
TOLERANCE = {"load_dependent_friction": 3e-3, "asymmetric_friction": 3e-3}


@pytest.mark.crossed(3)
@pytest.mark.parametrize("name", CASES)
def test_an_effect_moves_a_body_as_small_steps_do(name):
    values, hand = CASES[name]
    u = held()
    expected, plain = run_body(u, **hand), run_plain()
    run = simulate((BODY + effect(name)).start(**values), u)
    reach = np.abs(plain).max()
    assert np.abs(run.outputs["x"] - expected).max() < TOLERANCE.get(name, 1e-4) * reach
    assert np.abs(expected - plain).max() > 0.03 * reach


def test_an_end_stop_below_pushes_up():
    u = held()
    expected = run_body(u, force=lambda x, v: 900.0 * (-0.01 - x) if x < -0.01 else 0.0)
    run = simulate((BODY + effect("end_stop")).start(kc=900.0, gap=-0.01, side=-1.0), u)
    assert np.abs(run.outputs["x"] - expected).max() < 1e-4 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("name", "values", "extra"),
    [
        ("root_leak", {"c": 3e-8, "laminar": 1e2}, lambda p, u: -3e-8 * copysign(sqrt(abs(p)), p)),
        ("pump_back_pressure", {"b": 5e-8}, lambda p, u: -5e-8 * p * 2e-5 * u),
    ],
)
def test_an_effect_moves_a_pressure_as_small_steps_do(name, values, extra):
    u = np.abs(held()) + 1.0
    pressure, h, expected = 0.0, PERIOD / 2000, []
    for sample in u:
        expected.append(pressure)
        for _ in range(2000):
            pressure += h * (2e-5 * sample - 5e-12 * pressure + extra(pressure, sample)) / 1e-11
    run = simulate((VOLUME + effect(name)).start(**values), u, substeps=200)
    assert run.outputs["q"] == pytest.approx(np.array(expected), abs=2e-3 * np.max(expected))
    plain = simulate(VOLUME, u).outputs["q"]
    assert np.abs(plain - run.outputs["q"]).max() > 0.05 * np.max(expected)


def test_play_holds_its_place_from_one_row_to_the_next_and_keeps_up_with_the_held_input():
    model = (BODY + effect("input_hysteresis")).start(h=2.0)
    run = simulate(model, np.repeat([5.0, 4.0, 0.0, -5.0], 20), substeps=4)
    w = run.states[model.bound_effects[0].model_names["w"]]
    assert w[[19, 39, 59, 79]] == pytest.approx([3.0, 3.0, 2.0, -3.0])


def test_bouc_wen_takes_the_constants_of_the_public_benchmark():
    beta, gamma, alpha = 800.0, -1100.0, 300.0
    u = held()
    x = v = z = 0.0
    h, expected = PERIOD / 2000, []
    for sample in u:
        expected.append(x)
        for _ in range(2000):
            v += h * (sample - DAMPING * v - STIFFNESS * x - alpha * z) / MASS
            x += h * v
            z += h * (v - beta * abs(v) * z - gamma * v * abs(z))
    run = simulate((BODY + effect("bouc_wen_hysteresis")).start(alpha=alpha, beta=beta, gamma=gamma), u, substeps=60)
    assert run.outputs["x"] == pytest.approx(np.array(expected), abs=2e-3 * np.max(np.abs(expected)))
