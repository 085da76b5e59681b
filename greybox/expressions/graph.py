"""One walk over the graph of a CasADi expression, for everything that reads equations: units, text, structure."""

from __future__ import annotations

from collections.abc import Callable
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
    """The value of a scalar ``expression``, found from the leaves upwards, each shared node once, without recursion.

    ``leaf(name)`` is the value of a symbol, ``constant(number)`` that of a number, ``combine(node, values)`` that of an
    operation, ``node.op()`` being its code (``casadi.OP_ADD`` ...) and ``values`` those of its operands.
    Raises ModelError for a vector.
    """
    root = ca.SX(expression)
    if root.numel() != 1:
        raise ModelError(f"{root} has {root.size1()} rows and {root.size2()} columns; an equation's term is one number")
    if root.nnz() == 0:  # a zero that is not stored
        return constant(0.0)
    found: dict[int, T] = {}
    # The root keeps every node alive, so the address of a node is its identity.
    stack: list[tuple[ca.SX, int, list[ca.SX] | None]] = [(root, root.element_hash(), None)]
    while stack:
        node, key, operands = stack.pop()
        if operands is not None:
            found[key] = combine(node, [found[operand.element_hash()] for operand in operands])
        elif key in found:
            continue
        elif node.is_symbolic():
            found[key] = leaf(node.name())
        elif node.is_constant():
            found[key] = constant(float(node))
        else:
            operands = [node.dep(k) for k in range(node.n_dep())]
            stack.append((node, key, operands))
            stack.extend((operand, operand.element_hash(), None) for operand in reversed(operands))
    return found[root.element_hash()]
