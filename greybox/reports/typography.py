"""How a page writes numbers, units and counts: with the signs that a terminal may lack."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from greybox.plots.scaling import typeset_exponents, typeset_unit
from greybox.rendering.tables import format_number

__all__ = ["as_sentence", "count_noun", "format_number", "format_range", "join_names", "typeset_number", "typeset_unit"]

WORD = re.compile(r"[a-z]{3,}[ :,-]|(?:no|at|on|in|it|of|is|an?|as|by|if|to)[ :]")


def typeset_number(text: str) -> str:
    """A cell of numbers as print has it: ``5.01e-04 +- 3e-06`` is 5.01·10⁻⁴ ± 3·10⁻⁶."""
    return typeset_exponents(text.replace("+-", "±").replace(" x noise", " × noise"))


def format_range(values: np.ndarray) -> str:
    """``-3.1 to 2.7``, of the finite ``values`` (N,)."""
    known = values[np.isfinite(values)]
    return f"{known.min():.4g} to {known.max():.4g}".replace("-", "−") if len(known) else "nothing"


def count_noun(number_of: int, what: str) -> str:
    """``1 record``, ``2 records``."""
    return f"{number_of} {what}" if number_of == 1 else f"{number_of} {what}s"


def join_names(names: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}" if names else ""


def as_sentence(text: str) -> str:
    """With a capital at its beginning, where that is a word, and a full stop at its end."""
    text = text.strip()
    if WORD.match(text):  # a name of a signal or a constant stays as it is
        text = text[:1].upper() + text[1:]
    return text + ("" if text.endswith((".", "!", "?", ":")) or not text else ".")
