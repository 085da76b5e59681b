"""Texts that try to become more than text, and values whose every text is one of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from typing import Any

from greybox.base.document import Later
from greybox.base.errors import GreyboxError
from greybox.base.values import Finding
from greybox.show.sentences import sentence

MARKUP = (
    """</script><script>window.hurt=1</script><img src=x onerror="window.hurt=1">""",
    """"><svg onload=window.hurt=1>'`${window.hurt=1}{{7*7}}""",
    r"""\href{javascript:window.hurt=1}{x}\text{</mtext><img src=x onerror=window.hurt=1>}""",
    """<a href="javascript:window.hurt=1">x</a>%{hurt}&lt;script&gt;--><!--""",
    """</title></style></textarea><iframe srcdoc="<script>parent.hurt=1</script>">""",
    """<math><mtext><table><mglyph><style><img src=x onerror=window.hurt=1>""",
)
"""Texts that run a script in a page that does not escape them: ``window.hurt`` is set then."""

RARER_MARKUP = (
    """<details open ontoggle=window.hurt=1>x</details><object data="data:text/html,<script>parent.hurt=1</script>"></object>""",
    """<style>@import "data:text/css,*{}";</style><link rel=stylesheet href=data:text/css,x onload=window.hurt=1>""",
    """<base href=//x.invalid/><form action=javascript:window.hurt=1><button autofocus onfocus=window.hurt=1>x</button></form>""",
    r"""\u003cscript\u003ewindow.hurt=1\u003c/script\u003e\x3cimg src=x onerror=window.hurt=1\x3e""",
    """&#60;script&#62;window.hurt=1&#60;/script&#62;&lt;img src=x onerror=window.hurt=1&gt;""",
    """`);window.hurt=1;//');window.hurt=1;//");window.hurt=1;//</script >""",
    """<template><img src=x onerror=window.hurt=1></template><noscript><p title="</noscript><img src=x onerror=window.hurt=1>">""",
)
"""The same by roads that fewer pages leave open; for the slow study."""

ELEMENTS = "img, iframe, object, embed, base, [onerror], [onload], [ontoggle], [onfocus]"
"""What no page has, and the texts would make."""

CODE = (
    "*/ int hurt(void){return 1;} /*",
    "x\n*/ void __attribute__((constructor)) hurt(void){} /*",
    "*\\\n/ void __attribute__((constructor)) hurt(void){} /*",
    "*??/\n/ void __attribute__((constructor)) hurt(void){} /*",
    '"""\nimport os; os.environ["HURT"]="1"\n"""',
    '\\"""\nimport os; os.environ["HURT"]="1"\n#',
    "\x00\x01\x1b[2J\x7f\x85\u2028\u2029\u202e\ufeff",
    "\ud800 half of a character",
    '"; end plant; model hurt Real hurt; equation hurt = 1; end hurt; //',
    "\r\nequation hurt = 1;\n//",
    "\\",
    "]]><hurt/> <!-- & &amp; &#0;",
)
"""Texts that end a comment or a literal of a language that does not escape them: something called ``hurt`` is there then."""


def poison(value: Any, texts: Iterator[str]) -> Any:
    """``value`` with every text in it replaced by the next of ``texts``; what is no text, or must be one of a few, stays."""
    if isinstance(value, (Enum, type)):
        return value
    if isinstance(value, str):
        return next(texts)
    if isinstance(value, Finding):
        return _poison_finding(value, texts)
    if is_dataclass(value):
        kept = {"name"} if type(value).__name__ in ("Section", "Figure") else set()
        changed = {
            f.name: poison(getattr(value, f.name), texts) for f in fields(value) if f.init and f.name not in kept
        }
        return replace(value, **changed)
    if isinstance(value, Mapping):
        return {key: poison(item, texts) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(poison(item, texts) for item in value)
    if isinstance(value, Later):
        return [poison(item, texts) for item in value]
    return value


def _poison_finding(finding: Finding, texts: Iterator[str]) -> Finding:
    """A finding with hostile texts in its values, as far as its sentence takes them."""
    poisoned = finding
    for name, value in [("", finding.subject), *finding.values.items()]:
        hostile = poison(value, texts)
        changed = (
            replace(poisoned, values={**poisoned.values, name: hostile}) if name else replace(poisoned, subject=hostile)
        )
        try:
            sentence(changed)
        except (
            GreyboxError,
            LookupError,
            ValueError,
            TypeError,
            AttributeError,
        ):  # one of a few words: the sentence depends on it
            continue
        poisoned = changed
    return poisoned
