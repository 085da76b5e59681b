"""The unit of an expression: by every rule, and what no rule allows."""

from __future__ import annotations

import sys

import casadi as ca
import pytest

from greybox.base.errors import ModelError
from greybox.base.units import ONE, parse_unit
from greybox.model.expressions.operations import UnitMismatchError
from greybox.model.expressions.text import infer_unit

UNITS = {"x": "m", "y": "m", "v": "m/s", "F": "N", "r": "", "k": "N/m", "mm": "mm", "t": "s", "angle": "deg"}
x, y, v, F, r, k, mm, t, angle = (ca.SX.sym(symbol) for symbol in UNITS)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (x + y, "m"),
        (x - 2 * y, "m"),
        (-x * k, "N"),
        (x + v * t, "m"),
        (ca.fmin(x, y), "m"),
        (ca.fmax(x, 0), "m"),
        (ca.fmin(x, ca.inf), "m"),
        (x * x, "m^2"),
        (2 * x, "m"),
        (1 / x, "1/m"),
        (x**3, "m^3"),
        (x**-2, "1/m^2"),
        (ca.sqrt(x), "m^0.5"),
        (x**1.5, "m^1.5"),
        (x / v, "s"),
        (r**r, ""),
        (2**r, ""),
        (ca.exp(-x / y), ""),
        (F * ca.tanh(v * t / y), "N"),
        (ca.log10(r), ""),
        (ca.sin(r) + ca.erf(r) + ca.log1p(r) + ca.expm1(r) + ca.floor(r), ""),
        (ca.atan2(x, y), ""),
        (ca.hypot(x, y), "m"),
        (F * ca.sign(v), "N"),
        (ca.fabs(v), "m/s"),
        (ca.copysign(x, v), "m"),
        (ca.fmod(x, y), "m"),
        (ca.if_else(v > 0, x, y), "m"),
        (ca.if_else(v > 0, x, 0), "m"),
        (ca.if_else(ca.logic_and(v > 0, x < y), 1, -1), ""),
        (k * x * (x > y), "N"),
        (x * 0, ""),
        (3.0, ""),
        (mm / x, "0.001"),
    ],
)
def test_unit_of_an_expression(value: ca.SX, expected: str) -> None:
    assert (infer_unit(value, UNITS) or ONE) == parse_unit(expected)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (x + v, "adds m and m/s in 'x + v'"),
        (k * (x - r), "subtracts m and a number in 'x - r'"),
        (x + 1e-9, "adds m and a number in 'x + 1e-9'"),
        (x + mm, "adds m and mm in 'x + mm'"),
        (ca.fmin(x, v), "takes the smaller of m and m/s in 'min(x, v)'"),
        (ca.fmax(x, 1), "takes the larger of m and a number in 'max(x, 1)'"),
        (ca.hypot(x, v), "takes the length of m and m/s in 'hypot(x, v)'"),
        (ca.atan2(x, v), "takes the angle of m and m/s in 'atan2(x, v)'"),
        (ca.fmod(x, v), "takes the remainder of m and m/s in 'fmod(x, v)'"),
        (ca.if_else(x > v, x, 0), "compares m/s and m in 'v < x'"),
        (ca.if_else(x > 0, x, v), "adds m and m/s in 'if(x > 0, x, v)'"),
        (ca.if_else(x, r, 0), "if needs a number without unit, has m in 'if(x, r, 0)'"),
        (ca.exp(x), "exp needs a number without unit, has m in 'exp(x)'"),
        (F * ca.tanh(v), "tanh needs a number without unit, has m/s in 'tanh(v)'"),
        (ca.floor(x), "floor needs a number without unit, has m in 'floor(x)'"),
        (ca.sin(angle), "sin needs a number without unit, has deg in 'sin(angle)'"),
        (x**r, "raises m to a power that is not a number in 'x^r'"),
        (r**x, "a power needs a number without unit, has m in 'r^x'"),
        (x + ca.SX.sym("w"), "uses 'w', which is not a state, input or parameter of the model"),
    ],
)
def test_expression_without_a_unit(value: ca.SX, message: str) -> None:
    with pytest.raises(UnitMismatchError) as error:
        infer_unit(value, UNITS)
    assert message in str(error.value)


def test_a_vector_is_no_term() -> None:
    with pytest.raises(ModelError, match="has 2 rows and 1 columns; a term of an equation is one number"):
        infer_unit(ca.vertcat(x, y), UNITS)


@pytest.mark.rest
def test_deep_expressions_need_no_recursion() -> None:
    deep = x
    for _ in range(2 * sys.getrecursionlimit()):
        deep = ca.fmax(deep, y) + x
    assert infer_unit(deep, UNITS) == parse_unit("m")


# ---- the units of a model ------------------------------------------------------------------------------------------
