"""A document as a page: one HTML file that opens without a network: style, scripts and figures inside.

Texts come from models, records and results of others. They become HTML here and nowhere else: Jinja escapes what stands in the
template, `mathml` what stands in equations, `embedded` what the page's script reads. The page's content security policy is the
second wall: a browser runs the two scripts whose hashes it names, and fetches nothing.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import math
import re
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from html import escape, unescape
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import quote
from xml.etree import ElementTree as ET

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from latex2mathml.converter import convert_to_element
from markupsafe import Markup

from greybox.base import DataError, Finding, write_file
from greybox.base.document import Block, Details, Document, FigureBlock, FileLink, TableBlock, Text
from greybox.show.figures.figure import PALETTE, raise_powers, typeset_number
from greybox.show.figures.plotly_backend import css_variable, height_on_page, to_plotly
from greybox.show.sentences import sentence
from greybox.show.sentences.wording import as_sentence

# What attributes an equation may have: none that links, loads or runs.
MATHML_ATTRIBUTES = (
    "xmlns display stretchy fence form separator accent accentunder linethickness mathvariant columnalign columnspacing rowspacing"
    " columnlines rowlines displaystyle scriptlevel width height depth minsize maxsize movablelimits lspace rspace"
)
# Characters that HTML does not have: left out.
CONTROL_CHARACTERS = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
MARKUP = {"hovertemplate"}  # templates hold markup of ours, and what they hold of others is escaped already


# Bytes of a page: what an e-mail still carries.
LARGEST_PAGE = 6000000


def render_page(page: Document) -> str:
    """The page as HTML. Raises DataError where it would be larger than 6 MB."""
    script = _inside("page.js")
    drawn = page.evidence or any(_has_figure(block) for section in page.sections for block in section.blocks)
    scripts: list[str | bytes] = [script, *([read_plotly()] if drawn else [])]
    html = (
        _environment()
        .get_template("page.html")
        .render(
            page=page,
            style=page_style(),
            script=script,
            plotly=pack_plotly() if drawn else "",
            policy=security_policy(scripts),
        )
    )
    html = _as_text(html)
    if len(html.encode()) > LARGEST_PAGE:
        raise DataError(
            f"the report {label(page.title)!r} is larger than {LARGEST_PAGE / 1e6:.0f} MB; give fewer records"
        )
    return html


def write_page(page: Document, path: str | Path) -> Path:
    """Write the page to ``path`` (folders are made) and return it."""
    return write_file(path, render_page(page))


def _has_figure(block: Block) -> bool:
    return isinstance(block, FigureBlock) or (isinstance(block, Details) and any(map(_has_figure, block.blocks)))


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("greybox.show.printers", "template"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"mathml": mathml, "data": embedded, "kind": lambda block: type(block).__name__.lower()}
    environment.filters |= {
        "notes": split_notes,
        "answer": say_answer,
        "filled": leave_empty_columns_out,
        "height": height_on_page,
        "say": say,
        "label": label,
        "cell": cell,
        "heading": heading,
        "unit": raise_powers,
        "whole": keep_options_whole,
    }
    return environment


def security_policy(scripts: Sequence[str | bytes]) -> str:
    """What a browser may do for a page: run scripts of these texts, style, and nothing else."""
    digests = [hashlib.sha256(text.encode() if isinstance(text, str) else text).digest() for text in scripts]
    allowed = " ".join(f"'sha256-{b64encode(digest).decode()}'" for digest in digests)
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:;"
        " base-uri 'none'; form-action 'none'"
    )


def mathml(latex: str) -> Markup:
    """LaTeX as MathML, which browsers typeset and screen readers read; as its text where it cannot be typeset."""
    latex = _as_text(latex)
    try:
        root = convert_to_element(latex, display="block")
    # Only the converter runs here, whose errors have no common class: the reader gets the formula as it is written.
    except Exception:
        return Markup("<code>{}</code>").format(latex)
    for element in root.iter():
        # The converter leaves texts as they came, with marks of its own such as &#x0002B; among them.
        element.text, element.tail = (None if t is None else unescape(t) for t in (element.text, element.tail))
        for name in {*element.attrib}.difference(MATHML_ATTRIBUTES.split()):
            del element.attrib[name]
    return Markup(ET.tostring(root, encoding="unicode"))


def figure_content(block: FigureBlock) -> dict[str, Any]:
    """What a page's script needs of a figure, as plain values, its texts escaped for Plotly."""
    drawn = to_plotly(block.figure, block.stretches)
    return {
        "data": _plain(drawn.traces, shown=True),
        "views": [{**_plain(view, shown=True), "name": view["name"]} for view in drawn.views],
        "signals": _plain(drawn.signals),
        "group": block.group,
        "switch": block.switch,
    }


