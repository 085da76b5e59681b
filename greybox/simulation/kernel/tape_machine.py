"""Tapes as programs of the tape machine: C that is compiled once for all models and runs their instructions as data.

A machine takes two to seven times as long as compiled code and gives the same bits: both fuse the same products (`fuse_products`), and the
loops over the record are the same text. A structure that a search looks at once is thereby done before a compiler has started.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from greybox.model.expressions.operations import OPERATIONS
from greybox.model.expressions.printer import c_instruction
from greybox.simulation.kernel.c_compiler import choose_vector_width, load_library
from greybox.simulation.kernel.c_routine import FUSED, read_template
from greybox.simulation.kernel.llvm_routine import Code, generate
from greybox.simulation.kernel.tape import Tape, find_needed, order_terms

# Numbers that no operation of CasADi (from 0) nor a fused one (-1 to -3) has; machine.c has the same list.
LOAD, LOAD_TANGENT, STORE, STORE_TANGENT, PICK, SUM_1, SUM_2, SUM_3, SUM_MORE, END = range(-4, -14, -1)


def block_width() -> int:
    """Doubles in one of the machine's blocks: what is best for few directions; more of them take more blocks."""
    return choose_vector_width(1)


class Program(NamedTuple):
    """One tape: what runs once for each length of step, what runs each time, the constants, and how many registers they take."""

    once: np.ndarray
    each: np.ndarray
    constants: np.ndarray
    values: int
    tangents: int


class _Routine(ctypes.Structure):
    _fields_ = (
        ("values", ctypes.c_long),
        ("tangents", ctypes.c_long),
        ("numbers", ctypes.c_long),
        ("once", ctypes.c_void_p),
        ("each", ctypes.c_void_p),
        ("constants", ctypes.c_void_p),
        ("run_once", ctypes.c_void_p),
        ("run_each", ctypes.c_void_p),
    )


class _Machine(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_long) for name in ("nx", "nu", "nq", "ny", "nb")),
        *((name, _Routine) for name in ("advance", "outputs", "generator")),
    )


