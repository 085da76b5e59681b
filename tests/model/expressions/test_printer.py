"""Expressions as code: brackets where the order needs them and nowhere else, one if from its two halves, shared parts once."""

from __future__ import annotations

import math

import casadi as ca
import pytest

from greybox.base import GreyboxError
from greybox.model.expressions.graph import nodes, walk
from greybox.model.expressions.operations import Binding
from greybox.model.expressions.printer import MODELICA, PYTHON, Printer

x, y, z = (ca.SX.sym(name) for name in "xyz")
SYMBOLS = {"x": "x", "y": "y", "z": "z"}


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        (x + (y + z), "x + (y + z)"),
        (x + y + z, "x + y + z"),
        (x - (y - z), "x - (y - z)"),
        (x + -y, "x - y"),
        (x * (y * z), "x * (y * z)"),
        ((x + y) * z, "(x + y) * z"),
        (-x * y, "-x * y"),
        (x / (y * z), "x / (y * z)"),
        (-(x + y), "-(x + y)"),
        (x**2 + (-y) ** 2.5, "x**2 + (-y)**2.5"),
        ((x * y) ** 2.5, "(x * y)**2.5"),
        (2 * x + 1 / y, "2 * x + 1 / y"),
        (x * 1e6 + 7, "1000000.0 * x + 7"),
        (ca.fmin(x + y, 0.1), "ca.fmin(x + y, 0.1)"),
        (ca.if_else(x < y, x, z), "ca.if_else(x < y, x, z)"),
        (x * ca.inf, "ca.inf * x"),
        (ca.if_else(x < y, math.nan, z), 'ca.if_else(x < y, float("nan"), z)'),
    ],
)
def test_python(expression: ca.SX, expected: str) -> None:
    assert Printer(PYTHON, SYMBOLS).write(expression) == expected


def test_modelica_spells_choices_and_powers_its_own_way() -> None:
    text = Printer(MODELICA, SYMBOLS).write(ca.if_else(ca.logic_and(x < y, z <= 1), x**2, ca.fmax(y, 0)))
    assert text == "(if (x < y) and (z <= 1) then x^2 else max(y, 0))"


def test_a_language_without_a_word_for_nan_refuses_it() -> None:
    with pytest.raises(GreyboxError, match="NaN, for which Modelica has no word"):
        Printer(MODELICA, SYMBOLS).write(ca.if_else(x < y, math.nan, z))


def test_a_part_that_is_used_twice_gets_a_name() -> None:
    long = ca.sqrt(ca.fabs(x * y + z * y - x)) + 12345.678
    printer = Printer(PYTHON, SYMBOLS)
    printer.count_uses([long * x, long * y])
    assert [printer.write(long * x), printer.write(long * y)] == ["part_1 * x", "part_1 * y"]
    assert [name for name, _ in printer.shared] == ["part_1"]
    plain = Printer(PYTHON, SYMBOLS)
    assert "part" not in plain.write(long * x) + plain.write(long * y), "without counting, nothing is shared"


def test_a_part_takes_no_name_of_a_symbol() -> None:
    long = ca.sqrt(ca.fabs(x * y + z * y - x)) + 12345.678
    printer = Printer(PYTHON, {**SYMBOLS, "y": "part_1"})
    printer.count_uses([long * x, long * z])
    assert printer.write(long * x) == "part_2 * x"


def test_what_is_printed_says_how_tightly_it_holds() -> None:
    printer = Printer(PYTHON, SYMBOLS)
    assert printer.print(x + y).binding == Binding.SUM
    assert printer.print(-x * y).opposite == "x * y"


def test_each_node_is_visited_once_and_after_its_operands() -> None:
    shared = x * y
    order = [node.element_hash() for node in nodes([shared + ca.sin(shared), shared])]
    assert len(order) == len(set(order)) == 5
    assert order.index(shared.element_hash()) < order.index(order[-1])
    assert walk(shared + shared * z, lambda name: 1, lambda number: 0, lambda node, counts: sum(counts)) == 5
