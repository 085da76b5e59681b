"""Effects of heat, rotation, stores and circuits against small Runge-Kutta steps written out here, on the plants to start from."""

from collections.abc import Callable
from functools import cache
from math import copysign, cos, pi, sin, tanh

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.model.effects.catalogue import CATALOGUE, effect, find_placements, place_effect
from greybox.shell.project import find_model, template_root

FINE = 50
Rate = Callable[[list[float], float], list[float]]


def plant(name: str) -> Model:
    return find_model(str(template_root() / "plants" / name / f"{name}.py"))


def run_small_steps(rate: Rate, start: list[float], u: np.ndarray, period: float) -> np.ndarray:
    """States (N, nx) at each row; the input is held."""
    # Numbers of Python: arrays of two or three elements take several times as long.
    x, h, rows = list(start), period / FINE, []
    for held in u.tolist():
        rows.append(x)
        for _ in range(FINE):
            k1 = rate(x, held)
            k2 = rate([a + h / 2 * k for a, k in zip(x, k1, strict=True)], held)
            k3 = rate([a + h / 2 * k for a, k in zip(x, k2, strict=True)], held)
            k4 = rate([a + h * k for a, k in zip(x, k3, strict=True)], held)
            x = [a + h / 6 * (b + 2 * c + 2 * d + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)]
    return np.array(rows)


