"""What MkDocs does with a page before it is built: formulas between dollar signs become MathML, which browsers typeset offline."""

from __future__ import annotations

import re
from typing import Any

from latex2mathml.converter import convert

DISPLAYED = re.compile(r"^\$\$(.+?)\$\$", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"(?<![\\$`\w])\$(?!\s)([^$\n`]+?)(?<!\s)\$(?![\w$])")
CODE = re.compile(r"(^```.*?^```|`[^`\n]+`)", re.DOTALL | re.MULTILINE)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page's text with its formulas typeset; code is left as it is."""
    pieces = CODE.split(markdown)
    return "".join(piece if k % 2 else _typeset(piece) for k, piece in enumerate(pieces))


def _typeset(text: str) -> str:
    text = DISPLAYED.sub(lambda found: _line(convert(found.group(1).strip(), display="block")), text)
    return INLINE.sub(lambda found: _line(convert(found.group(1))), text)


def _line(mathml: str) -> str:
    """In one line, so that Markdown takes it for one piece."""
    return " ".join(mathml.split())
