"""The value of a unit: a factor to SI and the exponents of the base units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

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
