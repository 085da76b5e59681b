"""Texts of models, records and results as other languages hold them: one line each, and nothing that a compiler would obey."""

from __future__ import annotations

import unicodedata

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
