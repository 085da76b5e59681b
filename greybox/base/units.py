"""Units: their value in SI, their text read and written, and data from one into another."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from fractions import Fraction
from functools import cache, lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from greybox.base.errors import ModelError, UnitError, nearest

# The value of a unit: a factor to SI and the exponents of the base units.

Dimensions = tuple[tuple[str, float], ...]


@dataclass(frozen=True, eq=False)
class Unit:
    """The value of a unit: a factor times a product of SI base units.

    Parameters
    ----------
    factor
        What one of this unit is worth in SI units.
    dimensions
        The base units as (symbol, exponent), sorted by symbol, without zeros.

    Notes
    -----
    Two units are equal when their dimensions are the same and their factors agree within 1e-9.
    """

    factor: float = 1.0
    dimensions: Dimensions = ()

    def __mul__(self, other: Unit) -> Unit:
        return Unit(self.factor * other.factor, add_exponents(self.dimensions, other.dimensions, 1.0))

    def __truediv__(self, other: Unit) -> Unit:
        return Unit(self.factor / other.factor, add_exponents(self.dimensions, other.dimensions, -1.0))

    def __pow__(self, exponent: float) -> Unit:
        return Unit(self.factor**exponent, add_exponents((), self.dimensions, float(exponent)))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Unit):
            return NotImplemented
        return self.dimensions == other.dimensions and math.isclose(self.factor, other.factor, rel_tol=1e-9)

    def __hash__(self) -> int:
        return hash(self.dimensions)


@lru_cache(maxsize=4096)
def add_exponents(first: Dimensions, second: Dimensions, times: float) -> Dimensions:
    """The exponents of ``first`` times ``second ** times``."""
    powers = dict(first)
    for symbol, exponent in second:
        powers[symbol] = round(powers.get(symbol, 0.0) + times * exponent, 9)  # so that 1/3 + 2/3 is 1
    return tuple(sorted((symbol, exponent) for symbol, exponent in powers.items() if exponent))


ONE = Unit()
SECOND = Unit(1.0, (("s", 1.0),))


# The text of a unit, read and written: ``N*s/m`` is a number and the powers of symbols.

Powers = dict[str, float]  # symbol -> exponent, in the order in which the symbols were written

TOKEN = re.compile(r"(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|([^\W\d]\w*|%)|(\*\*|[*/^()+-])")
SPELLINGS = {"°C": "degC", "°F": "degF", "°": "deg", "·": "*", "²": "^2", "³": "^3"}
# Both code points of the micro sign (U+00B5, U+03BC) and of the ohm sign (U+03A9, U+2126) are found in files.
SPELLINGS |= {"\u00b5": "u", "\u03bc": "u", "\u03a9": "ohm", "\u2126": "ohm"}


# Characters of a unit; no rig has a longer one, and so brackets in brackets stay few.
LONGEST_UNIT = 100


@lru_cache(maxsize=4096)
def parse_powers(unit: str) -> tuple[float, Powers]:
    """Number and powers of symbols in a unit's text, multiplied out from left to right."""
    text = unit.strip()
    for special, plain in SPELLINGS.items():
        text = text.replace(special, plain)
    if text in ("", "-"):
        return 1.0, {}
    shown = unit if len(unit) <= LONGEST_UNIT else f"{unit[:LONGEST_UNIT]}..."
    try:
        if len(text) > LONGEST_UNIT:
            raise ValueError("too long")
        # Tokens in reverse order, so that the next one is popped from the end.
        tokens, position = [], 0
        while position < len(text):
            match = TOKEN.match(text, position)
            if not match and not text[position].isspace():
                raise ValueError(text[position])
            if match:
                tokens.append(match.group())
            position = match.end() if match else position + 1
        tokens.reverse()
        factor, powers = _product(tokens)
        if tokens or not (0 < factor < math.inf and all(map(math.isfinite, powers.values()))):
            raise ValueError(tokens[-1] if tokens else factor)
    except (ValueError, IndexError, ArithmeticError):
        raise ModelError(
            f"unit {shown!r} cannot be read; write symbols with *, / and ^, as in N*s/m or m^3/(s*Pa)"
        ) from None
    return factor, {symbol: exponent for symbol, exponent in powers.items() if exponent}


def _product(tokens: list[str]) -> tuple[float, Powers]:
    factor, powers = _power(tokens)
    while tokens and tokens[-1] != ")":
        sign = 1.0
        if tokens[-1] in ("*", "/"):
            sign = -1.0 if tokens.pop() == "/" else 1.0
        more, others = _power(tokens)
        # Left to right: a/b*c is (a/b) c.
        factor *= more**sign
        for symbol, exponent in others.items():
            powers[symbol] = round(powers.get(symbol, 0.0) + sign * exponent, 9)
    return factor, powers


