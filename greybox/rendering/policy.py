"""What sentences leave out."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TextLimits:
    """Up to where figures and formulas are written out."""

    longest_formula: int = 80
    """Characters of a formula that are worth showing in a sentence."""

    most_percent: float = 99.0
    """Nothing is said to be more certain than this."""

    noise_reach: float = 5.0
    """A noise level whose 95 % interval reaches further than a factor e to this is written without the interval: it says nothing."""

    change_reach: float = 10.0
    """A change whose 95 % interval reaches further than so many times the value is not determined: its figures say nothing."""


TEXT_LIMITS = TextLimits()
