"""Gains of a mistaken unit, steps of a reading and jitter of stamps, on a mass whose motion is that of its matrix exponential."""

import numpy as np
import pytest
from scipy.linalg import expm

import greybox as gb
from greybox.estimation.findings import EstimationCode
from greybox.estimation.reading_errors import estimate_jitter
from tests.support.findings import find

PERIOD, ROWS = 0.02, 600
M, K, B = 0.5, 8.0, 0.4
MASS = gb.Model(
    "mass",
    states=[gb.State("x", "m", role="displacement"), gb.State("v", "m/s", role="velocity")],
    inputs=[gb.Input("F", "N", role="drive")],
    outputs=[gb.Output("x", "m")],
    parameters=[
        gb.Parameter("M", "kg", M, (1e-3, 1e3), fixed=True),
        gb.Parameter("K", "N/m", K, (1e-2, 1e6)),
        gb.Parameter("B", "N*s/m", B, (1e-4, 1e3)),
    ],
    balances=lambda x, u, p: [
        gb.Balance("motion", "m/s", 1, "x", v=x.v),
        gb.Balance("force", "N", p.M, "v", drive=u.F, spring=-p.K * x.x, damper=-p.B * x.v),
    ],
)


def pushed(seed=4):
    """A held force (ROWS,) and position and speed (ROWS, 2), exact at every row."""
    force = np.repeat(np.random.default_rng(seed).normal(size=ROWS // 10), 10)
    generator = np.array([[0, 1, 0], [-K / M, -B / M, 1 / M], [0, 0, 0]])
    step = expm(PERIOD * generator)
    states = np.zeros((ROWS, 2))
    for k in range(ROWS - 1):
        states[k + 1] = step[:2, :2] @ states[k] + step[:2, 2] * force[k]
    return force, states


def record(force, position, noise, seed=1):
    error = noise * np.random.default_rng(seed).normal(size=ROWS)
    return gb.Experiment("pushed", PERIOD * np.arange(ROWS), {"F": force}, {"x": position + error})


def codes(found):
    return {f.code for f in found.findings}


@pytest.mark.parametrize(
    ("name", "gain", "units"),
    [
        # rpm read as rad/s: 2 pi / 60.
        ("sensor_gain", 0.1047197551, "revolutions a minute and radians a second"),
        ("sensor_gain", 1000.0, "a power of ten"),
        ("input_gain", 9.80665, "kilogram-force and newton"),
        ("input_gain", 1 / 57.29577951, "degrees and radians"),
        ("sensor_gain", 1.15, None),
        ("input_gain", 7.0, None),
    ],
)
def test_a_gain_that_is_the_factor_of_two_units_is_named(name, gain, units):
    force, states = pushed()
    shown, size = (force, gain) if name == "sensor_gain" else (force / gain, 1.0)
    model = (MASS + gb.effect(name)).start(g=0.5 * gain if gain > 1 else -0.5)
    found = gb.fit(model, record(shown, size * states[:, 0], 1e-3 * size), noise={"x": 1e-3 * size})
    assert 1 + found.parameters["g"].value == pytest.approx(gain, rel=0.01)
    if units is None:
        assert EstimationCode.GAIN_IS_UNIT_FACTOR not in codes(found)
    else:
        mistaken = find(found.findings, EstimationCode.GAIN_IS_UNIT_FACTOR)
        assert mistaken.subject == name and mistaken.values["units"] == units and units in str(mistaken)


def test_a_residual_that_is_the_steps_of_the_reading_is_said_to_be():
    force, states = pushed()
    rounded = 0.05 * np.round(states[:, 0] / 0.05)
    found = gb.fit(MASS, record(force, rounded, 0.0), noise={"x": 0.05 / np.sqrt(12)})
    steps = find(found.findings, EstimationCode.RESIDUAL_OF_STEPS)
    assert steps.values["step"] == pytest.approx(0.05) and steps.values["share"] > 0.8
    louder = gb.fit(MASS, record(force, rounded, 0.05), noise={"x": 0.05})
    assert EstimationCode.RESIDUAL_OF_STEPS not in codes(louder)


def test_a_residual_of_stamps_with_jitter_tells_how_far_they_are_off():
    force, states = pushed()
    off = 2e-3 * np.random.default_rng(2).normal(size=ROWS)
    # Taken a little early or late: position plus speed times that.
    late = states[:, 0] + states[:, 1] * off
    found = gb.fit(MASS, record(force, late, 2e-4), noise={"x": 1e-3})
    jitter = find(found.findings, EstimationCode.RESIDUAL_OF_JITTER)
    assert jitter.values["jitter"] == pytest.approx(2e-3, rel=0.15) and jitter.values["share"] > 0.5
    assert EstimationCode.RESIDUAL_OF_JITTER not in codes(gb.fit(MASS, record(force, states[:, 0], 1e-3)))


def test_what_looks_like_stamps_that_are_off_by_more_than_a_step_is_no_jitter():
    force, states = pushed()
    off = np.random.default_rng(2).normal(size=ROWS)
    for steps, is_jitter in (0.5, True), (1.5, False):
        late = states[:, 0] + states[:, 1] * steps * PERIOD * off
        found = gb.fit(MASS, record(force, late, 2e-4), noise={"x": 1e-3})
        assert (EstimationCode.RESIDUAL_OF_JITTER in codes(found)) == is_jitter


def test_noise_that_is_constant_or_grows_with_the_reading_is_no_jitter():
    _, states = pushed()
    position, speed = states.T
    for seed in range(100):
        error = np.random.default_rng(seed).normal(size=ROWS)
        assert estimate_jitter(error, speed, position) is None
        assert estimate_jitter(error * (0.01 + 0.1 * np.abs(position)), speed, position) is None
