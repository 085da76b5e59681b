"""Numbers and units as people read them on an axis."""

from __future__ import annotations

import numpy as np
import pytest

from greybox.show.figures.figure import (
    root_mean_square,
    scale_to_prefix,
    typeset_exponents,
    typeset_unit,
    value_range,
    write_cell,
)


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
    scale, shown = scale_to_prefix(unit, np.array([0.0, -largest, np.nan]))
    assert (scale, shown) == (pytest.approx(factor), text)


def test_units_and_powers_of_ten_are_written_as_in_print() -> None:
    assert typeset_unit("kg*m**2/s**3") == typeset_unit("kg*m^2/s^3") == "kg m²/s³"
    assert typeset_unit("ohm") == "Ω"
    assert typeset_exponents("5e-04 and 2e+07") == "5·10⁻⁴ and 2·10⁷"
    assert typeset_exponents("6158 +- 4e+01 and 2.54e+03") == "6158 +- 40 and 2540"


def test_a_correlation_has_a_minus_sign_only_where_it_shows_digits() -> None:
    assert [write_cell(v) for v in (1.0, -0.254, -0.004)] == ["1.00", "−0.25", "0.00"]


def test_sizes_are_those_of_the_finite_values() -> None:
    values = np.array([3.0, np.nan, -4.0, np.inf])
    assert root_mean_square(values) == pytest.approx(np.sqrt(12.5))
    assert value_range(values) == (-4.0, 3.0)
    assert np.isnan(root_mean_square(values[1:2])) and np.isnan(value_range(values[1:2])).all()
