"""How a page writes numbers, units and ranges: with the signs that a terminal may lack."""

from __future__ import annotations

import re

import numpy as np

from greybox.plots.scaling import typeset_exponents, typeset_unit
from greybox.rendering.tables import format_number

# The hyphen in front of a negative number, not the one within a name or between two numbers.
NEGATIVE = re.compile(r"(?<![^\s(\[,;=])-(?=\d)")

__all__ = ["format_number", "format_range", "typeset_number", "typeset_unit"]


def typeset_number(text: str) -> str:
    """A text with numbers as print has it: ``-5.01e-04 +- 3e-06`` is −5.01·10⁻⁴ ± 3·10⁻⁶."""
    return NEGATIVE.sub("−", typeset_exponents(text.replace("+-", "±").replace(" x noise", " × noise")))


def format_range(values: np.ndarray) -> str:
    """``-3.1 to 2.7``, of the finite ``values`` (N,)."""
    known = values[np.isfinite(values)]
    return f"{known.min():.4g} to {known.max():.4g}".replace("-", "−") if len(known) else "nothing"
