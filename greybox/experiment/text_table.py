"""Text tables: separator, decimal sign and encoding recognised, numbers read exactly, offending lines named."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from greybox.errors import DataError
from greybox.experiment.preamble import LOOKED_AT, NUMBER, describe_misplaced_header, read_separator_line
from greybox.experiment.problems import RowLabels
from greybox.experiment.table import describe_non_numbers

GAPS = ("", "NA", "N/A", "n/a", "null", "NULL", "None")  # besides nan in any spelling
NO_NUMBER = "?"
CHUNK = 20_000  # lines taken apart at a time
BLANKS = ""  # separator: any run of blanks
SEPARATORS = (";", "\t", ",", BLANKS)
SNIFFED = 20  # lines looked at for the separator
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
    places: RowLabels
    separator: str
    header_line: int
    comments: tuple[str, ...] = ()

    def values(self, positions: Sequence[int]) -> tuple[dict[int, np.ndarray], list[str]]:
        """Columns (N,) as float64 with NaN for gaps, and the problems met."""
        first, *others = (self._read(positions, decimal) for decimal in self._decimals())
        columns, ragged, bad = min([first, *others], key=lambda reading: sum(map(len, reading[2].values())))
        if ragged:
            return columns, [self._ragged(ragged)]
        found = ((self.headers[k], list(texts), list(texts.values())) for k, texts in bad.items() if texts)
        return columns, [describe_non_numbers(header, rows, texts, self.places) for header, rows, texts in found]

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
        for start in range(0, len(self.lines), CHUNK):
            rows = [split_line(line, self.separator) for line in self.lines[start : start + CHUNK]]
            ragged |= {start + k: len(row) for k, row in enumerate(rows) if len(row) != len(self.headers)}
            for k in () if ragged else positions:
                columns[k][start : start + CHUNK], wrong = _numbers([row[k] for row in rows], decimal)
                bad[k] |= {start + row: rows[row][k] for row in wrong}
        return columns, ragged, bad

    def _ragged(self, ragged: dict[int, int]) -> str:
        """Message for lines with more or fewer fields than the header; ``ragged`` is row -> number of fields."""
        rows, wanted = list(ragged), len(self.headers)
        first = ragged[rows[0]]
        several = f"have another number of fields ({first} in the first of them)"
        found = f"has {first} field{'s' if first > 1 else ''}" if len(rows) == 1 else several
        decimal_comma = self.separator == "," and first > wanted
        remedy = (
            "write a decimal point, or ';' between the columns"
            if decimal_comma
            else "give every line one field a column"
        )
        return f"{self.places.say(rows)} {found}, the header (line {self.header_line}) has {wanted}; {remedy}"


def read_text(path: Path) -> TextTable:
    """Open a text table. Raises DataError for an empty or binary file, and where the header is not the first line."""
    text = _decoded(path.read_bytes(), path.name)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    kept = [k for k, line in enumerate(lines) if line and not line.isspace() and not line.lstrip().startswith("#")]
    if not kept:
        raise DataError(f"{path.name}: the file is empty; it needs a header line and rows of numbers")
    stated = read_separator_line(lines[kept[0]])
    if stated is not None and len(kept) > 1:
        kept = kept[1:]
    header, body = kept[0], kept[1:]
    separator = stated or _separator(lines[header], [lines[k] for k in body[:SNIFFED]])
    headers = split_header(lines[header], separator)
    if all(NUMBER.fullmatch(h.replace(",", ".")) for h in headers):
        raise DataError(
            f"{path.name}: line {header + 1} holds numbers where the header should be; begin the file with a line"
            " of names and units such as 'time [s],u [V],x [um]' (a line that begins with '#' is a comment)"
        )
    misplaced = describe_misplaced_header([lines[k] for k in kept[:LOOKED_AT]], [k + 1 for k in kept[:LOOKED_AT]])
    if misplaced:
        raise DataError(f"{path.name}: {misplaced}")
    places = RowLabels("line", np.array(body, dtype=np.int64) + 1)
    comments = tuple(line for line in lines if line.lstrip().startswith("#"))
    return TextTable(tuple(headers), tuple(lines[k] for k in body), places, separator, header + 1, comments)


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


def _separator(header: str, body: Sequence[str]) -> str:
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


def _decoded(raw: bytes, name: str) -> str:
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


def _numbers(texts: Sequence[str], decimal: str) -> tuple[np.ndarray, list[int]]:
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
