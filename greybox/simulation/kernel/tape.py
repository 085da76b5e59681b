"""A CasADi function as a list of scalar instructions and tangent instructions, in the order in which they can run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import casadi as ca

from greybox.base import GreyboxError
from greybox.model.expressions.operations import OPERATIONS, Flat, Selection, operation_name


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
        # Constants meet when coefficients are multiplied out: c1 * c2 and 1 * x cost nothing at run time.
        if op == ca.OP_MUL and args[0].number is not None and args[1].number is not None:
            return self.constant(args[0].number * args[1].number)
        if op == ca.OP_MUL and 1.0 in (args[0].number, args[1].number):
            return args[1] if args[0].number == 1.0 else args[0]
        numbers = tuple(a.index for a in args)
        if op in OPERATIONS and OPERATIONS[op].commutative:
            # a + b and b + a are one node.
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
        # By its text: 0.0 and -0.0 are equal and not the same.
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
            # A copy of a register is the same scalar.
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
    # 1 * tangent is the tangent itself.
    if len(terms) == 1 and terms[0][0] is None:
        return result, terms[0][1]
    varying = any(tape.tangents[tangent].varying or (c is not None and tape.nodes[c].varying) for c, tangent in terms)  # type: ignore[index]
    return result, tape.tangent(Tangent(tuple(terms), None, None, varying))


def _pick(tape: Tape, selection: Selection, scalars: Sequence[Scalar], tangents: list[int | None]) -> int | None:
    condition = selection.condition(*scalars)
    chosen = [None if side is None else tangents[side] for side in selection.operands]
    # Both sides move alike (or not at all): no choice is needed.
    if chosen[0] == chosen[1]:
        return chosen[0]
    varying = condition.varying or any(tape.tangents[tangent].varying for tangent in chosen if tangent is not None)
    return tape.tangent(Tangent(tuple((None, tangent) for tangent in chosen), condition.index, None, varying))


# Fewer and shorter tangent instructions: short chains are multiplied out into scalar coefficients.
#
# A tangent instruction acts on whole blocks of lanes and its result is waited for by the next one; a product of two
# coefficients is a scalar, and often one that is the same at every substep and computed once. Multiplying out is the
# elimination of a vertex from the computational graph (Griewank and Walther, Evaluating Derivatives, 2008, chapter 9).

Terms = dict[int, tuple[float, int | None]]  # tangent -> (sign, coefficient node or None for 1)


def simplify_tape(tape: Tape, max_terms: int = 6) -> Tape:
    """The same function with fewer tangent instructions; node numbers are kept.

    An instruction that is used once is multiplied out if it has at most ``max_terms`` terms: more of them cost more coefficients than
    they save tangents. One that is used more often is multiplied out if it has one term.
    """
    uses = Counter(k for tangent in tape.tangents for _, k in tangent.terms if k is not None)
    # Outputs and sides of a choice must be single instructions, not sums.
    pinned = {k for output in tape.outputs for _, k in output}
    pinned |= {k for tangent in tape.tangents if tangent.condition is not None for _, k in tangent.terms}
    result = Tape(nodes=list(tape.nodes))
    expanded: dict[int, Terms] = {}  # tangent of the old tape -> its terms on the new one
    for kind, k in tape.order:
        if kind == "node":
            result.keep(k)
            continue
        tangent = tape.tangents[k]
        if tangent.condition is not None:
            sides = tuple((c, None if side is None else _only(expanded[side])) for c, side in tangent.terms)
            expanded[k] = {result.tangent(tangent._replace(terms=sides)): (1.0, None)}
        elif tangent.source is not None:
            expanded[k] = {result.tangent(tangent): (1.0, None)}
        else:
            terms = _multiply_out(result, tangent, expanded)
            # Elimination pays where it saves an instruction on lanes for few products of scalars; with many uses
            # each would be multiplied out again.
            short = len(terms) == 1 or (uses[k] == 1 and len(terms) <= max_terms)
            if short and k not in pinned:
                expanded[k] = terms
                continue
            # A sum begins with what is computed once, then follows the tape: the last term is the one that is waited for.
            ordered = sorted(terms.items(), key=lambda item: (result.tangents[item[0]].varying, item[0]))
            moving = any(
                result.tangents[t].varying or (c is not None and result.nodes[c].varying) for t, (_, c) in ordered
            )
            whole = Tangent(
                tuple((c, t) for t, (_, c) in ordered), None, None, moving, tuple(s for _, (s, _) in ordered)
            )
            expanded[k] = {result.tangent(whole): (1.0, None)}
    result.outputs = [[(n, None if k is None else _only(expanded[k])) for n, k in output] for output in tape.outputs]
    return result


def _only(terms: Terms) -> int:
    return next(iter(terms))


def _multiply_out(tape: Tape, tangent: Tangent, expanded: dict[int, Terms]) -> Terms:
    """The terms of ``tangent`` with the terms of its sources in their place."""
    terms: Terms = {}
    for coefficient, source in tangent.terms:
        assert source is not None  # only a choice has a side without tangent
        outer = _split_sign(tape, coefficient)
        for base, inner in expanded[source].items():
            term = _product(tape, outer, inner)
            if base in terms:
                sign, node = terms[base]
                first, second = (tape.constant(1.0) if n is None else Scalar(tape, n) for n in (node, term[1]))
                # s1 a + s2 b = s1 (a + s1 s2 b): the sign of the first stays outside.
                term = sign, (first + second if sign == term[0] else first - second).index
            terms[base] = term
    return terms


def _split_sign(tape: Tape, coefficient: int | None) -> tuple[float, int | None]:
    """A coefficient as sign and node, with leading minus signs taken off."""
    sign = 1.0
    # Signs go to the term, where adding becomes subtracting for nothing: -(-a) costs no instruction.
    while coefficient is not None and tape.nodes[coefficient].op == ca.OP_NEG:
        sign, coefficient = -sign, tape.nodes[coefficient].args[0]
    if coefficient is not None and tape.nodes[coefficient].number in (1.0, -1.0):
        return sign * tape.nodes[coefficient].number, None  # type: ignore[operator]
    return sign, coefficient


def _product(tape: Tape, a: tuple[float, int | None], b: tuple[float, int | None]) -> tuple[float, int | None]:
    if a[1] is None or b[1] is None:
        return a[0] * b[0], a[1] if b[1] is None else b[1]
    sign, node = _split_sign(tape, (Scalar(tape, a[1]) * Scalar(tape, b[1])).index)
    return a[0] * b[0] * sign, node


# Products and sums of a tape as fused multiply-adds, so that every engine rounds at the same places.
#
# A C compiler that may contract ``a * b + c`` chooses by itself where it does, and its choice differs from function to function. Here the
# choice is part of the tape: the compiled kernel and the tape machine then give the same bits, and a search may change from one to the
# other at any moment.

FMA, FMS, FNMA = -1, -2, -3
"""``a * b + c``, ``a * b - c`` and ``c - a * b``, rounded once."""

Term = tuple[float, int | None, int]  # sign, coefficient node or None for 1, tangent


def fuse_products(tape: Tape) -> Tape:
    """The same function with sums of products fused; node numbers are kept, and nodes that nobody needs any more do not run."""
    result = Tape([_fuse(tape, node) for node in tape.nodes], list(tape.tangents), [], list(tape.outputs))
    nodes, tangents = find_needed(result)
    result.order = [(kind, k) for kind, k in tape.order if k in (nodes if kind == "node" else tangents)]
    return result


def order_terms(tangent: Tangent) -> list[Term]:
    """The terms of a sum in the order in which they are added up: one without a coefficient first, the others as fused multiply-adds."""
    signs = tangent.signs or (1.0,) * len(tangent.terms)
    terms = [
        (sign, coefficient, k) for sign, (coefficient, k) in zip(signs, tangent.terms, strict=True) if k is not None
    ]
    # Every engine adds in this order, which is thereby the order of rounding.
    first = next((i for i, (sign, coefficient, _) in enumerate(terms) if coefficient is None and sign > 0), 0)
    return [terms[first], *terms[:first], *terms[first + 1 :]]


def _fuse(tape: Tape, node: Node) -> Node:
    if node.op not in (ca.OP_ADD, ca.OP_SUB):
        return node
    # The later of two products is the one that waits for more.
    for place in sorted((0, 1), key=lambda i: -node.args[i]):
        product = tape.nodes[node.args[place]]
        # Both in the same part: a product that is computed once stays out of the sum that is not.
        if product.op in (ca.OP_MUL, ca.OP_SQ) and product.varying == node.varying:
            a, b = product.args if product.op == ca.OP_MUL else product.args * 2
            # a b + c; of a difference the product may stand in front (a b - c) or behind (c - a b).
            op = FMA if node.op == ca.OP_ADD else (FMS, FNMA)[place]
            return Node(op, (a, b, node.args[1 - place]), None, node.varying)
    return node


def find_needed(tape: Tape, with_tangents: bool = True) -> tuple[set[int], set[int]]:
    """The nodes and the tangents from which an output, or its tangent, comes."""
    nodes: set[int] = set()
    tangents: set[int] = set()
    # Backwards from the outputs; tangents first, because their coefficients are nodes.
    waiting = [k for output in tape.outputs for _, k in output if k is not None] if with_tangents else []
    sources = [node for output in tape.outputs for node, _ in output]
    while waiting:
        k = waiting.pop()
        if k in tangents:
            continue
        tangents.add(k)
        tangent = tape.tangents[k]
        waiting += [side for _, side in tangent.terms if side is not None]
        sources += [c for c, _ in tangent.terms if c is not None]
        sources += [] if tangent.condition is None else [tangent.condition]
    while sources:
        k = sources.pop()
        if k not in nodes:
            nodes.add(k)
            sources += () if tape.nodes[k].op == ca.OP_INPUT else tape.nodes[k].args
    return nodes, tangents
