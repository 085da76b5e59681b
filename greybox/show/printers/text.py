"""A document as plain text: what ``print(result)`` and a command show.

The answer in the first line, one table, a few notes, and on request all else; each line as wide as the terminal, broken between words.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from greybox.base import Finding, to_line
from greybox.base import document as doc
from greybox.base.texts import LINE_WIDTH, to_lines, wrap
from greybox.show.sentences import sentence
from greybox.show.sentences.wording import count_noun

# Notes below the table, and the lines that they take: what is said of a usual result fits on a screen. All stand on the
# page and among the details.
MOST_NOTES, NOTE_LINES = 5, 9
# Rows of the one table: a terminal shows as many without losing the answer above it.
MOST_ROWS = 12


def print_text(document: doc.Document, width: int = LINE_WIDTH, *, details: bool | None = None) -> str:
    """The answer, the table and the notes of a document; with ``details`` all else that a terminal can show.

    Where something is left out ``--details`` is named, or what gives a page in Python, where nobody said anything of ``details``.
    """
    if not document.answer:
        return print_blocks(document.details, width)
    tables = (block_lines(_shorten(table, details), width) for table in document.table)
    parts = [wrap(_say(document.answer), width), *tables, _note_lines(document.notes, width, details)]
    text = ["\n".join(lines) for lines in parts if lines]
    return "\n\n".join([*text, *([print_blocks(document.details, width)] if details and document.details else [])])


def _shorten(table: doc.Block, details: bool | None) -> doc.Block:
    """The first rows of a long table."""
    left = len(table.rows) - MOST_ROWS if isinstance(table, doc.TableBlock) and not details else 0
    if not isinstance(table, doc.TableBlock) or left < 2:
        return table
    more = [f"... {left} more{'' if details is None else ' with --details'}", *[""] * (len(table.head) - 1)]
    return replace(table, rows=[*table.rows[:MOST_ROWS], more])


def _note_lines(notes: Sequence[doc.Text], width: int, details: bool | None) -> list[str]:
    """Notes, the worst first, as many as there is room for; how many are left."""
    lines: list[str] = []
    # Different findings may be one sentence.
    texts = list(dict.fromkeys(map(_say, notes)))
    for k, text in enumerate(texts):
        new = wrap(text if text.startswith("remedy: ") else f"note: {text}", width, "  ")
        if not details and k and (k == MOST_NOTES or len(lines) + len(new) > NOTE_LINES):
            rest = "gb.report(result, FOLDER)" if details is None else "--details, or the page"
            return [*lines, f"({count_noun(len(texts) - k, 'more note')}: {rest})"]
        lines += new
    return lines


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
    table = [[cell for cell, kept in zip(row, filled, strict=True) if kept] for row in table]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    room = width - GAP
    needed = [
        max((len(word) for cell in column for word in cell.split()), default=0) for column in zip(*table, strict=True)
    ]
    least = [min(w, max(n, LEAST_COLUMN)) for w, n in zip(widths, needed, strict=True)]
    # The widest column of words gives way first.
    while (excess := sum(widths) + GAP * (len(widths) - 1) - room) > 0:
        wide = max(range(len(widths)), key=lambda k: (widths[k] > least[k], widths[k]))
        if widths[wide] <= least[wide]:
            break
        widths[wide] = max(least[wide], widths[wide] - excess)
    lines: list[str] = []
    for columns in _groups(widths, room):
        lines += [line for row in table for line in _row_lines([row[k] for k in columns], [widths[k] for k in columns])]
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
