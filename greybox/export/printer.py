"""Expressions as the text of a language: `casadi` in Python, Modelica. Every number to the last digit."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import casadi as ca

from greybox.errors import GreyboxError
from greybox.kernel.tape import operation_name

# How tightly an operation binds; an operand that binds less is put in brackets.
CHOICE, OR, AND, COMPARE, ADD, NEGATE, MULTIPLY, POWER, ATOM = range(9)
SUMS = {ca.OP_ADD: "+", ca.OP_SUB: "-"}
COMPARISONS = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
LOGIC = {ca.OP_AND: "and", ca.OP_OR: "or", ca.OP_NOT: "not"}
NAMES: tuple[str, ...] = ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")
NAMES += ("asinh", "acosh", "atanh", "atan2", "sign", "floor", "ceil", "erf")
FUNCTIONS = {getattr(ca, f"OP_{name.upper()}"): name for name in NAMES} | {
    ca.OP_FABS: "fabs",
    ca.OP_FMIN: "fmin",
    ca.OP_FMAX: "fmax",
    ca.OP_LOG1P: "log1p",
    ca.OP_EXPM1: "expm1",
    ca.OP_HYPOT: "hypot",
}
# A part that is used more than once and longer than this gets a name of its own.
WORTH_A_NAME = 30


class Half(NamedTuple):
    """One half of an if: the condition (its node, its text), whether it is the one where that is false, and the value there."""

    condition: int
    text: str
    otherwise: bool
    value: str


class Printed(NamedTuple):
    """A text and how tightly it binds; ``opposite``: what stands behind a leading minus; ``half`` of an if."""

    text: str
    binds: int
    opposite: str = ""
    half: Half | None = None


@dataclass(frozen=True)
class Dialect:
    """How a language writes what differs: powers, infinity, calls, choices, ``and``, ``or`` and ``not``; which functions it lacks."""

    name: str
    power: str
    infinity: str
    call: Callable[[str, Sequence[str]], str]
    choose: Callable[[str, str, str], Printed]
    logic: Callable[[str, Sequence[Printed]], Printed]
    lacks: frozenset[str] = frozenset()


@dataclass
class Printer:
    """Writes expressions whose symbols are called as ``symbols`` says; ``shared`` are the parts that got names of their own."""

    dialect: Dialect
    symbols: Mapping[str, str]
    prefix: str = "part"
    shared: list[tuple[str, str]] = field(default_factory=list)
    _texts: dict[int, Printed] = field(default_factory=dict)
    _uses: Counter[int] = field(default_factory=Counter)
    _kept: list[ca.SX] = field(default_factory=list)  # a node is known by its address as long as it lives

    def look_at(self, expressions: Iterable[ca.SX | float]) -> None:
        """Count what these expressions have in common, before any of them is written."""
        roots = [ca.SX(expression) for expression in expressions]
        self._kept += roots
        for node in _nodes(roots):
            self._uses.update(node.dep(k).element_hash() for k in range(_operands(node)))

    def write(self, expression: ca.SX | float) -> str:
        """The text of a scalar expression. Raises GreyboxError for an operation that the language does not have."""
        return self.written(expression).text

    def written(self, expression: ca.SX | float) -> Printed:
        """The text of a scalar expression with how tightly it binds."""
        root = ca.SX(expression)
        if root.nnz() == 0:
            return Printed("0", ATOM)
        self._kept.append(root)
        for node in _nodes([root], self._texts):
            found = self._node(node)
            often = self._uses[node.element_hash()] > 1 and len(found.text) > WORTH_A_NAME
            if often and found.binds > COMPARE and found.half is None:
                self.shared.append((f"{self.prefix}_{len(self.shared) + 1}", found.text))
                found = Printed(self.shared[-1][0], ATOM)
            self._texts[node.element_hash()] = found
        return self._texts[root.element_hash()]

    def _node(self, node: ca.SX) -> Printed:
        if node.is_symbolic():
            return Printed(self.symbols[node.name()], ATOM)
        if node.is_constant():
            return self._number(float(node))
        op, power = node.op(), self.dialect.power
        operands = [self._texts[node.dep(k).element_hash()] for k in range(node.n_dep())]
        first, last = operands[0], operands[-1]
        if op in SUMS:
            return self._sum(op, first, last)
        if op in (ca.OP_MUL, ca.OP_DIV):
            return _product("*" if op == ca.OP_MUL else "/", first, last)
        if op == ca.OP_NEG:
            return _minus(_within(first, MULTIPLY))
        if op == ca.OP_TWICE:
            return _product("*", Printed("2", ATOM), first)
        if op == ca.OP_INV:
            return _product("/", Printed("1", ATOM), first)
        if op == ca.OP_SQ:
            return Printed(f"{_within(first, ATOM)}{power}2", POWER)
        if op in (ca.OP_POW, ca.OP_CONSTPOW):
            return Printed(f"{_within(first, ATOM)}{power}{_within(last, ATOM)}", POWER)
        if op in COMPARISONS and COMPARISONS[op] not in self.dialect.lacks:
            return Printed(f"{_within(first, ADD)} {COMPARISONS[op]} {_within(last, ADD)}", COMPARE)
        if op in LOGIC:
            return self.dialect.logic(LOGIC[op], operands)
        if op == ca.OP_IF_ELSE_ZERO:
            return self._half(node, first.text, last.text)
        return self._call(node, operands)

    def _sum(self, op: int, first: Printed, last: Printed) -> Printed:
        one, other = first.half, last.half
        if (
            op == ca.OP_ADD
            and one
            and other
            and one.condition == other.condition
            and not one.otherwise
            and other.otherwise
        ):
            return self.dialect.choose(one.text, one.value, other.value)
        if op == ca.OP_ADD and last.opposite:
            return Printed(f"{_within(first, ADD)} - {last.opposite}", ADD)
        return Printed(
            f"{_within(first, ADD)} {SUMS[op]} {_within(last, MULTIPLY if op == ca.OP_SUB else NEGATE + 1)}", ADD
        )

    def _half(self, node: ca.SX, condition: str, value: str) -> Printed:
        test = node.dep(0)
        otherwise = test.op() == ca.OP_NOT
        half = Half((test.dep(0) if otherwise else test).element_hash(), condition, otherwise, value)
        return self.dialect.choose(condition, value, "0")._replace(half=half)

    def _number(self, value: float) -> Printed:
        size = abs(value)
        text = (
            repr(int(size))
            if size.is_integer() and size < 1e6
            else repr(size)
            if size < math.inf
            else self.dialect.infinity
        )
        return _minus(text) if value < 0 else Printed(text, ATOM)

    def _call(self, node: ca.SX, operands: list[Printed]) -> Printed:
        name = FUNCTIONS.get(node.op()) or COMPARISONS.get(node.op())
        if name is None or name in self.dialect.lacks:
            said = name or operation_name(node.op())
            raise GreyboxError(
                f"{self.dialect.name} has no {said} (in {node}); write the term without it, or export another format"
            )
        return Printed(self.dialect.call(name, [operand.text for operand in operands]), ATOM)


def _nodes(roots: Sequence[ca.SX], known: Container[int] = ()) -> Iterator[ca.SX]:
    """The nodes of some expressions that are not ``known``, each once, operands first."""
    found: set[int] = set()
    stack = [(root, False) for root in reversed(roots)]
    while stack:
        node, ready = stack.pop()
        key = node.element_hash()
        if ready:
            yield node
        elif key not in found and key not in known:
            found.add(key)
            stack.append((node, True))
            stack += [(node.dep(k), False) for k in reversed(range(_operands(node)))]


def _operands(node: ca.SX) -> int:
    return 0 if node.is_constant() or node.is_symbolic() else node.n_dep()


def _product(sign: str, first: Printed, last: Printed) -> Printed:
    """A product or quotient; a leading minus stands in front of the whole."""
    left = first.opposite or _within(first, MULTIPLY)
    text = f"{left} {sign} {_within(last, POWER)}"
    return _minus(text) if first.opposite else Printed(text, MULTIPLY)


def _minus(text: str) -> Printed:
    return Printed(f"-{text}", NEGATE, opposite=text)


def _within(operand: Printed, binds: int) -> str:
    return operand.text if operand.binds >= binds else f"({operand.text})"


def function_call(name: str, arguments: Sequence[str]) -> str:
    """``f(a, b)``."""
    return f"{name}({', '.join(arguments)})"
