"""A standard deviation for each row: as published tables have error bars."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import curve_fit

import greybox as gb
from greybox import Balance, Experiment, Model, Output, Parameter, State
from greybox.base.errors import DataError, ModelError

OPTIONS = gb.FitOptions(at_rest=True)


def decay() -> Model:
    """y' = -k y, y(0) = A; y = A exp(-k t)."""
    return Model(
        "decay",
        states=[State("y", "g", lambda p: p.A)],
        inputs=[],
        outputs=[Output("y", "g")],
        parameters=[Parameter("A", "g", 3.0, (0.0, 100.0)), Parameter("k", "1/s", 0.5, (0.0, 10.0))],
        balances=lambda x, u, p: [Balance("rate", "g/s", 1, "y", loss=-p.k * x.y)],
    )


TIME = np.linspace(0.0, 5.0, 60)


def record(seed: int, *, growing: bool = True) -> Experiment:
    std = 0.01 + 0.1 * np.exp(-TIME) if growing else np.full(60, 0.02)
    y = 5.0 * np.exp(-0.8 * TIME) + std * np.random.default_rng(seed).standard_normal(60)
    return Experiment("table", TIME, {}, {"y": y}, noise={"y": std})


def test_constants_and_intervals_are_those_of_weighted_least_squares() -> None:
    data = record(1)
    result = gb.fit(decay(), data, options=OPTIONS)
    values, covariance = curve_fit(
        lambda t, a, k: a * np.exp(-k * t), TIME, data.outputs["y"], (3.0, 0.5), data.noise["y"], absolute_sigma=True
    )
    for name, value, std in zip(("A", "k"), values, np.sqrt(np.diag(covariance)), strict=True):
        assert result.parameters[name].value == pytest.approx(value, rel=1e-6)
        # Intervals widen only where the residual exceeds the noise.
        assert result.parameters[name].std == pytest.approx(std, rel=0.15)
    assert result.noise.sources["y"] == "given"
    assert result.noise.std["y"] == pytest.approx(np.sqrt(np.mean(data.noise["y"] ** 2)))


def test_the_same_noise_in_every_row_is_one_number() -> None:
    data = record(2, growing=False)
    rows = gb.fit(decay(), data, options=OPTIONS)
    once = gb.fit(decay(), Experiment("table", TIME, {}, data.outputs), noise={"y": 0.02}, options=OPTIONS)
    for name in ("A", "k"):
        assert rows.parameters[name].value == pytest.approx(once.parameters[name].value, rel=1e-7)
        assert rows.parameters[name].std == pytest.approx(once.parameters[name].std, rel=1e-5)


@pytest.mark.slow
def test_intervals_cover_the_truth() -> None:
    inside = 0
    for seed in range(100):
        low, high = gb.fit(decay(), record(seed), options=OPTIONS).parameters["k"].interval
        inside += low < 0.8 < high
    assert 90 <= inside <= 99


def test_parts_of_a_record_keep_their_noise_and_its_fingerprint_tells_it() -> None:
    data = record(1)
    part = data.window(10, 30)
    np.testing.assert_array_equal(part.noise["y"], data.noise["y"][10:30])
    assert not data.with_outputs({}).noise
    assert data.fingerprint != Experiment("table", TIME, {}, data.outputs).fingerprint


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ({"z": np.ones(60)}, "noise of 'z': there is no such output"),
        ({"y": np.zeros(60)}, "noise of 'y' is 0 in row 1; give a positive standard deviation"),
        ({"y": np.ones(59)}, "noise of 'y' has 59 rows, time has 60"),
    ],
)
def test_what_is_no_noise_is_refused(noise: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(DataError, match=message):
        Experiment("table", TIME, {}, {"y": np.exp(-TIME)}, noise=noise)


def test_records_tell_it_all_or_none() -> None:
    bare = Experiment("other", TIME, {}, record(2).outputs)
    with pytest.raises(DataError, match="'table' tells it row by row, 'other' does not"):
        gb.fit(decay(), [record(1), bare], options=OPTIONS)
    with pytest.raises(ModelError, match="a fit with process noise takes one standard deviation"):
        gb.fit(decay().with_process_noise("y"), record(1), options=OPTIONS)