def _power(tokens: list[str]) -> tuple[float, Powers]:
    token = tokens.pop()
    if token == "(":
        factor, powers = _product(tokens)
        _expect(tokens, ")")
    elif token[0].isdigit() or token[0] == ".":
        factor, powers = float(token), {}
        if not factor:
            raise ValueError(token)
    elif token == "%" or token[0].isalpha() or token[0] == "_":
        factor, powers = 1.0, {token: 1.0}
    else:
        raise ValueError(token)
    if tokens and tokens[-1] in ("^", "**"):
        tokens.pop()
        exponent = _exponent(tokens)
        return factor**exponent, {symbol: e * exponent for symbol, e in powers.items()}
    return factor, powers


def _exponent(tokens: list[str]) -> float:
    token = tokens.pop()
    if token in ("+", "-"):
        return _exponent(tokens) * (-1.0 if token == "-" else 1.0)
    if token != "(":
        return float(token)
    value = _exponent(tokens)
    if tokens[-1] == "/":
        tokens.pop()
        value /= _exponent(tokens)
    _expect(tokens, ")")
    return value


def _expect(tokens: list[str], token: str) -> None:
    if tokens.pop() != token:
        raise ValueError(token)


def format_powers(factor: float, powers: Powers, digits: int = 6) -> str:
    """``N*s/m``, ``m^3/(s*Pa)``, ``1000 N``, ``1/s``: the text of a unit, in the order of ``powers``."""
    above = [_power_text(s, e) for s, e in powers.items() if e > 0]
    below = [_power_text(s, -e) for s, e in powers.items() if e < 0]
    number = [f"{factor:.{digits}g}"] if factor != 1 or not above else []
    text = " ".join([*number, *(["*".join(above)] if above else [])])
    if not below:
        return text
    return f"{text}/({'*'.join(below)})" if len(below) > 1 else f"{text}/{below[0]}"


def _power_text(symbol: str, exponent: float) -> str:
    if exponent == 1:
        return symbol
    short = f"{exponent:.4g}"
    return (
        f"{symbol}^{short}" if float(short) == exponent else f"{symbol}^({Fraction(exponent).limit_denominator(1000)})"
    )


# What the symbols of units are worth, and the unit of a text.
#
# The SI symbols that most models use are known here: importing pint and building its registry takes half a second.
# Every other unit (psi, inch, degC ...) is looked up in pint's application registry, which is also where a user
# defines new ones.


def _si(kg: float = 0, m: float = 0, s: float = 0, A: float = 0, *, factor: float = 1.0) -> Unit:
    return Unit(factor, add_exponents((), (("kg", kg), ("m", m), ("s", s), ("A", A)), 1.0))


PREFIXES = {"p": 1e-12, "n": 1e-9, "u": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6, "G": 1e9}
PREFIXED = {
    "m": _si(m=1),
    "g": _si(kg=1, factor=1e-3),
    "s": _si(s=1),
    "A": _si(A=1),
    "K": Unit(1.0, (("K", 1.0),)),
    "N": _si(1, 1, -2),
    "Pa": _si(1, -1, -2),
    "J": _si(1, 2, -2),
    "W": _si(1, 2, -3),
    "V": _si(1, 2, -3, -1),
    "ohm": _si(1, 2, -3, -2),
    "H": _si(1, 2, -2, -2),
    "F": _si(-1, -2, 4, 2),
    "T": _si(1, 0, -2, -1),
    "Wb": _si(1, 2, -2, -1),
    "Hz": _si(s=-1),
}
KNOWN = PREFIXED | {
    prefix + symbol: Unit(factor * unit.factor, unit.dimensions)
    for prefix, factor in PREFIXES.items()
    for symbol, unit in PREFIXED.items()
}
KNOWN |= {
    "cm": _si(m=1, factor=1e-2),
    "C": _si(s=1, A=1),
    "rad": ONE,
    "deg": Unit(math.pi / 180),
    "%": Unit(1e-2),
    "min": _si(s=1, factor=60),
    "bar": _si(1, -1, -2, factor=1e5),
    "l": _si(m=3, factor=1e-3),
    "L": _si(m=3, factor=1e-3),
    "rpm": _si(s=-1, factor=math.pi / 30),
}
BASE = {"kilogram": "kg", "meter": "m", "second": "s", "ampere": "A", "kelvin": "K", "mole": "mol", "candela": "cd"}
LONG = BASE | {"gram": "g", "kilogramme": "kg", "metre": "m", "liter": "l", "litre": "l", "minute": "min"}
LONG |= {"newton": "N", "pascal": "Pa", "joule": "J", "watt": "W", "hertz": "Hz", "radian": "rad", "degree": "deg"}
LONG |= {"volt": "V", "Ohm": "ohm", "henry": "H", "farad": "F", "tesla": "T", "weber": "Wb", "coulomb": "C"}
# What a symbol counts. SI gives all of these the dimension 1, but numbers of one are not numbers of another: a turn is 2 pi radians, a
# hertz one period of a rotation or of anything else, and a count is worth whatever the sensor is.
COUNTED = {"rad": "angle", "deg": "angle", "rpm": "angle", "%": "share"}
COUNTED |= {s: "period" for s in KNOWN if s.endswith("Hz")}
COUNTED |= dict.fromkeys(("percent", "permille", "ppm"), "share")
# Symbols written without a sign between them, which pint would read as something else or not at all.
RUN_TOGETHER = {"Nm": "N*m", "Ns": "N*s", "Vs": "V*s", "As": "A*s", "Nms": "N*m*s", "Pas": "Pa*s", "VA": "V*A"}


