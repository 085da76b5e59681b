"""A document as plain text: what ``print(result)`` and a command show.

The answer in the first line, one table, a few notes, and on request all else; each line as wide as the terminal, broken between words.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain

from greybox.base import Finding, to_line
from greybox.base import document as doc
from greybox.base.texts import LINE_WIDTH, to_lines, wrap
from greybox.show.sentences import sentence
from greybox.show.sentences.wording import count_noun

# Lines of a result without ``--details``, what a command prints below it among them: as many as a screen shows at once. What finds no
# room stands on the page and among the details.
MOST_LINES = 25
# Notes below the table, and rows that a table keeps at least.
MOST_NOTES, LEAST_ROWS = 5, 3


def print_text(
    document: doc.Document, width: int = LINE_WIDTH, *, details: bool | None = None, lines: int = MOST_LINES
) -> str:
    """The answer, the table and the notes of a document in at most ``lines``; with ``details`` all that a terminal can show.

    Where something is left out ``--details`` is named, or what gives a page in Python, where nobody said anything of ``details``.
    """
    if not document.answer:
        return print_blocks(document.details, width)
    answer, tables, notes = wrap(_say(document.answer), width), list(document.table), _list_notes(document.notes, width)
    if details:
        parts = _join([answer, *(block_lines(table, width) for table in tables), list(chain(*notes))])
        return "\n\n".join([*parts, *([print_blocks(document.details, width)] if document.details else [])])
    # Rows of each block that are shown, and how few they may become: the first table is there in any case, another with as many or not.
    rows = [len(table.rows) if isinstance(table, doc.TableBlock) else 0 for table in tables]
    least = [LEAST_ROWS if not any(rows[:k]) else 0 for k in range(len(rows))]
    count = min(len(notes), MOST_NOTES)
    while True:
        shown = [_first_rows(table, n, width, details) for table, n in zip(tables, rows, strict=True)]
        below = _first_notes(notes, count, details)
        parts = _join([answer, *shown, below])
        # An empty line stands between two parts.
        if sum(part.count("\n") + 2 for part in parts) - 1 <= lines:
            break
        # Notes and rows that say least stand last: those of the longer part give way.
        longer = [k for k in range(len(rows)) if rows[k] > least[k]]
        longest = max(longer, key=lambda k: len(shown[k]), default=None)
        if count > 1 and (longest is None or len(below) > len(shown[longest])):
            count -= 1
        elif longest is not None:
            rows[longest] = rows[longest] - 1 if rows[longest] > LEAST_ROWS else 0
        else:
            break
    return "\n\n".join(parts)


def _join(parts: Iterable[Sequence[str]]) -> list[str]:
    """Each part that has lines as one text."""
    return ["\n".join(lines) for lines in parts if lines]


def _first_rows(table: doc.Block, count: int, width: int, details: bool | None) -> list[str]:
    """The first ``count`` rows of a table, and how many are left."""
    if not isinstance(table, doc.TableBlock) or count >= len(table.rows):
        return block_lines(table, width)
    more = f"  ... {len(table.rows) - count} more{'' if details is None else ' with --details'}"
    return [*block_lines(replace(table, rows=table.rows[:count]), width), more] if count else []


def _list_notes(notes: Sequence[doc.Text], width: int) -> list[list[str]]:
    """The lines of each note; different findings may be one sentence."""
    texts = dict.fromkeys(map(_say, notes))
    return [wrap(text if text.startswith("remedy: ") else f"note: {text}", width, "  ") for text in texts]


def _first_notes(notes: Sequence[Sequence[str]], count: int, details: bool | None) -> list[str]:
    """The first ``count`` notes, which are the worst; how many are left."""
    left = len(notes) - count
    where = "gb.report(result, FOLDER)" if details is None else "--details, or the page"
    return [*chain(*notes[:count]), *([f"({count_noun(left, 'more note')}: {where})"] if left else [])]


def print_blocks(blocks: Iterable[doc.Block], width: int = LINE_WIDTH) -> str:
    """Blocks as lines of text, an empty line between two of them."""
    return "\n\n".join("\n".join(lines) for block in blocks if (lines := block_lines(block, width)))


def block_lines(block: doc.Block, width: int = LINE_WIDTH) -> list[str]:
    """The lines of one block; a figure has none."""
    match block:
        case doc.Paragraphs():
            return [line for item in block.items for line in wrap(_say(item), width, "  ")]
        case doc.BulletList():
            return [line for item in block.items for line in wrap(f"  {_say(item)}", width, "    ")]
        case doc.Facts():
            indent = " " * (block.width or 2)
            lines = [_name(name, block.width) + _say(text) for name, text in block.items]
            return [line for text in lines for line in wrap(text, width, indent)]
        case doc.TableBlock():
            head = [block.corner or block.head[0], *block.head[1:]]
            return table_lines([*head[:-1], "" if head[-1] == doc.REMARK else head[-1]], block.rows, width)
        case doc.EquationList() | doc.CodeBlock():
            return [block.text]
        case doc.Subheading():
            return [_say(block.title)]
        case doc.Details():
            inside = (line for inner in block.blocks for line in _indented(inner, width))
            return [*wrap(_say(block.summary), width, "  "), *inside]
        case doc.FigureBlock():
            return []


def _indented(block: doc.Block, width: int) -> list[str]:
    """The lines of a block within another one; tables and lists are indented already."""
    if isinstance(block, (doc.TableBlock, doc.BulletList)):
        return block_lines(block, width)
    return [f"  {line}" for line in "\n".join(block_lines(block, width - 2)).splitlines()]


# An option that a value follows.
OPTION = re.compile(r"(?<= )(--?[\w-]+) (?!-)")
# What a shell takes as one word, blanks included.
QUOTED = re.compile(r"'[^']*'")


def wrap_command(command: str, width: int) -> list[str]:
    """A command to copy: a line that is too long goes on behind a backslash. An option stays with its value."""
    # A blank in quotes is part of a word: a backslash there would be, too.
    joined = OPTION.sub("\\1\0", QUOTED.sub(lambda word: word.group().replace(" ", "\0"), command))
    lines = textwrap.wrap(joined, width - 2, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
    lines = [line.replace("\0", " ") for line in lines]
    return [*(f"{line} \\" for line in lines[:-1]), *lines[-1:]]


def _say(text: doc.Text) -> str:
    return sentence(text) if isinstance(text, Finding) else to_lines(text)


def _name(name: str, width: int) -> str:
    return f"{to_line(name):<{width}}" if width else f"{to_line(name)}: " if name else ""


# Tables: columns as wide as they must be; words wrap within a cell, and columns that find no room stand below.

# Letters that a column of words keeps at least when a table is too wide, and spaces between two columns.
LEAST_COLUMN, GAP = 8, 2


def table_lines(head: Sequence[str], rows: Sequence[Sequence[str]], width: int = LINE_WIDTH) -> list[str]:
    """Lines of a table, indented by two; each column as wide as it must be, the whole no wider than ``width``."""
    table = [[to_line(cell) for cell in row] for row in [head, *rows]]
    # A column that nothing stands in is left out.
    filled = [any(column) for column in zip(*table, strict=True)]
    columns = [column for column, kept in zip(zip(*table, strict=True), filled, strict=True) if kept]
    table = [list(row) for row in zip(*columns, strict=True)]
    widths = [max(map(len, column)) for column in columns]
    room = width - GAP - GAP * (len(widths) - 1)
    needed = [max((len(word) for cell in column for word in cell.split()), default=0) for column in columns]
    # Heads give way first, then the cells; of either the widest column of words.
    for least in (
        [max(n, *map(len, column[1:]), 0) for n, column in zip(needed, columns, strict=True)],
        [min(w, max(n, LEAST_COLUMN)) for w, n in zip(widths, needed, strict=True)],
    ):
        while (excess := sum(widths) - room) > 0:
            wide = max(range(len(widths)), key=lambda k: (widths[k] > least[k], widths[k]))
            if widths[wide] <= least[wide]:
                break
            widths[wide] = max(least[wide], widths[wide] - excess)
    lines: list[str] = []
    for group in _groups(widths, width - GAP):
        lines += [line for row in table for line in _row_lines([row[k] for k in group], [widths[k] for k in group])]
    return lines


def _groups(widths: Sequence[int], room: int) -> Iterator[list[int]]:
    """Numbers of the columns that stand side by side; each group begins with the first column, which names the rows."""
    group, used = [0], widths[0]
    for k in range(1, len(widths)):
        if used + GAP + widths[k] > room and len(group) > 1:
            yield group
            group, used = [0], widths[0]
        group.append(k)
        used += GAP + widths[k]
    yield group


def _row_lines(cells: Sequence[str], widths: Sequence[int]) -> list[str]:
    wrapped = [
        textwrap.wrap(cell, w, break_long_words=False, break_on_hyphens=False) or [""]
        for cell, w in zip(cells, widths, strict=True)
    ]
    height = max(map(len, wrapped))
    columns = [[*cell, *[""] * (height - len(cell))] for cell in wrapped]
    return [
        (" " * GAP + (" " * GAP).join(cell.ljust(w) for cell, w in zip(line, widths, strict=True))).rstrip()
        for line in zip(*columns, strict=True)
    ]
