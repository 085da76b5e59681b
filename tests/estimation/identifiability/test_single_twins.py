"""A constant that has another answer by itself, and sums with coefficients: what the equations say is what a fit says."""

import casadi as ca
import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Experiment, Input, Model, Output, Parameter, State
from greybox.estimation.findings import EstimationCode
from greybox.estimation.identifiability.sensitivity import IdentifiabilityCode

STEP, ROWS, TAU, GAIN = 0.1, 200, 2.0, 1.5


def lag(gain, names, bounds):
    return Model(
        "lag",
        states=[State("x", "K")],
        inputs=[Input("u", "K")],
        outputs=[Output("x", "K")],
        parameters=[*(Parameter(n, "1", 0.7, bounds) for n in names), Parameter("tau", "s", 1.0, (0.1, 50.0))],
        balances=lambda x, u, p: [Balance("heat", "K", p.tau, "x", inflow=gain(p) * u.u, outflow=-x.x)],
    )


def measure():
    """The exact step of a lag under a held input, and noise."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.choice([0.0, 1.0, 2.0], ROWS // 20), 20)
    x, y, a = 0.0, [], np.exp(-STEP / TAU)
    for value in u:
        y.append(x)
        x = a * x + (1 - a) * GAIN * value
    y = np.array(y) + 0.02 * rng.normal(size=ROWS)
    return Experiment.from_arrays(STEP * np.arange(ROWS), {"u": u}, {"x": y})


EVEN = {"square": lambda p: p.a**2, "cosine": lambda p: 1.8 * ca.cos(p.a), "size": lambda p: 1.8 * ca.fabs(p.a)}


@pytest.mark.parametrize("gain", EVEN.values(), ids=EVEN)
def test_a_constant_whose_sign_no_record_shows_is_told_with_its_other_value(gain):
    found = gb.fit(lag(gain, "a", (-1.5, 1.5)), measure())
    (twin,) = (f for f in found.findings if f.code == IdentifiabilityCode.OTHER_ANSWER)
    assert twin.values["values"] == pytest.approx({"a": -found.parameters["a"].value})


def test_an_odd_gain_has_one_answer():
    found = gb.fit(lag(lambda p: p.a**3 + p.a, "a", (-1.5, 1.5)), measure())
    assert not [f for f in found.findings if f.code == IdentifiabilityCode.OTHER_ANSWER]


@pytest.mark.parametrize(
    ("gain", "text"), [(lambda p: p.a + 2 * p.b, "a + 2 b"), (lambda p: p.a - 3 * p.b, "a - 3 b")], ids=["2", "3"]
)
def test_a_sum_with_coefficients_that_is_determined_has_its_value(gain, text):
    found = gb.fit(lag(gain, "ab", (-9.0, 9.0)), measure())
    (open_direction,) = (f for f in found.findings if f.code == EstimationCode.DIRECTION_UNDETERMINED)
    (formula,) = open_direction.values["determined"]
    assert formula["text"] == text
    assert abs(formula["value"] - GAIN) < 4 * formula["std"] < 0.02
