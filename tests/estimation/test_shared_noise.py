"""One measurement in two records is known by its noise, whatever was done to its readings; a repeated experiment is not one."""

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Experiment, Input, Model, Output, Parameter, State
from greybox.estimation.findings import EstimationCode

ROWS, STEP, NOISE = 400, 0.1, 0.05


def lag():
    return Model(
        "lag",
        states=[State("x", "K")],
        inputs=[Input("u", "K")],
        outputs=[Output("x", "K")],
        parameters=[Parameter("tau", "s", 3.0, (0.1, 100.0)), Parameter("k", "1", 1.0, (0.1, 10.0))],
        balances=lambda x, u, p: [Balance("heat", "K", p.tau, "x", inflow=p.k * u.u, out=-x.x)],
    )


def measure(cube=0.0):
    """Input and clean output: the exact step of a lag of 2 s, or Euler steps with a cubic loss that the model lacks."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 0.0, 1.0, 2.0], ROWS // 20), 20)
    x, y = 0.0, []
    for value in u:
        y.append(x)
        for _ in range(20):
            x += STEP / 20 * ((1.5 * value - x) / 2 - cube * x**3)
    return u, np.array(y)


def record(name, u, y):
    return Experiment.from_arrays(STEP * np.arange(len(u)), {"u": u}, {"x": y}, name=name)


def shared(result):
    return [f for f in result.findings if f.code == EstimationCode.NOISE_SHARED]


COPIES = {
    "mirrored": lambda u, y, noise: (-u, -y),
    "in another unit": lambda u, y, noise: (1000 * u, 1000 * y),
    "with fresh noise": lambda u, y, noise: (u, y + 0.2 * noise),
    "with some rows of its own": lambda u, y, noise: (u, np.where(np.arange(ROWS) % 50 == 7, y + noise, y)),
    "smoothed": lambda u, y, noise: (u, np.convolve(y, np.ones(3) / 3, "same")),
}


@pytest.mark.parametrize("copy", COPIES.values(), ids=COPIES)
def test_a_copy_is_known_by_its_noise(copy):
    rng = np.random.default_rng(1)
    u, clean = measure()
    y = clean + NOISE * rng.normal(size=ROWS)
    again = record("b", *copy(u, y, NOISE * rng.normal(size=ROWS)))
    (both,) = shared(gb.fit(lag(), [record("a", u, y), again]))
    assert both.values["other"] == "a" and "count twice" in str(both)
    (judged,) = shared(gb.fit(lag(), record("a", u, y), validation=[again]))
    assert "cannot validate" in str(judged)


@pytest.mark.crossed(3)
@pytest.mark.parametrize("count", [1, 4, 12])
@pytest.mark.parametrize("cube", [0.0, 0.05, 0.5], ids=["noise", "incomplete", "wrong"])
def test_single_glitches_make_no_copy(cube, count):
    """The most of the power of each residual lies in a few rows, of their own in each record."""
    rng = np.random.default_rng(3)
    u, clean = measure(cube)
    records = []
    for name in "abc":
        y = clean + NOISE * rng.normal(size=ROWS)
        y[rng.choice(ROWS, count, replace=False)] += 30.0 * rng.choice([-1.0, 0.7], count)
        records.append(record(name, u, y))
    assert not shared(gb.fit(lag(), records[:2], validation=records[2:], options=gb.FitOptions(loss="huber")))


def test_a_copy_is_known_under_glitches_of_its_own():
    rng = np.random.default_rng(1)
    u, clean = measure()
    y = clean + NOISE * rng.normal(size=ROWS)
    copies = [np.where(np.arange(ROWS) % 80 == at, y + 30.0, y) for at in (11, 57)]
    assert shared(
        gb.fit(lag(), [record(n, u, c) for n, c in zip("ab", copies, strict=True)], options=gb.FitOptions(loss="huber"))
    )


@pytest.mark.parametrize(("cube", "step"), [(0.0, 0.0), (0.05, 0.0), (0.0, 0.1)], ids=["noise", "incomplete", "coarse"])
def test_a_repeated_experiment_is_another_measurement(cube, step):
    rng = np.random.default_rng(2)
    u, clean = measure(cube)
    noise = NOISE if not step else 0.3 * step
    readings = [clean + noise * rng.normal(size=ROWS) for _ in range(3)]
    readings = [np.round(y / step) * step if step else y for y in readings]
    records = [record(name, u, y) for name, y in zip("abc", readings, strict=True)]
    assert not shared(gb.fit(lag(), records[:2], validation=records[2:]))