@lru_cache(maxsize=4096)
def parse_unit(unit: str) -> Unit:
    """The unit that a text stands for.

    Parameters
    ----------
    unit
        Symbols with ``*``, ``/``, ``^`` or ``**`` and brackets: ``N*s/m``, ``kPa``, ``m^3/(s*Pa)``, ``V**0.5/s``. ``''`` and ``-`` are a
        plain number.

    Returns
    -------
    Unit
        Its factor to SI and its dimensions.

    Raises
    ------
    ModelError
        For a text that is no unit, and for one with a zero point of its own (degC), which no equation can hold.

    Examples
    --------
    >>> parse_unit("N*s/m") == parse_unit("kg/s")
    True
    """
    factor, powers = parse_powers(unit)
    offset = [symbol for symbol in powers if _symbol(symbol, unit).shifted]
    if offset and powers == {offset[0]: 1.0}:
        raise ModelError(
            f"unit {unit!r} has an offset, which an equation cannot contain; use K (data in {offset[0]} are converted)"
        )
    result = Unit(factor)
    for symbol, exponent in powers.items():
        result = result * _symbol(symbol, unit).unit ** exponent
    return result


def is_unit(text: str) -> bool:
    """Whether a text stands for a unit, with a zero point of its own or not."""
    try:
        for symbol in parse_powers(text)[1]:
            _symbol(symbol, text)
    except ModelError:
        return False
    return True


def has_zero_point(unit: str) -> bool:
    """Whether numbers in this unit count from another zero than SI (degC)."""
    powers = parse_powers(unit)[1]
    return len(powers) == 1 and all(e == 1 and _symbol(s, unit).shifted for s, e in powers.items())


@cache
def registry() -> Any:
    """Pint's application registry."""
    import pint  # slow to import, and only unusual units need it

    return pint.get_application_registry()


class _Symbol(NamedTuple):
    """One symbol in SI, whether it has a zero point of its own (then the unit is that of a difference), and what it counts."""

    unit: Unit
    shifted: bool
    counted: str


# A prefix above this makes no unit of an angle: "Grad" is the German degree, not 1e9 rad.
LARGEST_ANGLE_PREFIX = 1.0


@lru_cache(maxsize=4096)
def _symbol(symbol: str, unit: str) -> _Symbol:
    plain = LONG.get(symbol, symbol)
    if plain in KNOWN:
        return _Symbol(KNOWN[plain], False, COUNTED.get(plain, ""))
    if symbol in RUN_TOGETHER:
        raise ModelError(f"unit {unit!r}: {symbol!r} is not one symbol; write {RUN_TOGETHER[symbol]}")
    known = registry()
    try:
        base = known.Quantity(1.0, symbol).to_base_units()
        shifted = known.Quantity(0.0, symbol).to_base_units().magnitude != 0
        if shifted:
            base = known.Quantity(1.0, f"delta_{symbol}").to_base_units()
        if not 0 < base.magnitude < math.inf:
            raise ValueError(base.magnitude)
        items = {name: float(e) for name, e in base.unit_items()}
        prefix = known.parse_unit_name(symbol)[0][0]
        if "radian" in items and prefix and known.Quantity(1.0, prefix + "meter").m_as("meter") > LARGEST_ANGLE_PREFIX:
            raise ValueError(prefix)
    # Pint reads numbers and powers too. Its errors: AttributeError (unknown), ValueError (syntax), TypeError (zero points), KeyError (m⁰).
    except (AttributeError, TypeError, ValueError, LookupError, ArithmeticError, AssertionError):
        raise ModelError(f"unit {unit!r}: {symbol!r} is not a unit; {nearest(symbol, PREFIXED)}") from None
    # What is left out (radian, count, bit) has no dimension.
    result = Unit(
        float(base.magnitude), add_exponents((), tuple((BASE[n], e) for n, e in items.items() if n in BASE), 1.0)
    )
    return _Symbol(result, shifted, COUNTED.get(symbol) or _find_counted(items, result))


