"""Readings about a round number lie near one point of many grids: that is no step of their sensor, and no noise."""

import numpy as np
import pytest

from greybox.data.experiment import Experiment
from greybox.data.noise.noise_sources import estimate_noise
from greybox.data.noise.repeats import estimate_written_step
from greybox.data.sensor_faults import find_reading_step
from tests.support.first_order import first_order

# Level, movement (rms), noise, and decimals with which a logger writes it.
EVERYDAY = {
    "room, K": (300, 0.5, 0.01, 3),
    "cellar, K": (283, 0.3, 0.02, 2),
    "grid of 50 Hz": (50, 0.03, 0.001, 4),
    "grid of 60 Hz": (60, 0.02, 0.0005, 4),
    "mains of 230 V": (230, 1.2, 0.2, 2),
    "mains of 240 V": (240, 0.9, 0.1, 2),
    "battery, V": (12, 0.05, 0.002, 3),
    "bus of 24 V": (24, 0.08, 0.005, 3),
    "rail of 5 V": (5, 0.004, 0.0002, 5),
    "rail of 3.3 V": (3.3, 0.003, 0.0001, 5),
    "air, Pa": (1e5, 300, 20, 0),
    "air, bar": (1.013, 0.004, 0.0002, 5),
    "supply, bar": (6, 0.03, 0.002, 4),
    "oil, bar": (200, 1, 0.1, 2),
    "speed, rpm": (3000, 12, 0.5, 1),
    "speed, rad/s": (100, 0.4, 0.02, 3),
    "level, m": (2, 0.01, 0.0005, 5),
    "level, mm": (500, 3, 0.2, 1),
    "bath, degC": (70, 0.2, 0.01, 3),
    "oven, degC": (1000, 5, 0.5, 1),
    "flow, l/min": (10, 0.06, 0.003, 4),
    "pH": (7, 0.02, 0.002, 4),
    "force, N": (100, 0.5, 0.05, 3),
    "current, A": (20, 0.1, 0.01, 3),
}


def reading(name, rows=800):
    level, movement, noise, _ = EVERYDAY[name]
    rng = np.random.default_rng(list(EVERYDAY).index(name))
    u, x = np.repeat(rng.normal(size=rows // 20), 20), np.zeros(rows)
    for k in range(rows - 1):
        x[k + 1] = x[k] + 0.1 * (u[k] - x[k])
    return u, level + movement * x / np.std(x) + noise * rng.normal(size=rows)


@pytest.mark.crossed(3)
@pytest.mark.parametrize("written", [False, True], ids=["as measured", "as written"])
@pytest.mark.parametrize("name", EVERYDAY)
def test_the_noise_about_a_round_number_is_that_of_the_sensor(name, written):
    u, y = reading(name)
    _, _, noise, decimals = EVERYDAY[name]
    record = Experiment.from_arrays(0.1 * np.arange(len(y)), {"u": u}, {"y": np.round(y, decimals) if written else y})
    found = estimate_noise(first_order(), [record], {})
    assert 0.5 * noise < found.std[0] < 2 * noise


@pytest.mark.parametrize("offset", [0.0, 273.15, 1e4])
@pytest.mark.parametrize("step", [0.5, 0.01, 1.0])
def test_a_written_step_is_still_found_where_readings_visit_many_points(step, offset):
    y = np.round(np.random.default_rng(1).normal(0.0, 20 * step, 500) / step) * step + offset
    assert estimate_written_step([y]) == pytest.approx(step, rel=1e-6)


def test_significant_digits_are_found_over_several_decades():
    y = np.array([float(f"{v:.3g}") for v in np.geomspace(1e-3, 900.0, 300)])
    expected = np.sqrt(np.mean([10.0 ** (2 * (np.floor(np.log10(v)) - 2)) for v in np.unique(y)]))
    assert estimate_written_step([y]) == pytest.approx(expected, rel=1e-6)


def test_no_noise_exceeds_what_the_signal_moves():
    rng = np.random.default_rng(2)
    u = np.repeat(rng.normal(size=20), 5)
    # Codes of a coarse sensor, which a signal hardly moves between.
    y = np.where(rng.random(100) < 0.02, 310.0, 300.0)
    found = estimate_noise(first_order(), [Experiment.from_arrays(np.arange(100.0), {"u": u}, {"y": y})], {})
    assert found.std[0] <= np.std(y)


@pytest.mark.parametrize("least", [5e-324, 1e-320, 1e-310])
def test_numbers_that_have_lost_their_digits_have_no_step(least):
    """A damaged file may hold them: no warning of the arithmetic may end its check."""
    readings = np.concatenate([np.random.default_rng(1).normal(size=400), least * np.arange(1, 30)])
    assert find_reading_step(readings) is None
    assert estimate_written_step([readings]) == 0.0
