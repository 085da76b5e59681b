"""Numbers and tables in plain text, for every renderer."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence


def format_number(value: float, digits: int = 5) -> str:
    """A number for people: ``digits`` significant digits, short."""
    return f"{value:.{digits}g}"


def format_with_std(value: float, std: float) -> str:
    """``value +- std`` with two digits of the uncertainty: ``0.26910 +- 0.00034``."""
    if not (std > 0 and math.isfinite(std)):
        return format_number(value)
    write = make_formatter(value, std)
    return f"{write(value)} +- {write(std)}"


def make_formatter(value: float, std: float) -> Callable[[float], str]:
    """How to write numbers beside ``value +- std``, such as the ends of its interval: to two digits of the uncertainty."""
    if not (std > 0 and math.isfinite(std)):
        return format_number
    exponent = math.floor(math.log10(std))
    digits = max(1 - exponent, 0)
    if not (abs(value) >= 1e6 or 0 < abs(value) < 1e-3 or digits > 8):
        return lambda v: f"{v:.{digits}f}"

    def scientific(v: float) -> str:
        leading = math.floor(math.log10(max(abs(v), std))) if math.isfinite(v) else 0
        return f"{v:.{min(max(leading - exponent + 1, 1), 9)}e}"

    return scientific


def format_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table, indented by two; each column as wide as it must be."""
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    return [
        "  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in [head, *rows]
    ]


def join_words(words: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return ", ".join(words[:-1]) + " and " + words[-1] if len(words) > 1 else "".join(words)


def format_shares(shares: Mapping[str, float], digits: int = 2) -> str:
    """``2 % of x, 0.5 % of i`` from shares of one."""
    return ", ".join(f"{100 * share:.{digits}g} % of {name}" for name, share in shares.items())
