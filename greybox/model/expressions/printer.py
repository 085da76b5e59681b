"""Expressions as text: one walk over the graph, and a dialect that says how a language writes symbols, numbers and operations.

`PYTHON`, `NUMPY`, `MODELICA` and `FORMULA` differ only in their column of the table of operations and in how they write a choice; `LATEX`
(`greybox.model.expressions.text`) adds typesetting, and `TEXT` (`greybox.model.expressions.text`) collects factors and powers before it
writes them.
"""

from __future__ import annotations

import itertools
import keyword
import math
import re
import textwrap
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, Generic, NamedTuple, TypeVar

import casadi as ca

from greybox.base import GreyboxError
from greybox.base.texts import escape_line, to_line
from greybox.model.balance import Balance
from greybox.model.expressions.graph import as_scalar, count_operands, nodes, walk
from greybox.model.expressions.operations import OPERATIONS, Binding, Operation, operation_name

T = TypeVar("T")

LONGEST_INTEGER = len("999999.0")  # longer ones are written as floating-point numbers
CALL = re.compile(r"\\?[\w.]+\(")


class Dialect(ABC, Generic[T]):
    """How a language writes the parts of an expression; ``T`` is the type of a part that is already written."""

    @abstractmethod
    def symbol(self, name: str) -> T:
        """A variable or constant."""

    @abstractmethod
    def number(self, value: float) -> T:
        """A number."""

    @abstractmethod
    def operation(self, node: ca.SX, operands: Sequence[T]) -> T:
        """An operation on operands that are already written. Raises GreyboxError where the language does not have it."""

    def write(self, expression: ca.SX | float) -> T:
        """A scalar expression."""
        return walk(expression, self.symbol, self.number, self.operation)


class Half(NamedTuple):
    """One half of an if, which CasADi writes as a sum of two.

    ``condition`` and ``text`` are the node and the text of the condition, ``value`` what stands where it holds, or, for the half that is
    ``otherwise``, where it does not.
    """

    condition: int
    text: str
    otherwise: bool
    value: str


class Printed(NamedTuple):
    """A text and how tightly it holds together; ``opposite``: what stands behind a leading minus; ``half`` of an if."""

    text: str
    binding: Binding
    opposite: str = ""
    half: Half | None = None

    def within(self, binding: Binding, brackets: str = "({})") -> str:
        """The text, in brackets where it holds together less tightly than its place needs."""
        return self.text if self.binding >= binding else brackets.format(self.text)


@dataclass(frozen=True)
class CodeDialect(Dialect[Printed]):
    """A language whose operations are a column of the table, and which writes ``choice`` for ``condition ? yes : no``.

    ``infinity`` and ``undefined`` are its words for these values; empty where it has none.
    """

    name: str
    column: str
    choice: str
    infinity: str
    undefined: str = ""
    brackets: str = "({})"

    def symbol(self, name: str) -> Printed:
        """The name as it is."""
        return Printed(name, Binding.ATOM)

    def number(self, value: float) -> Printed:
        """The shortest text that reads back as the same number. Raises GreyboxError for NaN where the language has no word for it."""
        if math.isnan(value):
            if not self.undefined:
                raise GreyboxError(
                    f"the equations hold NaN, for which {self.name} has no word; give a number there, or keep to where it is not reached"
                )
            return Printed(self.undefined, Binding.ATOM)
        size = abs(value)
        text = repr(size) if size < math.inf else self.infinity
        text = text.removesuffix(".0") if len(text) <= LONGEST_INTEGER else text
        return self._minus(text) if value < 0 else Printed(text, Binding.ATOM)

    def operation(self, node: ca.SX, operands: Sequence[Printed]) -> Printed:
        """The template of the operation with its operands, bracketed where they need it. Raises GreyboxError where there is none."""
        code = node.op()
        if code == ca.OP_IF_ELSE_ZERO and self.choice:
            return self._half(node, *operands)
        row = OPERATIONS.get(code)
        template = getattr(row, self.column) if row else ""
        if row is None or not template:
            raise GreyboxError(
                f"{self.name} has no {row.name if row else operation_name(code)} (in {node}); write the term without it, or export"
                " another format"
            )
        if code == ca.OP_ADD:
            return self._add(*operands)
        if code == ca.OP_NEG:
            return self._minus(operands[0].within(row.needs[0], self.brackets))
        if row.binding == Binding.PRODUCT:
            return self._product(row, template, operands)
        return self._fill(row, template, operands)

    def choose(self, condition: str, yes: str, no: str) -> Printed:
        """``yes`` where the condition holds, else ``no``."""
        return Printed(self.choice.format(condition, yes, no), Binding.ATOM)

    def needs(self, row: Operation) -> tuple[Binding, ...]:
        """How tightly the operands of an operator must hold together to stand without brackets."""
        return row.needs

    def _fill(self, row: Operation, template: str, operands: Sequence[Printed]) -> Printed:
        if CALL.match(template):
            return Printed(template.format(*(operand.text for operand in operands)), Binding.ATOM)
        pairs = zip(operands, self.needs(row), strict=False)
        return Printed(template.format(*(operand.within(need, self.brackets) for operand, need in pairs)), row.binding)

    def _add(self, first: Printed, second: Printed) -> Printed:
        row = OPERATIONS[ca.OP_ADD]
        one, other = first.half, second.half
        if one and other and one.condition == other.condition and not one.otherwise and other.otherwise:
            return self.choose(one.text, one.value, other.value)
        if second.opposite:  # a + -b
            return Printed(f"{first.within(Binding.SUM, self.brackets)} - {second.opposite}", Binding.SUM)
        return self._fill(row, getattr(row, self.column), (first, second))

    def _product(self, row: Operation, template: str, operands: Sequence[Printed]) -> Printed:
        """A product or quotient; a minus in front of its first factor stands in front of the whole."""
        first = operands[0]
        if len(operands) > 1 and first.opposite:
            inner = self._fill(row, template, (Printed(first.opposite, Binding.PRODUCT), operands[1]))
            return self._minus(inner.text)
        return self._fill(row, template, operands)

    def _half(self, node: ca.SX, condition: Printed, value: Printed) -> Printed:
        test = node.dep(0)
        otherwise = test.op() == ca.OP_NOT
        key = (test.dep(0) if otherwise else test).element_hash()
        half = Half(key, condition.text, otherwise, value.text)
        return self.choose(condition.text, value.text, "0")._replace(half=half)

    def _minus(self, text: str) -> Printed:
        return Printed(f"-{text}", Binding.NEGATION, opposite=text)


