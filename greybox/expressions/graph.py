"""The graph of a CasADi expression, walked from its leaves to its root: units, text, derivatives and switches all read it here."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator
from typing import TypeVar

import casadi as ca

from greybox.errors import ModelError

T = TypeVar("T")


def walk(
    expression: ca.SX | float,
    leaf: Callable[[str], T],
    constant: Callable[[float], T],
    combine: Callable[[ca.SX, list[T]], T],
) -> T:
    """The value of a scalar expression, computed from its leaves upwards, each shared node once.

    Parameters
    ----------
    expression
        A scalar CasADi expression, or a number.
    leaf
        The value of a symbol, from its name.
    constant
        The value of a number.
    combine
        The value of an operation, from its node (``node.op()`` is the code: ``casadi.OP_ADD`` ...) and the values of its operands.

    Raises
    ------
    ModelError
        The expression is a vector or a matrix.

    Examples
    --------
    How many symbols an expression contains:

    >>> x, y = ca.SX.sym("x"), ca.SX.sym("y")
    >>> walk(x * y + 1, lambda name: 1, lambda number: 0, lambda node, counts: sum(counts))
    2
    """
    root = as_scalar(expression)
    values: dict[int, T] = {}
    for node in nodes([root]):
        if node.is_symbolic():
            value = leaf(node.name())
        elif node.is_constant():
            value = constant(float(node))
        else:
            value = combine(node, [values[node.dep(k).element_hash()] for k in range(node.n_dep())])
        values[node.element_hash()] = value
    return values[root.element_hash()]


def nodes(roots: Iterable[ca.SX], known: Container[int] = ()) -> Iterator[ca.SX]:
    """The nodes of some scalar expressions, each once and its operands before it, without those whose hash is ``known``.

    A node is identified by ``element_hash()``, its address: keep the expressions alive for as long as hashes are compared.
    """
    visited: set[int] = set()
    stack = [(root, False) for root in reversed(list(roots))]
    while stack:
        node, operands_done = stack.pop()
        key = node.element_hash()
        if operands_done:
            yield node
        elif key not in visited and key not in known:
            visited.add(key)
            stack.append((node, True))
            stack += [(node.dep(k), False) for k in reversed(range(count_operands(node)))]


def as_scalar(expression: ca.SX | float) -> ca.SX:
    """The expression as one stored CasADi element. Raises ModelError for a vector or a matrix."""
    scalar = ca.SX(expression)
    if scalar.numel() != 1:
        raise ModelError(
            f"{scalar} has {scalar.size1()} rows and {scalar.size2()} columns; a term of an equation is one number"
        )
    return ca.densify(scalar)


def count_operands(node: ca.SX) -> int:
    """How many operands a node has: none for a symbol or a number."""
    return 0 if node.is_constant() or node.is_symbolic() else node.n_dep()
