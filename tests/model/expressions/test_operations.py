"""Every row of the table of operations, in every language: what is written means the operation, slopes are its derivative."""

from __future__ import annotations

import math
import re

import casadi as ca
import numpy as np
import pytest

from greybox.base.errors import GreyboxError, ModelError
from greybox.base.units import ONE
from greybox.model.expressions.operations import FLAT, OPERATIONS, Binding, Operation, Slopes, function, operation_name
from greybox.model.expressions.printer import MODELICA, NUMPY, PYTHON, Printer, c_instruction, c_literal, c_type
from greybox.model.expressions.text import LATEX, TEXT, evaluate_formula, expression_text, format_formula, infer_unit
from greybox.simulation.kernel.interpreted import evaluate_tape
from greybox.simulation.kernel.tape import read_tape

A, B = ca.SX.sym("a"), ca.SX.sym("b")
POINTS = {ca.OP_ACOSH: (1.6, 1.7), ca.OP_FMOD: (3.1, 1.7), ca.OP_REMAINDER: (3.1, 1.7)}
# Modelica Language Specification 3.6, sections 3.7 and 10.3.4: the built-in functions of numbers.
MODELICA_FUNCTIONS = {
    *("abs", "sign", "sqrt", "div", "mod", "rem", "ceil", "floor", "integer", "min", "max", "exp", "log", "log10"),
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh"),
}
ROWS = [pytest.param(row, id=operation_name(row.code)) for row in OPERATIONS.values()]


class Values(dict):
    """Symbols by name, as a formula asks for them."""

    @property
    def names(self) -> list[str]:
        return list(self)


def applied(row: Operation) -> ca.SX:
    return ca.SX.unary(row.code, A) if row.arity == 1 else ca.SX.binary(row.code, A, B)


def point(row: Operation) -> tuple[float, float]:
    return POINTS.get(row.code, (0.6, 1.7))


def value(expression: ca.SX, at: tuple[float, float]) -> float:
    return float(ca.Function("f", [A, B], [expression])(*at))


def written_or_refused(dialect, expression: ca.SX, available: bool) -> str:
    """The text; where the language does not have the operation, the error is checked and the text is empty."""
    printer = Printer(dialect, {"a": "a", "b": "b"})
    if available:
        return printer.write(expression)
    with pytest.raises(GreyboxError, match=f"{dialect.name} has no "):
        printer.write(expression)
    return ""


@pytest.mark.parametrize("row", ROWS)
def test_arity_is_that_of_casadi(row: Operation) -> None:
    assert applied(row).n_dep() == row.arity == len(row.needs[: row.arity])


@pytest.mark.parametrize("row", ROWS)
@pytest.mark.parametrize(("dialect", "library"), [(PYTHON, ca), (NUMPY, np)], ids=["python", "numpy"])
def test_python_text_means_the_operation(row: Operation, dialect, library) -> None:
    available = bool(getattr(row, dialect.column)) or row.code == ca.OP_IF_ELSE_ZERO
    text = written_or_refused(dialect, applied(row) + 1, available)
    if text:
        at = point(row)
        names = {"ca": ca, "np": np, "a": at[0], "b": at[1]}
        if library is ca:
            names |= {"a": ca.SX(at[0]), "b": ca.SX(at[1])}
        assert float(eval(text, names)) == pytest.approx(value(applied(row), at) + 1, rel=1e-14)


@pytest.mark.parametrize("row", ROWS)
def test_a_formula_reads_back_as_the_operation(row: Operation) -> None:
    if not row.formula:
        with pytest.raises(ModelError, match="cannot be written as a formula"):
            format_formula("tie", applied(row))
        return
    again = evaluate_formula("tie", format_formula("tie", applied(row)), Values(a=A, b=B))
    assert value(again, point(row)) == pytest.approx(value(applied(row), point(row)), rel=1e-14)


@pytest.mark.parametrize("row", ROWS)
def test_modelica_text_names_the_operands(row: Operation) -> None:
    text = written_or_refused(MODELICA, applied(row), bool(row.modelica) or row.code == ca.OP_IF_ELSE_ZERO)
    assert not text or {"a", "b"[: row.arity - 1]} - {""} <= set(re.findall(r"\w+", text))


@pytest.mark.parametrize("row", ROWS)
def test_modelica_text_calls_only_what_the_language_has(row: Operation) -> None:
    assert set(re.findall(r"(\w+)\(", row.modelica)) <= MODELICA_FUNCTIONS


