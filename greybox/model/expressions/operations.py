"""The table of operations: one row for each, with everything that differentiation, unit checks, simplification and printing need.

A new operation of CasADi is a new row. For a function such as ``sinh`` that is its name, its derivative and, unless it takes and returns
plain numbers, the rule for its unit::

    function(ca.OP_SINH, "sinh", slopes(lambda a, r: a.apply(ca.OP_COSH))),

The name then serves every language. One that spells the operation otherwise gets a template of its own (``{0}`` and ``{1}`` stand for the
operands), one that does not have it an empty template.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import casadi as ca

from greybox.base.units import ONE, Unit

# How an operation passes a derivative on: for ``r = op(a, b)`` the tangent is ``dr = (dr/da) da + (dr/db) db``.
#
# Each slope is written once, on the scalars of a tape (`greybox.simulation.kernel.tape.Scalar`, which have the usual operators), and
# becomes C or CasADi instructions later. Where a function has a kink or an infinite slope, the slope here is finite, so that a point
# touched for one sample cannot turn a whole record into ``0 * inf``: ``sqrt`` and powers below one have slope 0 at 0, ``|a|`` has slope 0
# at 0, ``hypot`` and ``atan2`` have slope 0 at the origin. A `Selection` takes one operand's tangent whole and never multiplies the other
# one.

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


# The unit of an operation from the units of its operands.


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


Branch = Callable[[int, Sequence[ca.SX]], ca.SX]


class Binding(IntEnum):
    """How tightly an operation holds together; an operand that binds less than its place needs is put in brackets."""

    CHOICE = 0
    OR = 1
    AND = 2
    COMPARISON = 3
    SUM = 4
    NEGATION = 5
    PRODUCT = 6
    POWER = 7
    ATOM = 8


@dataclass(frozen=True, kw_only=True)
class Operation:
    """One operation of CasADi. The fields from ``c`` to ``latex`` are templates, empty where the language does not have the operation."""

    code: int
    """CasADi's number: ``casadi.OP_SINH``."""
    name: str
    """CasADi's name, ``casadi.sinh``, or the sign of an operator."""
    arity: int = 1
    """Number of operands."""
    binding: Binding = Binding.ATOM
    """How tightly the operation holds together."""
    needs: tuple[Binding, ...] = (Binding.CHOICE, Binding.CHOICE)
    """How tightly each operand must hold together to stand without brackets."""
    derivative: Derivative | None = None
    """How a tangent passes through; None where no rule is known: such an operation cannot be fitted."""
    unit: UnitRule
    """The unit of the result."""
    c: str = ""
    """One instruction of C99, its operands being variables or numbers."""
    python: str = ""
    """CasADi in Python."""
    numpy: str = ""
    """NumPy, for numbers and arrays."""
    modelica: str = ""
    """Modelica."""
    formula: str = ""
    """A formula of constants as a user writes it."""
    text: str = ""
    """The equations that a person reads. Sums, products and powers have no template there: they are collected first."""
    latex: str = ""
    """LaTeX."""
    branch: Branch | None = None
    """For an operation that switches where ``a`` (or ``a - b``) is zero: its smooth expression on the side above (1) or below (-1)."""
    commutative: bool = False
    """Whether the operands may change places without a change of the last bit."""
    logical: bool = False
    """Whether the result is true or false."""


def function(
    code: int,
    name: str,
    derivative: Derivative | None,
    unit: UnitRule | None = None,
    *,
    arity: int = 1,
    **templates: Any,
) -> Operation:
    """The row of a function: plain numbers in and out unless ``unit`` says otherwise, called by its name where no template is given."""
    arguments = ", ".join(f"{{{k}}}" for k in range(arity))
    call = f"{name}({arguments})"
    columns = dict.fromkeys(("c", "modelica", "formula", "text"), call)
    columns |= {"python": f"ca.{call}", "numpy": f"np.{call}"}
    columns["latex"] = rf"\operatorname{{{{{name}}}}}\left({arguments}\right)"
    unit = unit or number_from_numbers(name)
    return Operation(code=code, name=name, arity=arity, derivative=derivative, unit=unit, **{**columns, **templates})


