"""Units as German and English loggers write them, against their factors by definition (SI brochure, DIN 1301, ISO 80000)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from greybox.base import ModelError, unit_converter
from greybox.base.units import Note, UnitError
from greybox.data.notation import converts, read_conversion, read_notation

TURN = 2 * math.pi
NOTATIONS = [
    # speed of rotation: one revolution a minute or a second
    *(
        (text, "rad/s", TURN / 60)
        for text in ("U/min", "Umdr./min", "Umdr/min", "RPM", "r/min", "rev/min", "tr/min", "upm")
    ),
    *((text, "rad/s", TURN / 60) for text in ("1/min", "min-1", "min⁻¹", "/min", "min^-1")),
    *((text, "rad/s", TURN) for text in ("U/s", "Hz", "turn/s", "rps", "cycle/s")),
    ("kHz", "rad/s", 1e3 * TURN),
    ("°/s", "rad/s", TURN / 360),
    ("rpm", "Hz", 1 / 60),
    ("rad/s", "Hz", 1 / TURN),
    ("U/min", "1/min", 1.0),
    ("mV/min-1", "V*s/rad", 1e-3 * 60 / TURN),
    # angles
    *((text, "rad", TURN / 360) for text in ("Grad", "°", "deg", "degrees")),
    *((text, "rad", TURN) for text in ("Umdr.", "turns", "revs")),
    ("gon", "rad", TURN / 400),
    ("mrad", "rad", 1e-3),
    # lengths, times
    *((text, "m", 1e-6) for text in ("µm", "μm", "um")),
    *((text, "m", 0.0254) for text in ("inch", "in", "Zoll")),
    *((text, "s", 1.0) for text in ("sec", "Sek.", "Sekunden", "Sec")),
    *((text, "s", 1e-3) for text in ("msec", "millis", "Millisekunden")),
    *((text, "s", 1e-6) for text in ("µs", "usec", "micros")),
    *((text, "s", 60.0) for text in ("Min.", "min", "Minuten")),
    *((text, "s", 3600.0) for text in ("Std", "Stunden", "hr")),
    ("km/h", "m/s", 1 / 3.6),
    ("m/s2", "m/s^2", 1.0),
    ("m s-2", "m/s^2", 1.0),
    ("g", "m/s^2", 9.80665),
    ("g", "kg", 1e-3),
    # forces, torques, masses
    ("kN", "N", 1e3),
    ("daN", "N", 10.0),
    ("kp", "N", 9.80665),
    ("lbf", "N", 4.4482216152605),
    *((text, "N*m", 1.0) for text in ("Nm", "N.m", "N m", "N·m")),
    ("mNm", "N*m", 1e-3),
    ("Ncm", "N*m", 1e-2),
    ("Nms/rad", "N*m*s", 1.0),
    ("kgm²", "kg*m^2", 1.0),
    ("kgcm2", "kg*m^2", 1e-4),
    ("N/mm", "N/m", 1e3),
    # pressures, flows
    *((text, "Pa", 1e5) for text in ("bar", "bara", "bar(a)", "bar abs", "BAR")),
    ("mbar", "Pa", 100.0),
    ("KPa", "Pa", 1e3),
    ("PSI", "Pa", 6894.757293168),
    ("N/mm²", "Pa", 1e6),
    *((text, "m^3/s", 1e-3 / 60) for text in ("l/min", "L/min", "lpm")),
    *((text, "m^3/s", 1 / 3600) for text in ("m3/h", "m³/h", "cbm/h")),
    ("ccm", "m^3", 1e-6),
    # energy, electricity
    ("PS", "W", 735.49875),
    ("KW", "W", 1e3),
    ("Ws", "J", 1.0),
    ("kWh", "J", 3.6e6),
    ("mAh", "A*s", 3.6),
    ("kΩ", "ohm", 1e3),
    ("Ohm", "ohm", 1.0),
    ("Vdc", "V", 1.0),
    # parts of one, and numbers that a converter or a counter gives
    *((text, "1", 1e-2) for text in ("%", "pct", "Prozent")),
    ("‰", "1", 1e-3),
    *(
        (text, "1", 1.0)
        for text in ("inc", "Inkremente", "RAW", "counts", "ADC counts", "LSB", "Digits", "ticks", "bit", "a.u.")
    ),
    ("ticks/s", "1/s", 1.0),
    # rates that are no rotation
    ("1/min", "1/s", 1 / 60),
    ("Hz", "1/s", 1.0),
    ("1/h", "1/s", 1 / 3600),
]


@pytest.mark.parametrize(("text", "unit", "factor"), NOTATIONS)
def test_a_notation_of_a_logger_is_worth_what_its_author_meant(text, unit, factor):
    assert read_conversion(text, unit)(np.array([2.0]))[0] == pytest.approx(2 * factor, rel=1e-9)


@pytest.mark.parametrize(
    ("text", "unit", "kelvin"),
    [
        ("°C", "K", 293.15),
        ("C", "K", 293.15),
        ("deg C", "K", 293.15),
        ("Celsius", "K", 293.15),
        ("F", "K", 266.4833333),
    ],
)
def test_temperatures_keep_their_zero(text, unit, kelvin):
    assert read_conversion(text, unit)(20.0) == pytest.approx(kelvin)


@pytest.mark.parametrize(
    ("text", "unit", "rule"),
    [
        ("1/s", "rad/s", "turns, radians"),
        ("s-1", "rad/s", "turns, radians"),
        ("cps", "rad/s", "turns, radians"),
        ("rpm", "1/s", "turns, radians"),
        ("rad/s", "1/s", "turns, radians"),
        ("deg", "1", "turns, radians"),
        ("inc", "rad", "turns, radians"),
        ("%", "rad", "percent"),
        ("1/h", "rad/s", "turns, radians"),
        ("8bits", "1", "range or a resolution"),
        ("10 V", "V", "range or a resolution"),
        ("1000 rpm", "rad/s", "range or a resolution"),
        ("byte", "1", "a number"),
        ("pi", "1", "a number"),
        ("dozen", "1", "not a unit"),
        ("Mrad", "rad", "not a unit"),
        ("grad", "rad", "gon"),
        ("barg", "Pa", "gauge"),
        ("bar(g)", "Pa", "gauge"),
        ("psig", "Pa", "gauge"),
        ("slpm", "m^3/s", "standard litres"),
        ("Nl/min", "m^3/s", "standard litres"),
        ("dBm", "W", "logarithm"),
        ("ton", "kg", "907 kg to some"),
        ("Tons/h", "kg/s", "907 kg to some"),
        # An inch by 96, a petaparsec, carats and pints to a registry of units.
        ("px", "m", "different things"),
        ("pcs", "m", "different things"),
        ("ct", "kg", "different things"),
        ("pts", "m^3", "different things"),
        ("m", "s", "different things"),
    ],
)
def test_what_has_several_meanings_is_refused(text, unit, rule):
    assert not converts(text, unit)
    with pytest.raises(ModelError, match=rule):
        read_conversion(text, unit)


@pytest.mark.parametrize(
    ("text", "target", "one"),
    [
        ("turn/2048", "rad", 2 * np.pi / 2048),
        ("10 ms", "s", 0.01),
        ("bar/65536", "Pa", 1e5 / 65536),
        ("0.25*mm", "m", 2.5e-4),
    ],
)
def test_a_number_in_a_unit_is_what_one_count_stands_for_only_where_it_is_told(text, target, one):
    assert read_conversion(text, target, is_told=True)(np.array([1.0, 3.0])) == pytest.approx([one, 3 * one])
    with pytest.raises(ModelError, match="range or a resolution"):
        read_conversion(text, target)


@pytest.mark.parametrize(("text", "target"), [("12 bit", "1"), ("0.1 degC", "K"), ("8bits", "1")])
def test_bits_and_counts_from_another_zero_are_refused_whoever_says_them(text, target):
    with pytest.raises(ModelError):
        read_conversion(text, target, is_told=True)


def test_what_is_taken_for_granted_is_said():
    notes = {text: read_conversion(text, "rad/s").note for text in ("1/min", "Hz", "rpm", "deg/s")}
    assert notes == {"1/min": Note.TURNS, "Hz": Note.TURNS, "rpm": Note.NONE, "deg/s": Note.NONE}
    assert read_conversion("inc", "1").note is Note.COUNTS
    assert read_conversion("1/min", "1/s").note is Note.NONE


def test_a_radian_may_be_left_out_where_no_rotation_is_meant():
    assert unit_converter("N*m/rad", "N*m").identical
    assert unit_converter("V*s", "V*s/rad").identical
    with pytest.raises(UnitError, match="turns, radians"):
        unit_converter("N*m/deg", "N*m")


def test_the_unit_of_the_model_is_never_read_otherwise():
    assert read_notation("1000 N", "1000 N") == "1000 N"
    assert read_notation("C", "C") == "C"
