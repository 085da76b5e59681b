"""Frequency responses as records: read, and fitted alone or with records over time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize, signal

import greybox as gb
from greybox.base.errors import DataError
from greybox.comparison.frequency.fit_response import fit_frequency_response
from greybox.comparison.frequency.response import FrequencyResponse, read_frequency_response
from models.micro_actuator import micro_actuator

TRUE = micro_actuator.fix("M", "Ra", "La", "Kf", "Kv")
START = TRUE.start(B=1.6 * TRUE.parameter("B").value, K=0.7 * TRUE.parameter("K").value)
BAND = np.geomspace(5, 400, 40)


def exact_response(frequency, output="x"):
    """From the transfer function that scipy makes of the three balances, written out by hand."""
    M, B, K, Kf, Kv, La, Ra = (TRUE.parameter(n).value for n in ("M", "B", "K", "Kf", "Kv", "La", "Ra"))
    A = np.array([[0, 1, 0], [-K / M, -B / M, Kf / M], [0, -Kv / La, -Ra / La]])
    C = {"x": [[1.0, 0, 0]], "i": [[0, 0, 1.0]]}[output]
    num, den = signal.ss2tf(A, np.array([[0], [0], [1 / La]]), np.array(C), np.zeros((1, 1)))
    return signal.freqs(num[0], den, 2 * np.pi * frequency)[1], np.linalg.eigvals(A)


def noisy(seed, share=0.01, frequency=BAND):
    exact = exact_response(frequency)[0]
    std = share * np.abs(exact)
    rng = np.random.default_rng(seed)
    disturbed = exact + std / np.sqrt(2) * (rng.standard_normal(len(exact)) + 1j * rng.standard_normal(len(exact)))
    return FrequencyResponse.from_points(frequency, np.abs(disturbed), np.angle(disturbed), "u", "x", std=std)


def test_poles_from_exact_points_are_those_of_scipy():
    exact, poles = exact_response(BAND)
    points = FrequencyResponse(BAND, exact[:, None, None], ("u",), ("x",))
    result = fit_frequency_response(START, points)
    assert result.success
    fitted = gb.linearise(result.model).poles
    np.testing.assert_allclose(np.sort_complex(fitted), np.sort_complex(poles), rtol=1e-6)


def test_a_resonance_three_times_too_low_is_found():
    far = TRUE.start(K=TRUE.parameter("K").value / 9, B=10 * TRUE.parameter("B").value)
    result = fit_frequency_response(far, noisy(0))
    assert result.parameters["K"].value == pytest.approx(TRUE.parameter("K").value, rel=5e-3)


@pytest.mark.rest
def test_intervals_hold_the_truth_as_often_as_they_say():
    inside, widths = [], []
    for seed in range(40):
        result = fit_frequency_response(TRUE, noisy(seed, frequency=BAND[::2]))
        for name in result.uncertainty.free:
            low, high = result.parameters[name].interval
            inside.append(low <= TRUE.parameter(name).value <= high)
        widths.append(np.sqrt(np.mean([m.noise_ratio**2 for m in result.misfit.values()])))
    assert 0.88 < np.mean(inside) <= 1
    assert np.mean(widths) == pytest.approx(1, abs=0.1)


def test_points_without_variance_get_intervals_from_their_error():
    points = noisy(3)
    bare = FrequencyResponse(points.frequency, points.response, ("u",), ("x",))
    result, weighted = (fit_frequency_response(TRUE, p) for p in (bare, points))
    assert result.parameters["K"].std == pytest.approx(weighted.parameters["K"].std, rel=0.4)


def test_points_and_records_together_know_more_than_each_alone():
    rng = np.random.default_rng(5)
    time = 2.5e-4 * np.arange(400)
    u = gb.signals.multisine(time, 5, 300, 1.0, rng)
    record = gb.simulate(TRUE, {"time": time, "u": u}).record({"x": 1e-6, "i": 1e-2}, rng)
    noise = {"x": 1e-6, "i": 1e-2}
    points = noisy(6, 1e-3)
    both = fit_frequency_response(START, points, record, noise=noise)
    alone, over_time = fit_frequency_response(START, points), gb.fit(START, record, noise=noise)
    assert both.success and len(both.traces) == 2
    for name in both.uncertainty.free:
        stds = [f.parameters[name].std for f in (alone, over_time, both)]
        expected = (stds[0] ** -2 + stds[1] ** -2) ** -0.5
        assert stds[2] < min(stds[:2])
        assert stds[2] == pytest.approx(expected, rel=0.3)
        assert abs(both.parameters[name].value - TRUE.parameter(name).value) < 4 * stds[2]


def test_a_response_of_a_held_input_is_fitted_as_such():
    dt = 1e-3
    frequency = np.geomspace(5, 450, 30)
    linear = gb.linearise(TRUE, dt=dt)
    points = FrequencyResponse(
        frequency, linear.frequency_response(2 * np.pi * frequency)[:, :1], ("u",), ("x",), sampling_time=dt
    )
    result = fit_frequency_response(START, points)
    assert result.parameters["K"].value == pytest.approx(TRUE.parameter("K").value, rel=1e-7)


@pytest.mark.parametrize("form", ["polar", "decibels", "complex"])
def test_points_are_read_from_a_file(tmp_path, form):
    exact = exact_response(BAND)[0]
    columns = {
        "polar": ("frequency [Hz],magnitude,phase [deg]", BAND, np.abs(exact), np.rad2deg(np.angle(exact))),
        "decibels": (
            "omega [rad/s],gain [dB],phase [rad]",
            2 * np.pi * BAND,
            20 * np.log10(np.abs(exact)),
            np.angle(exact),
        ),
        "complex": ("f,real,imag", BAND, exact.real, exact.imag),
    }[form]
    rows = "\n".join(",".join(map(repr, row)) for row in np.column_stack(columns[1:]).tolist())
    (tmp_path / "bode.csv").write_text(
        f"{columns[0]},coherence\n" + "\n".join(f"{r},0.99" for r in rows.splitlines()) + "\n"
    )
    points = read_frequency_response(tmp_path / "bode.csv", "u", "x", averages=10)
    np.testing.assert_allclose(points.response[:, 0, 0], exact, rtol=1e-9)
    np.testing.assert_allclose(points.variance[:, 0, 0], np.abs(exact) ** 2 * 0.01 / 9.9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frequency": [2.0, 1.0]}, "increase from point to point"),
        ({"response": np.ones((3, 1, 1))}, "has shape"),
        ({"response": np.full((2, 1, 1), np.nan)}, "no point holds a value"),
        ({"variance": np.zeros((2, 1, 1))}, "not above 0"),
    ],
)
def test_points_that_cannot_be_are_refused(change, message):
    good = {"frequency": [1.0, 2.0], "response": np.ones((2, 1, 1)), "inputs": ("u",), "outputs": ("x",)}
    with pytest.raises(DataError, match=message):
        FrequencyResponse(**{**good, **change})


def test_a_signal_that_the_model_does_not_have_is_refused():
    with pytest.raises(DataError, match="has no output 'z'"):
        fit_frequency_response(TRUE, FrequencyResponse([1.0], np.ones((1, 1, 1)), ("u",), ("z",)))


@pytest.mark.rest
def test_a_resonance_curve_without_phase_is_a_measurement(tmp_path):
    exact = exact_response(BAND)[0]
    rng = np.random.default_rng(5)
    std = 0.01 * np.abs(exact)
    magnitude = np.abs(exact) + std * rng.standard_normal(len(BAND))
    rows = "\n".join(f"{f:.9g},{20 * np.log10(m):.9g}" for f, m in zip(BAND, magnitude, strict=True))
    (tmp_path / "curve.csv").write_text(f"frequency [Hz],magnitude [dB]\n{rows}\n")
    read = read_frequency_response(tmp_path / "curve.csv", "u", "x")
    assert not read.with_phase
    np.testing.assert_allclose(read.response[:, 0, 0], magnitude, rtol=1e-7)

    # scipy's own least squares on the magnitude, from the transfer function written out by hand
    def error(z):
        M, Kf, Kv, La, Ra = (TRUE.parameter(n).value for n in ("M", "Kf", "Kv", "La", "Ra"))
        s = 2j * np.pi * BAND
        mechanical = M * s**2 + np.exp(z[0]) * s + np.exp(z[1])
        return (np.abs(Kf / (mechanical * (La * s + Ra) + Kf * Kv * s)) - magnitude) / std

    known = FrequencyResponse.from_points(BAND, magnitude, None, "u", "x", std=std)
    result = fit_frequency_response(START, known)
    own = optimize.least_squares(error, np.log([START.values["B"], START.values["K"]]), x_scale="jac", xtol=1e-14)
    spread = np.sqrt(np.diag(np.linalg.inv(own.jac.T @ own.jac)))
    for k, name in enumerate(("B", "K")):
        assert result.parameters[name].value == pytest.approx(np.exp(own.x[k]), rel=1e-5)
        assert result.parameters[name].std == pytest.approx(np.exp(own.x[k]) * spread[k], rel=0.02)
    assert result.misfit["x_per_u_magnitude"].noise_ratio == pytest.approx(np.sqrt(2 * own.cost / len(BAND)), rel=0.02)
    # Without a std each point is known by a share of its size: the same on its logarithm, which moves and so can be followed.
    untold = fit_frequency_response(TRUE.start(K=TRUE.parameter("K").value / 4), read)
    shares = optimize.least_squares(lambda z: np.log1p(error(z) * std / magnitude), own.x, x_scale="jac", xtol=1e-14)
    np.testing.assert_allclose([untold.parameters[name].value for name in ("B", "K")], np.exp(shares.x), rtol=1e-5)
    assert untold.misfit["x_per_u_log_magnitude"].best_fit_percent > 90
