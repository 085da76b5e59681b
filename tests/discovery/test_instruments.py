"""A physical name has to beat the lie of an instrument: gains, units and clocks on a pendulum whose constants are known."""

import numpy as np
import pytest
from scipy.signal import lfilter

import greybox as gb
from greybox.discovery.findings import DiscoveryCode as Code
from greybox.estimation.findings import EstimationCode
from tests.support.findings import find
from tests.support.first_order import first_order
from tests.support.weighed_pendulum import NOISE, WITH_FRICTION, swung

pytestmark = pytest.mark.rest

NAMES = ("input_gain", "sensor_gain", "clock_skew", "cubic_stiffness")
KNOWN = WITH_FRICTION.fix("J", "mgl")


def search(model, record, rows):
    """A search in the first two thirds of these rows, judged on the last."""
    learnt, kept = record.window(0, 2 * rows // 3), record.window(2 * rows // 3, rows)
    return gb.discover(model, learnt, validation=kept, noise=NOISE, effects=[gb.effect(name) for name in NAMES])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("made", "name", "value", "rows"),
    [
        pytest.param({"gain": 9.80665}, "input_gain", 1 / 9.80665 - 1, 300, id="kilogram-force read as newton"),
        pytest.param({"skew": 0.04}, "clock_skew", 0.04, 180, id="a clock that is 4 % slow"),
    ],
)
def test_the_lie_of_an_instrument_is_named(made, name, value, rows):
    found = search(KNOWN, swung(**made), rows)
    (effect,) = found.effects
    (constant,) = effect["parameters"].values()
    assert effect["name"] == name and effect["grade"] == "established"
    assert abs(constant["value"] - value) < 4 * constant["std"]
    if name == "input_gain":
        unit = find(found.instruments, EstimationCode.GAIN_IS_UNIT_FACTOR)
        assert unit.values["units"] == "kilogram-force and newton" and str(unit) in " ".join(str(found).split())


@pytest.mark.parametrize("side", [1, pytest.param(-1, marks=pytest.mark.slow)], ids=["upper", "lower"])
def test_either_end_of_the_range_of_a_sensor_is_named(side):
    """A converter shows its last value for all that is beyond, with the noise in front of it."""
    generator = np.random.default_rng(15)
    period, lag, gain, end = 0.05, 0.5, 2.0, side * 1.2
    u = np.repeat(generator.normal(size=60), 10)
    # First-order lag under a held input, its step in closed form.
    kept = np.exp(-period / lag)
    y = lfilter([0.0, gain * (1 - kept)], [1.0, -kept], u) + 0.01 * generator.normal(size=len(u))
    cut = side * np.minimum(side * y, side * end)
    assert 0.02 < np.mean(cut != y) < 0.3
    record = gb.Experiment("cut", period * np.arange(len(u)), {"u": u}, {"y": cut})
    names = ("sensor_saturation", "reading_curve", "input_saturation", "gain_by_sign", "input_offset")
    found = gb.discover(
        first_order(),
        record.window(0, 400),
        validation=record.window(400, 600),
        noise={"y": 0.01},
        effects=[gb.effect(name) for name in names],
    )
    (effect,) = found.effects
    assert effect["name"] == "sensor_saturation" and effect["grade"] == "established"
    assert found.extended.model.values["side"] == side
    assert abs(found.extended.model.values["y_max"] - end) < 0.01


@pytest.mark.slow
def test_weighed_constants_that_take_a_gain_are_said_where_nothing_is_established():
    """A weight of one per cent gives way to a record: the model follows it, and the answer says at what price."""
    found = search(WITH_FRICTION, swung(gain=1.15), rows=300)
    alike = find(found.instruments, EstimationCode.PRIORS_OFF_ALIKE)
    assert alike.values["factor"] == pytest.approx(1.15, abs=0.02) and str(alike) in " ".join(str(found).split())
    assert alike in found.all_findings


@pytest.mark.slow
def test_where_the_constants_are_free_no_scale_is_tried_and_the_answer_says_what_takes_it():
    record = swung(gain=1.15)
    learnt, kept = record.window(0, 400), record.window(400, 600)
    free = WITH_FRICTION.prior(J=None, mgl=None)
    found = gb.discover(
        free, learnt, validation=kept, noise=NOISE, effects=[gb.effect(n) for n in ("input_gain", "cubic_stiffness")]
    )
    taken = found.not_tried["input_gain"]
    assert taken.code == Code.TAKEN_BY_CONSTANTS and {"J", "mgl"} < set(taken.values["constants"])
    assert not found.effects
