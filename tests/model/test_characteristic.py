"""Curves in a model: straight pieces between points whose heights are fitted."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Characteristic, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError

AT = (0.0, 50.0, 120.0, 200.0)
TORQUE = (0.0, 0.02, 0.15, 0.5)


def make_fan(shape: str, start: tuple[float, ...] = (0.0, 0.05, 0.1, 0.3)) -> Model:
    fan = Characteristic("fan", "N*m", over="rad/s", at=AT, start=start, shape=shape)

    def balances(x, u, p):
        return [Balance("torque", "N*m", p.J, "w", motor=p.k * u.i, fan=-fan(x.w, p))]

    return Model(
        "fan",
        states=[State("w", "rad/s", role="velocity")],
        inputs=[Input("i", "A", role="drive")],
        outputs=[Output("w", "rad/s")],
        parameters=[
            Parameter("J", "kg*m^2", 1e-3, (1e-5, 1)),
            Parameter("k", "N*m/A", 0.05, fixed=True),
            *fan.parameters,
        ],
        balances=balances,
    )


@pytest.mark.parametrize("shape", ["any", "rising"])
def test_it_is_the_interpolation_of_numpy_between_the_points(shape: str) -> None:
    curve = Characteristic("fan", "N*m", over="rad/s", at=AT, start=TORQUE, shape=shape)
    values = {q.name: q.value for q in curve.parameters}
    x = np.linspace(0, 200, 81)
    height = [float(ca.DM(curve(ca.DM(place), values))) for place in x]
    np.testing.assert_allclose(height, np.interp(x, AT, TORQUE), atol=1e-15)


def test_the_outermost_pieces_go_on() -> None:
    curve = Characteristic("c", "V", over="V", at=(0, 1, 2), start=(0, 1, 3))
    values = {q.name: q.value for q in curve.parameters}
    assert float(curve(ca.DM(4.0), values)) == pytest.approx(7.0)
    assert float(curve(ca.DM(-2.0), values)) == pytest.approx(-2.0)


@pytest.mark.parametrize("shape", ["any", "rising"])
def test_a_fit_finds_the_curve_with_intervals(shape: str) -> None:
    """The record is an explicit Euler run with a step a hundred times finer, written here."""
    rng = np.random.default_rng(4)
    rows, period, fine = 1500, 0.01, 100
    current = np.repeat(rng.uniform(0, 9, 30), rows // 30)
    speed, w = np.empty(rows), 0.0
    for k in range(rows):
        speed[k] = w
        for _ in range(fine):
            w += period / fine * (0.05 * current[k] - np.interp(w, AT, TORQUE)) / 2e-3
    record = gb.Experiment(
        "bench", period * np.arange(rows), {"i": current}, {"w": speed + 0.2 * rng.standard_normal(rows)}
    )
    assert speed.max() < 200
    result = gb.fit(make_fan(shape), record, noise={"w": 0.2}, options=gb.FitOptions(at_rest=True))
    assert result.success
    word = "fan_rise_3" if shape == "rising" else "fan_3"
    true = TORQUE[2] - TORQUE[1] if shape == "rising" else TORQUE[2]
    low, high = result.parameters[word].interval
    assert low - 1e-3 < true < high + 1e-3
    assert result.parameters["J"].value == pytest.approx(2e-3, rel=0.01)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"at": (0, 0, 1)}, "ascend"),
        ({"at": (0,), "start": (0,)}, "ascend"),
        ({"start": (0, 1)}, "2 heights"),
        ({"start": (0, 2, 1), "shape": "rising"}, "not rising"),
        ({"shape": "up"}, "any, rising, falling"),
    ],
)
def test_a_curve_that_cannot_be_is_refused(change: dict, words: str) -> None:
    settings = {"at": (0, 1, 2), "start": (0, 1, 2)} | change
    with pytest.raises(ModelError, match=words):
        Characteristic("c", "V", over="V", **settings)


def test_a_falling_curve_counts_its_falls() -> None:
    curve = Characteristic("c", "V", over="V", at=(0, 1, 2), start=(3, 1, 0), shape="falling")
    values = {q.name: q.value for q in curve.parameters}
    assert [q.name for q in curve.parameters][:3] == ["c_1", "c_fall_2", "c_fall_3"]
    assert float(curve(ca.DM(1.5), values)) == pytest.approx(0.5)