def operator(
    code: int,
    sign: str,
    template: str,
    binding: Binding,
    needs: tuple[Binding, ...],
    derivative: Derivative,
    unit: UnitRule,
    **templates: Any,
) -> Operation:
    """The row of an operator, written as in ``template`` by every language that has no template of its own."""
    columns: dict[str, Any] = dict.fromkeys(("c", "python", "numpy", "modelica", "formula", "latex"), template)
    columns |= {"name": sign, "code": code, "arity": len(needs), "binding": binding, "needs": needs}
    return Operation(derivative=derivative, unit=unit, **{**columns, **templates})


def comparison(code: int, sign: str, latex: str, branch: Branch, **templates: Any) -> Operation:
    """The row of a comparison."""
    rule = number_from_same_unit("compares")
    columns = {"latex": f"{{0}} {latex} {{1}}", "text": f"({{0}} {sign} {{1}})", "formula": "", **templates}
    template = f"{{0}} {sign} {{1}}"
    return operator(
        code, sign, template, Binding.COMPARISON, (Binding.SUM,) * 2, FLAT, rule, branch=branch, logical=True, **columns
    )


def logic(code: int, word: str, binding: Binding, **templates: Any) -> Operation:
    """The row of ``and`` and ``or``."""
    needs = (Binding.SUM, Binding.SUM)
    columns = {"python": f"ca.logic_{word}({{0}}, {{1}})", "numpy": f"np.logical_{word}({{0}}, {{1}})", "formula": ""}
    columns |= {"text": f"({{0}} {word} {{1}})"}
    rule = number_from_numbers(word)
    template = f"{{0}} {word} {{1}}"
    return operator(
        code, word, template, binding, needs, FLAT, rule, commutative=True, logical=True, **{**columns, **templates}
    )


def _constant_branch(above: bool, below: bool) -> Branch:
    return lambda side, operands: ca.SX(above if side > 0 else below)


