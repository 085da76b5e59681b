"""Fewer and shorter tangent instructions: short chains are multiplied out into scalar coefficients.

A tangent instruction acts on whole blocks of lanes and its result is waited for by the next one; a product of two
coefficients is a scalar, and often one that is the same at every substep and computed once. Multiplying out is the
elimination of a vertex from the computational graph (Griewank and Walther, Evaluating Derivatives, 2008, chapter 9).
"""

from __future__ import annotations

from collections import Counter

import casadi as ca

from greybox.kernel.tape import Scalar, Tangent, Tape

Terms = dict[int, tuple[float, int | None]]  # tangent -> (sign, coefficient node or None for 1)


def simplify_tape(tape: Tape, max_terms: int = 6) -> Tape:
    """The same function with fewer tangent instructions; node numbers are kept.

    An instruction that is used once is multiplied out if it has at most ``max_terms`` terms: more of them cost more coefficients than
    they save tangents. One that is used more often is multiplied out if it has one term.
    """
    uses = Counter(k for tangent in tape.tangents for _, k in tangent.terms if k is not None)
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
            short = len(terms) == 1 or (uses[k] == 1 and len(terms) <= max_terms)
            expanded[k] = terms if short and k not in pinned else {_append_instruction(result, terms): (1.0, None)}
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
            terms[base] = _add_terms(tape, terms[base], term) if base in terms else term
    return terms


def _split_sign(tape: Tape, coefficient: int | None) -> tuple[float, int | None]:
    """A coefficient as sign and node, with leading minus signs taken off."""
    sign = 1.0
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


def _add_terms(tape: Tape, a: tuple[float, int | None], b: tuple[float, int | None]) -> tuple[float, int | None]:
    first, second = (tape.constant(1.0) if node is None else Scalar(tape, node) for _, node in (a, b))
    return a[0], (first + second if a[0] == b[0] else first - second).index


def _append_instruction(tape: Tape, terms: Terms) -> int:
    """The terms as one instruction, those that are ready first in front."""
    ordered = sorted(terms.items(), key=lambda item: (tape.tangents[item[0]].varying, item[0]))
    moving = any(tape.tangents[k].varying or (c is not None and tape.nodes[c].varying) for k, (_, c) in ordered)
    return tape.tangent(
        Tangent(tuple((c, k) for k, (_, c) in ordered), None, None, moving, tuple(s for _, (s, _) in ordered))
    )
