"""Expressions as a person writes them: ``Kf (1 - a x^2) i``, ``-Ra i``, ``sqrt(2 g h)``, with the fewest brackets."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import casadi as ca

from greybox.base.errors import GreyboxError, ModelError, nearest
from greybox.base.units import ONE, Unit, parse_unit, unit_name
from greybox.model.expressions.graph import walk
from greybox.model.expressions.operations import (
    OPERATIONS,
    Binding,
    Operands,
    Operation,
    UnitMismatchError,
    operation_name,
)
from greybox.model.expressions.printer import FORMULA, CodeDialect, Dialect, Printed

Factors = dict[str, float]  # text that stands for itself (a name, a call, a bracket) -> exponent

NUMBER = re.compile(r"-?[\d.]+(e-?\d+)?")
MIRRORED = {"<": ">", "<=": ">=", "==": "==", "!=": "!="}


class Product(NamedTuple):
    """``number factors / (divisor divisors)`` with its sign; ``choice`` is (condition, value) of half an if."""

    negative: bool
    number: float
    factors: Factors
    divisor: float
    divisors: Factors
    choice: tuple[str, str] | None = None


Sum = tuple[Product, ...]


class TextDialect(Dialect[Sum]):
    """Equations for people: numbers, factors and powers of a product are collected before it is written."""

    def symbol(self, name: str) -> Sum:
        """The name as it is."""
        return (_atom(name),)

    def number(self, value: float) -> Sum:
        """A product that is a number."""
        return (_constant(value),)

    def operation(self, node: ca.SX, operands: Sequence[Sum]) -> Sum:
        """A sum of products; what is neither stands as a factor of its own."""
        code = node.op()
        if code in ARITHMETIC:
            return ARITHMETIC[code](*operands)
        if code == ca.OP_MUL and _is_log10(node):
            return (_atom(f"log10({expression_text(node.dep(1).dep(0))})"),)
        if code == ca.OP_MUL:
            return (_multiply(_single(operands[0]), _single(operands[1])),)
        if code in (ca.OP_POW, ca.OP_CONSTPOW):
            return (_power(node, *operands),)
        texts = [_sum_text(operand) for operand in operands]
        if code == ca.OP_IF_ELSE_ZERO:
            return (_atom(f"if({texts[0]}, {texts[1]}, 0)")._replace(choice=(_operand(operands[0]), texts[1])),)
        if code == ca.OP_FABS and "|" not in texts[0]:
            return (_atom(f"|{texts[0]}|"),)
        row = OPERATIONS.get(code)
        if row is None or not row.text:
            return (_atom(f"{operation_name(code)}({', '.join(texts)})"),)
        if row.logical:
            one, *other = [_operand(operand) for operand in operands]
            # CasADi turns ``x > 0`` into ``0 < x``: turned back.
            turned = row.name in MIRRORED and NUMBER.fullmatch(one)
            return (_atom(f"({other[0]} {MIRRORED[row.name]} {one})" if turned else row.text.format(one, *other)),)
        return (_atom(row.text.format(*texts)),)


TEXT = TextDialect()


def expression_text(value: ca.SX | float) -> str:
    """A scalar CasADi expression as text: ``Kf (1 - a x^2) i``, ``|v|``, ``if(condition, a, b)``.

    >>> x, k = ca.SX.sym("x"), ca.SX.sym("k")
    >>> expression_text(-k * x * (1 + x**2))
    '-k x (1 + x^2)'
    """
    return _sum_text(_write(value))


def signed_text(value: ca.SX | float) -> tuple[bool, str]:
    """Whether a minus stands in front, and the text behind it; a sum of several terms is put in brackets."""
    terms = _write(value)
    if len(terms) == 1:
        return terms[0].negative, _product_text(terms[0])
    return False, f"({_sum_text(terms)})"


def number_text(value: float) -> str:
    """Six digits at most: ``0.2691``, ``1e-9``, ``inf``."""
    mantissa, mark, exponent = f"{value:.6g}".partition("e")
    return f"{mantissa}e{int(exponent)}" if mark else mantissa


def _write(value: ca.SX | float) -> Sum:
    return TEXT.write(value)


def _atom(text: str) -> Product:
    return Product(False, 1.0, {text: 1.0}, 1.0, {})


def _constant(value: float) -> Product:
    return Product(value < 0, abs(value), {}, 1.0, {})


def _add(first: Sum, second: Sum) -> Sum:
    if len(first) == len(second) == 1 and first[0].choice and second[0].choice:
        condition, value = first[0].choice
        other, alternative = second[0].choice
        if other == f"(not {condition})":  # the two halves of one if_else
            return (_atom(f"if({_bare(condition)}, {value}, {alternative})"),)
    return first + second


def _negate(value: Sum) -> Sum:
    product = _single(value)
    return (product._replace(negative=not product.negative, choice=None),)


def _invert(product: Product) -> Product:
    return Product(product.negative, product.divisor, product.divisors, product.number, product.factors)


def _multiply(first: Product, second: Product) -> Product:
    return Product(
        first.negative != second.negative,
        first.number * second.number,
        _add_exponents(first.factors, second.factors),
        first.divisor * second.divisor,
        _add_exponents(first.divisors, second.divisors),
    )


def _raise_to(product: Product, exponent: float) -> Product:
    """A power with a positive number for exponent; only a lone factor takes it on itself."""
    lone = (
        len(product.factors) == 1
        and product.number == product.divisor == 1
        and not product.divisors
        and not product.negative
    )
    inner = next(iter(product.factors.values()), 1.0)
    # (x^2)^0.5 is |x|, not x: exponents multiply only where both are whole.
    if lone and (inner == 1 or (inner.is_integer() and exponent.is_integer())):
        return _atom("")._replace(factors=dict.fromkeys(product.factors, inner * exponent))
    return Product(False, 1.0, {f"({_sum_text((product,))})": exponent}, 1.0, {})


def _add_exponents(first: Factors, second: Factors) -> Factors:
    merged = dict(first)
    for text, exponent in second.items():
        merged[text] = merged.get(text, 0.0) + exponent
    return merged


def _single(value: Sum) -> Product:
    return value[0] if len(value) == 1 else _atom(f"({_sum_text(value)})")


# What collects terms and factors instead of filling a template.
ARITHMETIC: dict[int, Callable[..., Sum]] = {
    ca.OP_ADD: _add,
    ca.OP_SUB: lambda first, second: first + _negate(second),
    ca.OP_NEG: _negate,
    ca.OP_DIV: lambda first, second: (_multiply(_single(first), _invert(_single(second))),),
    ca.OP_INV: lambda value: (_invert(_single(value)),),
    ca.OP_TWICE: lambda value: (_multiply(_constant(2.0), _single(value)),),
    ca.OP_SQ: lambda value: (_raise_to(_single(value), 2.0),),
}


def _power(node: ca.SX, base: Sum, exponent: Sum) -> Product:
    constant = node.dep(1)
    if constant.is_constant() and math.isfinite(float(constant)):
        power = float(constant)
        raised = _raise_to(_single(base), abs(power))
        return _invert(raised) if power < 0 else raised
    return _atom(f"({_beside_caret(base)}^{_beside_caret(exponent)})")


def _beside_caret(value: Sum) -> str:
    return _product_text(value[0]) if _stands_alone(value) else f"({_sum_text(value)})"


def _stands_alone(value: Sum) -> bool:
    """Whether the text is a name, a number, a call or a bracket, which needs no brackets beside ``^``."""
    if len(value) > 1 or value[0].negative or value[0].divisors or value[0].divisor != 1:
        return False
    exponents = list(value[0].factors.values())
    return not exponents or (exponents == [1.0] and value[0].number == 1)


def _is_log10(node: ca.SX) -> bool:
    factor, inner = node.dep(0), node.dep(1)
    return (
        factor.is_constant() and inner.is_op(ca.OP_LOG) and math.isclose(float(factor), 1 / math.log(10), rel_tol=1e-14)
    )


def _operand(value: Sum) -> str:
    """Beside a comparison, ``and`` or ``not``: brackets stay around a comparison, a sum needs none."""
    return _product_text(value[0]) if len(value) == 1 and not value[0].negative else _sum_text(value)


def _bare(text: str) -> str:
    """A text without the one pair of brackets around the whole of it."""
    depth = 0
    for k, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth == 0:
            return text[1:-1] if k == len(text) - 1 and text[0] == "(" else text
    return text


def _sum_text(value: Sum) -> str:
    if len(value) == 1 and not value[0].negative:
        return _bare(_product_text(value[0]))
    text = ("-" if value[0].negative else "") + _product_text(value[0])
    for term in value[1:]:
        text += (" - " if term.negative else " + ") + _product_text(term)
    return text


def _product_text(product: Product) -> str:
    """The product without its sign."""
    above, below = _side(product.number, product.factors), _side(product.divisor, product.divisors)
    if not below:
        return " ".join(above) or "1"
    return f"{' '.join(above) or '1'}/{below[0] if len(below) == 1 else '(' + ' '.join(below) + ')'}"


def _side(value: float, factors: Factors) -> list[str]:
    return [
        *([number_text(value)] if value != 1 else []),
        *(text if e == 1 else f"{text}^{number_text(e)}" for text, e in factors.items()),
    ]


# Expressions as LaTeX: ``Kf i - B v`` becomes ``K_{f}\,i - B\,v``, a quotient a fraction, a root a root.

LETTERS = "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau upsilon phi chi psi omega"
CAPITALS = "Gamma Delta Theta Lambda Xi Pi Sigma Phi Psi Omega"
GREEK = frozenset(f"{LETTERS} {CAPITALS}".split())
SQUARE = re.compile(r"\{([^{}]+)\}\^\{2\}$")
NAME_PARTS = re.compile(r"([A-Za-z]+?)_?(\d+|(?<=[A-Z])[a-z]+)?$")
# A fraction and an exponent hold their operands together themselves, and sums and products are typeset without regard to their order.
NEEDS = {
    ca.OP_ADD: (Binding.SUM, Binding.SUM),
    ca.OP_MUL: (Binding.PRODUCT, Binding.PRODUCT),
    ca.OP_TWICE: (Binding.PRODUCT,),
    ca.OP_DIV: (Binding.CHOICE, Binding.CHOICE),
    ca.OP_INV: (Binding.CHOICE,),
    ca.OP_POW: (Binding.ATOM, Binding.CHOICE),
    ca.OP_CONSTPOW: (Binding.ATOM, Binding.CHOICE),
}


class LatexDialect(CodeDialect):
    """LaTeX for a formula set in mathematics mode."""

    def symbol(self, name: str) -> Printed:
        """A letter with what follows it below the line."""
        return Printed(symbol_latex(name), Binding.ATOM)

    def number(self, value: float) -> Printed:
        """Six digits, a power of ten where that is shorter."""
        mantissa, mark, exponent = number_text(abs(value)).partition("e")
        text = rf"{mantissa}\cdot 10^{{{exponent}}}" if mark else mantissa.replace("inf", self.infinity)
        return self._minus(text) if value < 0 else Printed(text, Binding.PRODUCT if mark else Binding.ATOM)

    def needs(self, row: Operation) -> tuple[Binding, ...]:
        """Fewer brackets than in a program: see `NEEDS`."""
        return NEEDS.get(row.code, row.needs)

    def _fill(self, row: Operation, template: str, operands: Sequence[Printed]) -> Printed:
        if row.code == ca.OP_TWICE:
            return self._times(Printed("2", Binding.ATOM), operands[0])
        if row.code == ca.OP_MUL:
            return self._times(*operands)
        if row.code == ca.OP_ADD and operands[1].binding == Binding.SUM and operands[1].text.startswith("-"):
            return Printed(f"{operands[0].within(Binding.SUM, self.brackets)} - {operands[1].text[1:]}", Binding.SUM)
        return super()._fill(row, template, operands)

    def _times(self, first: Printed, second: Printed) -> Printed:
        left, right = first.within(Binding.PRODUCT, self.brackets), second.within(Binding.PRODUCT, self.brackets)
        square = SQUARE.match(right)
        if square and (left == square.group(1) or left.endswith(rf"\,{square.group(1)}")):  # x x^2
            base = square.group(1)
            return Printed(f"{left.removesuffix(base)}{{{base}}}^{{3}}", Binding.PRODUCT)
        between = r"\cdot " if right[0].isdigit() else r"\,"
        return Printed(left + between + right, Binding.PRODUCT)


LATEX = LatexDialect(
    "LaTeX",
    "latex",
    r"\begin{{cases}}{1} & {0} \\ {2} & \text{{otherwise}}\end{{cases}}",
    r"\infty",
    r"\text{NaN}",
    r"\left({}\right)",
)


def expression_latex(value: ca.SX | float) -> str:
    """A scalar CasADi expression as LaTeX."""
    return LATEX.write(value).text


def symbol_latex(name: str) -> str:
    r"""A name as a symbol: ``Kf`` -> ``K_{f}``, ``p1`` -> ``p_{1}``, ``tau_e`` -> ``\tau_{e}``, ``friction.Fc`` -> ``F_{c,friction}``."""
    owner, _, symbol = name.rpartition(".")
    head, _, tail = symbol.partition("_")
    if not tail and (parts := NAME_PARTS.match(head)) and head not in GREEK:
        head, tail = parts.group(1), parts.group(2) or ""
    below = ",".join(part for part in (tail, owner) if part)
    base = (
        rf"\{head}" if head in GREEK else (head if len(head) == 1 and head.isalnum() else rf"\mathrm{{{_plain(head)}}}")
    )
    return f"{base}_{{{_subscript(below)}}}" if below else base


def _subscript(text: str) -> str:
    return text if text.isalnum() and (len(text) == 1 or text.isdigit()) else rf"\mathrm{{{_plain(text)}}}"


def _plain(text: str) -> str:
    """Letters and digits as they are; what LaTeX reads as a command becomes a space."""
    return re.sub(r"[^A-Za-z0-9.,']+", r"\\,", text)


# Formulas of constants as text: ``2*Kf``, ``C0*(1 + c*(ps/p0 - 1))``. Read into expressions, and written so that they read back.

OPERATORS: dict[type[ast.operator], Callable[[ca.SX, ca.SX], ca.SX]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
}
# As people write them (abs, min, max) and as CasADi calls them (fabs, fmin, fmax).
FUNCTIONS = {
    name: row
    for row in OPERATIONS.values()
    if row.formula and row.name.isidentifier()
    for name in (row.formula.partition("(")[0], row.name)
}
REMEDY = "write it with names of parameters, numbers, + - * / ^ and brackets, as in 'Kf' or '2*Kf'"


class Values(Protocol):
    """Values by name."""

    def __contains__(self, name: str) -> bool: ...

    def __getitem__(self, name: str) -> Any: ...

    @property
    def names(self) -> list[str]:
        """Every name that can be asked for."""


def evaluate_formula(subject: str, text: str, p: Values) -> ca.SX:
    """The formula ``text`` with the values of ``p`` (symbols or numbers) for its names.

    ``subject`` begins the message of a ModelError, which is raised for text that is no formula and for an unknown name.
    """
    return _evaluate(_parse(subject, text), subject, text, p)


def list_formula_names(subject: str, text: str) -> list[str]:
    """The names that a formula contains, each once, in their order."""

    def names(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.Name | ast.Attribute):
            yield ast.unparse(node)
        else:
            for child in node.args if isinstance(node, ast.Call) else ast.iter_child_nodes(node):
                yield from names(child)

    return list(dict.fromkeys(names(_parse(subject, text))))


def format_formula(subject: str, value: ca.SX | float) -> str:
    """A CasADi expression of constants as text that `evaluate_formula` reads back.

    Raises ModelError for an operation that a formula does not have.
    """
    try:
        return FORMULA.write(value).text
    except ModelError:
        raise
    except GreyboxError:
        raise ModelError(f"{subject}: {value} cannot be written as a formula; {REMEDY}") from None


def _parse(subject: str, text: str) -> ast.expr:
    try:
        return ast.parse(text.strip().replace("^", "**"), mode="eval").body
    except (SyntaxError, ValueError):
        raise ModelError(f"{subject}: {text!r} is not a formula; {REMEDY}") from None


def _evaluate(node: ast.expr, subject: str, text: str, p: Values) -> ca.SX:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return ca.SX(node.value)
    if isinstance(node, ast.Name | ast.Attribute):  # an effect's constant may be called 'creep.K'
        name = ast.unparse(node)
        if name not in p:
            raise ModelError(f"{subject}: no parameter {name!r}; {nearest(name, p.names)}")
        return ca.SX(p[name])
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        value = _evaluate(node.operand, subject, text, p)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        left, right = (_evaluate(operand, subject, text, p) for operand in (node.left, node.right))
        return OPERATORS[type(node.op)](left, right)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        name = node.func.id
        if name not in FUNCTIONS:
            raise ModelError(f"{subject}: no function {name!r}; {nearest(name, FUNCTIONS)}")
        row = FUNCTIONS[name]
        if len(node.args) != row.arity:
            raise ModelError(f"{subject}: {text!r} gives {name} {len(node.args)} numbers; {REMEDY}")
        return ca.SX(getattr(ca, row.name)(*(_evaluate(a, subject, text, p) for a in node.args)))
    raise ModelError(f"{subject}: {ast.unparse(node)!r} in {text!r} is not part of a formula; {REMEDY}")


# The unit of an expression, from the units of its symbols.


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
