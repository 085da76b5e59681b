"""Tapes as machine code by LLVM, where the package llvmlite is installed: some 30 ms a structure, and no compiler is started.

Only the routines of a step are made here; the loops over the record are those of the tape machine. There is nothing to optimise in the
text, which a tape is already, so that only LLVM's code generator runs. It fuses no products by itself: the bits are those of C.
"""

from __future__ import annotations

import ctypes.util
import importlib.util
import os
import platform
import re
import shutil
import struct
import sys
import tempfile
import threading
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import casadi as ca

from greybox.base import write_file
from greybox.model.expressions.operations import OPERATIONS
from greybox.simulation.kernel.c_compiler import CompilerError, run_compiler
from greybox.simulation.kernel.tape import FMA, FMS, FNMA, Tape, find_needed, order_terms

ARITHMETIC = {ca.OP_ADD: "fadd", ca.OP_SUB: "fsub", ca.OP_MUL: "fmul", ca.OP_DIV: "fdiv"}
COMPARISONS = {ca.OP_LT: "olt", ca.OP_LE: "ole", ca.OP_EQ: "oeq", ca.OP_NE: "une"}
CALL = re.compile(r"(\w+)\(\{0\}(?:, \{1\})?\)")
INSTRUCTIONS = ("sqrt", "fabs", "floor", "ceil", "copysign")
"""Functions of C that are instructions of a processor."""


class Code(NamedTuple):
    """A tape as machine code: addresses of the part that runs once and of that which runs each time, registers between them, and what keeps
    it alive."""

    once: int
    each: int
    values: int
    tangents: int
    engine: Any


@lru_cache(maxsize=1)
def has_llvm() -> bool:
    """Whether routines can be made here: with llvmlite, on a processor that fuses products as compiled C does."""
    if importlib.util.find_spec("llvmlite") is None:
        return False
    try:
        llvm = _load_llvm()
    except (
        ImportError,
        OSError,
    ):  # it is there and does not load, for want of memory as a rule: the tape machine gives the same numbers
        return False
    processor = platform.machine().lower()
    is_x86_with_fma = processor in ("x86_64", "amd64") and llvm.get_host_cpu_features().get("fma", False)
    return is_x86_with_fma or processor in ("arm64", "aarch64")


@lru_cache(maxsize=1)
def _load_llvm() -> ModuleType:
    """Loaded when it is needed: it is a large library."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    mathematics = ctypes.util.find_library("m")  # a process has not always loaded it where LLVM looks
    if mathematics is not None:
        llvm.load_library_permanently(mathematics)
    return llvm


def generate(tape: Tape, width: int, blocks: int) -> Code:
    """The code of a tape of operations that C has, with ``blocks`` blocks of ``width`` tangents, or none. Raises RuntimeError where LLVM
    cannot."""
    text = _Text(tape, width, blocks)
    llvm = _load_llvm()
    source = f'target triple = "{llvm.get_default_triple()}"\n{text.module()}'
    missing = sorted(name for name in text.functions if llvm.address_of_symbol(name) is None)
    if missing:  # LLVM would end the process
        raise RuntimeError(f"this process has no function {', '.join(missing)}")
    engine = _run_generator(llvm, source, text.instructions)
    once, each = (engine.get_function_address(name) for name in ("once", "each"))
    return Code(once, each, max(1, text.values), max(1, text.tangents), engine)


# Held while LLVM works in this process. A copy of it by `os.fork` would find LLVM's own locks taken for good: the fork waits, a fraction
# of a second.
_is_at_work = threading.Lock()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_is_at_work.acquire, after_in_parent=_is_at_work.release, after_in_child=_is_at_work.release
    )


# Instructions of LLVM from which its code generator runs in a process of its own. It takes 0.3 ms each, and more in long routines, and
# nothing can interrupt it in this process; a process of its own costs 0.2 s and ends with the program.
LONG_ROUTINE = 700


def _run_generator(llvm: ModuleType, source: str, instructions: int) -> Any:
    """The machine code of ``source``, loaded. Raises RuntimeError where there is none."""
    if instructions < LONG_ROUTINE:
        with _is_at_work:
            engine = llvm.create_mcjit_compiler(llvm.parse_assembly(source), create_target(llvm))
            engine.finalize_object()
        return engine
    folder = Path(tempfile.mkdtemp(prefix="greybox-"))
    try:
        text, code = folder / "routine.ll", folder / "routine.o"
        write_file(text, source)
        command = [sys.executable, "-P", "-c", GENERATOR, str(text), str(code)]
        try:
            run = run_compiler(command, is_background=True)
        except CompilerError as error:  # it takes too long, or the program has ended
            raise RuntimeError(str(error)) from error
        if run.returncode or not code.exists():
            raise RuntimeError(f"the process of the code generator ended with code {run.returncode}")
        # An empty module carries the object file that the other process has made.
        with _is_at_work:
            engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), create_target(llvm))
            engine.add_object_file(llvm.object_file.ObjectFileRef.from_data(code.read_bytes()))
            engine.finalize_object()
        return engine
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def create_target(llvm: ModuleType) -> Any:
    """This machine, as the code generator sees it."""
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=2, jit=True
    )


GENERATOR = """
import sys
import llvmlite.binding as llvm
llvm.initialize_native_target()
llvm.initialize_native_asmprinter()
target = llvm.Target.from_default_triple().create_target_machine(
    cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=2, jit=True
)
with open(sys.argv[1], encoding="utf-8") as text, open(sys.argv[2], "wb") as code:
    code.write(target.emit_object(llvm.parse_assembly(text.read())))