def _find_counted(items: Mapping[str, float], unit: Unit) -> str:
    """What a symbol counts whose base units in the registry are ``items``."""
    if "radian" in items:
        return "angle"
    if {"count", "bit"} & set(items):
        return "count" if unit.factor == 1 and "bit" not in items else "number"
    # A factor without a dimension (pi, dB) is a number, and nobody measures in it.
    return "number" if not unit.dimensions and unit.factor != 1 else ""


# Data from one unit into another.


class Note(StrEnum):
    """What a conversion takes for granted, for whoever reads the numbers."""

    NONE = ""
    TURNS = "turns"
    """A period (Hz, 1/min) is one turn: 2 pi rad."""
    COUNTS = "counts"
    """A count is 1."""


@dataclass(frozen=True)
class Conversion:
    """From numbers in one unit to numbers in another: ``conversion(values)`` is an array of the same shape.

    Attributes
    ----------
    apply
        The function itself.
    identical
        Whether it leaves numbers as they are.
    note
        What it takes for granted.
    """

    apply: Callable[[np.ndarray], Any] = field(repr=False)
    identical: bool
    note: Note = Note.NONE

    def __call__(self, values: Any) -> np.ndarray:
        """``values`` in the unit converted to, as float64."""
        return np.asarray(self.apply(np.asarray(values, dtype=np.float64)), dtype=np.float64)


def unit_converter(source: str, target: str) -> Conversion:
    """The function that turns numbers in one unit into numbers in another, zero points (degC to K) included.

    Units of one dimension that do not count the same are told apart. A period is one turn where hertz or ``1/min`` meet an angle over
    time (``note`` says so); ``1/s`` may be turns or radians a second and is refused there, as are counts, pure numbers (pi) and percent.

    Parameters
    ----------
    source, target
        Units as text: ``kPa``, ``N*s/m``, ``degC``.

    Returns
    -------
    Conversion
        Takes numbers or an array in ``source`` and returns an array of the same shape in ``target``.

    Raises
    ------
    UnitError
        When the two measure different things.
    ModelError
        For an unknown unit.

    Examples
    --------
    >>> float(unit_converter("kPa", "Pa")(2.0)), round(float(unit_converter("Hz", "rad/s")(1.0)), 4)
    (2000.0, 6.2832)
    """
    unlike = UnitError(
        f"{source or '1'} cannot be converted to {target or '1'}: they measure different things;"
        " correct one of the two units"
    )
    if has_zero_point(source) or has_zero_point(target):
        import pint

        known = registry()
        first, second = ("*".join(parse_powers(u)[1]) for u in (source, target))
        try:
            known.Quantity(1.0, first).to(second)
        except pint.DimensionalityError:
            raise unlike from None
        return Conversion(lambda values: known.Quantity(values, first).to(second).magnitude, first == second)
    given, wanted = parse_unit(source), parse_unit(target)
    if given.dimensions != wanted.dimensions:
        raise unlike
    turns, note = _compare_counted(source, target)
    # Numbers of turns become numbers of radians.
    ratio = given.factor / wanted.factor * (2 * math.pi) ** turns
    return Conversion(lambda values: values * ratio, math.isclose(ratio, 1.0, rel_tol=1e-9), note)


