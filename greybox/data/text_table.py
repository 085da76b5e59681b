"""Text tables: separator, decimal sign and encoding recognised, numbers read exactly, offending lines named.

A file is read line by line, twice: once for its shape, once for the columns that are wanted. Nothing else of it is kept.
"""

from __future__ import annotations

import codecs
import csv
import re
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from greybox.base import DataError, Finding, shorten
from greybox.data.columns import (
    GAPS,
    WITHOUT_MARKS,
    Marks,
    check_size,
    check_width,
    describe_non_numbers,
    describe_wrong_count,
    find_decimal_signs,
    find_open_points,
    is_gap,
)
from greybox.data.headers import HEADER_LINES, find_table_head, is_row_of_units, join_units
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.problems import RowLabels
from greybox.data.stamps import StampReader, Stamps, is_stamp

NO_NUMBER = "?"
BLANKS = ""  # separator: any run of blanks
SEPARATORS = (";", "\t", ",", BLANKS)
NUMBER = re.compile(r"[+-]?(([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?|inf|infinity|nan)", re.IGNORECASE)
_SEPARATOR_LINE = re.compile(r'"?sep=(?P<separator>.|\\t)"?', re.IGNORECASE)
# Blanks separate, but not those before or inside the brackets of a unit: time [s]  p_a [kPa].
_BLANK_HEADER = re.compile(r"\"[^\"]*\"|[^\s\[(]+(?:\s*[\[(][^\])]{0,100}[\])])?")
_BLANK_FIELD = re.compile(r"\"[^\"]*\"|\S+")
# What a spreadsheet writes instead of a number: #N/A, #DIV/0!, #NAME?, in other languages #NV, #WERT!
_SPREADSHEET_ERROR = re.compile(r"#(N/A|NV|[^\W\d_]+(/0)?[!?])(?=[,;\t]|\s+[-+.\d#]|\s*$)")
_WIDE_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


class Reading(NamedTuple):
    """What a table holds where ``decimal`` is the decimal sign."""

    decimal: str
    columns: dict[int, np.ndarray | Stamps]
    ragged: dict[int, list[str]]
    """Row -> its fields, where they are not as many as the headers."""
    bad: dict[int, dict[int, str]]
    """Column -> row -> text that is no number."""
    marks: dict[int, Marks]
    """What the columns show of their marks, where no row before showed the decimal sign."""


@dataclass(frozen=True)
class TextSource:
    """Where the lines come from: the file and its encoding."""

    path: Path
    encoding: str

    def read_lines(self) -> Iterator[str]:
        """Every line, however lines end, without its end."""
        with open(self.path, encoding=self.encoding, newline=None) as file:
            for line in file:
                yield line.removesuffix("\n")


