"""Transfer functions as formulas: their coefficients as sums of products of powers of the constants.

A term is a tuple of exponents, one for each parameter, with a rational factor: ``Kf Kv / (Ra M)``. Where a model divides by
anything but a product the formulas are not of this kind, and there are none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction

import casadi as ca
import numpy as np

from greybox.identifiability.policy import IDENTIFIABILITY_POLICY
from greybox.model.system import System

Polynomial = dict[tuple[int, ...], Fraction]


class _NoFormulaError(Exception):
    """The expression is not a sum of products of powers."""


def transfer_function_coefficients(system: System) -> list[Polynomial]:
    """Coefficients of ``det(s I - A)``, of the numerators of ``C adj(s I - A) B``, and ``D``; plain numbers are left out.

    Empty where there are no such formulas, or only unwieldy ones.
    """
    parts = [
        ca.jacobian(system.rhs, system.x),
        ca.jacobian(system.rhs, system.u),
        ca.jacobian(system.outputs, system.x),
        ca.jacobian(system.outputs, system.u),
    ]
    try:
        a, b, c, d = (_matrix(part, system.p) for part in parts)
        characteristic, adjugates = _leverrier(a, system.p.numel())
        result = [*characteristic]
        for m in adjugates:
            result += [entry for row in _times(_times(c, m), b) for entry in row]
        result += [entry for row in d for entry in row]
    except _NoFormulaError:
        return []
    return [poly for poly in result if poly and not _constant(poly)]


def divide(numerator: Polynomial, denominator: Polynomial) -> Polynomial | None:
    """The quotient, if the denominator is one term."""
    if len(denominator) != 1:
        return None
    ((exponents, factor),) = denominator.items()
    return {tuple(np.subtract(e, exponents).tolist()): f / factor for e, f in numerator.items()}


def logarithmic_gradient(poly: Polynomial, p: np.ndarray) -> np.ndarray:
    """``d log |poly| / d log p`` (np,) at the parameters ``p``; not finite where a divisor or the whole is zero."""
    powers = np.array(list(poly), float)
    with np.errstate(all="ignore"):
        terms = np.array([float(f) for f in poly.values()]) * np.prod(p**powers, axis=1)
        return np.asarray(terms @ powers / terms.sum())


def remove_known_factors(poly: Polynomial, known: Sequence[int]) -> Polynomial:
    """The same up to a known factor: constants in ``known`` that are in every term alike are taken out, so is the number."""
    shared = np.zeros(len(next(iter(poly))), int)
    for k in known:
        powers = {e[k] for e in poly}
        if len(powers) == 1:
            shared[k] = powers.pop()
    first = next(iter(poly.values()))
    return {tuple(np.subtract(e, shared).tolist()): f / first for e, f in poly.items()}


def format_polynomial(poly: Polynomial, names: Sequence[str]) -> str:
    """As a person writes it: ``(B + Kf Kv/Ra)/M``."""
    powers = np.array(list(poly))
    low, high = powers.min(axis=0), powers.max(axis=0)
    outside = np.where(low > 0, low, np.where(high < 0, high, 0))
    if len(poly) == 1:
        return _product(powers[0], names)
    terms = [_number(f) + _product(np.array(e) - outside, names) for e, f in poly.items()]
    total = " + ".join(terms).replace("+ -", "- ")
    return _product(outside, names, f"({total})") if outside.any() else total


def _product(powers: np.ndarray, names: Sequence[str], first: str = "") -> str:
    above = [first] if first else []
    above += [_power(n, k) for n, k in zip(names, powers, strict=True) if k > 0]
    below = [_power(n, -k) for n, k in zip(names, powers, strict=True) if k < 0]
    text = " ".join(above) or "1"
    if not below:
        return text
    return f"{text}/{below[0]}" if len(below) == 1 else f"{text}/({' '.join(below)})"


def _power(name: str, exponent: float) -> str:
    return name if exponent == 1 else f"{name}^{exponent:g}"


def _number(factor: Fraction) -> str:
    return "" if factor == 1 else "-" if factor == -1 else f"{float(factor):g} "


def _leverrier(a: list[list[Polynomial]], width: int) -> tuple[list[Polynomial], list[list[list[Polynomial]]]]:
    """Faddeev and Leverrier: coefficients of ``det(s I - A)`` and the matrices of ``adj(s I - A)``, highest power first."""
    n = len(a)
    zero = (0,) * width
    m = [[{zero: Fraction(1)} if i == j else {} for j in range(n)] for i in range(n)]
    characteristic, adjugates = [], []
    for k in range(1, n + 1):
        adjugates.append(m)
        am = _times(a, m)
        c = _scaled(_sum([am[i][i] for i in range(n)]), Fraction(-1, k))
        characteristic.append(c)
        m = [[_sum([am[i][j], c]) if i == j else am[i][j] for j in range(n)] for i in range(n)]
    return characteristic, adjugates


def _times(left: list[list[Polynomial]], right: list[list[Polynomial]]) -> list[list[Polynomial]]:
    columns = range(len(right[0]) if right else 0)
    return [[_sum([_product_of(row[k], right[k][j]) for k in range(len(right))]) for j in columns] for row in left]


def _product_of(one: Polynomial, other: Polynomial) -> Polynomial:
    result: Polynomial = {}
    for e, f in one.items():
        for g, h in other.items():
            key = tuple(x + y for x, y in zip(e, g, strict=True))
            result[key] = result.get(key, Fraction(0)) + f * h
    return _drop_zeros(result)


def _sum(parts: Sequence[Polynomial]) -> Polynomial:
    result: Polynomial = {}
    for part in parts:
        for e, f in part.items():
            result[e] = result.get(e, Fraction(0)) + f
    return _drop_zeros(result)


def _scaled(poly: Polynomial, factor: Fraction) -> Polynomial:
    return {e: f * factor for e, f in poly.items()}


def _drop_zeros(poly: Polynomial, max_terms: int = IDENTIFIABILITY_POLICY.max_terms) -> Polynomial:
    if len(poly) > max_terms:
        raise _NoFormulaError
    return {e: f for e, f in poly.items() if f}


def _constant(poly: Polynomial) -> bool:
    return not any(any(e) for e in poly)


def _matrix(part: ca.SX, p: ca.SX) -> list[list[Polynomial]]:
    """A matrix of expressions in ``p``, each as a polynomial."""
    rows, columns = part.shape
    if not rows * columns:
        return [[] for _ in range(rows)]
    flat = _read(ca.Function("entries", [p], [ca.densify(ca.vec(part))]), p.numel())
    return [[flat[i + rows * j] for j in range(columns)] for i in range(rows)]


def _read(f: ca.Function, width: int) -> list[Polynomial]:
    """The outputs of a function of one column of ``width`` symbols."""
    work: dict[int, Polynomial] = {}
    out: list[Polynomial] = [{} for _ in range(f.numel_out(0))]
    zero = (0,) * width
    for k in range(f.n_instructions()):
        kind, where, source = f.instruction_id(k), f.instruction_output(k), f.instruction_input(k)
        if kind == ca.OP_CONST:
            value = Fraction(f.instruction_constant(k))
            work[where[0]] = {zero: value} if value else {}
        elif kind == ca.OP_INPUT:
            work[where[0]] = {tuple(int(j == source[1]) for j in range(width)): Fraction(1)}
        elif kind == ca.OP_OUTPUT:
            out[where[1]] = work[source[0]]
        elif kind in _OPERATIONS:
            work[where[0]] = _OPERATIONS[kind](*(work[s] for s in source))
        else:
            raise _NoFormulaError
    return out


def _quotient(one: Polynomial, other: Polynomial) -> Polynomial:
    result = divide(one, other)
    if result is None:
        raise _NoFormulaError
    return result


def _raised(one: Polynomial, other: Polynomial) -> Polynomial:
    if not _constant(other) or len(other) > 1:
        raise _NoFormulaError
    power = next(iter(other.values()), Fraction(0))
    if power.denominator != 1 or not 0 <= power <= 6:
        raise _NoFormulaError
    result: Polynomial = {(0,) * len(next(iter(one), ())): Fraction(1)}
    for _ in range(int(power)):
        result = _product_of(result, one)
    return result


_OPERATIONS: dict[int, Callable[..., Polynomial]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: lambda a, b: _sum([a, b]),
    ca.OP_SUB: lambda a, b: _sum([a, _scaled(b, Fraction(-1))]),
    ca.OP_MUL: _product_of,
    ca.OP_DIV: _quotient,
    ca.OP_NEG: lambda a: _scaled(a, Fraction(-1)),
    ca.OP_SQ: lambda a: _product_of(a, a),
    ca.OP_TWICE: lambda a: _scaled(a, Fraction(2)),
    ca.OP_INV: lambda a: _quotient({(0,) * len(next(iter(a), ())): Fraction(1)}, a),
    ca.OP_POW: _raised,
    ca.OP_CONSTPOW: _raised,
}
