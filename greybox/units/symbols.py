"""What the symbols of units are worth, and the unit of a text.

The SI symbols that most models use are known here: importing pint and building its registry takes half a second.
Every other unit (psi, inch, degC ...) is looked up in pint's application registry, which is also where a user
defines new ones.
"""

from __future__ import annotations

import math
from functools import cache, lru_cache
from typing import Any

from greybox.errors import ModelError, nearest
from greybox.units.grammar import parse_powers
from greybox.units.unit import ONE, Unit, add_exponents


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
    offset = [symbol for symbol in powers if _symbol(symbol, unit)[1]]
    if offset and powers == {offset[0]: 1.0}:
        raise ModelError(
            f"unit {unit!r} has an offset, which an equation cannot contain; use K (data in {offset[0]} are converted)"
        )
    result = Unit(factor)
    for symbol, exponent in powers.items():
        result = result * _symbol(symbol, unit)[0] ** exponent
    return result


def has_zero_point(unit: str) -> bool:
    """Whether numbers in this unit count from another zero than SI (degC)."""
    powers = parse_powers(unit)[1]
    return len(powers) == 1 and all(e == 1 and _symbol(s, unit)[1] for s, e in powers.items())


@cache
def registry() -> Any:
    """Pint's application registry."""
    import pint  # slow to import, and only unusual units need it

    return pint.get_application_registry()


@lru_cache(maxsize=4096)
def _symbol(symbol: str, unit: str) -> tuple[Unit, bool]:
    """One symbol in SI, and whether it has a zero point of its own (then the unit is that of a difference)."""
    plain = LONG.get(symbol, symbol)
    if plain in KNOWN:
        return KNOWN[plain], False
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
    except Exception:  # pint reads numbers, functions and Python's own words too, and fails in many ways
        raise ModelError(f"unit {unit!r}: {symbol!r} is not a unit; {nearest(symbol, PREFIXED)}") from None
    # What is left out (radian, count, bit) has no dimension.
    powers = tuple((BASE[unit_name], float(e)) for unit_name, e in base.unit_items() if unit_name in BASE)
    return Unit(float(base.magnitude), add_exponents((), powers, 1.0)), shifted