class TapeMachine:
    """The routines of a step, as the functions of the machine's library want them.

    Parameters
    ----------
    sizes
        ``nx``, ``nu``, ``nq``, ``ny``, and ``nb`` the blocks of tangents, 0 for a simulation.
    tapes
        ``advance``, ``outputs`` and, for an exact hold, ``generator``.
    is_translated
        Whether LLVM turns the tapes into machine code; else the machine runs their instructions.
    """

    def __init__(self, sizes: Mapping[str, int], tapes: Mapping[str, Tape], is_translated: bool = False) -> None:
        self.library = load_machine()
        self._blocks = sizes["nb"]
        make = self._translate if is_translated else self._assemble
        self._kept: list[Program | Code] = []
        self.instructions = 0
        self._machine = _Machine(**sizes, **{name: make(tape) for name, tape in tapes.items()})

    @property
    def length(self) -> int:
        """Instructions, each counted once for every block of tangents: what a compiler has to write."""
        return self.instructions * max(1, self._blocks)

    @property
    def address(self) -> int:
        """Of the description that every function takes first."""
        return ctypes.addressof(self._machine)

    def _assemble(self, tape: Tape) -> _Routine:
        program = assemble(tape, tangents=self._blocks > 0)
        self._kept.append(program)
        self.instructions += len(program.each) // 4
        arrays = (program.once, program.each, program.constants)
        return _Routine(program.values, program.tangents, len(program.constants), *(a.ctypes.data for a in arrays))

    def _translate(self, tape: Tape) -> _Routine:
        # Registers of twice the width where there are many blocks: half the instructions to make, and to run.
        pairs = 2 if self._blocks % 2 == 0 and choose_vector_width(self._blocks * block_width()) > block_width() else 1
        code = generate(tape, pairs * block_width(), self._blocks // pairs)
        self._kept.append(code)
        return _Routine(code.values, code.tangents, run_once=code.once, run_each=code.each)


@lru_cache(maxsize=1)
def load_machine() -> ctypes.CDLL:
    """The library, compiled where this machine does not have it yet: everything waits for it. Raises CompilerError."""
    return load_library(source_of_machine, "tape machine", is_quick=True)


def source_of_machine() -> str:
    """The C text of the machine."""
    cases = []
    for code in (*FUSED, *OPERATIONS):
        text = FUSED[code].format("A", "B", "C") if code in FUSED else c_instruction(code, ("A", "B"))
        if text:
            operands = 3 if code in FUSED else OPERATIONS[code].arity
            cases.append(f"case {code}: r[pc[1]] = {text}; pc += {2 + operands}; break;")
    define = " \\\n    ".join(["#define VALUE_CASES", *cases])
    parts = ["/* Generated by greybox: runs the instructions of any model. */", f"#define W {block_width()}"]
    names = ("kernel.h", "lanes.h", "machine.c", "sums.c", "exact_hold.c", "machine_plain.h", "simulate.c")
    texts = [read_template(name) for name in names]
    # The compiler gets one text, without a folder to look in.
    text = "\n".join([*parts, *texts[:2], define, *texts[2:]])
    return text.replace('#include "machine_run.h"', read_template("machine_run.h"))


def assemble(tape: Tape, tangents: bool) -> Program:
    """The program of a tape of operations that C has, with its tangents or without."""
    return _Assembler(tape, tangents).program()


Operand = tuple[str, int]
"""``r`` and a node (``~k`` is node ``k`` with the other sign), ``t`` and a tangent (-1 is zero), as capitals where the instruction writes
them; an empty text and a plain number."""
_Sections = dict[bool, list[tuple[int, list[Operand]]]]
_NAMES = ("r", "t", "R", "T")


class _Assembler:
    """Instructions name nodes and tangents of the tape first, registers in the end."""

    def __init__(self, tape: Tape, tangents: bool) -> None:
        self.tape, self.has_tangents = tape, tangents
        self.constants: dict[str, tuple[int, float]] = {}
        self.nodes, self.tangents = find_needed(tape, tangents)
        self.negated: set[int] = set()

    def program(self) -> Program:
        sections: _Sections = {False: [], True: []}
        for kind, k in self.tape.order:
            if kind == "node" and k in self.nodes:
                self._add_node(sections, k)
            elif kind == "tangent" and k in self.tangents:
                self._add_tangent(sections, k)
        for i, (node, tangent) in enumerate(self.tape.outputs[0]):
            sections[True].append((STORE, [("", i), ("r", node)]))
            if self.has_tangents:
                sections[True].append((STORE_TANGENT, [("", i), ("t", -1 if tangent is None else tangent)]))
        return self._place(sections)

    def _add_node(self, sections: _Sections, k: int) -> None:
        node = self.tape.nodes[k]
        if node.op == ca.OP_CONST:
            return
        if node.op == ca.OP_INPUT:
            sections[node.varying].append((LOAD, [("R", k), ("", node.args[0]), ("", node.args[1])]))
            return
        sections[node.varying].append((node.op, [("R", k), *(("r", a) for a in node.args)]))

    def _add_tangent(self, sections: _Sections, k: int) -> None:
        tangent = self.tape.tangents[k]
        section = sections[tangent.varying]
        if tangent.source is not None:
            section.append((LOAD_TANGENT, [("T", k), ("", tangent.source[0]), ("", tangent.source[1])]))
        elif tangent.condition is not None:
            sides = [("t", -1 if side is None else side) for _, side in tangent.terms]
            section.append((PICK, [("T", k), ("r", tangent.condition), *sides]))
        else:
            terms: list[Operand] = []
            for sign, coefficient, side in order_terms(tangent):
                terms += [self._coefficient(sections, sign, coefficient), ("t", side)]
            count = len(terms) // 2
            op = {1: SUM_1, 2: SUM_2, 3: SUM_3}.get(count, SUM_MORE)
            section.append((op, [("T", k), *([("", count)] if op == SUM_MORE else []), *terms]))

    def _coefficient(self, sections: _Sections, sign: float, coefficient: int | None) -> Operand:
        if coefficient is None or self.tape.nodes[coefficient].number is not None:
            number = 1.0 if coefficient is None else self.tape.nodes[coefficient].number
            return "", self._constant(sign * number)  # type: ignore[operator]
        if sign > 0:
            return "r", coefficient
        # The instruction adds only: a negative coefficient becomes a register of its own, computed once for all sums
        # that use it.
        if coefficient not in self.negated:
            self.negated.add(coefficient)
            sections[self.tape.nodes[coefficient].varying].append(
                (ca.OP_NEG, [("R", ~coefficient), ("r", coefficient)])
            )
        return "r", ~coefficient

    def _constant(self, number: float) -> int:
        """The register of a number; zero has two signs."""
        return self.constants.setdefault(repr(number), (len(self.constants), number))[0]

    def _place(self, sections: _Sections) -> Program:
        """Registers for all: those of the part that runs each time are taken again once their value is not needed any more."""
        for section in sections.values():
            section[:] = [(op, [self._as_constant(operand) for operand in operands]) for op, operands in section]
        # Where a value of the repeated part is read last: from there on its register is free.
        last_use = {
            (kind.lower(), k): i
            for i, (_, operands) in enumerate(sections[True])
            for kind, k in operands
            if kind in _NAMES
        }
        registers: dict[Operand, int] = {("t", -1): 0}
        # Constants lie in the first registers; tangent register 0 is zero and never written.
        count = {"r": len(self.constants), "t": 1}
        code: dict[bool, list[int]] = {}
        for is_each in (False, True):
            # Values of the part that runs once keep their registers for good: the other part reads them at every
            # substep.
            unused: dict[str, list[int]] = {"r": [], "t": []}
            own_results: set[Operand] = set()
            code[is_each] = []
            for i, (op, operands) in enumerate(sections[is_each]):
                line = [k if kind not in ("r", "t") else registers[kind, k] for kind, k in operands]
                for operand in dict.fromkeys(operands) if is_each else ():
                    if operand in own_results and last_use[operand] == i:
                        unused[operand[0]].append(registers[operand])
                for n, (kind, k) in enumerate(operands):
                    if kind in ("R", "T"):
                        bank = kind.lower()
                        if not unused[bank]:
                            unused[bank].append(count[bank])
                            count[bank] += 1
                        line[n] = registers[bank, k] = unused[bank].pop()
                        if is_each:
                            own_results.add((bank, k))
                code[is_each] += [op, *line]
            code[is_each].append(END)
        once, each = (np.array(code[is_each], dtype=np.int32) for is_each in (False, True))
        constants = np.array([number for _, number in self.constants.values()] or [0.0])
        return Program(once, each, constants, max(count["r"], len(constants)), count["t"])

    def _as_constant(self, operand: Operand) -> Operand:
        """The register of a number in the place of its node."""
        kind, k = operand
        number = self.tape.nodes[k].number if kind == "r" and k >= 0 else None
        return operand if number is None else ("", self._constant(number))
