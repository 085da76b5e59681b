"""Text tables: separator, decimal sign and encoding recognised, numbers read exactly, offending lines named."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from greybox.errors import DataError, ModelError
from greybox.experiment.policy import READING_POLICY, ReadingPolicy
from greybox.experiment.problems import RowLabels
from greybox.experiment.table import describe_non_numbers
from greybox.units import unit_converter

GAPS = ("", "NA", "N/A", "n/a", "null", "NULL", "None")  # besides nan in any spelling
NO_NUMBER = "?"
BLANKS = ""  # separator: any run of blanks
SEPARATORS = (";", "\t", ",", BLANKS)
NUMBER = re.compile(r"[+-]?(([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?|inf|infinity|nan)", re.IGNORECASE)
_SEPARATOR_LINE = re.compile(r'"?sep=(?P<separator>.|\\t)"?', re.IGNORECASE)
_BETWEEN_WORDS = re.compile(r"[;,\s]+")
# Blanks separate, but not those before or inside the brackets of a unit: time [s]  p_a [kPa].
_BLANK_HEADER = re.compile(r"\"[^\"]*\"|[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?")
_BLANK_FIELD = re.compile(r"\"[^\"]*\"|\S+")

# Columns; row -> number of fields where it is not that of the header; column -> row -> text that is no number.
Reading = tuple[dict[int, np.ndarray], dict[int, int], dict[int, dict[int, str]]]


@dataclass(frozen=True)
class TextTable:
    """Lines of a text file that hold numbers, under their ``headers``; ``header_line`` is counted from 1.

    ``comments``: the lines that begin with ``#``.
    """

    headers: tuple[str, ...]
    lines: tuple[str, ...]
    row_labels: RowLabels
    separator: str
    header_line: int
    comments: tuple[str, ...] = ()
    policy: ReadingPolicy = field(default=READING_POLICY, repr=False)

    def values(self, positions: Sequence[int]) -> tuple[dict[int, np.ndarray], list[str]]:
        """Columns (N,) as float64 with NaN for gaps, and the problems met."""
        first, *others = (self._read(positions, decimal) for decimal in self._decimals())
        columns, ragged, bad = min([first, *others], key=lambda reading: sum(map(len, reading[2].values())))
        if ragged:
            return columns, [self._describe_ragged(ragged)]
        wrong = ((self.headers[k], list(texts), list(texts.values())) for k, texts in bad.items() if texts)
        return columns, [describe_non_numbers(header, rows, texts, self.row_labels) for header, rows, texts in wrong]

    def _decimals(self) -> tuple[str, ...]:
        """Decimal signs worth trying: a comma can be one wherever it does not separate columns."""
        text = "" if self.separator == "," else "".join(self.lines)
        if "," not in text:
            return (".",)
        return (".", ",") if "." in text else (",",)

    def _read(self, positions: Sequence[int], decimal: str) -> Reading:
        columns = {k: np.zeros(len(self.lines)) for k in positions}
        ragged: dict[int, int] = {}
        bad: dict[int, dict[int, str]] = {k: {} for k in positions}
        chunk = self.policy.rows_per_chunk
        for start in range(0, len(self.lines), chunk):
            rows = [split_line(line, self.separator) for line in self.lines[start : start + chunk]]
            ragged |= {start + k: len(row) for k, row in enumerate(rows) if len(row) != len(self.headers)}
            for k in () if ragged else positions:
                columns[k][start : start + chunk], wrong = _to_numbers([row[k] for row in rows], decimal)
                bad[k] |= {start + row: rows[row][k] for row in wrong}
        return columns, ragged, bad

    def _describe_ragged(self, ragged: dict[int, int]) -> str:
        """Message for lines with more or fewer fields than the header; ``ragged`` is row -> number of fields."""
        rows, expected = list(ragged), len(self.headers)
        first = ragged[rows[0]]
        several = f"have another number of fields ({first} in the first of them)"
        what = f"has {first} field{'s' if first > 1 else ''}" if len(rows) == 1 else several
        decimal_comma = self.separator == "," and first > expected
        remedy = (
            "write a decimal point, or ';' between the columns"
            if decimal_comma
            else "give every line one field a column"
        )
        lines = self.row_labels.describe(rows)
        return f"{lines} {what}, the header (line {self.header_line}) has {expected}; {remedy}"


def read_text(path: Path, policy: ReadingPolicy = READING_POLICY) -> TextTable:
    """Open a text table. Raises DataError for an empty or binary file, and where the header is not the first line."""
    text = _decode(path.read_bytes(), path.name)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    kept = [k for k, line in enumerate(lines) if line and not line.isspace() and not line.lstrip().startswith("#")]
    if not kept:
        raise DataError(f"{path.name}: the file is empty; it needs a header line and rows of numbers")
    stated = read_separator_line(lines[kept[0]])
    if stated is not None and len(kept) > 1:
        kept = kept[1:]
    header, body = kept[0], kept[1:]
    separator = stated or _guess_separator(lines[header], [lines[k] for k in body[: policy.separator_lines]])
    headers = split_header(lines[header], separator)
    if all(NUMBER.fullmatch(h.replace(",", ".")) for h in headers):
        raise DataError(
            f"{path.name}: line {header + 1} holds numbers where the header should be; begin the file with a line"
            " of names and units such as 'time [s],u [V],x [um]' (a line that begins with '#' is a comment)"
        )
    first = kept[: policy.header_lines]
    misplaced = describe_misplaced_header([lines[k] for k in first], [k + 1 for k in first])
    if misplaced:
        raise DataError(f"{path.name}: {misplaced}")
    labels = RowLabels("line", np.array(body, dtype=np.int64) + 1)
    comments = tuple(line for line in lines if line.lstrip().startswith("#"))
    rows = tuple(lines[k] for k in body)
    return TextTable(tuple(headers), rows, labels, separator, header + 1, comments, policy)


def split_line(line: str, separator: str) -> list[str]:
    """The fields of a line, blanks around them removed."""
    if separator == BLANKS:
        return line.split() if '"' not in line else [f.strip('"').strip() for f in _BLANK_FIELD.findall(line)]
    if '"' not in line:
        return [f.strip() for f in line.split(separator)]
    return [f.strip() for f in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]


def split_header(line: str, separator: str) -> list[str]:
    """The headers of the header line; with blanks as separator a unit in brackets stays with its name."""
    if separator != BLANKS:
        return split_line(line, separator)
    return [f.strip('"').strip() for f in _BLANK_HEADER.findall(line)]


def read_separator_line(line: str) -> str | None:
    """The separator in the line ``sep=;`` that Excel writes first; None for any other line."""
    match = _SEPARATOR_LINE.fullmatch(line.strip(" \r"))
    return match["separator"].replace("\\t", "\t") if match else None


def describe_misplaced_header(lines: Sequence[str], numbers: Sequence[int]) -> str:
    """What instruments put between the first of ``lines`` and the rows of numbers, with the remedy; "" where nothing is.

    ``numbers``: line of the file of each, counted from 1. Only lines that hold something are given.
    """
    plain = [line.replace('"', "") for line in lines]
    first = next((k for k, line in enumerate(plain) if _is_row_of_numbers(line)), 0)
    if first < 2 or NUMBER.fullmatch(_split_words(plain[first - 1])[0]):
        return ""
    header, number = plain[first - 1], numbers[first - 1]
    if first == 2 and _is_row_of_units(header):
        example = "'time [s],u [V],x [um]'"
        return f"line {number} looks like units ({header.strip()}); put them into the header, as in {example}, and delete the line"
    if len(_split_words(plain[0])) == len(_split_words(header)):
        return ""
    before = f"the {first - 1} lines" if first > 2 else "the line"
    return f"line {number} looks like the header ({header.strip()[:60]}); delete {before} before it, or begin them with '#'"


def _split_words(line: str) -> list[str]:
    return [word for word in _BETWEEN_WORDS.split(line.strip()) if word] or [""]


def _is_row_of_numbers(line: str) -> bool:
    """Whether more than half of a line's words are numbers."""
    words = _split_words(line)
    return 2 * sum(NUMBER.fullmatch(word) is not None for word in words) > len(words)


