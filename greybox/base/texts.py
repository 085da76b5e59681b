"""Texts of models, records and results as other languages hold them: one line each, and nothing that a compiler would obey."""

from __future__ import annotations

import re
import shlex
import textwrap
import unicodedata
from collections.abc import Callable, Collection, Iterable

# Control and format characters (escapes of a terminal, marks that turn the direction of writing: a reviewer would see another order than
# the compiler, letters without width), separators of lines and paragraphs, and halves of characters, which no file in UTF-8 can hold.
UNWRITABLE = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
# Of no category that tells them from characters to come: no document in XML may hold them.
NONCHARACTERS = frozenset("\ufffe\uffff")
# What ends or opens a comment of C, alone or after the compiler has joined lines and replaced trigraphs.
COMMENT_MARKS = (("\\", "/"), ("*/", "* /"), ("/*", "/ *"), ("??", "? ?"))
# With what a cell of a table begins that a spreadsheet runs, also in letters of full width.
FORMULA_MARKS = tuple("=+-@\uff1d\uff0b\uff0d\uff20")


def to_line(text: str) -> str:
    """``text`` on one line: each character that no line can hold becomes a space."""
    if text.isprintable():
        return text
    return "".join(" " if unicodedata.category(c) in UNWRITABLE or c in NONCHARACTERS else c for c in text)


def to_message(text: str) -> str:
    """``text`` for a terminal that it cannot command: lines after the first are indented, so that none looks like a message of its own."""
    first, *more = (to_line(line).rstrip() for line in text.split("\n"))
    return "\n".join([first, *(line if line.startswith("  ") else f"  {line}" for line in more)])


def to_lines(text: str) -> str:
    """``text`` as an answer shows it: its lines stay."""
    return "\n".join(map(to_line, text.split("\n")))


def to_word(text: str) -> str:
    """``text`` as one word of a command that is proposed: a shell takes it as it is."""
    return shlex.quote(to_line(text))


def to_cell(text: str) -> str:
    """``text`` as a cell of a CSV table: one line, and no formula to a spreadsheet."""
    line = to_line(text)
    return f"'{line}" if line.lstrip().startswith(FORMULA_MARKS) else line


def to_comment(text: str) -> str:
    """``text`` for a comment of C, Modelica or Python that it cannot end."""
    line = to_line(text)
    for mark, harmless in COMMENT_MARKS:
        while mark in line:
            line = line.replace(mark, harmless)
    return line


def escape_line(text: str) -> str:
    r"""``text`` between quotation marks of Python or TOML, as its own: ``\u0000``, ``\ud800`` and the like are written out."""
    marks = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\r": "\\r", "\t": "\\t"}
    return "".join(marks.get(c) or (c if c.isprintable() else _escape(ord(c))) for c in text)


def _escape(code: int) -> str:
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


# Names as other programs allow them: letters, digits and underscores, each once.


def to_identifier(name: str) -> str:
    """``micro_actuator + coulomb_friction`` as ``micro_actuator_coulomb_friction``."""
    text = re.sub(r"\W+", "_", name).strip("_")
    return text if text and not text[0].isdigit() else f"_{text}"


def to_identifiers(
    names: Iterable[str], taken: Collection[str] = (), spell: Callable[[str], str] = to_identifier
) -> list[str]:
    """Each of ``names`` as an identifier that is none of the others and not ``taken``; ``spell`` writes one."""
    result: list[str] = []
    for name in names:
        plain = unique = spell(name)
        number = 1
        while unique in result or unique in taken:
            number += 1
            unique = f"{plain}_{number}"
        result.append(unique)
    return result


# Lines of a terminal.


# Columns of a line where no terminal says how many it has.
LINE_WIDTH = 80
# A number and its per cent.
PERCENT = re.compile(r"(?<=\d) (?=%)")


def wrap(text: str, width: int, indent: str = "") -> list[str]:
    """Lines of at most ``width`` letters, broken between words; a word that is longer stands alone. Its own lines stay."""
    lines: list[str] = []
    for line in PERCENT.sub("\0", text).split("\n"):
        lead = line[: len(line) - len(line.lstrip())]
        lines += textwrap.wrap(
            line.strip(),
            width,
            initial_indent=lead,
            subsequent_indent=indent if len(indent) > len(lead) else f"{lead}{indent}" if lead else indent,
            break_long_words=False,
            break_on_hyphens=False,
        ) or [""]
    return [line.replace("\0", " ") for line in lines]
