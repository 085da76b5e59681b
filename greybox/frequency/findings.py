"""Codes of the tests of linearity; their sentences are in `greybox.rendering.frequency`."""

from __future__ import annotations

from enum import StrEnum


class LinearityCheck(StrEnum):
    """Tests of a best linear approximation: each compares a variance with that of the noise."""

    REALISATIONS_AGREE = "realisations_agree"
    """The response is the same for other phases of the input."""
    EVEN_LINES_ARE_NOISE = "even_lines_are_noise"
    """Even lines that are not excited hold noise alone."""
    ODD_LINES_ARE_NOISE = "odd_lines_are_noise"
    """Odd lines that are not excited hold noise alone."""
