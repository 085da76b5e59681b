"""What a column of a file means: its name, its unit, and how the unit is known. Every format, the survey and the shell go through it."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from typing import NamedTuple

from greybox.base import ModelError
from greybox.base.units import KNOWN, LONG, SPELLINGS, parse_powers
from greybox.data.notation import PRODUCT, WORDS, converts, is_notation, read_notation

TIME = "time"  # the name of the time column


class UnitSource(StrEnum):
    """How the unit of a column is known."""

    NONE = "none"
    """Nothing states one."""
    STATED = "stated"
    """Brackets of the header, a row of units, an attribute or a format of the file."""
    NAME = "name"
    """The header says it in words or as a quotient: ``t in ms``, ``n/rpm``."""
    ENDING = "ending"
    """The name ends like a unit, which may be chance: ``time_ms``, ``x_mm``, ``millis``."""
    TOLD = "told"
    """The person who reads the file: ``--column 'time [ms]=time_ms'``."""
    SIZE = "size"
    """The numbers: stamps since 1970."""


@dataclass(frozen=True)
class Column:
    """A column of a file.

    Attributes
    ----------
    header
        As the file has it, whole.
    name, unit
        Its parts; the unit as it is written, "" where none is stated.
    position
        Place in the table, from 0.
    known
        How the unit is known.
    """

    header: str
    name: str
    unit: str
    position: int
    known: UnitSource = UnitSource.NONE

    @property
    def is_time(self) -> bool:
        """Whether its name is that of the time. ``T`` is a temperature."""
        return self.name == "t" or self.name.lower() == TIME


# Characters of a header; in a longer one neither unit nor name are looked for.
LONGEST_HEADER = 200
# Digits in brackets count the elements of an array: /arm.joint[2] [rad].
_SQUARE = re.compile(
    r"(?P<name>(?:[^\[\]]|(?<=\S)\[(?!1\])\d+\])*?)(?!(?<=[^\s\[\]])\[(?!1\])\d+\])\s*\[(?P<unit>[^\[\]]*)\]\s*(?P<rest>[^\[\]]*)"
)
# Signs for a unit (degree Celsius, ms, kW in one character of Asian fonts) and wide letters and brackets.
_ONE_SIGN = re.compile("[\u2100-\u214f\u3300-\u33ff\uff01-\uff5e]+")
# Brackets that may belong to the name: Laser (ch1), log{2}.
_OTHER = {")": "(", "}": "{", ">": "<"}


def parse_header(header: str, position: int) -> Column:
    """``x [um]``, ``x {um}`` or ``x (um)`` as name and unit; parentheses without a unit (``Laser (ch1)``) belong to the name."""
    whole = header.strip()
    # One character of a unit or of a whole line of wide ones is what it stands for.
    text = _ONE_SIGN.sub(lambda sign: unicodedata.normalize("NFKC", sign.group()), whole)
    if len(text) > LONGEST_HEADER:
        return Column(whole, text, "", position)
    square = _SQUARE.fullmatch(text)
    # Behind its brackets a name may go on, if they hold a unit: time [ms] raw.
    if square and (not square["rest"] or _looks_like_unit(square["unit"].strip())):
        name, unit = f"{square['name']} {square['rest']}".strip(), square["unit"].strip()
        return Column(whole, name, unit, position, UnitSource.STATED if unit else UnitSource.NONE)
    for at in (k for k, letter in enumerate(text) if k and letter == _OTHER.get(text[-1])):
        unit = text[at + 1 : -1].strip()
        if _looks_like_unit(unit):
            return Column(whole, text[:at].strip(), unit, position, UnitSource.STATED)
    return Column(whole, text, "", position)


def _looks_like_unit(text: str) -> bool:
    if text == "-":
        return True
    if not any(letter.isalpha() or letter in "%°‰" for letter in text):
        return False  # channel numbers: Laser (1)
    return is_notation(text)


# Separators of a name and what may be its unit; the first group states it, the others only look so (timeMs, tms).
_SEPARATOR = re.compile(
    r"(?P<states>[\s_]+in[\s_]+|\s*[/,]\s*)|[\s_.:;|-]+|(?<=[a-z])(?=[A-Z][a-z]+$)"
    r"|(?i:(?:(?<=^t)|(?<=time)|(?<=stamp)|(?<=zeit))(?=(?:ms|us|ns|sec|min|millis|micros)$))"
)
_GROUP = re.compile(r"[\[({<][^\[\](){}<>]+[\])}>]")
_WORD = re.compile(r"[^\W\d_]+|[%‰]")
# Symbols that a name may end with, beside those that every model uses.
_EVERYDAY = {
    *KNOWN,
    *("h", "day", "degC", "degF", "psi", "inch", "ft", "lbf", "lb", "gal", "turn", "kgf", "g_0", "mbar", "hPa"),
    *("permille", "hp", "metric_horsepower", "knot", "Ohm", "kohm", "kWh", "Wh", "Ah", "mAh", "kmh", "mph"),
}


def read_endings(column: Column) -> tuple[Column, ...]:
    """What a column may be whose header states no unit: ``time_ms``, ``timeMs``, ``ms_time`` and ``millis`` may be a time in ms."""
    text = column.name
    if column.unit or len(text) > LONGEST_HEADER:
        return ()
    cuts = [
        (text[: cut.start()], text[cut.end() :], UnitSource.NAME if cut["states"] else UnitSource.ENDING)
        for cut in _SEPARATOR.finditer(text)
        if cut.start()
    ]
    # Brackets or a word of several letters anywhere; the name is what stands around it.
    words = [word for word in _WORD.finditer(text) if len(word.group()) > 1 or word.group() in "%‰"]
    cuts += [
        (
            f"{text[: cut.start()]} {text[cut.end() :]}".strip(" _-.:;|()"),
            cut.group().strip("(){}<>"),
            UnitSource.ENDING,
        )
        for cut in (*_GROUP.finditer(text), *words)
    ]
    readings = [replace(column, name=name, unit=_find_everyday(unit), known=known) for name, unit, known in cuts]
    return tuple(reading for reading in readings if reading.unit)


@lru_cache(maxsize=4096)
def _find_everyday(text: str) -> str:
    """The text as an everyday unit; in small letters where it begins with a capital (``MS``, ``Mm``); "" where it is none."""
    plain = text.removeprefix("(").removesuffix(")") if text[:1] == "(" else text
    if len(plain) == 1 and plain.isalpha() and plain not in _EVERYDAY:
        return ""  # phi_r is a reference, not turns
    for unit in dict.fromkeys((plain.lower(), plain) if plain[:1].isupper() and len(plain) > 1 else (plain,)):
        # Asked beforehand: the registry is slow to say no, and a file has thousands of words.
        if not all(map(_is_everyday_word, _WORD.findall(unit))):
            continue
        try:
            powers = parse_powers(read_notation(unit))[1]
        except ModelError:
            continue
        if powers and _EVERYDAY.issuperset(powers):
            return unit
    return ""


def _is_everyday_word(word: str) -> bool:
    for special, plain in SPELLINGS.items():
        word = word.replace(special, plain)
    word = word.partition("^")[0]
    tables = (_EVERYDAY, LONG, WORDS)
    return any(word in table or word.lower() in table for table in tables) or PRODUCT.fullmatch(word) is not None


# Names of a time beside ``time`` and ``t``; only asked about.
_TIME_WORDS = frozenset(
    ("time", "t", "timestamp", "timestamps", "stamp", "clock", "zeit", "zeitstempel", "elapsed", "uptime", "since")
)


def read_time(column: Column) -> Column | None:
    """The column as the time, if its header may be that of one; its unit is a guess where it is known by the ending."""
    for reading in (*read_endings(column), column):
        words = {w.lower() for w in re.split(r"[\W_]+|(?<=[a-z])(?=[A-Z])", reading.name) if w != "T"}
        if (words & _TIME_WORDS or not reading.name) and (not reading.unit or converts(reading.unit, "s")):
            return reading
    return None


# Rows, or lines, above a table in which its header is looked for.
HEADER_LINES = 60
# Rows of numbers, one after the other, with which a table begins: one alone may state a date or a setting above it.
FIRST_ROWS = 3


class TableHead(NamedTuple):
    """Where a table begins, by the numbers of its rows from 0: the row of names, those of texts below it, the first of values."""

    names: int
    below: tuple[int, ...]
    first: int


def find_table_head(rows: Sequence[Sequence[str | None]]) -> TableHead | None:
    """The header of a table below a title: the first of the fullest rows of texts above the rows of values, or the one above its units.

    ``rows``: the first ones of a file, whose cells are texts, "" where nothing is, and None for a value. None without such rows.
    """
    values = [sum(cell is None for cell in row) for row in rows]
    filled = [sum(cell != "" for cell in row) for row in rows]
    are_rows = [2 * count > total for count, total in zip(values, filled, strict=True)]
    texts = [total if not count else 0 for count, total in zip(values, filled, strict=True)]
    if not any(are_rows):  # a table of words with few numbers
        are_rows = [bool(count) and any(texts[:k]) for k, count in enumerate(values)]
    start = next(
        (k for k in range(len(rows)) if all(are_rows[k : k + FIRST_ROWS])), are_rows.index(True) if any(are_rows) else 0
    )
    if not any(texts[:start]):
        return None
    names = texts.index(max(texts[:start]))
    # An index has a unit, and often no name.
    if names and is_row_of_units([str(cell) for cell in rows[names]]) and 2 * texts[names - 1] > texts[names]:
        names -= 1
    # The rows below the names begin with the first value, though they may be damaged, or hold words.
    first = next(k for k in range(names + 1, len(rows)) if values[k])
    return TableHead(names, tuple(k for k in range(names + 1, first) if filled[k]), first)


def is_row_of_units(fields: Sequence[str]) -> bool:
    """Whether texts below a row of names are their units: more than half of them."""
    stated = [word for field in fields if (word := field.strip("[](){} "))]
    return 2 * sum(word == "-" or is_notation(word) for word in stated) > len(stated)


def join_units(names: Sequence[str | None], units: Sequence[str | None]) -> list[str | None]:
    """Headers ``name [unit]`` of a row of names and the row of units below it; a name with a unit of its own stays as it is."""
    below = [str(unit or "").strip("[](){}<> ") for unit in units]
    below += [""] * (len(names) - len(units))
    return [
        f"{name} [{unit}]" if name and unit and not parse_header(str(name), 0).unit else name
        for name, unit in zip(names, below, strict=False)
    ]
