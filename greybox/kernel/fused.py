"""Products and sums of a tape as fused multiply-adds, so that every engine rounds at the same places.

A C compiler that may contract ``a * b + c`` chooses by itself where it does, and its choice differs from function to function. Here the
choice is part of the tape: the compiled kernel and the tape machine then give the same bits, and a search may change from one to the other
at any moment.
"""

from __future__ import annotations

from collections.abc import Iterable

import casadi as ca

from greybox.kernel.tape import Node, Tangent, Tape

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
    first = next((i for i, (sign, coefficient, _) in enumerate(terms) if coefficient is None and sign > 0), 0)
    return [terms[first], *terms[:first], *terms[first + 1 :]]


def _fuse(tape: Tape, node: Node) -> Node:
    if node.op not in (ca.OP_ADD, ca.OP_SUB):
        return node
    # The later of two products is the one that waits for more.
    for place in sorted((0, 1), key=lambda i: -node.args[i]):
        product = tape.nodes[node.args[place]]
        if product.op in (ca.OP_MUL, ca.OP_SQ) and product.varying == node.varying:
            a, b = product.args if product.op == ca.OP_MUL else product.args * 2
            op = FMA if node.op == ca.OP_ADD else (FMS, FNMA)[place]
            return Node(op, (a, b, node.args[1 - place]), None, node.varying)
    return node


def find_needed(tape: Tape, with_tangents: bool = True) -> tuple[set[int], set[int]]:
    """The nodes and the tangents from which an output, or its tangent, comes."""
    nodes: set[int] = set()
    tangents: set[int] = set()
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
            sources += _arguments(tape.nodes[k])
    return nodes, tangents


def _arguments(node: Node) -> Iterable[int]:
    return () if node.op == ca.OP_INPUT else node.args