"""
"""The program of that process: assembly language in, an object file out, by the same generator with the same settings."""


class _Text:
    """LLVM's assembly language. A value is a name or a number; values of the first part go to the second through registers."""

    def __init__(self, tape: Tape, width: int, blocks: int) -> None:
        self.tape, self.blocks, self.block = tape, blocks, f"<{width} x double>"
        self.nodes, self.needed_tangents = find_needed(tape, blocks > 0)
        self.width, self.values, self.tangents = width, 0, 0
        self.lines: list[str] = []
        self.names: dict[tuple[str, int], Any] = {}
        self.registers: dict[tuple[str, int], int] = {}
        self.declared: set[str] = set()
        self.functions: set[str] = set()
        self._count = 0

    @property
    def instructions(self) -> int:
        """Of both functions, once they are written."""
        return self._count

    def module(self) -> str:
        """Both functions and what they call."""
        arguments = "ptr %r, ptr %t, ptr %in, ptr %din, ptr %z, ptr %dz"
        parts = []
        for name, is_each in (("once", False), ("each", True)):
            self.lines, self.names = [], {}
            self._write_part(is_each)
            parts.append("\n".join([f"define void @{name}({arguments}) {{", *self.lines, "ret void", "}"]))
        declarations = [f"declare {text}" for text in sorted(self.declared)]
        return "\n".join([*declarations, *parts])

    def _write_part(self, is_each: bool) -> None:
        for kind, k in self.tape.order:
            if kind == "node" and k in self.nodes:
                node = self.tape.nodes[k]
                if node.op != ca.OP_CONST and node.varying == is_each:
                    self._write_node(k, is_each)
            elif kind == "tangent" and k in self.needed_tangents and self.tape.tangents[k].varying == is_each:
                self._write_tangent(k, is_each)
        if is_each:
            for i, (k, tangent) in enumerate(self.tape.outputs[0]):
                self._store("%z", i, "double", self._value(k))
                for b in range(self.blocks):
                    lane = "zeroinitializer" if tangent is None else self._lanes(tangent)[b]
                    self._store("%dz", i * self.blocks + b, self.block, lane)

    def _write_node(self, k: int, is_each: bool) -> None:
        node = self.tape.nodes[k]
        if node.op == ca.OP_INPUT:
            name = self._load(self._input("%in", node.args[0]), node.args[1], "double")
        else:
            name = self._operation(node.op, [self._value(a) for a in node.args])
        self.names["node", k] = name
        if not is_each:
            self.registers["node", k] = self.values
            self._store("%r", self.values, "double", name)
            self.values += 1

    def _write_tangent(self, k: int, is_each: bool) -> None:
        self.names["tangent", k] = lanes = [self._tangent(k, b) for b in range(self.blocks)]
        if not is_each:
            self.registers["tangent", k] = self.tangents
            for b, lane in enumerate(lanes):
                self._store("%t", self.tangents * self.blocks + b, self.block, lane)
            self.tangents += 1

    def _tangent(self, k: int, b: int) -> str:
        tangent = self.tape.tangents[k]
        if tangent.source is not None:
            source, element = tangent.source
            return self._load(self._input("%din", source), element * self.blocks + b, self.block)
        if tangent.condition is not None:
            yes, no = ("zeroinitializer" if side is None else self._lanes(side)[b] for _, side in tangent.terms)
            return self._choose(self._is_true(self._value(tangent.condition)), self.block, yes, no)
        total = ""
        for sign, coefficient, side in order_terms(tangent):
            lane = self._lanes(side)[b]
            if coefficient is None and total:
                total = self._add(f"{'fadd' if sign > 0 else 'fsub'} {self.block} {total}, {lane}")
            elif coefficient is None:
                total = lane if sign > 0 else self._add(f"fneg {self.block} {lane}")
            else:
                factor = self._spread(coefficient, sign)
                total = (
                    self._fma(self.block, factor, lane, total)
                    if total
                    else self._add(f"fmul {self.block} {factor}, {lane}")
                )
        return total

    def _operation(self, op: int, a: Sequence[str]) -> str:
        if op in ARITHMETIC:
            return self._add(f"{ARITHMETIC[op]} double {a[0]}, {a[1]}")
        if op == FMA:
            return self._fma("double", *a)
        if op == FMS:
            return self._fma("double", a[0], a[1], self._add(f"fneg double {a[2]}"))
        if op == FNMA:
            return self._fma("double", self._add(f"fneg double {a[0]}"), a[1], a[2])
        if op in COMPARISONS:
            return self._number(self._add(f"fcmp {COMPARISONS[op]} double {a[0]}, {a[1]}"))
        if op in (ca.OP_AND, ca.OP_OR):
            sides = ", ".join(map(self._is_true, a))
            return self._number(self._add(f"{'and' if op == ca.OP_AND else 'or'} i1 {sides}"))
        if op == ca.OP_NOT:
            return self._number(self._add(f"fcmp oeq double {a[0]}, 0.0"))
        if op == ca.OP_NEG:
            return self._add(f"fneg double {a[0]}")
        if op == ca.OP_SQ:
            return self._add(f"fmul double {a[0]}, {a[0]}")
        if op == ca.OP_TWICE:
            return self._add(f"fadd double {a[0]}, {a[0]}")
        if op == ca.OP_INV:
            return self._add(f"fdiv double 1.0, {a[0]}")
        if op == ca.OP_IF_ELSE_ZERO:
            return self._choose(self._is_true(a[0]), "double", a[1], "0.0")
        if op == ca.OP_SIGN:
            # sign(0) keeps its sign and sign(NaN) is NaN, as in C.
            above = self._choose(self._add(f"fcmp ogt double {a[0]}, 0.0"), "double", "1.0", a[0])
            return self._choose(self._add(f"fcmp olt double {a[0]}, 0.0"), "double", "-1.0", above)
        if op in (ca.OP_FMIN, ca.OP_FMAX):
            first = self._add(f"fcmp {'olt' if op == ca.OP_FMIN else 'ogt'} double {a[0]}, {a[1]}")
            # C's fmin and fmax give the number where the other is NaN; a plain comparison would give the NaN.
            other = self._add(f"fcmp uno double {a[1]}, {a[1]}")
            return self._choose(self._add(f"or i1 {first}, {other}"), "double", a[0], a[1])
        call = CALL.fullmatch(OPERATIONS[op].c)
        assert call is not None  # the table has no other forms: a test runs them all
        # An intrinsic becomes one instruction; the others are calls of the C library, the one that compiled C calls.
        name = f"@llvm.{call[1]}.f64" if call[1] in INSTRUCTIONS else f"@{call[1]}"
        self.functions |= set() if call[1] in INSTRUCTIONS else {call[1]}
        self.declared.add(f"double {name}({', '.join(['double'] * len(a))})")
        return self._add(f"call double {name}({', '.join(f'double {x}' for x in a)})")

    def _value(self, k: int) -> str:
        number = self.tape.nodes[k].number
        if number is not None:
            # As bits: a decimal text may be rounded in the last digit, and the bits are those of C.
            return f"0x{struct.unpack('<Q', struct.pack('<d', number))[0]:016X}"
        if ("node", k) not in self.names:
            self.names["node", k] = self._load("%r", self.registers["node", k], "double")
        return self.names["node", k]

    def _lanes(self, k: int) -> list[str]:
        if ("tangent", k) not in self.names:
            first = self.registers["tangent", k] * self.blocks
            self.names["tangent", k] = [self._load("%t", first + b, self.block) for b in range(self.blocks)]
        return self.names["tangent", k]

    def _spread(self, k: int, sign: float) -> str:
        """A coefficient in every lane."""
        key = ("spread" if sign > 0 else "negative", k)
        if key not in self.names:
            value = self._value(k) if sign > 0 else self._add(f"fneg double {self._value(k)}")
            one = self._add(f"insertelement {self.block} undef, double {value}, i32 0")
            mask = f"<{self.width} x i32> zeroinitializer"
            self.names[key] = self._add(f"shufflevector {self.block} {one}, {self.block} undef, {mask}")
        return self.names[key]

    def _input(self, array: str, which: int) -> str:
        key = (array, which)
        if key not in self.names:
            self.names[key] = self._load(array, which, "ptr")
        return self.names[key]

    def _fma(self, kind: str, a: str, b: str, c: str) -> str:
        name = "@llvm.fma.f64" if kind == "double" else f"@llvm.fma.v{self.width}f64"
        self.declared.add(f"{kind} {name}({kind}, {kind}, {kind})")
        return self._add(f"call {kind} {name}({kind} {a}, {kind} {b}, {kind} {c})")

    def _choose(self, condition: str, kind: str, yes: str, no: str) -> str:
        return self._add(f"select i1 {condition}, {kind} {yes}, {kind} {no}")

    def _is_true(self, value: str) -> str:
        return self._add(f"fcmp une double {value}, 0.0")

    def _number(self, condition: str) -> str:
        return self._add(f"uitofp i1 {condition} to double")

    def _load(self, array: str, element: int, kind: str) -> str:
        return self._add(f"load {kind}, ptr {self._place(array, element, kind)}, align 8")

    def _store(self, array: str, element: int, kind: str, value: str) -> None:
        place = self._place(array, element, kind)
        self.lines.append(f"store {kind} {value}, ptr {place}, align 8")

    def _place(self, array: str, element: int, kind: str) -> str:
        return self._add(f"getelementptr {kind}, ptr {array}, i64 {element}")

    def _add(self, instruction: str) -> str:
        self._count += 1
        self.lines.append(f"%v{self._count} = {instruction}")
        return f"%v{self._count}"
