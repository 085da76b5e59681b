"""How every elementary operation passes a tangent on: one table for both kernels.

For ``r = op(a, b)`` the tangent is ``dr = (dr/da) da + (dr/db) db``. The slopes are written once, on `Scalar`, and
become C or CasADi instructions later. Where a function has a kink or an infinite slope the table takes a finite one, so
that a point touched for one sample cannot spoil a whole record with ``0 * inf``: ``sqrt`` and powers below one have
slope 0 at 0, ``|a|`` has slope 0 at 0, ``hypot`` and ``atan2`` have slope 0 at the origin. `PICKS` choose a whole
tangent and never multiply the other one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Union

import casadi as ca

if TYPE_CHECKING:
    from greybox.kernel.tape import Scalar

Slope = Union["Scalar", float]
Unary = Callable[["Scalar", "Scalar"], Slope]
Binary = Callable[["Scalar", "Scalar", "Scalar"], Slope]

# dr/da from (a, r)
UNARY: dict[int, Unary] = {
    ca.OP_NEG: lambda a, r: -1.0,
    ca.OP_TWICE: lambda a, r: 2.0,
    ca.OP_SQ: lambda a, r: 2 * a,
    ca.OP_INV: lambda a, r: -(r * r),
    ca.OP_SQRT: lambda a, r: r.gate(0.5 / r),
    ca.OP_EXP: lambda a, r: r,
    ca.OP_LOG: lambda a, r: 1 / a,
    ca.OP_EXPM1: lambda a, r: r + 1,
    ca.OP_LOG1P: lambda a, r: 1 / (a + 1),
    ca.OP_SIN: lambda a, r: a.apply(ca.OP_COS),
    ca.OP_COS: lambda a, r: -a.apply(ca.OP_SIN),
    ca.OP_TAN: lambda a, r: 1 + r * r,
    ca.OP_ASIN: lambda a, r: 1 / (1 - a * a).apply(ca.OP_SQRT),
    ca.OP_ACOS: lambda a, r: -(1 / (1 - a * a).apply(ca.OP_SQRT)),
    ca.OP_ATAN: lambda a, r: 1 / (1 + a * a),
    ca.OP_SINH: lambda a, r: a.apply(ca.OP_COSH),
    ca.OP_COSH: lambda a, r: a.apply(ca.OP_SINH),
    ca.OP_TANH: lambda a, r: 1 - r * r,
    ca.OP_ASINH: lambda a, r: 1 / (1 + a * a).apply(ca.OP_SQRT),
    ca.OP_ACOSH: lambda a, r: 1 / (a * a - 1).apply(ca.OP_SQRT),
    ca.OP_ATANH: lambda a, r: 1 / (1 - a * a),
    ca.OP_ERF: lambda a, r: 2 / math.sqrt(math.pi) * (-(a * a)).apply(ca.OP_EXP),
    ca.OP_ERFINV: lambda a, r: math.sqrt(math.pi) / 2 * (r * r).apply(ca.OP_EXP),
    ca.OP_FABS: lambda a, r: a.apply(ca.OP_SIGN),
}

# dr/da and dr/db from (a, b, r)
BINARY: dict[int, tuple[Binary, Binary]] = {
    ca.OP_ADD: (lambda a, b, r: 1.0, lambda a, b, r: 1.0),
    ca.OP_SUB: (lambda a, b, r: 1.0, lambda a, b, r: -1.0),
    ca.OP_MUL: (lambda a, b, r: b, lambda a, b, r: a),
    ca.OP_DIV: (lambda a, b, r: 1 / b, lambda a, b, r: -(r * (1 / b))),
    ca.OP_POW: (lambda a, b, r: _base_slope(a, b, r), lambda a, b, r: (a > 0).gate(r * a.apply(ca.OP_LOG))),
    ca.OP_CONSTPOW: (lambda a, b, r: _base_slope(a, b, r), lambda a, b, r: (a > 0).gate(r * a.apply(ca.OP_LOG))),
    ca.OP_FMOD: (lambda a, b, r: 1.0, lambda a, b, r: (r - a) / b),
    ca.OP_REMAINDER: (lambda a, b, r: 1.0, lambda a, b, r: (r - a) / b),
    ca.OP_COPYSIGN: (lambda a, b, r: a.apply(ca.OP_SIGN) * r.apply(ca.OP_SIGN), lambda a, b, r: 0.0),
    ca.OP_ATAN2: (lambda a, b, r: _over(b, a * a + b * b), lambda a, b, r: -_over(a, a * a + b * b)),
    ca.OP_HYPOT: (lambda a, b, r: _over(a, r), lambda a, b, r: _over(b, r)),
}

# (condition from (a, b, r), which of a and b gives the tangent when it holds and when it does not); None is no tangent
PICKS: dict[int, tuple[Callable[[Scalar, Scalar, Scalar], Scalar], tuple[int | None, int | None]]] = {
    ca.OP_IF_ELSE_ZERO: (lambda a, b, r: a, (1, None)),
    ca.OP_FMIN: (lambda a, b, r: a.equals(r), (0, 1)),
    ca.OP_FMAX: (lambda a, b, r: a.equals(r), (0, 1)),
}

# Constant between their jumps: no tangent
FLAT = frozenset(
    [ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_SIGN]
)


def _base_slope(a: Scalar, b: Scalar, r: Scalar) -> Scalar:
    """``d(a^b)/da = b r / a``; at ``a = 0`` it is 1 for ``b = 1`` and 0 otherwise."""
    slope = a.gate(b * r / a)
    if b.number is not None:
        return slope
    return slope + (a.equals(0) * b.equals(1))


def _over(a: Scalar, b: Scalar) -> Scalar:
    return b.gate(a / b)
