"""What is said of a result, as a value: facts, sentences, tables, equations and figures, in the order in which they are read.

``result.describe()`` gives a `Document`; `greybox.show.printers` prints it, as plain text for a terminal and as a page. Texts are strings,
or findings, whose sentences stand in `greybox.show.sentences`. Numbers and units are written as a terminal has them
(``-5.01e-04 +- 3e-06``); the printer of the page typesets them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any, TypeAlias

from greybox.base.figure import Figure
from greybox.base.values import Finding

Text: TypeAlias = Finding | str


class Tone(StrEnum):
    """The colour at the edge of a text; the words say the same without the colour."""

    GOOD = "good"
    CAUTION = "caution"
    BAD = "bad"
    PLAIN = "plain"


@dataclass(frozen=True)
class Paragraphs:
    """Sentences, each a paragraph."""

    items: Sequence[Text]
    tone: Tone = Tone.PLAIN


@dataclass(frozen=True)
class Subheading:
    """A heading within a section."""

    title: Text


@dataclass(frozen=True)
class BulletList:
    """Short statements, one below the other."""

    items: Sequence[Text]


@dataclass(frozen=True)
class Facts:
    """Names and what there is to say of each: ``discretisation``, ``exact, zero-order hold``. A page has the ``title`` above them.

    ``width``: letters from the beginning of a line of plain text to what is said, for a list that is looked through; else a colon follows
    the name.
    """

    items: Sequence[tuple[str, Text]]
    title: str = ""
    width: int = 0


# Head of the last column of a table, where its cells speak for themselves: plain text leaves it out, a screen reader needs it.
REMARK = "remark"


class FileLink(str):
    """A file in the folder of the page as a cell of a table, by its path from there: a page opens it."""


@dataclass(frozen=True)
class TableBlock:
    """``rows`` of cells as text below ``head``; the first cell of a row names the row.

    A page has ``caption`` above it and ``note`` below. Plain text has ``corner`` in place of the first head, where the table stands for
    itself.
    """

    caption: Text
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: Text = ""
    corner: str = ""


@dataclass(frozen=True)
class Equation:
    """One equation: ``name`` and ``unit`` of the balance, and its LaTeX."""

    name: str
    unit: str
    latex: str


@dataclass(frozen=True)
class EquationList:
    """Equations below one another, and the same as plain text for those who copy it."""

    items: Sequence[Equation]
    text: str = ""


# By so many stretches a long curve of a page is drawn: as fine as a wide screen shows.
MOST_STRETCHES = 2000


@dataclass(frozen=True)
class FigureBlock:
    """A figure to look into closely, with a button for each of its panels.

    Parameters
    ----------
    figure
        What it shows.
    stretches
        By so many stretches a long curve is drawn.
    group
        Figures of one group zoom together along the horizontal axis.
    switch
        Figures with the same switch change their panels together.
    """

    figure: Figure
    stretches: int = MOST_STRETCHES
    group: str = ""
    switch: str = ""


@dataclass(frozen=True)
class CodeBlock:
    """Text to copy: a command, a listing."""

    text: str
    title: Text = ""


@dataclass(frozen=True)
class Details:
    """Blocks that open on request."""

    summary: Text
    blocks: Sequence[Block]


Block: TypeAlias = (
    "Paragraphs | Subheading | BulletList | Facts | TableBlock | EquationList | FigureBlock | CodeBlock | Details"
)


class Later(Sequence[Any]):
    """Blocks that are made when somebody reads them: plain text of a fit should not draw its figures, nor test its residual.

    ``Later(make, *arguments)`` is the list of what ``make(*arguments)`` yields.
    """

    def __init__(self, make: Callable[..., Iterable[Any]], *arguments: Any, **options: Any) -> None:
        self._make = lambda: list(make(*arguments, **options))

    @cached_property
    def _made(self) -> list[Any]:
        return self._make()

    def __getitem__(self, place: Any) -> Any:
        return self._made[place]

    def __len__(self) -> int:
        return len(self._made)


@dataclass(frozen=True)
class Section:
    """Blocks below a heading. ``name`` is its address within the page, ``title`` stands above it."""

    name: str
    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Document:
    """What is said of a result, once for the terminal and for the page.

    Parameters
    ----------
    title
        What it is.
    answer
        One sentence with its two or three numbers: the first line of plain text, and the first of the page's box. A small value without
        one is all ``details``.
    tone
        The colour of the box.
    table
        The one table that stands below the answer, with the facts or texts that go with it.
    notes
        What to know before trusting it, the worst first: plain text has the first `MOST_NOTES`, the page has all.
    details
        What plain text shows on request, beside what stands above.
    question
        What a page answers.
    evidence
        The one figure that convinces: it stands below the box.
    sections
        The rest of the page; a result without sections has no page of its own.
    kind
        What the page is called above its title.
    """

    title: Text
    answer: Text = ""
    tone: Tone = Tone.PLAIN
    table: Sequence[Block] = ()
    notes: Sequence[Text] = ()
    details: Sequence[Block] = ()
    question: Text = ""
    evidence: Sequence[FigureBlock] = ()
    sections: Sequence[Section] = ()
    kind: str = "report"

    @property
    def verdict(self) -> Paragraphs:
        """The answer and its notes, for the page of another result."""
        return Paragraphs([self.answer, *self.notes], self.tone)
