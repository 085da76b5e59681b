"""Expressions as C99: one instruction at a time, as the tape of a kernel lists them."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from greybox.expressions.operations import OPERATIONS


def c_instruction(code: int, operands: Sequence[str]) -> str:
    """An operation on variables and literals; empty for one that C does not have."""
    return OPERATIONS[code].c.format(*operands) if code in OPERATIONS else ""


def c_type(code: int) -> str:
    """The type of an operation's result."""
    return "int" if code in OPERATIONS and OPERATIONS[code].logical else "double"


def c_literal(value: float) -> str:
    """A literal that reads back as the same double."""
    if value != value:
        return "NAN"
    if value in (ca.inf, -ca.inf):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    return repr(value) if value >= 0 and repr(value) != "-0.0" else f"({value!r})"
