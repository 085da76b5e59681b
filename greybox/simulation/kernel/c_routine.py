"""A tape as C: what can be computed once in ``prepare_<name>``, the rest in ``<name>``, straight-line code for the
compiler.

Tangents are blocks of ``W`` lanes (vector types of GCC and Clang); a value and its tangents sit side by side, so that
the lanes run in the vector units while the scalar recursion waits for itself.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.resources import files

import casadi as ca

from greybox.model.expressions.operations import OPERATIONS, operation_name
from greybox.model.expressions.printer import c_instruction, c_literal, c_type
from greybox.simulation.kernel.tape import FMA, FMS, FNMA, Node, Tangent, Tape, UnsupportedOperationError, order_terms

FUSED = {FMA: "FMA({0}, {1}, {2})", FMS: "FMA({0}, {1}, -{2})", FNMA: "FMA(-{0}, {1}, {2})"}
CALL = re.compile(r"\b(?!sqrt|fabs|floor|ceil|copysign)[a-z]\w*\(")


def refuse_unwritable(op: int) -> None:
    """Raise UnsupportedOperationError for an operation that C does not have."""
    if op not in (ca.OP_CONST, ca.OP_INPUT, *FUSED) and not (op in OPERATIONS and OPERATIONS[op].c):
        raise UnsupportedOperationError(
            f"CasADi operation number {op} ({operation_name(op)}) cannot be written in C;"
            " write the term without it, or let the interpreted kernel run it"
        )


def read_template(name: str) -> str:
    """A C text of this package."""
    return files("greybox.simulation.kernel").joinpath(name).read_text(encoding="utf-8")


# Values that may be computed before the first tangent, in a step that calls functions such as ``tanh``: they lie in memory until then. A
# step of 700 values gains 6 % by that, a filter of 3000 takes 40 % more time.
MOST_VALUES_AHEAD = 1000


class CRoutine:
    """The C text of one tape.

    ``inputs`` are the names of its arguments; the tangents of ``x`` arrive as ``dx``. ``blocks`` is the number of
    tangent blocks, 0 for a routine without tangents.
    """

    def __init__(self, name: str, tape: Tape, inputs: Sequence[str], active: Sequence[int], blocks: int) -> None:
        self.name, self.tape, self.inputs, self.blocks = name, tape, inputs, blocks
        self.active = active if blocks else ()

    def text(self) -> str:
        """``struct <name>_once``, ``prepare_<name>`` and ``<name>``."""
        # Two parts: what does not change from substep to substep is computed where the coefficients are set, and
        # kept in a struct.
        once, each = self._statements(False), self._statements(True)
        fields = [
            f"    {self._type(n)} t{k};"
            for k, n in enumerate(self.tape.nodes)
            if n.args and n.op != ca.OP_INPUT and not n.varying
        ]
        fields += [
            f"    v d{k}_{b};"
            for k, n in enumerate(self.tape.tangents)
            if n.terms and not n.varying
            for b in range(self.blocks)
        ]
        outputs = [f"    z[{i}] = {self._value(node)};" for i, (node, _) in enumerate(self.tape.outputs[0])]
        outputs += [
            f"    dz[{i} * NB + {b}] = {'zero' if tangent is None else self._lane(tangent, b)};"
            for i, (_, tangent) in enumerate(self.tape.outputs[0])
            for b in range(self.blocks)
        ]
        # Compilers warn of arguments that no line needs, and which these are depends on the model.
        spare = [
            [f"    (void){name};" for name in ("c", *self.inputs) if not re.search(rf"\b{name}\b", "\n".join(lines))]
            for lines in (once, [*each, *outputs])
        ]
        arguments = ", ".join(
            f"const double *{name}" + (f", const vu *d{name}" if i in self.active else "")
            for i, name in enumerate(self.inputs)
        )
        results = "double *z, v *dz" if self.blocks else "double *z"
        return "\n".join(
            [
                f"struct {self.name}_once {{",
                # C has no empty struct.
                *(fields or ["    int none;"]),
                "};",
                "",
                f"static void prepare_{self.name}(struct {self.name}_once *c, {arguments})",
                "{",
                *spare[0],
                *once,
                "}",
                "",
                f"INLINE void {self.name}(const struct {self.name}_once *c, {arguments}, {results})",
                "{",
                *spare[1],
                *each,
                *outputs,
                "}",
                "",
            ]
        )

    def _statements(self, varying: bool) -> list[str]:
        lines = []
        for kind, k in self._order():
            if kind == "node":
                node = self.tape.nodes[k]
                if node.op not in (ca.OP_CONST, ca.OP_INPUT) and node.varying == varying:
                    target = f"const {self._type(node)} t{k}" if varying else f"c->t{k}"
                    lines.append(f"    {target} = {self._expression(node)};")
            elif self.blocks and self.tape.tangents[k].terms and self.tape.tangents[k].varying == varying:
                target = "const v d" if varying else "c->d"
                lines += [
                    f"    {target}{k}_{b} = {self._tangent(self.tape.tangents[k], b)};" for b in range(self.blocks)
                ]
        return lines

    def _order(self) -> list[tuple[str, int]]:
        """The instructions as they run; tangents after all values where calls of functions would come between their registers."""
        values = [(kind, k) for kind, k in self.tape.order if kind == "node"]
        operations = {self.tape.nodes[k].op for _, k in values}
        # Square roots, signs and rounding are instructions of the processor, the others functions.
        has_calls = any(op in OPERATIONS and CALL.search(OPERATIONS[op].c) for op in operations)
        # A call may use every vector register: tangents that are in them would be saved and fetched again around
        # each call.
        if len(values) > MOST_VALUES_AHEAD or not has_calls:
            return self.tape.order
        return [*values, *((kind, k) for kind, k in self.tape.order if kind != "node")]

    @staticmethod
    def _type(node: Node) -> str:
        return c_type(node.op)

    def _value(self, k: int) -> str:
        node = self.tape.nodes[k]
        if node.number is not None:
            return c_literal(node.number)
        if node.op == ca.OP_INPUT:
            return f"{self.inputs[node.args[0]]}[{node.args[1]}]"
        return f"t{k}" if node.varying else f"c->t{k}"

    def _expression(self, node: Node) -> str:
        operands = [self._value(a) for a in node.args]
        instruction = FUSED[node.op].format(*operands) if node.op in FUSED else c_instruction(node.op, operands)
        if not instruction:
            refuse_unwritable(node.op)
        return instruction

    def _lane(self, k: int, block: int) -> str:
        tangent = self.tape.tangents[k]
        if tangent.source is not None:
            return f"d{self.inputs[tangent.source[0]]}[{tangent.source[1]} * NB + {block}]"
        return f"d{k}_{block}" if tangent.varying else f"c->d{k}_{block}"

    def _tangent(self, tangent: Tangent, block: int) -> str:
        if tangent.condition is not None:
            sides = ", ".join("zero" if k is None else self._lane(k, block) for _, k in tangent.terms)
            return f"pick({self._value(tangent.condition)} != 0, {sides})"
        text = ""
        for sign, coefficient, k in order_terms(tangent):
            number = None if coefficient is None else self.tape.nodes[coefficient].number
            # The sign of the term and a coefficient of -1 in one.
            minus = "-" if (sign < 0) != (number == -1) else ""
            lane = self._lane(k, block)
            if coefficient is None or number in (1, -1):
                text = f"{text} {minus or '+'} {lane}" if text else minus + lane
            else:
                # A fused multiply-add, in the order of the tape: the machine rounds at the same places.
                product = f"{minus}{self._value(coefficient)}"
                text = f"FMA_LANES({product}, {lane}, {text})" if text else f"{product} * {lane}"
        return text
