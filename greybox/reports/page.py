"""A page as a value: sections of text, tables, equations and figures, in the order in which they are read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

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
class View:
    """What a figure shows once its button is pressed: the numbers of its ``traces``, and what that changes in its ``layout``.

    ``signals`` are residuals sampled evenly from ``start`` in steps of ``step`` seconds (``values``; ``figure``: the one that shows the
    spectrum, ``trace``: as which curve), whose spectra are taken anew over the stretch that is zoomed into.
    """

    traces: Sequence[int]
    layout: Mapping[str, Any] = field(default_factory=dict)
    signals: Sequence[Mapping[str, Any]] = ()


@dataclass(frozen=True)
class Figure:
    """A figure to look into closely.

    ``data`` and ``layout`` as Plotly takes them (plain lists and dictionaries, arrays); ``description`` says in words what is to be
    seen, for those who do not see it; ``height`` in pixels. Figures of one ``group`` zoom together along the horizontal axis.
    ``views`` are what buttons above it show, the first one at the beginning; figures with the same ``switch`` change theirs together.
    """

    name: str
    caption: str
    description: str
    data: Sequence[Mapping[str, Any]]
    layout: Mapping[str, Any]
    height: int = 360
    group: str = ""
    views: Mapping[str, View] = field(default_factory=dict)
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


Block: TypeAlias = "Text | Heading | Listing | Table | Equations | Figure | Code | Folded"


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
