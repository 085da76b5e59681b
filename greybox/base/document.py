"""A page as a value: sections of text, tables, equations and figures, in the order in which they are read.

Texts are strings, or findings, whose sentences stand in `greybox.show.sentences`. Numbers in them are written as a terminal has
them (``-5.01e-04 +- 3e-06``); the printer of the page typesets them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

import numpy as np

from greybox.base.findings import Finding
from greybox.show.figures.figure import Figure, typeset_exponents, typeset_unit
from greybox.show.figures.sheet import PAGE
from greybox.show.sentences.wording import format_number

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
    """Blocks below a heading. ``name`` is its address within the page, ``title`` stands above it."""

    name: str
    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Page:
    """A report: its title, the ``question`` it answers, the ``verdict`` with the one figure that convinces beside it, then the rest."""

    title: Text
    question: Text
    verdict: Paragraphs
    sections: Sequence[Section]
    kind: str = "report"
    evidence: FigureBlock | None = None


# How a page writes numbers, units and ranges: with the signs that a terminal may lack.

# The hyphen in front of a negative number, not the one within a name or between two numbers.
NEGATIVE = re.compile(r"(?<![^\s(\[,;=])-(?=\d)")

__all__ = ["format_number", "format_range", "typeset_number", "typeset_unit"]


def typeset_number(text: str) -> str:
    """A text with numbers as print has it: ``-5.01e-04 +- 3e-06`` is −5.01·10⁻⁴ ± 3·10⁻⁶."""
    return NEGATIVE.sub("−", typeset_exponents(text.replace("+-", "±").replace(" x noise", " × noise")))


def format_range(values: np.ndarray) -> str:
    """``-3.1 to 2.7``, of the finite ``values`` (N,)."""
    known = values[np.isfinite(values)]
    return f"{known.min():.4g} to {known.max():.4g}".replace("-", "−") if len(known) else "nothing"
