"""Units: what texts mean (against pint), what people call them, data, and every way an equation can be wrong."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pint
import pytest
from hypothesis import given
from hypothesis import strategies as st

from greybox.base.errors import ModelError, UnitError
from greybox.base.units import (
    KNOWN,
    LONG,
    ONE,
    RUN_TOGETHER,
    Unit,
    convert,
    format_unit,
    parse_unit,
    unit_converter,
    unit_name,
)

PINT = pint.UnitRegistry()
SI = {"kg": "kilogram", "m": "meter", "s": "second", "A": "ampere", "K": "kelvin", "mol": "mole", "cd": "candela"}


def same_as_pint(unit: Unit, text: str) -> bool:
    """Whether ``unit`` is what pint, with a registry of its own, makes of ``text``."""
    ours = PINT.Quantity(unit.factor, "")
    for symbol, exponent in unit.dimensions:
        ours = ours * PINT.Quantity(1.0, SI[symbol]) ** exponent
    theirs = PINT.Quantity(1.0, text).to_base_units()
    return ours.dimensionality == theirs.dimensionality and math.isclose(ours.magnitude, theirs.magnitude, rel_tol=1e-9)


@pytest.mark.parametrize("symbol", [*KNOWN, *LONG])
def test_built_in_symbols_agree_with_pint(symbol: str) -> None:
    assert same_as_pint(parse_unit(symbol), symbol.replace("kilogramme", "kilogram").replace("Ohm", "ohm"))


@pytest.mark.parametrize(
    "text",
    [
        "N*s/m",
        "m^3/(s*Pa)",
        "V**0.5/s",
        "N/m/s",
        "kg m / s**2",
        "l/min",
        "psi",
        "inch/minute",
        "1/s",
        "W/(m**2*K)",
        "N*m",
    ],
)
def test_texts_agree_with_pint(text: str) -> None:
    assert same_as_pint(parse_unit(text), text)


@pytest.mark.parametrize("text", ["", "1", "-", "m/m", "rad", "N*s/(N*s)", "count"])
def test_no_unit(text: str) -> None:
    assert parse_unit(text) == ONE


def test_spellings_of_one_unit() -> None:
    assert (
        parse_unit("µm")
        == parse_unit("um")
        == parse_unit("micrometer")
        == parse_unit("1e-6 m")
        == parse_unit("0.001 mm")
    )
    assert parse_unit("m/s²") == parse_unit("m/s^2") == parse_unit("m*s**-2") == parse_unit("m*s^(-2)")
    assert parse_unit("m^(2/3)") * parse_unit("m^(1/3)") == parse_unit("m")
    assert parse_unit("Ω") == parse_unit("V/A") != parse_unit("kohm")
    assert parse_unit("J/(kg*degC)") == parse_unit("J/(kg*K)")
    assert hash(parse_unit("V*s/m")) == hash(parse_unit("N/A"))
    assert parse_unit("m") != "m"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("foo/s", "unit 'foo/s': 'foo' is not a unit; known: m, g, s, "),
        ("kNN", "unit 'kNN': 'kNN' is not a unit; "),
        ("dB", "unit 'dB': 'dB' is not a unit"),
        ("meter⁰", "unit 'meter⁰': 'meter⁰' is not a unit"),
        ("degC", "unit 'degC' has an offset, which an equation cannot contain; use K"),
        *(
            (text, f"unit {text!r}: {text!r} is not one symbol; write {better}")
            for text, better in RUN_TOGETHER.items()
        ),
        *(
            (text, f"unit {text!r} cannot be read; write symbols with *, / and ^, as in N*s/m")
            for text in ("N//m", "N*", "(N", "N)", "m^", "m^x", "0 m", "$", "N-m", "--", "m^(1/2")
        ),
    ],
)
def test_what_is_no_unit(text: str, message: str) -> None:
    with pytest.raises(ModelError) as error:
        parse_unit(text)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("(N)/(m)**3", "N/m^3"),
        ("(N)/((m)/(s))", "N*s/m"),
        ("(N)/(m)**2", "N/m^2"),
        ("(V)/(A)", "ohm"),
        ("(V)*(s)/(A)", "H"),
        ("(kg)*(m)/(s)**2", "N"),
        ("(1)/(m)", "1/m"),
        ("(N)/(N)", "1"),
        ("kilogram*meter", "kg*m"),
        ("newton second / metre", "N*s/m"),
        ("m**3/(s*Pa)", "m^3/(s*Pa)"),
        ("V**0.5/s", "V^0.5/s"),
        ("m**(2/3)", "m^(2/3)"),
        ("9.80665 N/kg", "9.80665 N/kg"),
        *(
            (text, text)
            for text in ("", "-", "1", "%", "N", "kPa", "N*s/m", "V/A", "kg*m/s^2", "1/s", "l/min", "1000 N")
        ),
    ],
)
def test_tidy(text: str, expected: str) -> None:
    assert format_unit(text) == expected
    assert parse_unit(format_unit(text)) == parse_unit(text)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("kg*m/s^2", "N"),
        ("N/A*A/m*m", "N"),
        ("kg/s", "N*s/m"),
        ("J", "N*m"),
        ("N*m/s", "W"),
        ("A*V/m^2/s*s", "W/m^2"),
        ("Pa/s", "Pa/s"),
        ("V^0.5/s", "V^0.5/s"),
        ("m^3/(s*Pa)", "m^3/(Pa*s)"),
        ("m/s", "m/s"),
        ("kg*m^2", "kg*m^2"),
        ("kN", "1000 N"),
        ("mm/s", "0.001 m/s"),
        ("1/s", "1/s"),
        ("%", "0.01"),
        ("1", "1"),
    ],
)
def test_names_of_computed_units(text: str, expected: str) -> None:
    assert unit_name(parse_unit(text)) == expected
    assert parse_unit(expected) == parse_unit(text)


def test_a_computed_unit_takes_the_name_the_model_uses() -> None:
    assert unit_name(parse_unit("N/A"), ["m", "", "V*s/m"]) == "V*s/m"
    assert unit_name(parse_unit("kN"), ["N", "kN"]) == "kN"


@given(
    powers=st.dictionaries(st.sampled_from(["kg", "m", "s", "A", "K", "N", "V", "Pa"]), st.integers(-3, 3), max_size=4)
)
def test_a_name_means_its_unit(powers: dict[str, int]) -> None:
    unit = ONE
    for symbol, exponent in powers.items():
        unit = unit * parse_unit(symbol) ** exponent
    assert parse_unit(unit_name(unit)) == unit


def test_conversion_of_data() -> None:
    np.testing.assert_allclose(convert([0.0, 25.0], "degC", "K"), [273.15, 298.15])
    np.testing.assert_allclose(convert([300.0], "K", "degC"), [26.85])
    np.testing.assert_allclose(convert(212.0, "degF", "°C"), 100.0)
    np.testing.assert_allclose(convert(np.array([[1.0, 2.0]]), "mm", "m"), [[0.001, 0.002]])
    np.testing.assert_allclose(unit_converter("l/min", "m^3/s")([60.0]), [1e-3])
    np.testing.assert_allclose(convert([50.0], "%", ""), [0.5])
    np.testing.assert_allclose(convert([1.0], "degC/s", "K/s"), [1.0])


@pytest.mark.parametrize(("source", "target"), [("N", "m"), ("degC", "m"), ("", "degC"), ("V", "")])
def test_unlike_units_are_not_converted(source: str, target: str) -> None:
    with pytest.raises(UnitError) as error:
        convert([1.0], source, target)
    assert str(error.value).startswith(
        f"{source or '1'} cannot be converted to {target or '1'}: they measure different"
    )


def test_an_ordinary_model_does_not_wait_for_pint() -> None:
    code = "import sys, models.micro_actuator; sys.exit('pint' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# ---- the unit of an expression -------------------------------------------------------------------------------------
