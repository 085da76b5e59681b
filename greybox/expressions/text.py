"""Expressions as a person writes them: ``Kf (1 - a x^2) i``, ``-Ra i``, ``sqrt(2 g h)``, with the fewest brackets."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

import casadi as ca

from greybox.expressions.operations import OPERATIONS, Operation, operation_name
from greybox.expressions.printer import Dialect

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
            return (_atom(_relation(row, [_operand(operand) for operand in operands])),)
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


def _relation(row: Operation, operands: Sequence[str]) -> str:
    """A comparison, ``and``, ``or`` or ``not``; CasADi turns ``x > 0`` into ``0 < x``, which is turned back."""
    if row.name in MIRRORED and NUMBER.fullmatch(operands[0]):
        return f"({operands[1]} {MIRRORED[row.name]} {operands[0]})"
    return row.text.format(*operands)


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
