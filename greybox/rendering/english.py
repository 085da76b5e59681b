"""What templates are written with: sentences as data, lists, counts, capitals."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from greybox.findings import Finding

# Beginnings of a sentence that may take a capital; a name of a signal or a parameter stays as it is.
_WORD = re.compile(r"[a-z]{3,}[ :,-]|(?:no|at|on|in|it|of|is|an?|as|by|if|to)[ :]")


def phrase(code: str, subject: str = "", **values: Any) -> Finding:
    """A sentence as data: the code of its template and the values that go into it."""
    return Finding(code, subject=subject, values=values)


def count_noun(count: int, noun: str) -> str:
    """``1 record``, ``2 records``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def join_names(names: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}" if names else ""


def record_text(name: str) -> str:
    """A record as a sentence names it: ``record steps``, and ``record 1`` for one that has only its number for a name."""
    return name if name.startswith("record ") else f"record {name}"


def capitalise(text: str) -> str:
    """With a capital at its beginning, where that is a word and not a name."""
    return text[:1].upper() + text[1:] if _WORD.match(text) else text


def as_sentence(text: str) -> str:
    """With a capital at its beginning, where that is a word, and a full stop at its end."""
    text = capitalise(text.strip())
    return text + ("" if text.endswith((".", "!", "?", ":")) or not text else ".")
