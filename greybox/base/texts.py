"""Texts of models, records and results as other languages hold them: one line each, and nothing that a compiler would obey."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Iterable

# Control characters, marks that turn the direction of writing (a reviewer would see another order than the compiler), separators
# of lines and paragraphs, and halves of characters, which no file in UTF-8 can hold.
UNWRITABLE = frozenset({"Cc", "Cs", "Zl", "Zp"})
TURNING = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\ufeff\ufffe\uffff")
# What ends or opens a comment of C, alone or after the compiler has joined lines and replaced trigraphs.
COMMENT_MARKS = (("\\", "/"), ("*/", "* /"), ("/*", "/ *"), ("??", "? ?"))


def to_line(text: str) -> str:
    """``text`` on one line: each character that no line can hold becomes a space."""
    return "".join(" " if unicodedata.category(c) in UNWRITABLE or c in TURNING else c for c in text)


def to_comment(text: str) -> str:
    """``text`` for a comment of C, Modelica or Python that it cannot end."""
    line = to_line(text)
    for mark, harmless in COMMENT_MARKS:
        while mark in line:
            line = line.replace(mark, harmless)
    return line


def escape_line(text: str) -> str:
    r"""``text`` between quotation marks of Python, as its own: ``\x00``, ``\ud800`` and the like are written out."""
    marks = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\r": "\\r", "\t": "\\t"}
    return "".join(marks.get(c) or (c if c.isprintable() else c.encode("unicode_escape").decode("ascii")) for c in text)


# Names as other programs allow them: letters, digits and underscores, each once.


def to_identifier(name: str) -> str:
    """``micro_actuator + coulomb_friction`` as ``micro_actuator_coulomb_friction``."""
    text = re.sub(r"\W+", "_", name).strip("_")
    return text if text and not text[0].isdigit() else f"_{text}"


def to_identifiers(names: Iterable[str], taken: Collection[str] = ()) -> list[str]:
    """Each of ``names`` as an identifier that is none of the others and not ``taken``."""
    result: list[str] = []
    for name in names:
        plain = unique = to_identifier(name)
        number = 1
        while unique in result or unique in taken:
            number += 1
            unique = f"{plain}_{number}"
        result.append(unique)
    return result
