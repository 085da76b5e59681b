"""A document as plain text: what ``print(result)`` and a command show."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from greybox.base import Finding, to_line
from greybox.base import document as doc
from greybox.base.texts import to_lines
from greybox.show.sentences.registry import sentence


def print_text(document: doc.Document) -> str:
    """The brief of a document."""
    return print_blocks(document.brief)


def print_blocks(blocks: Iterable[doc.Block]) -> str:
    """Blocks as lines of text, an empty line between two of them."""
    return "\n\n".join("\n".join(lines) for block in blocks if (lines := block_lines(block)))


def block_lines(block: doc.Block) -> list[str]:
    """The lines of one block; a figure has none."""
    match block:
        case doc.Paragraphs():
            return [_say(item) for item in block.items]
        case doc.BulletList():
            return [f"  {_say(item)}" for item in block.items]
        case doc.Facts():
            return [_name(name, block.width) + _say(text) for name, text in block.items]
        case doc.TableBlock():
            head = [block.corner or block.head[0], *block.head[1:]]
            return table_lines([*head[:-1], "" if head[-1] == doc.REMARK else head[-1]], block.rows)
        case doc.EquationList() | doc.CodeBlock():
            return [block.text]
        case doc.Subheading():
            return [_say(block.title)]
        case doc.Details():
            inside = [line for inner in block.blocks for line in _indented(inner)]
            return [_say(block.summary), *inside]
        case doc.FigureBlock():
            return []


def _indented(block: doc.Block) -> list[str]:
    """The lines of a block within another one; tables and lists are indented already."""
    lines = "\n".join(block_lines(block)).splitlines()
    return lines if isinstance(block, (doc.TableBlock, doc.BulletList)) else [f"  {line}" for line in lines]


def _say(text: doc.Text) -> str:
    return sentence(text) if isinstance(text, Finding) else to_lines(text)


def _name(name: str, width: int) -> str:
    return f"{to_line(name):<{width}}" if width else f"{to_line(name)}: " if name else ""


def table_lines(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table, indented by two; each column as wide as it must be."""
    lines = [[to_line(cell) for cell in row] for row in [head, *rows]]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return ["  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in lines]
