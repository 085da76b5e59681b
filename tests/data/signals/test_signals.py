"""Test signals: band, level, levels and correlation are what was asked for."""

import numpy as np
import pytest

from greybox.base.errors import DataError
from greybox.data.signals import chirp, multisine, prbs, steps

TIME = 1e-3 * np.arange(1000)


def test_a_multisine_stays_in_its_band():
    signal = multisine(TIME, 20, 100, 2.5, np.random.default_rng(0))
    size = np.abs(np.fft.rfft(signal))
    frequency = np.fft.rfftfreq(1000, 1e-3)
    inside = (frequency >= 20) & (frequency <= 100)
    assert np.sqrt(np.mean(signal**2)) == pytest.approx(2.5)
    assert size[~inside].max() < 1e-9 * size[inside].min()
    with pytest.raises(DataError, match="has no line"):
        multisine(TIME, 20.2, 20.8, 1.0, np.random.default_rng(0))


def test_a_chirp_sweeps_evenly():
    time = 1e-4 * np.arange(20001)
    signal = chirp(time, 5, 105, 3.0)
    crossings = np.flatnonzero(signal[1:-1] * signal[2:] < 0)
    assert np.abs(signal).max() == pytest.approx(3.0, rel=1e-3)
    # Two crossings a period, and (5 + 105) / 2 Hz over 2 s are 110 periods; half of the first and last may be missing.
    assert abs(len(crossings) - 220) <= 2
    assert (crossings < 10000).sum() == pytest.approx(2 * (5 + 55) / 2, abs=2)
    with pytest.raises(DataError, match="a chirp up to 5000 Hz: samples every 0"):
        chirp(time, 5, 5000, 3.0)


def test_steps_have_the_new_level_from_the_given_time_on():
    signal = steps(np.arange(6.0), at=[1.0, 2.5, 4.0], levels=[2.0, -1.0, 0.5], initial=7.0)
    assert signal.tolist() == [7.0, 2.0, 2.0, -1.0, 0.5, 0.5]
    assert steps(np.arange(3.0), at=1, levels=4.0).tolist() == [0.0, 4.0, 4.0]
    assert steps(np.arange(3.0), at=[], levels=[]).tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("at", "levels", "message"),
    [
        ([1.0, 2.0], [1.0], "1 levels for 2 times"),
        ([2.0, 1.0], [1.0, 2.0], "times must increase"),
        ([1.0, 1.0], [1.0, 2.0], "times must increase"),
        ([1.0], [np.nan], "must be finite"),
    ],
)
def test_steps_that_make_no_signal_are_refused(at, levels, message):
    with pytest.raises(DataError, match=message):
        steps(np.arange(4.0), at, levels)


@pytest.mark.parametrize("order", [3, 5, 7, 10])
def test_a_period_of_a_prbs_is_white(order):
    """One more of one level than of the other, and the circular autocorrelation -1/n at every lag but zero."""
    n = 2**order - 1
    signal = prbs(np.arange(2.0 * n), order)
    period = signal[:n]
    assert set(period) == {-1.0, 1.0}
    assert abs(period.sum()) == 1
    assert np.array_equal(signal[n:], period)
    assert not any(np.array_equal(np.roll(period, k), period) for k in range(1, n))
    spectrum = np.fft.fft(period)
    correlation = np.fft.ifft(np.abs(spectrum) ** 2).real / n
    assert correlation[0] == pytest.approx(1.0)
    assert correlation[1:] == pytest.approx(np.full(n - 1, -1 / n))


def test_a_prbs_holds_each_value_and_takes_the_given_levels():
    plain, held = prbs(np.arange(31.0), 5), prbs(np.arange(100.0), 5, levels=(0.0, 3.0), hold=4)
    assert set(held) == {0.0, 3.0}
    assert np.array_equal(held[:100:4] > 0, plain[:25] > 0)
    assert np.array_equal(held[:100].reshape(-1, 4).min(axis=1), held[:100].reshape(-1, 4).max(axis=1))
    assert len(prbs(np.arange(10.0), 5, hold=4)) == 10


def test_another_register_shifts_the_sequence():
    one, other = prbs(np.arange(31.0), 5), prbs(np.arange(31.0), 5, state=[1, 0, 0, 0, 0])
    assert any(np.array_equal(np.roll(one, k), other) for k in range(1, 31))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"order": 1}, "order 1"),
        ({"order": 40}, "order 40"),
        ({"order": 5, "hold": 0}, "hold 0"),
        ({"order": 5, "levels": (1.0,)}, "1 levels"),
        ({"order": 5, "state": [0, 0, 0, 0, 0]}, "not all zero"),
        ({"order": 5, "state": [1, 0]}, "holds 5 zeros and ones"),
    ],
)
def test_a_prbs_that_cannot_be_made_is_refused(options, message):
    with pytest.raises(DataError, match=message):
        prbs(np.arange(10.0), **options)
