"""The unit of an expression, from the units of its symbols."""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca

from greybox.base.errors import UnitError
from greybox.base.units import ONE, Unit, parse_unit, unit_name
from greybox.model.expressions.graph import walk
from greybox.model.expressions.operations import OPERATIONS, Operands, UnitMismatchError
from greybox.model.expressions.text import expression_text


def unit_of(value: ca.SX | float, units: Mapping[str, str]) -> Unit:
    """The unit of an expression whose symbols have ``units`` (name -> unit); one that fits anything is a plain number.

    Raises UnitError where the expression adds, compares or raises what has no common sense.
    """
    try:
        return infer_unit(value, units) or ONE
    except UnitMismatchError as mismatch:
        raise UnitError(f"'{expression_text(value)}' {mismatch}") from None


def infer_unit(value: ca.SX | float, units: Mapping[str, str]) -> Unit | None:
    """The unit of an expression, None for one that fits anything (0, infinity). Raises UnitMismatchError for operands that do not fit."""

    def label(unit: Unit) -> str:
        return "a number" if unit == ONE else unit_name(unit, units.values())

    def leaf(symbol: str) -> Unit | None:
        if symbol not in units:
            raise UnitMismatchError(f"uses {symbol!r}, which is not a state, input or parameter of the model")
        return parse_unit(units[symbol])

    def constant(number: float) -> Unit | None:
        return ONE if number and math.isfinite(number) else None

    def combine(node: ca.SX, operands: list[Unit | None]) -> Unit | None:
        row = OPERATIONS.get(node.op())
        if node.op() == ca.OP_CALL:
            raise UnitMismatchError(
                "calls a function of its own, such as casadi.interpolant, that no formula stands for; write a table as"
                " greybox.Characteristic, and other functions as their formulas"
            )
        if row is None:
            raise UnitMismatchError(
                f"'{expression_text(node)}' is an operation whose unit is not known; write it with ordinary functions"
            )
        try:
            return row.unit(Operands(node, operands, label))
        except UnitMismatchError as mismatch:
            raise UnitMismatchError(f"{mismatch} in '{expression_text(node)}'") from None

    return walk(value, leaf, constant, combine)
