"""A page as a value: sections of text, tables, equations and figures, in the order in which they are read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from greybox.plots.figure import Figure
from greybox.plots.style import PAGE

Tone = Literal["good", "caution", "bad", "plain"]


@dataclass(frozen=True)
class Text:
    """Paragraphs in plain words. ``tone`` colours the edge of a verdict; the words say the same without the colour."""

    paragraphs: Sequence[str]
    tone: Tone = "plain"


@dataclass(frozen=True)
class Heading:
    """A heading within a section."""

    title: str


@dataclass(frozen=True)
class Listing:
    """Short statements, one below the other."""

    items: Sequence[str]


@dataclass(frozen=True)
class Table:
    """``rows`` of cells as text below ``head``; ``caption`` says what it shows. The first cell of a row names the row."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


@dataclass(frozen=True)
class Equation:
    """One equation: ``name`` and ``unit`` of the balance, and its LaTeX."""

    name: str
    unit: str
    latex: str


@dataclass(frozen=True)
class Equations:
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
class Code:
    """Text to copy: a command, a listing."""

    text: str
    title: str = ""


@dataclass(frozen=True)
class Folded:
    """Blocks that open on request."""

    summary: str
    blocks: Sequence[Block]


Block: TypeAlias = "Text | Heading | Listing | Table | Equations | FigureBlock | Code | Folded"


@dataclass(frozen=True)
class Section:
    """A heading and what stands below it. ``name`` is its address within the page."""

    name: str
    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Page:
    """A report: ``title``, the ``question`` it answers, the ``verdict`` in plain words, then the evidence."""

    title: str
    question: str
    verdict: Text
    sections: Sequence[Section]
    kind: str = "report"
