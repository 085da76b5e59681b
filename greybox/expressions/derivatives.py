"""How an operation passes a derivative on: for ``r = op(a, b)`` the tangent is ``dr = (dr/da) da + (dr/db) db``.

Each slope is written once, on the scalars of a tape (`greybox.kernel.tape.Scalar`, which have the usual operators), and becomes C or CasADi
instructions later. Where a function has a kink or an infinite slope, the slope here is finite, so that a point touched for one sample
cannot turn a whole record into ``0 * inf``: ``sqrt`` and powers below one have slope 0 at 0, ``|a|`` has slope 0 at 0, ``hypot`` and
``atan2`` have slope 0 at the origin. A `Selection` takes one operand's tangent whole and never multiplies the other one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca

Scalar = Any  # a scalar on a tape
Slope = Any  # a scalar on a tape, or a number that is the same everywhere


@dataclass(frozen=True)
class Slopes:
    """One slope for each operand, as functions of the operands and the result: ``(a, r)`` or ``(a, b, r)``."""

    rules: tuple[Callable[..., Slope], ...]


@dataclass(frozen=True)
class Selection:
    """The tangent of one operand: that of ``operands[0]`` where the condition holds, else of ``operands[1]``; None is no tangent."""

    condition: Callable[..., Scalar]
    operands: tuple[int | None, int | None]


@dataclass(frozen=True)
class Flat:
    """Constant between its jumps: no tangent."""


Derivative = Slopes | Selection | Flat
FLAT = Flat()


def slopes(*rules: Callable[..., Slope]) -> Slopes:
    """A derivative with these slopes."""
    return Slopes(rules)


def slope_of_base(a: Scalar, b: Scalar, r: Scalar) -> Scalar:
    """``d(a^b)/da = b r / a``; at ``a = 0`` it is 1 for ``b = 1`` and 0 otherwise."""
    slope = a.gate(b * r / a)
    if b.number is not None:
        return slope
    return slope + (a.equals(0) * b.equals(1))


def slope_of_exponent(a: Scalar, b: Scalar, r: Scalar) -> Scalar:
    """``d(a^b)/db = r log a`` for a positive base, 0 elsewhere."""
    return (a > 0).gate(r * a.apply(ca.OP_LOG))


def quotient_or_zero(a: Scalar, b: Scalar) -> Scalar:
    """``a / b``, 0 where ``b`` is 0."""
    return b.gate(a / b)
