"""What instruments and spreadsheets put around the header of a table: told from it, and named."""

from __future__ import annotations

import re
from collections.abc import Sequence

from greybox.errors import ModelError
from greybox.units import unit_converter

LOOKED_AT = 60  # lines in which the first row of numbers is looked for
NUMBER = re.compile(r"[+-]?(([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?|inf|infinity|nan)", re.IGNORECASE)
_SEPARATOR_LINE = re.compile(r'"?sep=(?P<separator>.|\\t)"?', re.IGNORECASE)
_BETWEEN = re.compile(r"[;,\s]+")


def read_separator_line(line: str) -> str | None:
    """The separator in the line ``sep=;`` that Excel writes first; None for any other line."""
    found = _SEPARATOR_LINE.fullmatch(line.strip(" \r"))
    return found["separator"].replace("\\t", "\t") if found else None


def describe_misplaced_header(lines: Sequence[str], numbers: Sequence[int]) -> str:
    """What stands between the first of ``lines`` and the rows of numbers, with the remedy; "" where nothing does.

    ``numbers``: line of the file of each, counted from 1. Only lines that hold something are given.
    """
    shown = [line.replace('"', "") for line in lines[:LOOKED_AT]]
    first = next((k for k, line in enumerate(shown) if _holds_numbers(line)), 0)
    if first < 2 or NUMBER.fullmatch(_words(shown[first - 1])[0]):
        return ""
    header, where = shown[first - 1], numbers[first - 1]
    if first == 2 and _are_units(header):
        example = "'time [s],u [V],x [um]'"
        return f"line {where} looks like units ({header.strip()}); put them into the header, as in {example}, and delete the line"
    if len(_words(shown[0])) == len(_words(header)):
        return ""
    before = f"the {first - 1} lines" if first > 2 else "the line"
    return (
        f"line {where} looks like the header ({header.strip()[:60]}); delete {before} before it, or begin them with '#'"
    )


def _words(line: str) -> list[str]:
    return [word for word in _BETWEEN.split(line.strip()) if word] or [""]


def _holds_numbers(line: str) -> bool:
    """Whether more than half of a line's words are numbers."""
    words = _words(line)
    return 2 * sum(NUMBER.fullmatch(word) is not None for word in words) > len(words)


def _are_units(line: str) -> bool:
    words = [word.strip("[]()") for word in _words(line)]
    try:
        for word in words:
            unit_converter(word, word)
    except ModelError:
        return False
    return any(words)