def steps(seed: int, rows: int, low: float, high: float) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).uniform(low, high, rows // 20), 20)


def thermal(loss: Callable[[float, float], float]) -> Rate:
    """Heated block, ambient at 20 degrees; ``loss(T, z)`` in W, ``z`` a second body with a time constant of 90 s."""

    def rate(x, power):
        body, reading, z = x
        return [(power - 0.8 * (body - 20) - loss(body, z)) / 400, (body - reading) / 8, (body - z) / 90]

    return rate


THERMAL = {
    "heat_loss": ({"G": 0.3}, lambda T, z: 0.3 * (T - 20)),
    "heat_gain": ({"Q0": 9.0}, lambda T, z: -9.0),
    "radiation_loss": ({"kr": 2e-9, "T0": 273.15}, lambda T, z: 2e-9 * ((T + 273.15) ** 4 - 293.15**4)),
    "natural_convection": ({"c": 0.3, "least": 1e-4}, lambda T, z: 0.3 * copysign(abs(T - 20) ** 1.25, T - 20)),
    "heat_storage": ({"g": 0.6, "tau_g": 90.0}, lambda T, z: 0.6 * (T - z)),
}


@pytest.mark.parametrize("name", THERMAL)
def test_heat_flows_as_by_small_steps(name: str) -> None:
    values, loss = THERMAL[name]
    power = steps(1, 200, 0, 60)
    expected = run_small_steps(thermal(loss), [20.0, 20.0, 20.0], power, 4.0)[:, 1]
    plain = run_small_steps(thermal(lambda T, z: 0.0), [20.0, 20.0, 20.0], power, 4.0)[:, 1]
    model = (plant("thermal") + effect(name)).start(**values)
    run = gb.simulate(model, {"time": 4.0 * np.arange(200), "P": power, "Ta": np.full(200, 20.0)}, substeps=20)
    assert np.abs(run.outputs["S"] - expected).max() < 2e-4 * np.ptp(plain)
    assert np.abs(expected - plain).max() > 0.03 * np.ptp(plain)


def two_mass(torque: Callable[[float, float], float]) -> Rate:
    def rate(x, T):
        a1, w1, a2, w2 = x
        shaft = 8 * (a1 - a2) + 5e-3 * (w1 - w2)
        return [w1, (T - 1e-2 * w1 - shaft) / 1.5e-3, w2, (shaft - 1e-2 * w2 + torque(a2, w2)) / 3e-3]

    return rate


@pytest.mark.parametrize(
    ("name", "values", "torque"),
    [
        ("gravity_torque", {"Gs": 0.2, "Gc": 0.05}, lambda a, w: -0.2 * sin(a) - 0.05 * cos(a)),
        ("viscous_damping", {"B1": 0.02}, lambda a, w: -0.02 * w),
    ],
)
def test_a_load_is_pulled_and_braked_as_by_small_steps(name, values, torque) -> None:
    T = steps(2, 400, -0.3, 0.3)
    expected = run_small_steps(two_mass(torque), [0.0] * 4, T, 2e-3)
    plain = run_small_steps(two_mass(lambda a, w: 0.0), [0.0] * 4, T, 2e-3)
    model = (plant("two_mass") + place_effect(effect(name), "load")).start(**values)
    run = gb.simulate(model, {"time": 2e-3 * np.arange(400), "T": T}, substeps=20)
    assert np.abs(run.outputs["a2"] - expected[:, 2]).max() < 1e-4 * np.ptp(expected[:, 2])
    assert np.abs(plain - expected)[:, 2].max() > 0.03 * np.ptp(plain[:, 2])


def test_a_ripple_of_the_torque_follows_the_angle_that_is_no_state() -> None:
    def rate(x, u):
        w, i, a = x
        ripple = 0.01 * sin(3 * a) + 0.004 * cos(3 * a)
        return [(0.04 * i - 2e-4 * w - ripple) / 2e-4, (u - 1.2 * i - 0.04 * w) / 1.5e-3, w]

    u = steps(3, 300, -6, 6)
    expected = run_small_steps(rate, [0.0, 0.0, 0.0], u, 2e-3)
    model = (plant("rotary_drive") + effect("torque_ripple")).start(Fs=0.01, Fc=0.004, n=3.0)
    run = gb.simulate(model, {"time": 2e-3 * np.arange(300), "u": u}, substeps=20)
    assert np.abs(run.outputs["w"] - expected[:, 0]).max() < 1e-4 * np.ptp(expected[:, 0])
    plain = gb.simulate(plant("rotary_drive"), {"time": 2e-3 * np.arange(300), "u": u})
    assert np.abs(plain.outputs["w"] - expected[:, 0]).max() > 0.01 * np.ptp(expected[:, 0])


def tanks(rate_of_upper: Callable[[float], float]) -> Rate:
    def rate(x, u):
        upper = 2e-5 * (2 * 9.81 * max(x[0], 0.0)) ** 0.5
        lower = 2e-5 * (2 * 9.81 * max(x[1], 0.0)) ** 0.5
        return [(1e-5 * u - upper + rate_of_upper(x[0])) / 0.015, (upper - lower) / 0.015]

    return rate


@pytest.mark.parametrize(
    ("name", "values", "flow"),
    [
        ("overflow", {"ko": 1e-3, "edge": 0.15}, lambda h: -1e-3 * max(h - 0.15, 0.0)),
        ("linear_leak", {"kl": 5e-5}, lambda h: -5e-5 * h),
    ],
)
def test_a_tank_runs_over_and_leaks_as_by_small_steps(name: str, values: dict, flow: Callable[[float], float]) -> None:
    u = steps(4, 300, 0, 8)
    expected = run_small_steps(tanks(flow), [0.1, 0.1], u, 4.0)
    plain = run_small_steps(tanks(lambda h: 0.0), [0.1, 0.1], u, 4.0)
    model = (plant("tanks") + effect(name)).start(**values)
    run = gb.simulate(model, {"time": 4.0 * np.arange(300), "u": u}, substeps=40)
    assert np.abs(run.outputs["h1"] - expected[:, 0]).max() < 1e-3 * np.ptp(plain[:, 0])
    assert np.abs(expected - plain).max() > 0.03 * np.ptp(plain[:, 0])


CIRCUIT = {
    "saturating_inductance": (
        {"a": 80.0},
        lambda q, i, u, w: (i, (u - 20 * i - q / 2e-6) * (1 + 80 * i**2) / 5e-3, 0.0),
    ),
    "brush_drop": (
        {"Ub": 0.8, "ib": 1e-2},
        lambda q, i, u, w: (i, (u - 20 * i - q / 2e-6 - 0.8 * tanh(i / 1e-2)) / 5e-3, 0.0),
    ),
    "drive_lag": ({"tau_u": 2e-4}, lambda q, i, u, w: (i, (w - 20 * i - q / 2e-6) / 5e-3, (u - w) / 2e-4)),
}


@pytest.mark.parametrize("name", CIRCUIT)
def test_a_circuit_behaves_as_by_small_steps(name: str) -> None:
    values, rate = CIRCUIT[name]
    u = 5 * np.sin(2 * pi * 700 * 2e-5 * np.arange(400)) + steps(5, 400, -2, 2)
    expected = run_small_steps(lambda x, held: list(rate(*x[:2], held, x[2])), [0.0, 0.0, 0.0], u, 2e-5)
    model = (plant("circuit") + effect(name)).start(**values)
    time = 2e-5 * np.arange(400)
    run = gb.simulate(model, {"time": time, "u": u}, substeps=20)
    plain = gb.simulate(plant("circuit"), {"time": time, "u": u})
    assert np.abs(run.outputs["i"] - expected[:, 1]).max() < 1e-3 * np.ptp(expected[:, 1])
    assert np.abs(plain.outputs["i"] - expected[:, 1]).max() > 0.02 * np.ptp(expected[:, 1])


@pytest.mark.rest
def test_each_effect_finds_the_plants_that_have_its_place() -> None:
    @cache
    def placed(name: str) -> set[str]:
        return {p.name for p in find_placements(plant(name), CATALOGUE) if p.effect}

    assert {"radiation_loss", "natural_convection", "heat_storage", "drive_lag"} <= placed("thermal")
    assert {"gravity_torque", "gravity_torque_at_load"} <= placed("two_mass")
    assert "torque_ripple" not in placed("two_mass")
    assert {"torque_ripple", "winding_heating", "brush_drop", "saturating_inductance"} <= placed("rotary_drive")
    assert {"overflow", "overflow_at_lower_tank", "linear_leak"} <= placed("tanks")
    assert not placed("stage") & {"gravity_torque", "torque_ripple", "overflow", "radiation_loss", "brush_drop"}


def test_an_ambient_temperature_may_be_a_parameter_and_kelvin_needs_no_offset() -> None:
    def balances(x, u, p):
        return [Balance("heat", "W", p.C, "T", heater=u.P, loss=-p.h * (x.T - p.Ta))]

    block = Model(
        "block",
        states=[State("T", "K", 293.0, role="temperature")],
        inputs=[Input("P", "W", role="drive")],
        outputs=[Output("T", "K")],
        parameters=[
            Parameter("C", "J/K", 400.0, (1, 1e6)),
            Parameter("h", "W/K", 0.8, (1e-3, 1e3)),
            Parameter("Ta", "K", 293.0, fixed=True, role="ambient_temperature"),
        ],
        balances=balances,
    )
    power = np.repeat([20.0, 0.0, 40.0, 10.0], 100)
    run = gb.simulate(block, {"time": 2.0 * np.arange(400), "P": power})
    (tailored,) = [p.effect for p in find_placements(block, CATALOGUE) if p.name == "radiation_loss"]
    scales = gb.effects.measure_scales(block, np.stack([run.outputs["T"]], axis=1), power, 2.0)
    ready = gb.effects.tailor_to_record(tailored, scales)
    assert {q.name: q.value for q in ready.parameters}["T0"] == 0.0
