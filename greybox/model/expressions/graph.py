"""The graph of a CasADi expression, walked from its leaves to its root: units, text, derivatives and switches all read it here."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import casadi as ca
import numpy as np

from greybox.base import ModelError
from greybox.base.numerics import SWITCH_EDGE, SWITCH_EDGE_OF_MOVE, SWITCH_PROBE
from greybox.model.expressions.operations import OPERATIONS, Branch

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


# Kinks: where a slope differs by side, and the smooth equations on one side of it.
#
# ``|a|``, ``sign(a)``, ``min(a, b)``, ``max(a, b)`` and comparisons switch where ``a`` or ``a - b`` is zero. At a point where one of them
# is zero the derivative is that of the branch on the chosen side, found exactly by putting that branch in the place of the switch.


@dataclass
class Switches:
    """The switches in ``expressions`` of the variables ``z``, further arguments being ``parameters``."""

    expressions: ca.SX
    z: ca.SX
    parameters: Sequence[ca.SX]
    _jacobians: dict[tuple[int, ...], ca.Function] = field(default_factory=dict)

    def __post_init__(self) -> None:
        roots = [as_scalar(self.expressions[k]) for k in range(self.expressions.numel())]
        self.nodes = [node for node in nodes(roots) if count_operands(node) and _branch(node)]
        sides = [node.dep(0) for node in self.nodes]
        others = [node.dep(1) if node.n_dep() == 2 else ca.SX(0) for node in self.nodes]
        values = ca.vertcat(*[a - b for a, b in zip(sides, others, strict=True)], ca.SX(0, 1))
        sizes = ca.vertcat(*[ca.fabs(a) + ca.fabs(b) for a, b in zip(sides, others, strict=True)], ca.SX(0, 1))
        arguments = [self.z, *self.parameters]
        self._values = ca.Function("switches", arguments, [ca.densify(values), ca.densify(sizes)])
        self._moves = ca.Function("moves", arguments, [ca.densify(ca.fabs(ca.jacobian(values, self.z)))])

    def edges(self, z: np.ndarray, sizes: np.ndarray, *parameters: np.ndarray) -> np.ndarray:
        """Numbers of the switches that are at their edge at ``z`` (n,), whose entries have the given typical ``sizes`` (n,)."""
        if not self.nodes:
            return np.empty(0, int)
        value, size = (v.full().ravel() for v in self._values(z, *parameters))
        reach = np.nan_to_num(self._moves(z, *parameters).full()) @ sizes
        return np.flatnonzero(np.abs(value) <= SWITCH_EDGE * size + SWITCH_EDGE_OF_MOVE * reach)

    def jacobian(
        self, edges: np.ndarray, z: np.ndarray, direction: np.ndarray, *parameters: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Values (m,) and slopes (m, n) at ``z`` with every switch at its edge put on the side to which ``direction`` (n,) leads."""
        signs: np.ndarray = np.zeros(0)
        if len(edges):
            beside = self._values(z + SWITCH_PROBE * direction, *parameters)[0].full().ravel()[edges]
            signs = np.where(beside < 0, -1, 1)
        key = tuple(int(sign) * (int(edge) + 1) for edge, sign in zip(edges, signs, strict=True))
        if key not in self._jacobians:
            smooth = self._smooth({abs(k) - 1: 1 if k > 0 else -1 for k in key}) if key else self.expressions
            arguments = [self.z, *self.parameters]
            results = [ca.densify(smooth), ca.densify(ca.jacobian(smooth, self.z))]
            self._jacobians[key] = ca.Function("side", arguments, results)
        value, slope = self._jacobians[key](z, *parameters)
        return value.full().ravel(), slope.full()

    def _smooth(self, sides: dict[int, int]) -> ca.SX:
        """The expressions with some switches replaced by one of their branches."""
        chosen = {self.nodes[k].element_hash(): side for k, side in sides.items()}
        symbols = {s.name(): s for s in ca.symvar(self.expressions)}

        def rebuild(node: ca.SX, operands: list[ca.SX]) -> ca.SX:
            side, branch = chosen.get(node.element_hash()), _branch(node)
            if side is not None and branch is not None:
                return branch(side, operands)
            if len(operands) == 1:
                return ca.SX.unary(node.op(), operands[0])
            return ca.SX.binary(node.op(), operands[0], operands[1])

        return ca.vertcat(
            *[walk(self.expressions[k], symbols.__getitem__, ca.SX, rebuild) for k in range(self.expressions.numel())]
        )


def _branch(node: ca.SX) -> Branch | None:
    """What the node is on either side of zero; None for one that does not switch."""
    row = OPERATIONS.get(node.op())
    return row.branch if row else None
