"""From findings, checks and results to English: every sentence that the program says about a result is in this package.

A module of this package serves one package of the library (``sentences/estimation.py`` serves ``greybox.estimation``). It holds

- ``register({code: template})``: one template for each code of findings, checks and other enumerations. A template is a format string
  over the finding's values and ``subject`` (``"The residual in {subject} is {ratio:.3g} times the sensor noise"``), in which lists,
  plurals, shares and units have specs of their own (`greybox.show.sentences.wording.SentenceFormatter`), or a function from the finding
  to its sentence where it depends on values.
- ``@renders("Profile")``: the function that writes a value of the class of that name, as a text or as blocks (`greybox.base.document`). A
  result that has a page is described in `greybox.show.documents`.

One style holds for all of them:

- A finding or a check is one clause that follows ``note:``, ``warning:``, ``error:``, ``next:``, ``remedy:`` or the name of a record:
  a small first letter, no full stop at its end. A cause follows a colon; a remedy is an imperative and follows a semicolon or a colon:
  ``output 'x' is constant at 3e-06: a constant signal carries no information; leave it out``.
- An answer is a paragraph of full sentences with capitals and full stops: the conclusion of a discovery, the verdict of a comparison,
  the text of a page, the caption of a figure. Pages write findings as sentences (`greybox.show.sentences.wording.as_sentence`).
- Headings, panel titles, table heads and table cells have no full stop.
- Subject first, then the number with its unit, then what it means, then the remedy. Present tense, active voice, no figure of speech.
- The words are those of ``docs/glossary.md``: a *parameter* is fitted; the *residual* is measured minus simulated; *estimation records*
  and *validation records*; *initial state*; *simulation error* and *prediction error*; a *gap* is a stretch of time without rows.

A writer is found by the name of the class, so a module needs a result class for type checking only.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from greybox.base import Check, Finding, to_line
from greybox.show.sentences.wording import fill_in

Template = str | Callable[[Any], str]
Writer = Callable[[Any], str | Sequence[Any]]

_templates: dict[str, Template] = {}
_writers: dict[str, Writer] = {}
# Packages that bring their sentences in a module ``document`` of their own.
EXTENSIONS = "greybox.extensions"


def register(new: Mapping[str, Template]) -> None:
    """Add templates by code.

    Raises
    ------
    ValueError
        If a code has a template already: codes are unique in the library.
    """
    twice = sorted(str(code) for code in new if str(code) in _templates)
    if twice:
        raise ValueError(f"codes with two templates: {', '.join(twice)}")
    _templates.update({str(code): template for code, template in new.items()})


def writes(*codes: str) -> Callable[[Callable[[Any], str]], Callable[[Any], str]]:
    """Decorator: the function is the template of these codes."""

    def add(writer: Callable[[Any], str]) -> Callable[[Any], str]:
        register(dict.fromkeys(codes, writer))
        return writer

    return add


def renders(class_name: str) -> Callable[[Writer], Writer]:
    """Decorator: the function writes values of the class of this name, as a text or as blocks. Class names are unique in the library."""

    def add(writer: Writer) -> Writer:
        if class_name in _writers:
            raise ValueError(f"two functions write {class_name}")
        _writers[class_name] = writer
        return writer

    return add


def templates() -> Mapping[str, Template]:
    """Every template by its code, from all modules of this package."""
    _load_all()
    return dict(_templates)


def sentence(item: Finding | Check) -> str:
    """The sentence of a finding or a check.

    Raises
    ------
    KeyError
        If its code has no template.
    """
    code = item.code if isinstance(item, Finding) else item.rule
    if code not in _templates:
        _load_for(type(code))
    if code not in _templates:  # read from a file: a plain string that does not say which package it belongs to
        _load_all()
    template = _templates[code]
    if not isinstance(template, str):
        text = template(item)
    elif isinstance(item, Finding):
        text = fill_in(template, (), {"subject": item.subject, **item.values})
    else:
        text = template.format(
            value=item.value, limit=item.limit, subject=item.subject, outcome="passed" if item.passed else "failed"
        )
    # Subjects and values may be texts of a file.
    return to_line(text)


def sentences(items: Iterable[Finding | Check]) -> tuple[str, ...]:
    """The sentences of several findings or checks, in their order."""
    return tuple(map(sentence, items))


def find_writer(value: Any) -> Writer:
    """The function that writes values of this class.

    Raises
    ------
    TypeError
        If there is none.
    """
    for load in (_load_for, lambda _: _load_all()):
        for kind in type(value).__mro__:
            load(kind)
            if kind.__name__ in _writers:
                return _writers[kind.__name__]
    raise TypeError(f"no module of greybox.show writes a {type(value).__name__}")


@cache
def _load_for(kind: type) -> None:
    """Import the modules that serve the package of ``kind``, if there are any: printing one result should not load the whole library."""
    module = kind.__module__
    if module.startswith("greybox.") and not module.startswith(f"{EXTENSIONS}."):
        # ``greybox.estimation.linear.sampling``: the modules ``estimation`` and ``linear`` here.
        for part in module.split("."):
            if part in _modules():
                import_module(f"{__package__}.{part}")
    # An extension has a module ``document`` beside its classes.
    elif (package := module.rpartition(".")[0]) and find_spec(f"{package}.document") is not None:
        import_module(f"{package}.document")


@cache
def _load_all() -> None:
    """Import every module of this package and those of the extensions; each registers what it holds."""
    for name in _modules():
        import_module(f"{__package__}.{name}")
    for extension in pkgutil.iter_modules(import_module(EXTENSIONS).__path__):
        if find_spec(beside := f"{EXTENSIONS}.{extension.name}.document") is not None:
            import_module(beside)


@cache
def _modules() -> tuple[str, ...]:
    return tuple(module.name for module in pkgutil.iter_modules([str(Path(__file__).parent)]))