PYTHON = CodeDialect("Python", "python", "ca.if_else({}, {}, {})", "ca.inf", 'float("nan")')
NUMPY = CodeDialect("Python", "numpy", "np.where({}, {}, {})", "np.inf", "np.nan")
MODELICA = CodeDialect("Modelica", "modelica", "(if {} then {} else {})", "1e300")
FORMULA = CodeDialect("a formula", "formula", "", "1e999")


@dataclass
class Printer:
    """Writes expressions that belong together, with a name for each longer part that is used more than once.

    Parameters
    ----------
    dialect
        The language: `PYTHON`, `NUMPY`, `MODELICA`, `FORMULA`, `LATEX`.
    symbols
        What each symbol is called in the language.
    prefix
        Of the names of shared parts: ``part_1``, ``part_2`` ...
    shortest_shared
        A shorter text is written out wherever it is used, in characters.
    shared
        The shared parts as (name, text), each to be defined before its first use; filled while expressions are written.

    Examples
    --------
    >>> x = ca.SX.sym("x")
    >>> Printer(PYTHON, {"x": "x.position"}).write(ca.sinh(x) / 2)
    'ca.sinh(x.position) / 2'
    """

    dialect: CodeDialect
    symbols: Mapping[str, str]
    prefix: str = "part"
    shortest_shared: int = 30
    shared: list[tuple[str, str]] = field(default_factory=list)
    _printed: dict[int, Printed] = field(default_factory=dict)
    _uses: Counter[int] = field(default_factory=Counter)
    _alive: list[ca.SX] = field(default_factory=list)  # a node is known by its address as long as it lives

    def count_uses(self, expressions: Iterable[ca.SX | float]) -> None:
        """Find out which parts these expressions share. To be called before the first of them is written."""
        roots = [ca.SX(expression) for expression in expressions]
        self._alive += roots
        for node in nodes(roots):
            self._uses.update(node.dep(k).element_hash() for k in range(count_operands(node)))

    def write(self, expression: ca.SX | float) -> str:
        """The text of a scalar expression. Raises GreyboxError for an operation that the language does not have."""
        return self.print(expression).text

    def print(self, expression: ca.SX | float) -> Printed:
        """The text of a scalar expression with how tightly it holds together."""
        root = as_scalar(expression)
        self._alive.append(root)
        for node in nodes([root], self._printed):
            printed = self._print_node(node)
            shareable = printed.binding > Binding.COMPARISON and printed.half is None
            if shareable and self._uses[node.element_hash()] > 1 and len(printed.text) > self.shortest_shared:
                self.shared.append((self._name_part(), printed.text))
                printed = Printed(self.shared[-1][0], Binding.ATOM)
            self._printed[node.element_hash()] = printed
        return self._printed[root.element_hash()]

    def _name_part(self) -> str:
        """The next name of a shared part that no symbol has."""
        taken = {name for name, _ in self.shared} | set(self.symbols.values())
        return next(name for k in itertools.count(len(self.shared) + 1) if (name := f"{self.prefix}_{k}") not in taken)

    def _print_node(self, node: ca.SX) -> Printed:
        if node.is_symbolic():
            return self.dialect.symbol(self.symbols[node.name()])
        if node.is_constant():
            return self.dialect.number(float(node))
        return self.dialect.operation(node, [self._printed[node.dep(k).element_hash()] for k in range(node.n_dep())])