@dataclass(frozen=True)
class TextTable:
    """Lines of a text file that hold numbers, under their ``headers``; ``header_line`` is counted from 1.

    ``comments``: the lines that begin with ``#`` or ``%``. ``headless``: the file has no header, and the headers are the numbers of
    the columns. ``skipped``: lines of the table before the first row of numbers, of which the last is the header where ``has_header_line``.
    ``dated``: as of `DataTable`, by the first row. ``signs``: decimal signs that the first rows show.
    """

    source: TextSource
    headers: tuple[str, ...]
    row_labels: RowLabels
    separator: str
    header_line: int
    skipped: int
    comments: tuple[str, ...] = ()
    headless: bool = False
    has_header_line: bool = False
    has_comma: bool = False
    has_point: bool = True
    signs: frozenset[str] = frozenset()
    dated: Mapping[int, bool] = field(default_factory=dict)
    policy: ReadingPolicy = field(default=READING_POLICY, repr=False)

    @property
    def rows(self) -> int:
        """Rows of numbers."""
        return len(self.row_labels.numbers) if self.row_labels.numbers is not None else 0

    @property
    def numbered(self) -> tuple[int, ...]:
        """Positions of the columns, in the order in which they are counted."""
        return tuple(range(len(self.headers)))

    def rename(self, names: Sequence[str]) -> TextTable:
        """The table with ``names`` for headers. Raises DataError for another number of them."""
        if len(names) != len(self.headers):
            raise DataError(describe_wrong_count(names, len(self.headers)))
        named = replace(self, headers=tuple(names), headless=False)
        # A line whose wanted fields are numbers is a row, whatever stands in the others.
        wanted = [text for text, name in zip(self.headers, names, strict=True) if name]
        numbers = self.row_labels.numbers
        if not self.has_header_line or numbers is None or not _holds_numbers(wanted):
            return named
        labels = RowLabels(self.row_labels.word, np.concatenate([[self.header_line], numbers]))
        return replace(named, skipped=self.skipped - 1, row_labels=labels)

    def values(self, positions: Sequence[int]) -> tuple[dict[int, np.ndarray | Stamps], list[str], tuple[Finding, ...]]:
        """Columns (N,) as float64 with NaN for gaps, or as stamps, the problems met, and what is to be said of the columns."""
        positions = list(dict.fromkeys(positions))
        check_size(self.rows, len(positions), self.policy)
        readings = (self._read(positions, decimal) for decimal in self._decimals())
        decimal, columns, ragged, bad, marks = min(readings, key=lambda reading: sum(map(len, reading.bad.values())))
        if ragged:
            return {k: np.zeros(0) for k in positions}, [self._describe_ragged(ragged)], ()
        wrong = ((self.headers[k], list(texts), list(texts.values())) for k, texts in bad.items() if texts)
        problems = [
            describe_non_numbers(header, rows, texts, self.row_labels, self.separator) for header, rows, texts in wrong
        ]
        if any(decimal in shown.decimal for shown in marks.values()):
            return columns, problems, ()
        problems += [
            f"column {shorten(self.headers[k])!r}: {shown.between[decimal]!r} beside '{shown.short:g}'; write {WITHOUT_MARKS}, or as many"
            " decimals in every row"
            for k, shown in marks.items()
            if shown.are_thousands(decimal) and not bad[k]
        ]
        points = (find_open_points(self.headers[k], shown, self.headers) for k, shown in marks.items())
        return columns, problems, tuple(chain.from_iterable(points))

    def _decimals(self) -> tuple[str, ...]:
        """Decimal signs worth trying: a comma can be one wherever it does not separate columns."""
        if self.separator == "," or not self.has_comma:
            return (".",)
        return (".", ",") if self.has_point else (",",)

    def _read(self, positions: Sequence[int], decimal: str) -> Reading:
        columns = {k: np.zeros(self.rows) for k in positions if k not in self.dated}
        stamps = {k: StampReader(GAPS) for k in positions if k in self.dated}
        ragged: dict[int, list[str]] = {}
        bad: dict[int, dict[int, str]] = {k: {} for k in positions}
        marks = {} if decimal in self.signs else {k: Marks() for k in columns}
        lines, start = islice(filter(_is_of_table, self.source.read_lines()), self.skipped, None), 0
        while block := list(islice(lines, self.policy.rows_per_chunk)):
            if start + len(block) > self.rows:
                break
            rows = [split_line(line, self.separator) for line in block]
            ragged |= {start + k: row for k, row in enumerate(rows) if len(row) != len(self.headers)}
            for k in () if ragged else positions:
                texts = [row[k] for row in rows]
                if k in stamps:
                    wrong = stamps[k].add(texts)
                else:
                    columns[k][start : start + len(block)], wrong = _to_numbers(texts, decimal)
                if k in marks:
                    is_marked = np.array(["." in text or "," in text for text in texts])
                    marks[k].add(texts if is_marked.any() else (), columns[k][start : start + len(block)][~is_marked])
                bad[k] |= {start + row: rows[row][k] for row in wrong}
            start += len(block)
        if start != self.rows:
            raise DataError(f"{self.source.path.name}: the file changed while it was read; read it again")
        dated = {} if ragged else {k: reader.finish() for k, reader in stamps.items()}
        return Reading(decimal, {**columns, **dated}, ragged, bad, marks)

    def _describe_ragged(self, ragged: dict[int, list[str]]) -> str:
        """Message for lines with more or fewer fields than the header; ``ragged`` is row -> fields."""
        rows, expected = list(ragged), len(self.headers)
        first = len(ragged[rows[0]])
        several = f"have another number of fields ({first} in the first of them)"
        what = f"has {first} field{'s' if first > 1 else ''}" if len(rows) == 1 else several
        sign = repr(self.separator) if self.separator != BLANKS else "a blank"
        if all(len(row) == expected + 1 and not row[-1] for row in ragged.values()):
            remedy = (
                f"the lines end with {sign} and the header does not: write it behind the header as well, or delete it"
            )
        elif not self.headers[-1] and all(len(row) == expected - 1 for row in ragged.values()):
            remedy = f"the header ends with {sign}: delete it there"
        elif self.separator == "," and first > expected:
            remedy = "write a decimal point, or ';' between the columns"
        else:
            remedy = "give every line one field a column"
        lines = self.row_labels.describe(rows)
        return f"{lines} {what}, the header (line {self.header_line}) has {expected}; {remedy}"


