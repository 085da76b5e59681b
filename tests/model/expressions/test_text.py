"""Expressions as text: what stands there is what is meant, and reads as a person writes it."""

from __future__ import annotations

import math
import re
from unittest import mock

import casadi as ca
import pytest
from hypothesis import given
from hypothesis import strategies as st

from greybox.model.expressions import text
from greybox.model.expressions.text import expression_text

x, y, v, k, a, b = (ca.SX.sym(name) for name in ("x", "y", "v", "k", "a", "b"))


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (x, "x"),
        (0, "0"),
        (2.5, "2.5"),
        (-1e-9 * x, "-1e-9 x"),
        (1.23456789e7 * x, "1.23457e7 x"),
        (x * ca.inf, "inf x"),
        (-k * x, "-k x"),
        (2 * x, "2 x"),
        (x / 2, "x/2"),
        (1 / x, "1/x"),
        (2 / x, "2/x"),
        (-x / (a * b), "-x/(a b)"),
        (x / y * a, "x a/y"),
        (x / (y / a), "x a/y"),
        (x * x, "x^2"),
        (x**3, "x^3"),
        (x**7, "x^7"),
        (x**-2, "1/x^2"),
        (x**-3, "1/x^3"),
        (x**1.5, "x^1.5"),
        (x**-0.5, "1/x^0.5"),
        ((x * y) ** 2, "(x y)^2"),
        ((x + y) ** 3, "(x + y)^3"),
        ((2 * x) ** 1.5, "(2 x)^1.5"),
        (x**a, "x^a"),
        (x ** (a + 1), "x^(a + 1)"),
        ((x + y) ** a, "(x + y)^a"),
        ((x**a) ** b, "(x^a)^b"),
        (x ** (a**b), "x^(a^b)"),
        ((x * a) ** b, "(x a)^b"),
        (2**x, "2^x"),
        (y * x**a, "y (x^a)"),
        (a + b - x, "a + b - x"),
        (a - (b + x), "a - (b + x)"),
        (a - (b - x), "a - (b - x)"),
        (-(a - b), "-(a - b)"),
        (a + (b - x), "a + b - x"),
        (-a - b, "-(a + b)"),
        (b - a - x, "b - a - x"),
        (a + 1, "a + 1"),
        (k * (1 - a * x**2) * y, "k (1 - a x^2) y"),
        ((a + b) / (x - y), "(a + b)/(x - y)"),
        (ca.sqrt(2 * a * x), "sqrt(2 a x)"),
        (ca.fabs(v), "|v|"),
        (ca.fabs(x * ca.fabs(v)), "abs(x |v|)"),
        (-k * ca.sign(v), "-k sign(v)"),
        (ca.tanh(v / a), "tanh(v/a)"),
        (ca.exp(-x / a), "exp(-x/a)"),
        (ca.log10(x), "log10(x)"),
        (ca.atan2(x, y) + ca.hypot(x, y), "atan2(x, y) + hypot(x, y)"),
        (ca.fmin(x, ca.fmax(y, 0)), "min(x, max(y, 0))"),
        (ca.if_else(x > 0, x, y), "if(x > 0, x, y)"),
        (ca.if_else(x <= a, x, 0), "if(x <= a, x, 0)"),
        (k * ca.if_else(x > 1e-9, -x, a + b), "k if(x > 1e-9, -x, a + b)"),
        (k * (x > y), "k (y < x)"),
        ((x < y) == a, "(x < y) == a"),
        (ca.logic_and(ca.logic_or(x < y, x < a + b), v), "((x < y) or (x < a + b)) and v"),
        (ca.if_else(ca.logic_or(x < y, a), x, y), "if((x < y) or a, x, y)"),
        (ca.if_else(ca.logic_and(x > 0, ca.logic_not(y > 0)), 1, 0), "if((x > 0) and (not (y > 0)), 1, 0)"),
        (ca.SX.sym("creep.tau") * x, "creep.tau x"),
    ],
)
def test_an_expression_reads_as_a_person_writes_it(value: ca.SX, expected: str) -> None:
    assert expression_text(value) == expected


def python(written: str) -> str:
    """The printed text as Python: powers, absolute values and the products that stand side by side."""
    written = re.sub(r"\|([^|]*)\|", r"abs(\1)", written).replace("^", "**").replace("if(", "choose(")
    return re.sub(r"(?<=[\w)])(?<!not) (?=[\w(])", "*", written)


SYMBOLS = {"x": 0.75, "y": 1.5, "v": -2.0, "k": 3.0}
FUNCTIONS = {"sqrt": math.sqrt, "tanh": math.tanh, "exp": math.exp, "choose": lambda c, p, q: p if c else q}
LEAVES = st.sampled_from([x, y, v, k, ca.SX(2.0), ca.SX(-1.0), ca.SX(0.5), ca.SX(3.0)])
ONE_OPERAND = st.sampled_from(
    [
        lambda e: -e,
        ca.fabs,
        ca.tanh,
        lambda e: ca.sqrt(ca.fabs(e)),
        lambda e: ca.exp(ca.tanh(e)),
        lambda e: e**2,
        lambda e: e**3,
        lambda e: e**-1,
        lambda e: ca.fabs(e) ** 1.5,
        lambda e: ca.fabs(e) ** -0.5,
        lambda e: ca.if_else(x < k, e, 1),
        lambda e: ca.if_else(x > k, 2, e),
        lambda e: (1 + ca.fabs(e)) ** y,
    ]
)
TWO_OPERANDS = st.sampled_from(
    [
        lambda e, f: e + f,
        lambda e, f: e - f,
        lambda e, f: e * f,
        lambda e, f: e / f,
        ca.fmin,
        ca.fmax,
        lambda e, f: ca.if_else(v > 0, e, f),
    ]
)


def grown(inner: st.SearchStrategy) -> st.SearchStrategy:
    one = st.builds(lambda function, e: function(e), ONE_OPERAND, inner)
    return one | st.builds(lambda function, e, f: function(e, f), TWO_OPERANDS, inner, inner)


@given(value=st.recursive(LEAVES, grown, max_leaves=12))
def test_the_text_evaluates_to_the_expression(value: ca.SX) -> None:
    function = ca.Function("f", [x, y, v, k], [value])
    expected = float(function(*SYMBOLS.values()))
    if not math.isfinite(expected) or abs(expected) > 1e6:
        return
    with mock.patch.object(text, "number_text", repr):  # all digits, and not the six that a person reads
        written = expression_text(value)
    names = SYMBOLS | FUNCTIONS | {"abs": abs, "min": min, "max": max}
    try:
        value_of_text = eval(python(written), {"__builtins__": {}}, names)
    except ZeroDivisionError:  # inside the branch that is not taken
        return
    assert value_of_text == pytest.approx(expected, rel=1e-6, abs=1e-6), written
