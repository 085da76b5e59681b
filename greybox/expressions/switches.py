"""Kinks: where a slope differs by side, and the smooth equations on one side of it.

``|a|``, ``sign(a)``, ``min(a, b)``, ``max(a, b)`` and comparisons switch where ``a`` or ``a - b`` is zero. At a point where one of them
is zero the derivative is that of the branch on the chosen side, found exactly by putting that branch in the place of the switch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from greybox.expressions.graph import walk

ONE_ARGUMENT = (ca.OP_FABS, ca.OP_SIGN)
TWO_ARGUMENTS = (ca.OP_FMIN, ca.OP_FMAX, ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE)
# A switch is at its edge when it is this near to zero, relative to what it compares, and to its change over a typical move.
NEAR, NEAR_OF_MOVE = 1e-11, 1e-13
# How far beside the point, relative to the variables, a side is told from the other.
BESIDE = 1e-6


@dataclass
class Switches:
    """The switches in ``expressions`` of the variables ``z``, further arguments being ``parameters``."""

    expressions: ca.SX
    z: ca.SX
    parameters: Sequence[ca.SX]
    _jacobians: dict[tuple[int, ...], ca.Function] = field(default_factory=dict)

    def __post_init__(self) -> None:
        nodes: dict[int, ca.SX] = {}

        def collect(node: ca.SX, operands: list[None]) -> None:
            if node.op() in (*ONE_ARGUMENT, *TWO_ARGUMENTS):
                nodes.setdefault(node.element_hash(), node)

        for k in range(self.expressions.numel()):
            walk(self.expressions[k], lambda _: None, lambda _: None, collect)
        self.nodes = list(nodes.values())
        sides = [node.dep(0) for node in self.nodes]
        others = [node.dep(1) if node.op() in TWO_ARGUMENTS else ca.SX(0) for node in self.nodes]
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
        return np.flatnonzero(np.abs(value) <= NEAR * size + NEAR_OF_MOVE * reach)

    def jacobian(
        self, edges: np.ndarray, z: np.ndarray, direction: np.ndarray, *parameters: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Values (m,) and slopes (m, n) at ``z`` with every switch at its edge put on the side to which ``direction`` (n,) leads."""
        signs = np.zeros(0)
        if len(edges):
            beside = self._values(z + BESIDE * direction, *parameters)[0].full().ravel()[edges]
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

        def rebuilt(node: ca.SX, operands: list[ca.SX]) -> ca.SX:
            side = chosen.get(node.element_hash())
            if side is not None:
                return _branch(node.op(), side, operands)
            if len(operands) == 1:
                return ca.SX.unary(node.op(), operands[0])
            return ca.SX.binary(node.op(), operands[0], operands[1])

        return ca.vertcat(
            *[walk(self.expressions[k], symbols.__getitem__, ca.SX, rebuilt) for k in range(self.expressions.numel())]
        )


def _branch(op: int, side: int, operands: list[ca.SX]) -> ca.SX:
    """What an operation is where its switch is above (``side`` 1) or below (-1) zero."""
    if op == ca.OP_FABS:
        return side * operands[0]
    if op == ca.OP_SIGN:
        return ca.SX(side)
    if op in (ca.OP_FMIN, ca.OP_FMAX):
        return operands[1] if (op == ca.OP_FMIN) == (side > 0) else operands[0]
    return ca.SX({ca.OP_LT: side < 0, ca.OP_LE: side < 0, ca.OP_EQ: False, ca.OP_NE: True}[op])
