"""A band-limited input: between samples it is neither held nor straight. Against theory, and on a public record."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import firwin, resample_poly

from greybox import Experiment
from greybox.base.errors import DataError
from greybox.model.effects.catalogue import effect
from greybox.simulation.integrators.discretisation import discretise
from greybox.simulation.kernel.compiled import CompiledKernel
from greybox.simulation.kernel.interface import KernelPoint
from greybox.simulation.records import (
    BAND_LIMITED_KAISER_BETA,
    BAND_LIMITED_POINTS,
    HALF_LENGTH,
    interpolate_band_limited,
    to_record,
)
from models.silverbox import silverbox
from tests.support.stepping import oscillator, path, values

BAND = (0.02, 0.1, 0.2, 0.3, 0.35)


@pytest.mark.parametrize("share", BAND)
def test_a_band_limited_input_drives_an_oscillator_as_theory_says(share):
    """Tones up to 0.35 of the sampling rate through a linear oscillator, against its frequency response."""
    rate, rows = 50.0, 3000
    model = oscillator(B=20.0)
    w, t = 2 * np.pi * share * rate, np.arange(rows) / rate
    experiment = Experiment("tone", t, {"u": np.cos(w * t + 0.3)}, {"x": np.zeros(rows)}, hold="band-limited")
    data = to_record(model, experiment)
    step = discretise(model.system, values(model), np.zeros((1, 2)), data.lengths)
    y, _ = path(step, data, values(model), np.zeros(2))
    expected = np.real(np.exp(1j * (w * t + 0.3)) / (50.0 - 2.0 * w**2 + 20.0j * w))
    middle = slice(500, -200)
    error = np.abs(data.samples(y)[:, 0] - expected)[middle].max() / np.abs(expected).max()
    assert error < 1e-3, error
    held = path(step, to_record(model, experiment.with_hold("first")), values(model), np.zeros(2))[0][:, 0]
    assert share < 0.05 or np.abs(held - expected)[middle].max() / np.abs(expected).max() > 10 * error


@pytest.mark.parametrize(("hold", "order"), [("zero", 1), ("first", 2)])
def test_a_smooth_input_that_is_held_or_straight_converges_with_its_order(hold, order):
    errors = np.array([tone_error(hold, rate) for rate in (50.0, 100.0, 200.0)])
    assert np.abs(np.log2(errors[:-1] / errors[1:]) - order).max() < 0.1, errors


def test_a_band_limited_input_needs_no_small_sampling_time():
    """No order in the sampling time: from three samples a period on what is left is the ripple of the interpolating filter."""
    assert max(tone_error("band-limited", rate) for rate in (25.0, 50.0, 200.0)) < 2e-5
    assert tone_error("first", 25.0) > 0.2


def tone_error(hold, rate, frequency=8.0):
    """Largest error of a linear oscillator's answer to a tone that is sampled at ``rate``, over the answer, once it has settled."""
    model, w, t = oscillator(B=20.0), 2 * np.pi * frequency, np.arange(int(15 * rate)) / rate
    data = to_record(model, Experiment("tone", t, {"u": np.cos(w * t + 0.3)}, {"x": np.zeros(len(t))}, hold=hold))
    step = discretise(model.system, values(model), np.zeros((1, 2)), data.lengths)
    y, _ = path(step, data, values(model), np.zeros(2))
    expected = np.real(np.exp(1j * (w * t + 0.3)) / (50.0 - 2.0 * w**2 + 20.0j * w))
    settled = slice(len(t) // 3, -len(t) // 10)
    return np.abs(data.samples(y)[:, 0] - expected)[settled].max() / np.abs(expected).max()


@pytest.mark.parametrize("rows", [2, 3, 30, 500])
def test_the_points_between_samples_are_those_of_another_program(rows):
    """`scipy.signal` with the same window: the interpolated points before lines are drawn through them."""
    u = np.random.default_rng(rows).normal(size=(rows, 2)) + 5
    margin, half = min(HALF_LENGTH, rows - 1), HALF_LENGTH * BAND_LIMITED_POINTS
    ends = np.pad(u, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    taps = firwin(2 * half + 1, 1 / BAND_LIMITED_POINTS, window=("kaiser", BAND_LIMITED_KAISER_BETA))
    fine = resample_poly(ends, BAND_LIMITED_POINTS, 1, axis=0, window=taps, padtype="line")
    fine[1:-1] -= (fine[2:] - 2 * fine[1:-1] + fine[:-2]) / 12
    expected = fine[BAND_LIMITED_POINTS * margin : BAND_LIMITED_POINTS * (margin + rows - 1) + 1]
    assert np.allclose(interpolate_band_limited(u, BAND_LIMITED_POINTS), expected, rtol=1e-12, atol=1e-12)


def test_rows_between_samples_carry_no_measurement():
    model = oscillator()
    y = np.arange(20.0)
    data = to_record(model, Experiment("rows", np.arange(20) * 0.1, {"u": np.sin(y)}, {"x": y}, hold="band-limited"))
    assert data.is_linear.all()
    assert data.h.sum() == pytest.approx(1.9)
    assert np.array_equal(data.samples(data.y)[:, 0], y)
    assert np.isfinite(data.y).sum() == 20
    assert np.isfinite(data.u).all()
    uneven = Experiment("uneven", np.arange(20.0) ** 1.1, {"u": np.sin(y)}, {"x": y}, hold="band-limited")
    with pytest.raises(DataError, match=r"'uneven': a band-limited input needs uniform sampling"):
        to_record(model, uneven)


def silverbox_error(folder, hold):
    """Error in mV over the test record, first rows left out, after a fit to the beginning of the training record."""
    model = silverbox + effect("cubic_stiffness") + effect("quadratic_stiffness") + effect("input_offset")
    p0, scale = values(model), np.array([40.0, 2e5, 2e5, 2e5, 2e4, 1e-2])
    runs = []
    for name, rows in (("train_multisine", 4000), ("test_multisine", None)):
        time, u, y = np.loadtxt(folder / "silverbox" / f"{name}.csv", delimiter=",", skiprows=1, max_rows=rows).T
        runs.append(to_record(model, Experiment(name, time, {"u": u}, {"y": y}, hold=hold)))
    step = discretise(model.system, p0, np.zeros((1, 2)), runs[0].lengths, substeps=8 if hold == "first" else 1)
    train, test = (data.read_by(step) for data in runs)
    kernel, n = CompiledKernel(step), len(p0)
    slope, begin = np.diag(np.r_[scale, 0, 0])[:n], np.zeros((2, n + 2))
    begin[:, n:] = np.diag([1e-3, 1.0])

    def misfit(z, data):
        p = z[:n] * scale
        r, jacobian = kernel.residuals(
            data, KernelPoint(p[None], slope[None], p, slope, begin[:, n:] @ z[n:], begin), np.array([1e3])
        )
        return data.samples(r)[:, 0], data.samples(jacobian)[:, 0]

    z = least_squares(lambda z: misfit(z, train)[0], np.r_[p0 / scale, 0, 0], jac=lambda z: misfit(z, train)[1]).x

    def from_start(s):
        return misfit(np.r_[z[:n], s], test)

    found = least_squares(lambda s: from_start(s)[0], [0, 0], jac=lambda s: from_start(s)[1][:, n:])
    return np.sqrt(np.mean(found.fun[50:] ** 2))


@pytest.mark.rest
def test_silverbox_is_band_limited(shared_data):
    """Cubic and quadratic stiffness and an offset: 0.9 mV with straight lines, 0.3 mV with the band-limited input."""
    assert silverbox_error(shared_data, "first") == pytest.approx(0.9, abs=0.05)
    assert silverbox_error(shared_data, "band-limited") == pytest.approx(0.3, abs=0.03)