def _is_row_of_units(line: str) -> bool:
    words = [word.strip("[]()") for word in _split_words(line)]
    try:
        for word in words:
            unit_converter(word, word)
    except ModelError:
        return False
    return any(words)


def _guess_separator(header: str, body: Sequence[str]) -> str:
    """The separator by which header and most lines have the same number (over 1) of fields, else the busiest."""
    best, best_share = "", 0.0
    for separator in SEPARATORS:
        count = len(split_header(header, separator))
        share = sum(len(split_line(line, separator)) == count for line in body) / max(len(body), 1)
        if count > 1 and share > best_share:
            best, best_share = separator, share
    if best_share:
        return best
    counts = Counter({s: len(split_header(header, s)) for s in SEPARATORS[:3]})
    separator, count = counts.most_common(1)[0]
    return separator if count > 1 else BLANKS


def _decode(raw: bytes, name: str) -> str:
    wide = raw[:2] in (b"\xff\xfe", b"\xfe\xff")
    if b"\0" in raw[:4096] and not wide:
        raise DataError(f"{name}: this is not a text file; export it as CSV, .npz, .mat (-v7) or .parquet")
    try:
        return raw.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        if wide:
            raise DataError(f"{name}: not readable as UTF-16 text ({error}); save it again as UTF-8") from error
        # What older instruments write; it has the micro and degree signs, and every byte is a letter in it.
        return raw.decode("latin-1")


def _to_numbers(texts: Sequence[str], decimal: str) -> tuple[np.ndarray, list[int]]:
    """Numbers (N,) with NaN for gaps, and the rows whose text is neither a number nor a gap."""
    if decimal == ",":
        texts = [text.replace(",", ".") if "." not in text else NO_NUMBER for text in texts]
    together = "".join(texts)
    # Python reads 1_000 and digits of other scripts as numbers; nobody who looks at the file would.
    if "_" not in together and together.isascii():
        try:
            return np.array(list(map(float, texts))), []
        except ValueError:
            pass  # a gap or a text: looked at one by one below
    values, wrong = np.full(len(texts), np.nan), []
    for k, text in enumerate(texts):
        if NUMBER.fullmatch(text):
            values[k] = float(text)
        elif text not in GAPS:
            wrong.append(k)
    return values, wrong
