"""Kinks: where a slope differs by side, and the smooth equations on one side of it.

``|a|``, ``sign(a)``, ``min(a, b)``, ``max(a, b)`` and comparisons switch where ``a`` or ``a - b`` is zero. At a point where one of them
is zero the derivative is that of the branch on the chosen side, found exactly by putting that branch in the place of the switch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from greybox.expressions.graph import as_scalar, count_operands, nodes, walk
from greybox.expressions.operations import OPERATIONS, Branch
from greybox.numerics import SWITCH_EDGE, SWITCH_EDGE_OF_MOVE, SWITCH_PROBE


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
        signs = np.zeros(0)
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
