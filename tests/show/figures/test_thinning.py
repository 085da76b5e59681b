"""Long records in few points: no peak is lost, and gaps stay gaps."""

from __future__ import annotations

import numpy as np

from greybox.base.figure import Thinning
from greybox.show.figures.figure import choose_evenly, min_max_envelope, thin_curve, thin_spectrum


def test_an_envelope_keeps_every_peak() -> None:
    time = np.linspace(0, 1, 100_003)
    values = np.sin(40 * time)
    values[[777, 50_000]] = [9.0, -7.0]
    t, v = min_max_envelope(time, values, 500)
    assert len(t) == len(v) == 1000
    assert (v.max(), v.min()) == (9.0, -7.0)
    assert np.all(np.diff(t) >= 0)
    assert abs(t[np.argmax(v)] - time[777]) < 1 / 500
    low, high = v[0::2], v[1::2]
    assert np.all(low <= high)


def test_short_records_stay_as_they_are_and_gaps_stay_gaps() -> None:
    time = np.arange(100.0)
    t, v = min_max_envelope(time, time, 50)
    assert t is time
    assert v is time
    values = np.ones(10_000)
    values[2000:4000] = np.nan
    t, v = min_max_envelope(np.arange(10_000.0), values, 100)
    inside = (t >= 2000) & (t < 4000)
    assert np.isnan(v[inside]).all()
    assert (v[~inside] == 1).all()


def test_a_long_spectrum_keeps_its_largest_line() -> None:
    values = np.random.default_rng(1).random(5000)
    f, few = thin_spectrum(np.arange(1.0, 5001.0), values, 50)
    assert len(f) == len(few) <= 50
    assert few.max() == values.max()


def test_each_kind_of_curve_is_thinned_in_its_own_way() -> None:
    x, y = np.arange(1.0, 1001.0), np.zeros(1000)
    assert {kind: len(thin_curve(x, y, kind, 20)[0]) for kind in Thinning} == {
        Thinning.NONE: 1000,
        Thinning.ENVELOPE: 40,
        Thinning.PEAKS: len(thin_spectrum(x, y, 20)[0]),
    }


def test_points_are_chosen_evenly_with_both_ends() -> None:
    assert choose_evenly(5, 10).tolist() == [0, 1, 2, 3, 4]
    assert choose_evenly(101, 3).tolist() == [0, 50, 100]