# Expressions as C99: one instruction at a time, as the tape of a kernel lists them.


def c_instruction(code: int, operands: Sequence[str]) -> str:
    """An operation on variables and literals; empty for one that C does not have."""
    return OPERATIONS[code].c.format(*operands) if code in OPERATIONS else ""


def c_type(code: int) -> str:
    """The type of an operation's result."""
    return "int" if code in OPERATIONS and OPERATIONS[code].logical else "double"


def c_literal(value: float) -> str:
    """A literal that reads back as the same double."""
    if value != value:
        return "NAN"
    if value in (ca.inf, -ca.inf):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    return repr(value) if value >= 0 and repr(value) != "-0.0" else f"({value!r})"


# How a Python model file is laid out: calls, signals, balances, expressions of ``x``, ``u`` and ``p``.


# Characters of a line of a written model, beyond which its arguments stand on lines of their own.
WIDTH = 110
INDENT = "    "


def call(name: str, arguments: Sequence[str], depth: int = 0, head: int | None = None) -> str:
    """``name(a, b)`` on one line where that is short enough, else over several; ``depth`` levels inside.

    ``head``: how many arguments stand on the first of these lines, each of the others then on its own; None fills the lines.
    """
    line = f"{name}({', '.join(arguments)})"
    if len(line) + len(INDENT) * depth <= WIDTH and "\n" not in line:
        return line
    lines = (
        _filled(arguments, WIDTH - len(INDENT) * (depth + 1))
        if head is None
        else [", ".join(arguments[:head]), *arguments[head:]]
    )
    inner = INDENT * (depth + 1)
    return f"{name}(\n" + "".join(f"{inner}{text},\n" for text in lines) + f"{INDENT * depth})"


def _filled(arguments: Sequence[str], width: int) -> list[str]:
    """Arguments put together in lines of at most ``width``; one that is long or has several lines stands alone."""
    lines: list[str] = []
    for text in arguments:
        alone = "\n" in text or not lines or "\n" in lines[-1]
        if not alone and len(lines[-1]) + 2 + len(text) < width:
            lines[-1] += f", {text}"
        else:
            lines.append(text)
    return lines


def docstring(title: str, paragraphs: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a module's docstring, the title folded, a blank line between paragraphs."""

    def safe(text: str) -> str:
        return to_line(text).replace("\\", "\\\\").replace('"""', "'''").rstrip()

    lines = textwrap.wrap(safe(title), WIDTH - 4)
    lines[0] = f'"""{lines[0]}'
    for paragraph in paragraphs:
        if paragraph:
            lines += ["", *map(safe, paragraph)]
    return [*lines, '"""']


def items(opening: str, entries: Sequence[str], closing: str, depth: int) -> str:
    """A list or tuple with an entry a line."""
    inner = INDENT * (depth + 1)
    return f"{opening}\n" + "".join(f"{inner}{e},\n" for e in entries) + f"{INDENT * depth}{closing}"


def signal(value: Any, depth: int, *, written: Mapping[str, str] | None = None) -> str:
    """A state, input, output or parameter as the call that makes it; ``written`` are texts of fields that are functions."""
    kept = [f for f in fields(value) if f.default is MISSING]
    arguments = [literal(getattr(value, f.name)) for f in kept]
    for f in fields(value):
        given = getattr(value, f.name)
        if f in kept or given == f.default:
            continue
        arguments.append(f"{f.name}={(written or {}).get(f.name) or literal(given)}")
    return call(type(value).__name__, arguments, depth)


def literal(value: Any) -> str:
    """A number, text or tuple as Python reads it back; infinities as ``math.inf``."""
    if isinstance(value, tuple):
        return f"({', '.join(literal(v) for v in value)}{',' if len(value) == 1 else ''})"
    if isinstance(value, float):
        return {"inf": "math.inf", "-inf": "-math.inf", "nan": "math.nan"}.get(repr(value), repr(value))
    if isinstance(value, str):
        return f'"{escape_line(value)}"'
    return repr(value)


def keywords(entries: Mapping[str, str]) -> list[str]:
    """``name=text`` of each entry, or all in ``**{...}`` where one is no name of Python."""
    if all(name.isidentifier() and not keyword.iskeyword(name) for name in entries):
        return [f"{name}={text}" for name, text in entries.items()]
    return ["**{" + ", ".join(f"{literal(name)}: {text}" for name, text in entries.items()) + "}"] if entries else []


def balance(value: Balance, state: str, writer: Printer, depth: int) -> str:
    """A balance as the call that makes it, its terms written out."""
    head = [literal(value.name), literal(value.unit), writer.write(value.storage), literal(state)]
    terms = {name: writer.write(term) for name, term in value.terms.items()}
    for name, block in value.blocks.items():
        terms[name] = call("Block", [literal(block.label), terms[name], *([literal(block.unit)] if block.unit else [])])
    moving = [literal(name) for name in value.motion.values() if name]
    return call("Balance", [*head, *keywords(terms)], depth, len(head)) + (call(".moving", moving) if moving else "")
