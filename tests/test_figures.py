"""Pictures: axes that people read, and envelopes that lose no peak."""

from __future__ import annotations

import numpy as np
import pytest

from greybox.figures.envelope import envelope
from greybox.figures.scale import label, scaled, written


def test_an_envelope_keeps_every_peak() -> None:
    time = np.linspace(0, 1, 100_003)
    values = np.sin(40 * time)
    values[[777, 50_000]] = [9.0, -7.0]
    t, v = envelope(time, values, most=500)
    assert len(t) == len(v) == 1000
    assert (v.max(), v.min()) == (9.0, -7.0)
    assert np.all(np.diff(t) >= 0)
    assert abs(t[np.argmax(v)] - time[777]) < 1 / 500
    low, high = v[0::2], v[1::2]
    assert np.all(low <= high)


def test_short_records_stay_as_they_are_and_gaps_stay_gaps() -> None:
    time = np.arange(100.0)
    t, v = envelope(time, time, most=50)
    assert t is time
    assert v is time
    values = np.ones(10_000)
    values[2000:4000] = np.nan
    t, v = envelope(np.arange(10_000.0), values, most=100)
    inside = (t >= 2000) & (t < 4000)
    assert np.isnan(v[inside]).all()
    assert (v[~inside] == 1).all()


@pytest.mark.parametrize(
    ("unit", "largest", "text", "factor"),
    [
        ("m", 4e-4, "µm", 1e6),
        ("A", 0.25, "mA", 1e3),
        ("V", 2.0, "V", 1.0),
        ("Pa", 8e5, "kPa", 1e-3),
        ("m", 1e-12, "nm", 1e9),
        ("m/s**2", 1e-5, "m/s²", 1.0),
        ("", 1e-5, "", 1.0),
        ("m", 0.0, "m", 1.0),
    ],
)
def test_units_get_the_prefix_that_suits_them(unit: str, largest: float, text: str, factor: float) -> None:
    found, shown = scaled(unit, np.array([0.0, -largest, np.nan]))
    assert (found, shown) == (pytest.approx(factor), text)


def test_labels_are_written_as_in_print() -> None:
    assert label("x", "µm") == "x [µm]"
    assert label("x", "") == "x"
    assert written("kg*m**2/s**3") == "kg m²/s³"
