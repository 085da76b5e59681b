"""A CasADi function as a list of scalar instructions and tangent instructions, in the order in which they can run."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import casadi as ca

from greybox.errors import GreyboxError
from greybox.expressions.derivatives import Flat, Selection
from greybox.expressions.operations import OPERATIONS, operation_name


class UnsupportedOperationError(GreyboxError):
    """A CasADi operation that a kernel cannot run."""


class Node(NamedTuple):
    """One scalar instruction. ``args`` are node numbers; for an input they are (which input, which element)."""

    op: int
    args: tuple[int, ...]
    number: float | None  # the value of a constant
    varying: bool  # changes from substep to substep; the others can be computed once


class Tangent(NamedTuple):
    """One tangent instruction: ``sum coefficient * tangent``; ``condition ? first : second``; or the tangent of an input."""

    terms: tuple[tuple[int | None, int | None], ...]  # (coefficient node or None for 1, tangent or None for none)
    condition: int | None
    source: tuple[int, int] | None
    varying: bool
    signs: tuple[float, ...] = ()  # of the terms, if not all positive


@dataclass
class Tape:
    """``order`` lists ('node' | 'tangent', number); ``outputs[i]`` the (node, tangent or None) of each element of output ``i``."""

    nodes: list[Node] = field(default_factory=list)
    tangents: list[Tangent] = field(default_factory=list)
    order: list[tuple[str, int]] = field(default_factory=list)
    outputs: list[list[tuple[int, int | None]]] = field(default_factory=list)
    _known: dict = field(default_factory=dict, repr=False)

    def constant(self, number: float) -> Scalar:
        """A number."""
        return self._node(ca.OP_CONST, (), float(number), False)

    def input(self, which: int, element: int, varying: bool) -> Scalar:
        """An element of an input."""
        return self._node(ca.OP_INPUT, (which, element), None, varying)

    def apply(self, op: int, *args: Scalar) -> Scalar:
        """An operation on scalars; the same operation on the same scalars is computed once."""
        if op == ca.OP_DIV and not args[1].varying:  # a division each substep costs more than the reciprocal once
            if args[1].number is None:
                return args[0] * self.apply(ca.OP_INV, args[1])
            if args[1].number:
                return args[0] * (1 / args[1].number)
        if op == ca.OP_MUL and args[0].number is not None and args[1].number is not None:
            return self.constant(args[0].number * args[1].number)
        if op == ca.OP_MUL and 1.0 in (args[0].number, args[1].number):
            return args[1] if args[0].number == 1.0 else args[0]
        numbers = tuple(a.index for a in args)
        if op in OPERATIONS and OPERATIONS[op].commutative:
            numbers = tuple(sorted(numbers))
        return self._node(op, numbers, None, any(a.varying for a in args))

    def tangent(self, tangent: Tangent) -> int:
        """Append a tangent instruction."""
        if tangent not in self._known:
            self.tangents.append(tangent)
            self._known[tangent] = len(self.tangents) - 1
            self.order.append(("tangent", len(self.tangents) - 1))
        return self._known[tangent]

    def keep(self, k: int) -> None:
        """Let the node ``k``, which is in the list already, run at this place."""
        node = self.nodes[k]
        self._known[(node.op, node.args, repr(node.number))] = k
        self.order.append(("node", k))

    def _node(self, op: int, args: tuple[int, ...], number: float | None, varying: bool) -> Scalar:
        key = (op, args, repr(number))
        if key not in self._known:
            self.nodes.append(Node(op, args, number, varying))
            self._known[key] = len(self.nodes) - 1
            self.order.append(("node", len(self.nodes) - 1))
        return Scalar(self, self._known[key])


class Scalar:
    """A scalar on a tape, written with the usual operators."""

    __slots__ = ("index", "tape")

    def __init__(self, tape: Tape, index: int) -> None:
        self.tape = tape
        self.index = index

    @property
    def number(self) -> float | None:
        """The value of a constant, else None."""
        return self.tape.nodes[self.index].number

    @property
    def varying(self) -> bool:
        """Whether it changes from substep to substep."""
        return self.tape.nodes[self.index].varying

    def apply(self, op: int) -> Scalar:
        """An operation with one argument."""
        return self.tape.apply(op, self)

    def gate(self, value: Scalar) -> Scalar:
        """``value`` where this scalar is not zero, else 0 (also where ``value`` is not finite)."""
        return self._with(ca.OP_IF_ELSE_ZERO, value)

    def equals(self, other: Scalar | float) -> Scalar:
        """1 where equal, else 0."""
        return self._with(ca.OP_EQ, other)

    def _with(self, op: int, other: Scalar | float, swapped: bool = False) -> Scalar:
        second = other if isinstance(other, Scalar) else self.tape.constant(other)
        return self.tape.apply(op, second, self) if swapped else self.tape.apply(op, self, second)

    def __neg__(self) -> Scalar:
        return self.apply(ca.OP_NEG)

    def __add__(self, other: Scalar | float) -> Scalar:
        return self._with(ca.OP_ADD, other)

    def __sub__(self, other: Scalar | float) -> Scalar:
        return self._with(ca.OP_SUB, other)

    def __mul__(self, other: Scalar | float) -> Scalar:
        return self._with(ca.OP_MUL, other)

    def __truediv__(self, other: Scalar | float) -> Scalar:
        return self._with(ca.OP_DIV, other)

    def __radd__(self, other: float) -> Scalar:
        return self._with(ca.OP_ADD, other, swapped=True)

    def __rsub__(self, other: float) -> Scalar:
        return self._with(ca.OP_SUB, other, swapped=True)

    def __rmul__(self, other: float) -> Scalar:
        return self._with(ca.OP_MUL, other, swapped=True)

    def __rtruediv__(self, other: float) -> Scalar:
        return self.apply(ca.OP_INV) if other == 1 else self._with(ca.OP_DIV, other, swapped=True)

    def __gt__(self, other: Scalar | float) -> Scalar:
        return self._with(ca.OP_LT, other, swapped=True)


def read_tape(
    function: ca.Function,
    *,
    active: Sequence[int] = (),
    varying: Sequence[int] = (),
    elements: Mapping[int, Collection[int]] | None = None,
) -> Tape:
    """The instructions of ``function`` with tangents carried from the ``active`` inputs.

    ``varying`` inputs change at every substep; what depends on the others alone is marked as computed once. ``elements``: active input
    -> its elements that have tangents, all of them where it is left out. Raises UnsupportedOperationError for an operation without a
    rule.
    """
    elements = elements or {}
    if not function.is_a("SXFunction"):
        function = function.expand()
    tape = Tape()
    rows_in = [function.sparsity_in(i).row() for i in range(function.n_in())]
    rows_out = [function.sparsity_out(i).row() for i in range(function.n_out())]
    tape.outputs = [[(tape.constant(0.0).index, None)] * function.size1_out(i) for i in range(function.n_out())]
    work: dict[int, tuple[Scalar, int | None]] = {}
    for k in range(function.n_instructions()):
        op, source, target = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            scalar, tangent = work[source[0]]
            tape.outputs[target[0]][rows_out[target[0]][target[1]]] = (scalar.index, tangent)
        elif op == ca.OP_CONST:
            work[target[0]] = (tape.constant(function.instruction_constant(k)), None)
        elif op == ca.OP_INPUT:
            which, element = source[0], rows_in[source[0]][source[1]]
            scalar = tape.input(which, element, which in varying)
            is_active = which in active and (which not in elements or element in elements[which])
            tangent = tape.tangent(Tangent((), None, (which, element), which in varying)) if is_active else None
            work[target[0]] = (scalar, tangent)
        elif op in (ca.OP_ASSIGN, ca.OP_LIFT):
            work[target[0]] = work[source[0]]
        else:
            work[target[0]] = _step(tape, op, [work[s] for s in source])
    return tape


def _step(tape: Tape, op: int, args: list[tuple[Scalar, int | None]]) -> tuple[Scalar, int | None]:
    """One instruction: its value and its tangent."""
    derivative = OPERATIONS[op].derivative if op in OPERATIONS else None
    if derivative is None:
        raise UnsupportedOperationError(
            f"CasADi operation number {op} ({operation_name(op)}) has no tangent rule; write the term without it"
        )
    scalars, tangents = [a[0] for a in args], [a[1] for a in args]
    result = tape.apply(op, *scalars)
    if isinstance(derivative, Flat) or all(tangent is None for tangent in tangents):
        return result, None
    if isinstance(derivative, Selection):
        return result, _pick(tape, derivative, (*scalars, result), tangents)
    terms: list[tuple[int | None, int | None]] = []
    for rule, tangent in zip(derivative.rules, tangents, strict=True):
        if tangent is None:
            continue
        slope = rule(*scalars, result)
        scalar = slope if not isinstance(slope, float) else tape.constant(slope)
        if scalar.number != 0:
            terms.append((None if scalar.number == 1 else scalar.index, tangent))
    if not terms:
        return result, None
    if len(terms) == 1 and terms[0][0] is None:
        return result, terms[0][1]
    varying = any(tape.tangents[tangent].varying or (c is not None and tape.nodes[c].varying) for c, tangent in terms)  # type: ignore[index]
    return result, tape.tangent(Tangent(tuple(terms), None, None, varying))


def _pick(tape: Tape, selection: Selection, scalars: Sequence[Scalar], tangents: list[int | None]) -> int | None:
    condition = selection.condition(*scalars)
    chosen = [None if side is None else tangents[side] for side in selection.operands]
    if chosen[0] == chosen[1]:
        return chosen[0]
    varying = condition.varying or any(tape.tangents[tangent].varying for tangent in chosen if tangent is not None)
    return tape.tangent(Tangent(tuple((None, tangent) for tangent in chosen), condition.index, None, varying))