def _compare_counted(source: str, target: str) -> tuple[float, Note]:
    """Power of 2 pi between two units of one dimension, and what it takes for granted. Raises UnitError for different quantities."""
    units = source, target
    counted = [_sum_counted(unit) for unit in units]
    kinds = {kind for sums in counted for kind in sums if counted[0].get(kind) != counted[1].get(kind)}
    if "number" in kinds:
        unit = next(unit for unit, sums in zip(units, counted, strict=True) if "number" in sums)
        raise UnitError(f"{unit} is a number and no unit of a reading")
    note = Note.COUNTS if "count" in kinds else Note.NONE
    if not any("angle" in sums for sums in counted):
        return 0.0, note
    # Where nothing else is counted, per minute means turns: 1/min is rpm.
    periods = [
        sums.get("period", 0.0 if "angle" in sums else -parse_powers(unit)[1].get("min", 0.0))
        for unit, sums in zip(units, counted, strict=True)
    ]
    turns = [sums.get("angle", 0.0) + period for sums, period in zip(counted, periods, strict=True)]
    if turns[0] == turns[1] and not {"count", "share"} & kinds:
        return periods[0] - periods[1], Note.TURNS if periods[0] != periods[1] else note
    # A radian may be left out, but for a rate: that of a rotation or of anything else.
    is_rate = {symbol for symbol, _ in parse_unit(source).dimensions} == {"s"}
    angles = [s for unit in units for s in parse_powers(unit)[1] if _symbol(s, unit).counted == "angle"]
    if kinds == {"angle"} and 0.0 in turns and not is_rate and all(s.endswith(("rad", "radian")) for s in angles):
        return 0.0, note
    raise UnitError(
        f"{source or '1'} and {target or '1'} share a dimension and may count different things (turns, radians, counts, percent);"
        " say which, in turn/s, rad/s, deg, rad, ..."
    )


def _sum_counted(unit: str) -> dict[str, float]:
    """What a unit counts, with exponents."""
    result: dict[str, float] = {}
    for symbol, exponent in parse_powers(unit)[1].items():
        counted = _symbol(symbol, unit).counted
        result[counted] = result.get(counted, 0.0) + exponent
    return {counted: exponent for counted, exponent in result.items() if counted and exponent}


def convert(values: Any, source: str, target: str) -> np.ndarray:
    """``values`` in the unit ``source`` as an array in the unit ``target``; errors as for `unit_converter`."""
    return unit_converter(source, target)(values)


# What a person calls a unit.

# A composed text is replaced by one of these; not by Pa: N/m^2 may be a stiffness that grows with the stroke.
SHORT = ("m", "kg", "s", "A", "K", "N", "V", "W", "ohm", "H", "F")
# Names for computed units, in order of preference.
NAMES = [*SHORT, "Pa", "m/s", "m/s^2", "m/s^3", "m^2/s^2", "N*m", "N*s/m", "N/m^3", "N/A", "V*s", "A*s"]
NAMES += ["J/K", "J/(kg*K)", "W/K", "K/W"]
DERIVED = ("N", "Pa", "V", "W", "ohm", "H", "F")


@lru_cache(maxsize=4096)
def format_unit(unit: str) -> str:
    """The unit as a person writes it, in the symbols that it was written with.

    >>> format_unit("(N)/(m)**3"), format_unit("(V)/(A)"), format_unit("N*s/m")
    ('N/m^3', 'ohm', 'N*s/m')
    """
    if unit.strip() in ("", "-"):
        return unit.strip()
    factor, powers = parse_powers(unit)
    text = format_powers(factor, {LONG.get(symbol, symbol): exponent for symbol, exponent in powers.items()}, digits=15)
    composed = len(powers) > 1 and text != re.sub(r"\s", "", unit).replace("**", "^")
    if composed and all(symbol in KNOWN for symbol in powers):
        value = parse_unit(unit)
        return next((short for short in SHORT if KNOWN.get(short) == value), text)
    return text


def unit_name(unit: Unit, known: Iterable[str] = ()) -> str:
    """What a person calls a computed unit: one of the ``known`` texts, else the shortest product of usual units; ``1`` for none.

    >>> unit_name(parse_unit("kg*m/s^2")), unit_name(parse_unit("kN")), unit_name(parse_unit("m/m"))
    ('N', '1000 N', '1')
    """
    for text in known:
        if text and parse_unit(text) == unit:
            return format_unit(text)
    return format_powers(1.0 if math.isclose(unit.factor, 1.0, rel_tol=1e-9) else unit.factor, _words(unit.dimensions))


@cache
def _words(dimensions: Dimensions) -> Powers:
    for text in NAMES:
        if parse_unit(text).dimensions == dimensions:
            return parse_powers(text)[1]

    # Else the shortest product of base units and at most one derived unit.
    def length(powers: Powers) -> float:
        broken = sum(not e.is_integer() for symbol, e in powers.items() if symbol in BASE.values())
        return sum(map(abs, powers.values())) + 0.5 * len(powers) + 2.0 * broken

    best = dict(dimensions)
    for symbol, exponent in product(DERIVED, (1.0, -1.0, 2.0, -2.0, 0.5, -0.5)):
        powers = {symbol: exponent} | dict(add_exponents(dimensions, KNOWN[symbol].dimensions, -exponent))
        # Fewer and plainer powers read better: a derived unit takes several base units with it.
        best = min(best, powers, key=length)
    return best
