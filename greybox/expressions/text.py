"""An expression as a person writes it: ``Kf (1 - a x^2) i``, ``-Ra i``, ``sqrt(2 g h)``."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import NamedTuple

import casadi as ca

from greybox.expressions.graph import walk

Factors = dict[str, float]  # text that stands for itself (a name, a call, a bracket) -> exponent


class Product(NamedTuple):
    """``number factors / (divisor divisors)`` with its sign; ``choice`` is (condition, value) of half an if."""

    negative: bool
    number: float
    factors: Factors
    divisor: float
    divisors: Factors
    choice: tuple[str, str] | None = None


Sum = tuple[Product, ...]

MATHEMATICAL: tuple[str, ...] = ("exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")
MATHEMATICAL += ("asinh", "acosh", "atanh", "erf", "erfinv", "log1p", "expm1", "floor", "ceil")
OTHERS = ("sqrt", "sign", "atan2", "hypot", "fmod", "remainder", "copysign")
FUNCTIONS = {getattr(ca, f"OP_{name.upper()}"): name for name in (*MATHEMATICAL, *OTHERS)}
FUNCTIONS |= {ca.OP_FMIN: "min", ca.OP_FMAX: "max"}
COMPARISONS = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!=", ca.OP_AND: "and", ca.OP_OR: "or"}
NUMBER = re.compile(r"-?[\d.]+(e-?\d+)?")
MIRRORED = {"<": ">", "<=": ">=", "==": "==", "!=": "!="}


def expression_text(value: ca.SX | float) -> str:
    """A scalar CasADi expression as text: ``Kf (1 - a x^2) i``, ``|v|``, ``if(condition, a, b)``, fewest brackets."""
    return _sum_text(_parsed(value))


def signed_text(value: ca.SX | float) -> tuple[bool, str]:
    """Whether a minus stands in front, and the text behind it; a sum of several is put in brackets."""
    terms = _parsed(value)
    if len(terms) == 1:
        return terms[0].negative, _product_text(terms[0])
    return False, f"({_sum_text(terms)})"


def number_text(value: float) -> str:
    """Six digits at most: ``0.2691``, ``1e-9``, ``inf``."""
    mantissa, mark, exponent = f"{value:.6g}".partition("e")
    return f"{mantissa}e{int(exponent)}" if mark else mantissa


def _parsed(value: ca.SX | float) -> Sum:
    return walk(value, lambda name: (_atom(name),), lambda x: (_constant(x),), _combined)


def _atom(text: str) -> Product:
    return Product(False, 1.0, {text: 1.0}, 1.0, {})


def _constant(value: float) -> Product:
    return Product(value < 0, abs(value), {}, 1.0, {})


def _combined(node: ca.SX, values: list[Sum]) -> Sum:
    op = node.op()
    if op in OPERATIONS:
        return OPERATIONS[op](values)
    if op == ca.OP_MUL and _is_log10(node):
        return (_atom(f"log10({expression_text(node.dep(1).dep(0))})"),)
    if op == ca.OP_MUL:
        return (_times(_single(values[0]), _single(values[1])),)
    if op in (ca.OP_POW, ca.OP_CONSTPOW):
        return (_power(node, values),)
    operands = [_operand(value) for value in values]
    if op in COMPARISONS:
        return (_atom(f"({_comparison(COMPARISONS[op], *operands)})"),)
    if op == ca.OP_NOT:
        return (_atom(f"(not {operands[0]})"),)
    texts = [_sum_text(value) for value in values]
    if op == ca.OP_FABS:
        return (_atom(f"abs({texts[0]})" if "|" in texts[0] else f"|{texts[0]}|"),)
    if op == ca.OP_IF_ELSE_ZERO:
        return (_atom(f"if({texts[0]}, {texts[1]}, 0)")._replace(choice=(operands[0], texts[1])),)
    return (_atom(f"{FUNCTIONS.get(op, f'operation{op}')}({', '.join(texts)})"),)


def _add(values: list[Sum]) -> Sum:
    first, second = values
    if len(first) == len(second) == 1 and first[0].choice and second[0].choice:
        condition, value = first[0].choice
        other, alternative = second[0].choice
        if other == f"(not {condition})":  # the two halves of one if_else
            return (_atom(f"if({_bare(condition)}, {value}, {alternative})"),)
    return first + second


def _negated(value: Sum) -> Sum:
    product = _single(value)
    return (product._replace(negative=not product.negative, choice=None),)


def _inverted(product: Product) -> Product:
    return Product(product.negative, product.divisor, product.divisors, product.number, product.factors)


def _times(first: Product, second: Product) -> Product:
    return Product(
        first.negative != second.negative,
        first.number * second.number,
        _merged(first.factors, second.factors),
        first.divisor * second.divisor,
        _merged(first.divisors, second.divisors),
    )


def _squared(value: Sum) -> Sum:
    return (_raised(_single(value), 2.0),)


def _raised(product: Product, exponent: float) -> Product:
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


def _merged(first: Factors, second: Factors) -> Factors:
    merged = dict(first)
    for text, exponent in second.items():
        merged[text] = merged.get(text, 0.0) + exponent
    return merged


def _single(value: Sum) -> Product:
    return value[0] if len(value) == 1 else _atom(f"({_sum_text(value)})")


OPERATIONS: dict[int, Callable[[list[Sum]], Sum]] = {
    ca.OP_ADD: _add,
    ca.OP_SUB: lambda values: values[0] + _negated(values[1]),
    ca.OP_NEG: lambda values: _negated(values[0]),
    ca.OP_DIV: lambda values: (_times(_single(values[0]), _inverted(_single(values[1]))),),
    ca.OP_INV: lambda values: (_inverted(_single(values[0])),),
    ca.OP_TWICE: lambda values: (_times(_constant(2.0), _single(values[0])),),
    ca.OP_SQ: lambda values: _squared(values[0]),
}


def _power(node: ca.SX, values: list[Sum]) -> Product:
    exponent = node.dep(1)
    if exponent.is_constant() and math.isfinite(float(exponent)):
        power = float(exponent)
        raised = _raised(_single(values[0]), abs(power))
        return _inverted(raised) if power < 0 else raised
    base, power_text = map(_beside_caret, values)
    return _atom(f"({base}^{power_text})")


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


def _comparison(sign: str, left: str, right: str) -> str:
    if sign in MIRRORED and NUMBER.fullmatch(left):  # CasADi turns x > 0 into 0 < x
        return f"{right} {MIRRORED[sign]} {left}"
    return f"{left} {sign} {right}"


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