# Lines of comment that are kept, for a header or a condition among them.
MOST_COMMENTS = 1000
# Lines on which the separator is decided.
SEPARATOR_LINES = 20


def read_text(path: Path, policy: ReadingPolicy = READING_POLICY) -> TextTable:
    """Open a text table. Raises DataError for an empty or binary file, and where the header is not the first line."""
    source = TextSource(path, _find_encoding(path, policy))
    numbers, comments, first = _LineNumbers(), dict[int, str](), list[str]()
    has_comma = has_point = False
    for number, line in enumerate(source.read_lines(), 1):
        if _is_of_table(line):
            numbers.add(number)
            if len(first) < HEADER_LINES:
                first.append(line)
            has_comma = has_comma or "," in line
            has_point = has_point or "." in line
        elif len(comments) < MOST_COMMENTS and not (line == "" or line.isspace()):
            comments[number] = line
    if not first:
        raise DataError(f"{path.name}: the file is empty; it needs a header line and rows of numbers")
    stated = read_separator_line(first[0])
    skipped = 1 if stated is not None and len(first) > 1 else 0
    if not skipped:
        stated = None
    body = first[skipped + 1 : skipped + 1 + SEPARATOR_LINES]
    separator = stated or _guess_separator(first[skipped], body)
    rows = numbers.as_sequence()
    headers, header_line = split_header(first[skipped], separator), int(rows[skipped])
    # A row may hold words as well: below a comment that names every field, a line with a number is one.
    stated_header = _find_header_in_comments(comments, int(rows[skipped]), separator, len(headers))
    is_named = stated_header is not None and any(_is_value(field) for field in headers)
    headless, has_units = is_named or _holds_numbers(headers), False
    if not headless:
        below = split_header(first[skipped + 1], separator) if len(first) > skipped + 1 else []
        labelled = _name_by_labels(headers, below)
        if not labelled and (placed := _find_header(first[skipped:], stated, rows[skipped : len(first)], path.name)):
            skipped, separator = skipped + placed[0], placed[1]
            headers, header_line = split_header(first[skipped], separator), int(rows[skipped])
            below = split_header(first[skipped + 1], separator)
        has_units = not labelled and _holds_units(below, headers)
        if has_units:
            headers = [str(header) for header in join_units(headers, below)]
        headers = labelled or headers
        skipped += 0 if labelled else 1 + has_units
    else:
        if stated_header is not None:
            header_line, headers = stated_header
            headless = False
        else:
            headers = [str(k) for k in range(1, len(headers) + 1)]
    check_width(len(headers), policy)
    first_row = split_line(first[skipped], separator) if skipped < len(first) else []
    if any(headers) and len(first_row) == len(headers):
        # A column of numbers without a name, such as the index that pandas writes, is one; behind a last separator there is none.
        headers = [
            name or (f"column {k}" if text else "")
            for k, (name, text) in enumerate(zip(headers, first_row, strict=True), 1)
        ]
    # Fields of all columns say it, where those that are wanted may not.
    signs = find_decimal_signs(text for line in first[skipped:] for text in split_line(line, separator))
    has_comma, has_point = has_comma and signs != {"."}, has_point and signs != {","}
    dated = {k: ":" in text for k, text in enumerate(first_row) if is_stamp(text)}
    labels = RowLabels("line", rows[skipped:])
    has_header_line = skipped > 0 and int(rows[skipped - 1]) == header_line
    return TextTable(
        source,
        tuple(headers),
        labels,
        separator,
        header_line,
        skipped,
        tuple(comments.values()),
        headless,
        has_header_line,
        has_comma,
        has_point,
        signs,
        dated,
        policy,
    )


class _LineNumbers:
    """Numbers of the lines of a table: a range, as long as no blank line or comment lies between them."""

    def __init__(self) -> None:
        self.first = self.last = 0
        self.scattered: array | None = None

    def add(self, number: int) -> None:
        """One more line, behind the others."""
        if self.scattered is not None:
            self.scattered.append(number)
        elif not self.first:
            self.first = self.last = number
        elif number == self.last + 1:
            self.last = number
        else:
            self.scattered = array("q", range(self.first, self.last + 1))
            self.scattered.append(number)

    def as_sequence(self) -> Sequence[int] | np.ndarray:
        """The numbers in their order."""
        if self.scattered is not None:
            return np.frombuffer(self.scattered, dtype=np.int64)
        return range(self.first, self.last + 1) if self.first else range(0)


def _is_of_table(line: str) -> bool:
    """Whether a line belongs to the table: it is neither blank nor a comment. A spreadsheet's ``#N/A`` begins no comment."""
    text = line.lstrip()
    if not text:
        return False
    return text[0] not in "#%" or (text[0] == "#" and _SPREADSHEET_ERROR.match(text) is not None)


