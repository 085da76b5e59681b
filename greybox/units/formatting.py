"""What a person calls a unit."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from functools import cache, lru_cache
from itertools import product

from greybox.units.grammar import Powers, format_powers, parse_powers
from greybox.units.symbols import BASE, KNOWN, LONG, parse_unit
from greybox.units.unit import Dimensions, Unit, add_exponents

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
    best = dict(dimensions)
    for symbol, exponent in product(DERIVED, (1.0, -1.0, 2.0, -2.0, 0.5, -0.5)):
        powers = {symbol: exponent} | dict(add_exponents(dimensions, KNOWN[symbol].dimensions, -exponent))
        best = min(best, powers, key=_length)
    return best


def _length(powers: Powers) -> float:
    broken = sum(not e.is_integer() for symbol, e in powers.items() if symbol in BASE.values())
    return sum(map(abs, powers.values())) + 0.5 * len(powers) + 2.0 * broken
