"""Expressions as LaTeX."""

import casadi as ca
import pytest

from greybox.model.expressions.text import expression_latex, symbol_latex


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        (lambda a, b: a * b / (a + b), r"\frac{a\,b}{a + b}"),
        (lambda a, b: -(a + b) * a, r"-\left(a + b\right)\,a"),
        (lambda a, b: ca.sqrt(ca.fabs(a)) / b, r"\frac{\sqrt{\left|a\right|}}{b}"),
        (lambda a, b: b * a * a**2, r"b\,{a}^{3}"),
        (lambda a, b: a + (-b), "a - b"),
        (lambda a, b: ca.sinh(a) ** b, r"{\sinh\left(a\right)}^{b}"),
        (lambda a, b: -1e-9 * a / b, r"-\frac{1\cdot 10^{-9}\,a}{b}"),
        (lambda a, b: ca.if_else(a <= b, a, 2), r"\begin{cases}a & a \le b \\ 2 & \text{otherwise}\end{cases}"),
    ],
)
def test_expressions_are_typeset(expression, expected: str) -> None:
    assert expression_latex(expression(ca.SX.sym("a"), ca.SX.sym("b"))) == expected


def test_names_become_symbols_and_never_commands() -> None:
    assert symbol_latex("Kf") == "K_{f}"
    assert symbol_latex("tau_e") == r"\tau_{e}"
    assert "\\input" not in symbol_latex("a_\\input{x}") and "{x}" not in symbol_latex("a_\\input{x}")
