"""Whether an input follows a reading: a mass with spring and damper, exact from row to row (SciPy), in a loop and without one."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from greybox.data.closed_loop import measure_feedback
from greybox.data.experiment import Experiment
from greybox.data.findings import RecordCode

PERIOD, ROWS, NOISE = 0.01, 1500, 1e-3
A, B, *_ = cont2discrete(
    (np.array([[0, 1], [-20, -0.6]]), np.array([[0.0], [1.0]]), np.eye(2), np.zeros((2, 1))), PERIOD
)


def run(control, seed=0, disturbance=0.0):
    """Input and reading (ROWS,): ``control(row, readings before this row, generator)`` gives the input of a row."""
    generator = np.random.default_rng(seed)
    state, load, inputs, readings = np.zeros(2), 0.0, [], []
    for row in range(ROWS):
        inputs.append(control(row, readings, generator))
        readings.append(state[0] + NOISE * generator.normal())
        load = 0.95 * load + disturbance * generator.normal()
        state = A @ state + B[:, 0] * (inputs[-1] + load)
    return np.array(inputs), np.array(readings)


PHASES = np.random.default_rng(9).uniform(0, 2 * np.pi, 30)
TONES = np.arange(1, 31)


def held(values):
    """The same draw for as many rows as ``values`` says."""
    return lambda row, readings, generator: 5 * np.random.default_rng((row // values, 3)).normal()


def toggled(row, readings, generator):
    return 5.0 * (-1) ** (row // 100)


def tones(row, readings, generator):
    return float(np.sin(2 * np.pi * TONES * row * PERIOD / 5 + PHASES).sum())


def sweep(row, readings, generator):
    t = row * PERIOD
    return 5 * np.sin(2 * np.pi * (0.1 * t + 0.1 * t**2))


def measured_tones(row, readings, generator):
    return tones(row, readings, generator) + 0.02 * generator.normal()


OPEN = {
    "held for 25 rows": held(25),
    "white": held(1),
    "square": toggled,
    "tones": tones,
    "sweep": sweep,
    "measured tones": measured_tones,
}


@pytest.mark.crossed(3)
@pytest.mark.parametrize("name", OPEN)
def test_an_input_that_was_chosen_beforehand_follows_nothing(name):
    for seed in range(10):
        assert measure_feedback(*run(OPEN[name], seed, disturbance=0.5)) < 0.1


def test_an_input_that_is_recorded_with_noise_follows_nothing():
    """The plant had the input itself, so its readings know more of it than the record does; afterwards as much again."""
    for noise in (0.02, 0.1, 0.5):
        t = PERIOD * np.arange(ROWS)
        u = np.sin(2 * t) + 0.5 * np.sin(5.3 * t + 1) + 0.015 * np.cumsum(np.random.default_rng(1).normal(size=ROWS))
        y = lfilter([0, 0.1], [1, -0.9], u)
        recorded = u + noise * np.random.default_rng(2).normal(size=ROWS)
        assert measure_feedback(recorded, y + NOISE * np.random.default_rng(3).normal(size=ROWS)) == 0.0


def following(row, readings, generator):
    """A controller of position and speed, a row late, about a path."""
    past = [0.0, 0.0, *readings][-2:]
    error = np.sin(2 * np.pi * 0.3 * row * PERIOD) - past[1]
    return 40.0 * error - 0.4 * (past[1] - past[0]) / PERIOD + 0.05 * generator.normal()


def test_an_input_of_a_controller_follows_its_output_and_the_record_says_which():
    for seed in range(10):
        assert measure_feedback(*run(following, seed, disturbance=0.5)) > 0.5
    u, y = run(following, disturbance=0.5)
    other = np.random.default_rng(5).normal(size=ROWS)
    record = Experiment.from_arrays(PERIOD * np.arange(ROWS), {"u": u}, {"z": other, "y": y})
    (loop,) = (f for f in record.findings if f.code == RecordCode.INPUT_FOLLOWS_OUTPUT)
    assert loop.subject == "u" and loop.values["output"] == "y" and loop.values["share"] > 0.5


def test_a_reading_that_shows_the_input_of_its_own_row_is_no_loop():
    """A plant faster than the sampling: the reading knows the input, because the input made it."""
    u = np.random.default_rng(2).normal(size=ROWS)
    assert measure_feedback(u, 3 * u + 1e-3 * np.random.default_rng(3).normal(size=ROWS)) == 0.0


@pytest.mark.parametrize("rows", [5, 17, 30])
def test_few_rows_and_rows_without_a_reading_say_nothing(rows):
    u, y = run(following)
    assert measure_feedback(u[:rows], y[:rows]) == 0.0
    assert measure_feedback(u, np.full(ROWS, np.nan)) == 0.0
