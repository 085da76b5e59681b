"""A page as a value: sections of text, tables, equations and figures, in the order in which they are read.

Texts are findings, whose sentences stand in `greybox.rendering`, or strings that come from elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

from greybox.findings import Finding
from greybox.plots.figure import Figure
from greybox.plots.style import PAGE

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
class PageTable:
    """``rows`` of cells as text below ``head``; ``caption`` says what it shows. The first cell of a row names the row."""

    caption: Text
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: Text = ""


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
    stretches: int = PAGE.most_stretches
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


Block: TypeAlias = "Paragraphs | Subheading | BulletList | PageTable | EquationList | FigureBlock | CodeBlock | Details"


@dataclass(frozen=True)
class Section:
    """Blocks below a heading. ``name`` is its address within the page; its title is the text of the code ``section_<name>``."""

    name: str
    blocks: Sequence[Block]

    @property
    def title(self) -> Finding:
        """What stands above it."""
        return Finding(f"section_{self.name}")


@dataclass(frozen=True)
class Page:
    """A report: its title, the ``question`` it answers, the ``verdict`` with the one figure that convinces beside it, then the rest."""

    title: Text
    question: Text
    verdict: Paragraphs
    sections: Sequence[Section]
    kind: str = "report"
    evidence: FigureBlock | None = None