def embedded(block: FigureBlock) -> Markup:
    """What the page's script needs of a figure, as JSON that cannot end the script element it stands in."""
    text = json.dumps(figure_content(block), allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


# Lines of the box at the head of a page, and letters of one of them over its full width.
BOX_LINES, BOX_LETTERS = 5, 105


def split_notes(page: Document) -> tuple[list[str], list[str]]:
    """The notes of a page: those that find room in its box below the answer, and those that a fold keeps."""
    texts = list(dict.fromkeys(map(say, page.notes)))
    left = BOX_LINES - math.ceil(len(say(page.answer)) / BOX_LETTERS)
    for k, text in enumerate(texts):
        left -= math.ceil(len(text) / BOX_LETTERS)
        if left < 0:
            return texts[:k], texts[k:]
    return texts, []


def leave_empty_columns_out(table: TableBlock) -> TableBlock:
    """The table without columns in which nothing stands below the head."""
    filled = [k for k in range(len(table.head)) if not table.rows or any(row[k] for row in table.rows)]
    return replace(table, head=[table.head[k] for k in filled], rows=[[row[k] for k in filled] for row in table.rows])


def say_answer(page: Document) -> str:
    """The first sentence; where it begins with the name of what the page is about, that stays as it is written."""
    first, text = label(page.answer).partition(" ")[0], say(page.answer)
    names = [word.strip(",:;") for word in label(page.title).split()]
    return first + text[len(first) :] if first.strip(",:;") in names else text


def say(texts: Text | Sequence[Text]) -> str:
    """Texts as sentences, with numbers as print has them."""
    return " ".join(as_sentence(label(text)) for text in ([texts] if isinstance(texts, (Finding, str)) else texts))


def label(text: Text) -> str:
    """A text that is no sentence: a title, a caption of a table."""
    return typeset_number(sentence(text) if isinstance(text, Finding) else text).replace(
        " -> ", " \N{RIGHTWARDS ARROW} "
    )


# Spaces at which a line of a cell should not break: around ± and ×, and in front of the unit at its end.
UNBROKEN = re.compile(r" (?=[±×])|(?<=[±×]) |(?<=\d) (?=\S{1,8}$)")


# A unit behind a number at the end of a cell, or of one of several things in it.
UNIT_AT_END = re.compile(r"(?<=[\d⁰-⁹¹²³]) ((?:1/)?[^\W\d_][\w^*/()]*)(?=$|, )")


def cell(text: str, head: str = "") -> str:
    """A cell of a table below ``head``, with numbers and units as print has them; a value is not torn from its unit or its uncertainty."""
    if isinstance(text, FileLink):
        return Markup('<a href="{}">{}</a>').format(quote(text), text)
    if head == "unit":
        return raise_powers(text).replace(" ", "\N{NO-BREAK SPACE}")
    if text == "-":
        return "–"
    number = UNIT_AT_END.sub(
        lambda match: raise_powers(match[0]).replace(" ", "\N{NO-BREAK SPACE}"), typeset_number(text)
    )
    return UNBROKEN.sub("\N{NO-BREAK SPACE}", number)


# An option of a command within a text; a line would be broken behind its hyphens.
OPTION = re.compile(r"(?<!\S)--[\w-]+")


def keep_options_whole(text: str) -> Markup:
    """A text in which no line is broken within an option of a command."""
    return Markup(OPTION.sub(lambda match: f'<span class="whole">{match[0]}</span>', str(Markup.escape(text))))


# A unit in the head of a column: ``B [N*s/m]``.
UNIT_OF_COLUMN = re.compile(r"(?<=\[)[^\[\]]+(?=\])")


def heading(text: str) -> str:
    """The head of a column, its unit as print has it."""
    return UNIT_OF_COLUMN.sub(lambda match: raise_powers(match[0]), text)


def page_style() -> Markup:
    """The colours of figures by their roles, in front of the style of all else."""
    light = "".join(f"{css_variable(role)}:{shade.light};" for role, shade in PALETTE.items())
    dark = "".join(f"{css_variable(role)}:{shade.dark};" for role, shade in PALETTE.items())
    return Markup(f':root{{{light}}}\n:root[data-theme="dark"]{{{dark}}}\n') + _inside("page.css")


# Significant digits of a number in a figure.
REPORT_DIGITS = 6


def _plain(value: Any, *, shown: bool = False) -> Any:
    """Arrays as lists, numbers in six digits, what is not finite as null (a gap in a curve).

    ``shown``: texts are for Plotly, which takes some tags in them as markup; they are escaped, but for the templates of ours.
    """
    if isinstance(value, dict):
        return {str(k): _plain(v, shown=shown and k not in MARKUP) for k, v in value.items()}
    if isinstance(value, str):
        return escape(value, quote=False) if shown else value
    if isinstance(value, np.ndarray):
        return _short(value) if value.dtype.kind == "f" else value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(v, shown=shown) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(f"{value:.{REPORT_DIGITS}g}") if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def _short(values: np.ndarray) -> list[float | None]:
    """Numbers (N,) in six digits, as short in JSON as they can be."""
    known = np.isfinite(values)
    sizes = np.abs(np.where(known & (values != 0), values, 1.0))
    places = np.clip(REPORT_DIGITS - 1 - np.floor(np.log10(sizes)), -300, 300)
    factors = 10.0 ** np.abs(places)
    rounded = np.where(places >= 0, np.rint(values * factors) / factors, np.rint(values / factors) * factors)
    return [v if is_known else None for v, is_known in zip(rounded.tolist(), known.tolist(), strict=True)]


def _inside(name: str) -> Markup:
    """A file of the package, copied into the page unchanged."""
    return Markup(files("greybox.show.printers").joinpath("template", name).read_text(encoding="utf-8"))


def _as_text(text: str) -> str:
    """What a page can hold: without control characters, and with a mark for what is no character (a file name that is not UTF-8)."""
    return CONTROL_CHARACTERS.sub("", text).encode("utf-8", "replace").decode()


# Of Plotly's script: higher levels save 200 kB and cost a quarter of a second on every page.
REPORT_COMPRESSION = 1


@cache
def pack_plotly() -> Markup:
    """Plotly's own script, packed; the page unpacks it."""
    return Markup(b64encode(gzip.compress(read_plotly(), REPORT_COMPRESSION, mtime=0)).decode())


@cache
def read_plotly() -> bytes:
    """Plotly's own script. Read as a file: importing plotly takes time, and 5 MB become 2."""
    home = find_spec("plotly")  # `files` would import it
    if home is None or not home.submodule_search_locations:
        raise DataError("a page with figures needs plotly, which is not installed; pip install plotly")
    return Path(home.submodule_search_locations[0], "package_data", "plotly.min.js").read_bytes()
