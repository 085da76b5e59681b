"""What objects to the usual set is looked at as well: where it does better than all before, it is the answer."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import greybox as gb
from greybox import Balance, Experiment, Input, Model, Output, Parameter, State
from greybox.discovery.conclusion import may_leave_more
from models.micro_actuator import micro_actuator


def balances(x, u, p):
    q = (p.G0 + p.Gf * u.fan) * (x.T1 - x.T2)
    return [
        Balance("block", "W", p.C1, "T1", heater=u.P, to_radiator=-q),
        Balance("radiator", "W", p.C2, "T2", from_block=q, loss=-p.Ga * (x.T2 - u.Ta)),
    ]


RIG = Model(
    "rig",
    [State("T1", "K", role="temperature"), State("T2", "K", role="temperature")],
    [Input("P", "W", role="drive"), Input("fan", "%"), Input("Ta", "K", role="ambient_temperature")],
    [Output("T1", "K"), Output("T2", "K")],
    [
        Parameter("C1", "J/K", 300, (1, 1e5)),
        Parameter("C2", "J/K", 500, (1, 1e5)),
        Parameter("G0", "W/K", 1, (0.001, 100)),
        Parameter("Gf", "W/K/%", 0.01, (0, 10)),
        Parameter("Ga", "W/K", 1, (0.01, 100)),
    ],
    balances,
)


def record(seed, rows=700, period=5.0):
    """A block that radiates, and a sensor on it that lags by 12 s, by an independent solver."""
    rng, time = np.random.default_rng(seed), period * np.arange(rows)
    power = np.repeat(rng.uniform(0, 220, rows // 48 + 1), 48)[:rows]
    fan = np.repeat(rng.choice([0, 25.0, 50, 75, 100], rows // 72 + 1), 72)[:rows]

    def slope(_, x, heat, speed):
        q = (1.2 + 0.025 * speed) * (x[0] - x[1])
        radiation = 4e-9 * (x[0] ** 4 - 294.0**4)
        return [(heat - q - radiation) / 420, (q - 3 * (x[1] - 294.0)) / 900, (x[0] - x[2]) / 12]

    x = np.array([300.0, 297.0, 300.0])
    runs = [x]
    for k in range(rows - 1):
        x = solve_ivp(slope, (0, period), x, args=(power[k], fan[k]), rtol=1e-9, atol=1e-9).y[:, -1]
        runs.append(x)
    read = np.array(runs) + 0.05 * rng.standard_normal((rows, 3))
    inputs = {"P": power, "fan": fan, "Ta": np.full(rows, 294.0)}
    return Experiment(f"run {seed}", time, inputs, {"T1": read[:, 2], "T2": read[:, 1]}, "zero")


@pytest.mark.parametrize(
    ("effect", "left", "is_noise_known", "expected"),
    [
        ("stribeck_friction", 0.0, False, False),
        ("stribeck_friction", 0.2, True, True),
        ("lugre_friction", 0.0, False, True),
        ("lugre_friction", 0.0, True, False),
    ],
)
def test_what_is_usual_may_take_the_place_of_what_leaves_more_than_noise_or_follows_it(
    effect, left, is_noise_known, expected
):
    """Friction without memory that leaves noise of a level nobody told was taken out for what is usual, at twice its error."""
    model = micro_actuator + gb.effect(effect)
    chosen = SimpleNamespace(model=model, effects=(effect,), noise_ratio=1.0)
    assert may_leave_more(chosen, left, is_noise_known) is expected
    # Noise that is known to be at most so loud is no noise where more is left.
    chosen.noise_ratio = 2.6
    assert may_leave_more(chosen, left, is_noise_known)


@pytest.mark.slow
def test_a_pair_that_is_first_fitted_beside_the_usual_set_is_named():
    found = gb.discover(RIG, record(1), validation=record(2), workers=1)
    assert found.verdict == "named"
    assert {e["name"] for e in found.effects} == {"radiation_loss", "sensor_lag"}
