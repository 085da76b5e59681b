"""The unit of an operation from the units of its operands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca

from greybox.units import ONE, Unit


class UnitMismatchError(Exception):
    """What is wrong with the units inside one expression."""


@dataclass(frozen=True)
class Operands:
    """An operation and the units of its operands; None fits anything (0 and infinity have no unit). ``label`` names a unit."""

    node: ca.SX
    units: Sequence[Unit | None]
    label: Callable[[Unit], str]

    def require_number(self, position: int, subject: str) -> None:
        """Refuse an operand that has a unit: ``sin needs a number without unit, has m``."""
        unit = self.units[position]
        if unit is not None and unit != ONE:
            raise UnitMismatchError(f"{subject} needs a number without unit, has {self.label(unit)}")

    def require_same(self, verb: str) -> Unit | None:
        """The unit that both operands have. Refuses two that differ: ``adds m and N``."""
        first, second = self.units
        if first is not None and second is not None and first != second:
            raise UnitMismatchError(f"{verb} {self.label(first)} and {self.label(second)}")
        return second if first is None else first


UnitRule = Callable[[Operands], Unit | None]


def keep_unit(operands: Operands) -> Unit | None:
    """The unit of the first operand."""
    return operands.units[0]


def no_unit(operands: Operands) -> Unit | None:
    """A plain number, whatever the operands are."""
    return ONE


def same_unit(verb: str) -> UnitRule:
    """The unit that both operands share; ``verb`` says what the operation does with them."""
    return lambda operands: operands.require_same(verb)


def number_from_same_unit(verb: str) -> UnitRule:
    """A plain number from two operands of the same unit: a comparison, an angle."""

    def rule(operands: Operands) -> Unit | None:
        operands.require_same(verb)
        return ONE

    return rule


def number_from_numbers(name: str) -> UnitRule:
    """A plain number from plain numbers, as for ``exp``."""

    def rule(operands: Operands) -> Unit | None:
        for position in range(len(operands.units)):
            operands.require_number(position, name)
        return ONE

    return rule


def power_of_unit(exponent: float) -> UnitRule:
    """The unit of the operand to a fixed power."""

    def rule(operands: Operands) -> Unit | None:
        unit = operands.units[0]
        return unit**exponent if unit else None

    return rule


def product_of_units(operands: Operands) -> Unit | None:
    """The product of both units."""
    first, second = operands.units
    return first * second if first and second else None


def quotient_of_units(operands: Operands) -> Unit | None:
    """The quotient of both units."""
    first, second = operands.units
    return first / second if first and second else None


def unit_to_operand(operands: Operands) -> Unit | None:
    """``a^b``: any unit to a constant power; to a variable power only a plain number."""
    base = operands.units[0]
    power = operands.node.dep(1)
    if power.is_constant():
        return base ** float(power) if base else None
    if base is not None and base != ONE:
        raise UnitMismatchError(f"raises {operands.label(base)} to a power that is not a number")
    operands.require_number(1, "a power")
    return ONE


def unit_where_true(operands: Operands) -> Unit | None:
    """``condition ? value : 0``: the unit of the value; the condition is a plain number."""
    operands.require_number(0, "if")
    return operands.units[1]
