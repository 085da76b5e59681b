"""How a Python model file is laid out: calls, signals, balances, expressions of ``x``, ``u`` and ``p``."""

from __future__ import annotations

import keyword
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Any

from greybox.base.texts import escape_line, to_line
from greybox.model.balance import Balance
from greybox.model.expressions.printer import Printer

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