def _find_header_in_comments(
    comments: dict[int, str], first_row: int, separator: str, columns: int
) -> tuple[int, list[str]] | None:
    """Line and headers of the last comment before the first row that has a name for each column: ``# time [s], u [V], x [um]``."""
    for number, line in reversed([(n, text) for n, text in comments.items() if n < first_row]):
        text = line.lstrip().lstrip("#%").strip()
        for between in dict.fromkeys((separator, *SEPARATORS)):
            headers = split_header(text, between)
            if (
                columns > 1
                and len(headers) == columns
                and all(any(map(str.isalpha, name)) and NUMBER.fullmatch(name) is None for name in headers)
            ):
                return number, headers
    return None


def _holds_numbers(fields: Sequence[str]) -> bool:
    """Whether the fields are those of a row, not of a header: numbers and perhaps gaps."""
    numbers = [_is_value(field.replace(",", ".")) for field in fields]
    return any(numbers) and all(is_number or is_gap(field) for is_number, field in zip(numbers, fields, strict=True))


def _name_by_labels(first: Sequence[str], second: Sequence[str]) -> list[str]:
    """Names of the columns of a log whose every row says them, ``sec: 0.29  out: 64``: the words before the numbers; none of a header."""
    if len(first) != len(second):
        return []
    pairs = [(one.replace(",", "."), other.replace(",", ".")) for one, other in zip(first, second, strict=True)]
    are_words = [one == other and not _is_value(one) for one, other in pairs]
    are_numbers = [all(_is_value(text) or is_gap(text) for text in pair) for pair in pairs]
    if not any(are_words) or not any(are_numbers) or not all(map(any, zip(are_words, are_numbers, strict=True))):
        return []
    return [first[k - 1].rstrip(":=") if k and are_words[k - 1] and are_numbers[k] else "" for k in range(len(first))]


def _is_value(text: str) -> bool:
    """Whether a field is a number, a date or a time of day."""
    return NUMBER.fullmatch(text) is not None or is_stamp(text)


