"""A delay longer than the first limit of its search, from coarse readings: against the exact response of a first-order lag."""

import numpy as np
import pytest

import greybox as gb
from greybox import Experiment, fit
from tests.support.first_order import first_order

H, ROWS, FINE = 0.1, 600, 50
GAIN, LAG = 2.0, 0.8


def make_record(delay: float, step: float, noise: float, hold: int) -> Experiment:
    """Readings of a lag behind a held input that is late by ``delay`` rows, rounded to multiples of ``step``."""
    rng = np.random.default_rng(hold)
    drive = np.repeat(rng.choice([0.0, 1.0, 2.0], ROWS // hold + 1), hold)[:ROWS]
    late = np.concatenate([np.full(round(delay * FINE), drive[0]), np.repeat(drive, FINE)])[: ROWS * FINE]
    state, decay = GAIN * drive[0], np.exp(-H / FINE / LAG)
    readings = np.empty(ROWS)
    for k, value in enumerate(late):
        if k % FINE == 0:
            readings[k // FINE] = state
        # Exact for a held input: x+ = e^(-h/T) x + (1 - e^(-h/T)) K u.
        state = decay * state + (1 - decay) * GAIN * value
    readings = np.round((readings + noise * rng.normal(size=ROWS)) / step) * step
    (u,), (y,) = (i.name for i in PLANT.inputs), (o.name for o in PLANT.outputs)
    return Experiment.from_arrays(H * np.arange(ROWS), {u: drive}, {y: readings}, hold="zero")


PLANT = first_order(gain=1.0, lag=1.0)


# Each delay and each noise; the other pairs at night.
DELAYS, NOISES = (16.3, 17.0, 30.7, 59.4), ((0.02, 0.005), (0.1, 0.02), (0.3, 0.05))
PAIRS = ((16.3, 0.02), (17.0, 0.1), (30.7, 0.1), (59.4, 0.1), (59.4, 0.3))


@pytest.mark.crossed(3)
@pytest.mark.parametrize(
    ("delay", "step", "noise"),
    [
        pytest.param(delay, step, noise, marks=[pytest.mark.slow] * ((delay, step) not in PAIRS))
        for delay in DELAYS
        for step, noise in NOISES
    ],
)
def test_a_delay_beyond_the_first_limit_is_found(delay, step, noise):
    found = fit(PLANT + gb.effect("transport_delay"), make_record(delay, step, noise, hold=25))
    stated = found.parameters["delay"]
    assert abs(stated.value / H - delay) < 4 * stated.std / H and stated.std / H < 0.2 and not stated.at_bound
    lag = found.parameters[found.uncertainty.free[1]]
    assert abs(lag.value - LAG) < 4 * lag.std


def test_a_limit_of_the_users_stays():
    bounded = (PLANT + gb.effect("transport_delay")).bound(delay=(0.0, 20 * H))
    found = fit(bounded, make_record(30.7, 0.1, 0.02, hold=25))
    assert found.parameters["delay"].value <= 20 * H