@pytest.mark.parametrize("row", ROWS)
def test_text_and_latex_name_the_operands(row: Operation) -> None:
    for text in (Printer(LATEX, {"a": "a", "b": "b"}).write(applied(row)), str(TEXT.write(applied(row)))):
        assert "a" in text and ("b" in text or row.arity == 1)
        assert "operation" not in text


@pytest.mark.parametrize("row", ROWS)
def test_the_tangent_is_the_derivative(row: Operation) -> None:
    """Slopes against central differences of CasADi's own values; what jumps has none."""
    assert row.derivative is not None
    f = ca.Function("f", [ca.vertcat(A, B)], [applied(row)])
    z, seeds = ca.SX.sym("z", 2), ca.SX.eye(2)
    y, dy = evaluate_tape(read_tape(f, active=(0,), varying=(0,)), [z], {0: seeds}, 2)
    at, e = np.array(point(row)), 1e-6
    result, slopes = (v.full().ravel() for v in ca.Function("tangents", [z], [y, dy])(at))
    assert result[0] == pytest.approx(value(applied(row), tuple(at)), rel=1e-14)
    differences = [(float(f(at + e * direction)) - float(f(at - e * direction))) / (2 * e) for direction in np.eye(2)]
    rtol = 1e-6 if row.code == ca.OP_ERFINV else 1e-7  # CasADi's erfinv is itself an approximation
    np.testing.assert_allclose(slopes, differences, rtol=rtol, atol=1e-8)
    assert (row.derivative == FLAT) <= (not slopes.any())


@pytest.mark.parametrize("row", ROWS)
def test_numbers_make_a_number(row: Operation) -> None:
    assert infer_unit(applied(row), {"a": "1", "b": "1"}) == ONE


@pytest.mark.parametrize("row", [p for p in ROWS if p.values[0].branch])
def test_a_branch_is_the_operation_on_its_side(row: Operation) -> None:
    operands = [A, B][: row.arity]
    for at in ((0.6, 1.7), (1.7, 0.6), (-0.6, 1.7)):
        side = 1 if (at[0] - at[1] if row.arity == 2 else at[0]) > 0 else -1
        assert value(ca.SX(row.branch(side, operands)), at) == value(applied(row), at)


@pytest.mark.parametrize("row", [p for p in ROWS if p.values[0].commutative])
def test_commutative_operands_change_places_to_the_last_bit(row: Operation) -> None:
    swapped = ca.SX.binary(row.code, B, A)
    assert value(swapped, point(row)) == value(applied(row), point(row))


def test_c_writes_one_instruction() -> None:
    assert c_instruction(ca.OP_SINH, ["t1"]) == "sinh(t1)"
    assert c_instruction(ca.OP_SQ, ["t1"]) == "t1 * t1"
    assert c_instruction(ca.OP_CONSTPOW, ["t1", "2.5"]) == "pow(t1, 2.5)"
    assert c_instruction(ca.OP_ERFINV, ["t1"]) == "", "C99 has no inverse error function"
    assert c_type(ca.OP_LT) == "int" and c_type(ca.OP_MUL) == "double"


@pytest.mark.parametrize(
    ("number", "literal"),
    [
        (0.1, "0.1"),
        (-2.0, "(-2.0)"),
        (-0.0, "(-0.0)"),
        (math.inf, "INFINITY"),
        (-math.inf, "(-INFINITY)"),
        (math.nan, "NAN"),
    ],
)
def test_c_literals(number: float, literal: str) -> None:
    assert c_literal(number) == literal


def test_a_function_is_one_row() -> None:
    """All that ``sinh`` has in the table beyond its name: the derivative."""
    slopes = OPERATIONS[ca.OP_SINH].derivative
    assert isinstance(slopes, Slopes)
    row = function(ca.OP_SINH, "sinh", slopes)
    assert (row.arity, row.binding) == (1, Binding.ATOM)
    assert (row.c, row.python, row.numpy, row.modelica) == ("sinh({0})", "ca.sinh({0})", "np.sinh({0})", "sinh({0})")
    assert (row.formula, row.text) == ("sinh({0})", "sinh({0})")
    assert row.latex.format("x") == r"\operatorname{sinh}\left(x\right)"


def test_an_operation_without_a_row_is_named() -> None:
    assert expression_text(ca.SX.binary(ca.OP_PRINTME, A, B)) == "OP_PRINTME(a, b)"
    assert operation_name(ca.OP_PRINTME) == "OP_PRINTME"
    assert operation_name(-1) == "unknown"
