"""Data from one unit into another."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from greybox.errors import UnitError
from greybox.units.grammar import parse_powers
from greybox.units.symbols import has_zero_point, parse_unit, registry


def unit_converter(source: str, target: str) -> Callable[[Any], np.ndarray]:
    """The function that turns numbers in one unit into numbers in another, zero points (degC to K) included.

    Parameters
    ----------
    source, target
        Units as text: ``kPa``, ``N*s/m``, ``degC``.

    Returns
    -------
    callable
        Takes numbers or an array in ``source`` and returns an array of the same shape in ``target``.

    Raises
    ------
    UnitError
        When the two measure different things.
    ModelError
        For an unknown unit.

    Examples
    --------
    >>> float(unit_converter("kPa", "Pa")(2.0))
    2000.0
    """
    if has_zero_point(source) or has_zero_point(target):
        return _by_pint(source, target)
    first, second = parse_unit(source), parse_unit(target)
    if first.dimensions != second.dimensions:
        raise _unlike(source, target)
    ratio = first.factor / second.factor
    return lambda values: np.asarray(values, dtype=float) * ratio


def convert(values: Any, source: str, target: str) -> np.ndarray:
    """``values`` in the unit ``source`` as an array in the unit ``target``; errors as for `unit_converter`."""
    return unit_converter(source, target)(values)


def _by_pint(source: str, target: str) -> Callable[[Any], np.ndarray]:
    import pint

    known = registry()
    first, second = ("*".join(parse_powers(u)[1]) for u in (source, target))
    try:
        known.Quantity(1.0, first).to(second)
    except pint.DimensionalityError:
        raise _unlike(source, target) from None
    return lambda values: np.asarray(known.Quantity(np.asarray(values, dtype=float), first).to(second).magnitude)


def _unlike(source: str, target: str) -> UnitError:
    return UnitError(
        f"{source or '1'} cannot be converted to {target or '1'}: they measure different things;"
        " correct one of the two units"
    )