def split_line(line: str, separator: str) -> list[str]:
    """The fields of a line, blanks around them removed."""
    if separator == BLANKS:
        return line.split() if '"' not in line else [f.strip('"').strip() for f in _BLANK_FIELD.findall(line)]
    if '"' not in line:
        return [f.strip() for f in line.split(separator)]
    try:
        return [f.strip() for f in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    except csv.Error:  # a quotation mark that is never closed, and more behind it than a field may hold
        return [line]


def split_header(line: str, separator: str) -> list[str]:
    """The headers of the header line; with blanks as separator a unit in brackets stays with its name."""
    if separator != BLANKS:
        return split_line(line, separator)
    return [f.strip('"').strip() for f in _BLANK_HEADER.findall(line)]


def read_separator_line(line: str) -> str | None:
    """The separator in the line ``sep=;`` that Excel writes first; None for any other line."""
    match = _SEPARATOR_LINE.fullmatch(line.strip(" \r"))
    return match["separator"].replace("\\t", "\t") if match else None


def _find_header(
    lines: Sequence[str], stated: str | None, numbers: Sequence[int] | np.ndarray, name: str
) -> tuple[int, str] | None:
    """Which of ``lines`` is the header where others stand above it, and the separator, ``stated`` or that of the rows; None for the first.

    ``numbers``: line of the file of each, counted from 1. Raises DataError where a line between header and rows is neither.
    """
    last = lines[-SEPARATOR_LINES:]
    separator = stated or _guess_separator(last[-1], last[:-1])
    fields = [split_header(line, separator) for line in lines]
    columns = Counter(map(len, fields[-SEPARATOR_LINES:])).most_common(1)[0][0]
    # A title has another number of fields, unless a spreadsheet fills them up with empty ones; the header may lack a last separator.
    for counts in ((columns,), (columns - 1, columns + 1)):
        rows = [list(map(_to_word, row)) if len(row) in (columns, *counts) else [""] for row in fields]
        if (head := find_table_head(rows)) is not None:
            break
    else:
        return None
    odd = [k for k in head.below[1:] or head.below if not _holds_units(fields[k], fields[head.names])]
    if odd:
        raise DataError(
            f"{name}: line {numbers[head.names]} looks like the header ({shorten(lines[head.names])}), and line {numbers[odd[0]]}"
            f" below it holds neither its units nor numbers ({shorten(lines[odd[0]])}); delete the one that does not belong to the"
            " table, or begin it with '#'"
        )
    return (head.names, separator) if head.names else None


def _to_word(field: str) -> str | None:
    """A field as a cell of `find_table_head`; a dash may be a unit."""
    if _is_value(field.replace(",", ".")):
        return None
    return "" if field != "-" and is_gap(field) else field


def _holds_units(fields: Sequence[str], headers: Sequence[str]) -> bool:
    """Whether the line below the ``headers`` holds their units; a title above names has no such line."""
    words = [_to_word(field.strip("[](){} ")) for field in fields]
    texts = [word for word in words if word]
    is_full = len(fields) == len(headers) and None not in words and 2 * sum(map(bool, headers)) > len(texts)
    return is_full and is_row_of_units(texts)


def _guess_separator(header: str, body: Sequence[str]) -> str:
    """The separator by which header and most lines have the same number (over 1) of fields, numbers if possible, else the busiest."""
    best, best_share = "", (0.0, 0.0)
    for separator in SEPARATORS:
        count = len(split_header(header, separator))
        rows = [split_line(line, separator) for line in body]
        fitting = [row for row in rows if len(row) == count]
        share = (sum(map(_holds_numbers, fitting)) / max(len(rows), 1), len(fitting) / max(len(rows), 1))
        if count > 1 and share > best_share:
            best, best_share = separator, share
    if best_share > (0.0, 0.0):
        return best
    counts = Counter({s: len(split_header(header, s)) for s in SEPARATORS[:3]})
    separator, count = counts.most_common(1)[0]
    return separator if count > 1 else BLANKS


# Bytes looked at together when the encoding is found.
BYTES_PER_BLOCK = 1000000


def _find_encoding(path: Path, policy: ReadingPolicy) -> str:
    """The encoding of a text: UTF-8, UTF-16 with or without its mark, or that of older instruments.

    Raises DataError for a file that is no text, and for a line longer than the policy allows, which no table has.
    """
    with open(path, "rb") as file:
        start = file.read(BYTES_PER_BLOCK)
        encoding = _guess_encoding(start[:4096], path.name)
        decoder = codecs.getincrementaldecoder(encoding)()
        block, since_end = start, 0
        while block:
            *lines, rest = re.split(rb"[\r\n]", block)
            longest = max([since_end + len(lines[0]), *map(len, lines[1:])]) if lines else 0
            since_end = len(rest) if lines else since_end + len(rest)
            if max(longest, since_end) > policy.longest_line:
                raise DataError(
                    f"{path.name}: a line is longer than {policy.longest_line} characters; write one line for each row"
                )
            try:
                decoder.decode(block)
            except UnicodeDecodeError as error:
                if encoding.startswith("utf-16"):
                    raise DataError(
                        f"{path.name}: not readable as UTF-16 text ({error.reason}); save it again as UTF-8"
                    ) from error
                # What older instruments write; it has the micro and degree signs, and every byte is a letter in it.
                encoding = "latin-1"
                decoder = codecs.getincrementaldecoder(encoding)()
            block = file.read(BYTES_PER_BLOCK)
        try:
            decoder.decode(b"", final=True)
        except UnicodeDecodeError as error:
            if encoding.startswith("utf-16"):
                raise DataError(
                    f"{path.name}: not readable as UTF-16 text ({error.reason}); save it again as UTF-8"
                ) from error
            encoding = "latin-1"
    return encoding


# Bytes that no text has: control characters but for tabs, ends of lines and pages, and the end that old systems write.
_NO_TEXT = bytes({*range(32)} - {0, 9, 10, 11, 12, 13, 26, 27})


def is_text(path: Path) -> bool:
    """Whether a file is a text, as far as its first bytes tell."""
    with open(path, "rb") as file:
        start = file.read(4096)
    try:
        is_wide = _guess_encoding(start, path.name).startswith("utf-16")
    except DataError:
        return False
    return is_wide or start.translate(None, _NO_TEXT) == start


def _guess_encoding(start: bytes, name: str) -> str:
    if start[:2] in _WIDE_MARKS:
        return "utf-16"
    even, odd = start[0::2].count(0), start[1::2].count(0)
    if not even + odd:
        return "utf-8-sig"
    # Latin letters in UTF-16 without its mark: every other byte is zero, and no line end hides in the others.
    for zeros, others, encoding in ((odd, even, "utf-16-le"), (even, odd, "utf-16-be")):
        if others == 0 and 2 * zeros > len(start) // 2:
            return encoding
    raise DataError(f"{name}: this is not a text file; export it as CSV, .npz, .mat (-v7) or .parquet")


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
        elif not is_gap(text):
            wrong.append(k)
    return values, wrong