B = Binding
ROWS = (
    # ---- arithmetic
    operator(
        ca.OP_ADD,
        "+",
        "{0} + {1}",
        B.SUM,
        (B.SUM, B.PRODUCT),
        slopes(lambda a, b, r: 1.0, lambda a, b, r: 1.0),
        same_unit("adds"),
        commutative=True,
    ),
    operator(
        ca.OP_SUB,
        "-",
        "{0} - {1}",
        B.SUM,
        (B.SUM, B.PRODUCT),
        slopes(lambda a, b, r: 1.0, lambda a, b, r: -1.0),
        same_unit("subtracts"),
    ),
    operator(ca.OP_NEG, "-", "-{0}", B.NEGATION, (B.PRODUCT,), slopes(lambda a, r: -1.0), keep_unit),
    operator(
        ca.OP_MUL,
        "*",
        "{0} * {1}",
        B.PRODUCT,
        (B.PRODUCT, B.POWER),
        slopes(lambda a, b, r: b, lambda a, b, r: a),
        product_of_units,
        formula="{0}*{1}",
        commutative=True,
    ),
    operator(
        ca.OP_DIV,
        "/",
        "{0} / {1}",
        B.PRODUCT,
        (B.PRODUCT, B.POWER),
        slopes(lambda a, b, r: 1 / b, lambda a, b, r: -(r * (1 / b))),
        quotient_of_units,
        formula="{0}/{1}",
        latex=r"\frac{{{0}}}{{{1}}}",
    ),
    operator(
        ca.OP_TWICE,
        "2*",
        "2 * {0}",
        B.PRODUCT,
        (B.POWER,),
        slopes(lambda a, r: 2.0),
        keep_unit,
        c="{0} + {0}",
        formula="2*{0}",
    ),
    operator(
        ca.OP_INV,
        "1/",
        "1 / {0}",
        B.PRODUCT,
        (B.POWER,),
        slopes(lambda a, r: -(r * r)),
        power_of_unit(-1.0),
        c="1.0 / {0}",
        formula="1/{0}",
        latex=r"\frac{{1}}{{{0}}}",
    ),
    operator(
        ca.OP_SQ,
        "^2",
        "{0}^2",
        B.POWER,
        (B.ATOM,),
        slopes(lambda a, r: 2 * a),
        power_of_unit(2.0),
        c="{0} * {0}",
        python="{0}**2",
        numpy="{0}**2",
        latex="{{{0}}}^{{2}}",
    ),
    *(
        operator(
            code,
            "^",
            "{0}^{1}",
            B.POWER,
            (B.ATOM, B.ATOM),
            slopes(slope_of_base, slope_of_exponent),
            unit_to_operand,
            c="pow({0}, {1})",
            python="{0}**{1}",
            numpy="{0}**{1}",
            latex="{{{0}}}^{{{1}}}",
        )
        for code in (ca.OP_POW, ca.OP_CONSTPOW)
    ),
    # ---- decisions
    comparison(ca.OP_LT, "<", "<", _constant_branch(False, True)),
    comparison(ca.OP_LE, "<=", r"\le", _constant_branch(False, True)),
    comparison(ca.OP_EQ, "==", "=", _constant_branch(False, False), modelica="", commutative=True),
    comparison(ca.OP_NE, "!=", r"\ne", _constant_branch(True, True), modelica="", commutative=True),
    logic(ca.OP_AND, "and", B.AND, c="{0} && {1}", latex=r"{0} \wedge {1}"),
    logic(ca.OP_OR, "or", B.OR, c="{0} || {1}", latex=r"{0} \vee {1}"),
    operator(
        ca.OP_NOT,
        "not",
        "not ({0})",
        B.AND,
        (B.CHOICE,),
        FLAT,
        number_from_numbers("not"),
        logical=True,
        c="!{0}",
        python="ca.logic_not({0})",
        numpy="np.logical_not({0})",
        formula="",
        text="(not {0})",
        latex=r"\neg\left({0}\right)",
    ),
    operator(
        ca.OP_IF_ELSE_ZERO,
        "if",
        "",
        B.CHOICE,
        (B.CHOICE, B.CHOICE),
        Selection(lambda a, b, r: a, (1, None)),
        unit_where_true,
        c="{0} ? {1} : 0.0",
    ),
    # ---- functions with kinks
    function(
        ca.OP_FABS,
        "fabs",
        slopes(lambda a, r: a.apply(ca.OP_SIGN)),
        keep_unit,
        modelica="abs({0})",
        formula="abs({0})",
        text="abs({0})",
        latex=r"\left|{0}\right|",
        branch=lambda side, operands: side * operands[0],
    ),
    function(
        ca.OP_SIGN,
        "sign",
        FLAT,
        no_unit,
        c="{0} < 0 ? -1.0 : {0} > 0 ? 1.0 : {0}",
        branch=lambda side, operands: ca.SX(side),
    ),
    function(
        ca.OP_FMIN,
        "fmin",
        Selection(lambda a, b, r: a.equals(r), (0, 1)),
        same_unit("takes the smaller of"),
        arity=2,
        c="({0} < {1} || {1} != {1}) ? {0} : {1}",
        modelica="min({0}, {1})",
        formula="min({0}, {1})",
        text="min({0}, {1})",
        latex=r"\min\left({0}, {1}\right)",
        branch=lambda side, operands: operands[1 if side > 0 else 0],
    ),
    function(
        ca.OP_FMAX,
        "fmax",
        Selection(lambda a, b, r: a.equals(r), (0, 1)),
        same_unit("takes the larger of"),
        arity=2,
        c="({0} > {1} || {1} != {1}) ? {0} : {1}",
        modelica="max({0}, {1})",
        formula="max({0}, {1})",
        text="max({0}, {1})",
        latex=r"\max\left({0}, {1}\right)",
        branch=lambda side, operands: operands[0 if side > 0 else 1],
    ),
    # ---- steps
    function(ca.OP_FLOOR, "floor", FLAT),
    function(ca.OP_CEIL, "ceil", FLAT),
    # ---- powers, exponentials, logarithms
    function(ca.OP_SQRT, "sqrt", slopes(lambda a, r: r.gate(0.5 / r)), power_of_unit(0.5), latex=r"\sqrt{{{0}}}"),
    function(ca.OP_EXP, "exp", slopes(lambda a, r: r), latex=r"\exp\left({0}\right)"),
    function(ca.OP_EXPM1, "expm1", slopes(lambda a, r: r + 1), modelica="(exp({0}) - 1)"),
    function(ca.OP_LOG, "log", slopes(lambda a, r: 1 / a), latex=r"\log\left({0}\right)"),
    function(ca.OP_LOG1P, "log1p", slopes(lambda a, r: 1 / (a + 1)), modelica="log(1 + ({0}))"),
    # ---- circular functions
    function(ca.OP_SIN, "sin", slopes(lambda a, r: a.apply(ca.OP_COS)), latex=r"\sin\left({0}\right)"),
    function(ca.OP_COS, "cos", slopes(lambda a, r: -a.apply(ca.OP_SIN)), latex=r"\cos\left({0}\right)"),
    function(ca.OP_TAN, "tan", slopes(lambda a, r: 1 + r * r), latex=r"\tan\left({0}\right)"),
    function(ca.OP_ASIN, "asin", slopes(lambda a, r: 1 / (1 - a * a).apply(ca.OP_SQRT))),
    function(ca.OP_ACOS, "acos", slopes(lambda a, r: -(1 / (1 - a * a).apply(ca.OP_SQRT)))),
    function(ca.OP_ATAN, "atan", slopes(lambda a, r: 1 / (1 + a * a))),
    function(
        ca.OP_ATAN2,
        "atan2",
        slopes(lambda a, b, r: quotient_or_zero(b, a * a + b * b), lambda a, b, r: -quotient_or_zero(a, a * a + b * b)),
        number_from_same_unit("takes the angle of"),
        arity=2,
    ),
    # ---- hyperbolic functions
    function(ca.OP_SINH, "sinh", slopes(lambda a, r: a.apply(ca.OP_COSH)), latex=r"\sinh\left({0}\right)"),
    function(ca.OP_COSH, "cosh", slopes(lambda a, r: a.apply(ca.OP_SINH)), latex=r"\cosh\left({0}\right)"),
    function(ca.OP_TANH, "tanh", slopes(lambda a, r: 1 - r * r), latex=r"\tanh\left({0}\right)"),
    function(ca.OP_ASINH, "asinh", slopes(lambda a, r: 1 / (1 + a * a).apply(ca.OP_SQRT)), modelica=""),
    function(ca.OP_ACOSH, "acosh", slopes(lambda a, r: 1 / (a * a - 1).apply(ca.OP_SQRT)), modelica=""),
    function(ca.OP_ATANH, "atanh", slopes(lambda a, r: 1 / (1 - a * a)), modelica=""),
    # ---- error function
    function(
        ca.OP_ERF,
        "erf",
        slopes(lambda a, r: 2 / math.sqrt(math.pi) * (-(a * a)).apply(ca.OP_EXP)),
        numpy="",
        modelica="",
    ),
    function(
        ca.OP_ERFINV,
        "erfinv",
        slopes(lambda a, r: math.sqrt(math.pi) / 2 * (r * r).apply(ca.OP_EXP)),
        c="",
        numpy="",
        modelica="",
    ),
    # ---- functions of two numbers
    function(
        ca.OP_HYPOT,
        "hypot",
        slopes(lambda a, b, r: quotient_or_zero(a, r), lambda a, b, r: quotient_or_zero(b, r)),
        same_unit("takes the length of"),
        arity=2,
        modelica="sqrt(({0})^2 + ({1})^2)",
        commutative=True,
    ),
    function(
        ca.OP_FMOD,
        "fmod",
        slopes(lambda a, b, r: 1.0, lambda a, b, r: (r - a) / b),
        same_unit("takes the remainder of"),
        arity=2,
        modelica="rem({0}, {1})",
    ),
    function(
        ca.OP_REMAINDER,
        "remainder",
        slopes(lambda a, b, r: 1.0, lambda a, b, r: (r - a) / b),
        same_unit("takes the remainder of"),
        arity=2,
        numpy="",
        modelica="",
    ),
    function(
        ca.OP_COPYSIGN,
        "copysign",
        slopes(lambda a, b, r: a.apply(ca.OP_SIGN) * r.apply(ca.OP_SIGN), lambda a, b, r: 0.0),
        keep_unit,
        arity=2,
        modelica="",
    ),
)

OPERATIONS: dict[int, Operation] = {row.code: row for row in ROWS}


def operation_name(code: int) -> str:
    """CasADi's name of an operation's number: ``OP_SINH``."""
    return next((name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == code), "unknown")
