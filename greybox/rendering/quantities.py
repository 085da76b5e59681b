"""Physical quantities as people read them: millivolts rather than 1e-3 V."""

from __future__ import annotations

import math

# Units that take a prefix as they are; others (m/s**2, rad, bar) are left alone.
PREFIXED = {"m", "m/s", "s", "V", "V/s", "A", "N", "Pa", "W", "Hz", "H", "F", "T", "N*m", "J"}
PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def choose_prefix(unit: str, largest: float) -> tuple[float, str]:
    """Factor and prefix with which a ``largest`` value in ``unit`` has one to three digits: ``(1e6, "µ")``."""
    if unit not in PREFIXED or not (largest > 0 and math.isfinite(largest)):
        return 1.0, ""
    exponent = 3 * math.floor(math.log10(largest) / 3)
    exponent = min(max(exponent, min(PREFIXES)), max(PREFIXES))
    return 10.0**-exponent, PREFIXES[exponent]


def quantity_text(value: float, unit: str, digits: int = 3, beside: float = 0.0) -> str:
    """``0.31 mV``, in the unit that suits the larger of it and the value ``beside`` it."""
    factor, prefix = choose_prefix(unit, max(abs(value), abs(beside)))
    return f"{factor * value:.{digits}g} {prefix}{unit}".rstrip()


def change_text(before: float, after: float, unit: str, digits: int = 3) -> str:
    """``8.84 to 0.31 mV``: both in the unit that suits the larger one."""
    factor, prefix = choose_prefix(unit, max(abs(before), abs(after)))
    return f"{factor * before:.{digits}g} to {factor * after:.{digits}g} {prefix}{unit}".rstrip()
