"""Which template belongs to which code, and which function writes which class of result."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from greybox.base.findings import Check, Finding

Template = str | Callable[[Any], str]
Writer = Callable[[Any], str]

_templates: dict[str, Template] = {}
_writers: dict[str, Writer] = {}
WRITTEN_BY = {"result": ("result", "estimation")}
"""Modules of this package that serve another package than the one of their name, and which one."""


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


def renders(class_name: str) -> Callable[[Writer], Writer]:
    """Decorator: the function writes values of the class of this name. Class names are unique in the library."""

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
        return template(item)
    if isinstance(item, Finding):
        return template.format_map({"subject": item.subject, **item.values})
    return template.format(
        value=item.value, limit=item.limit, subject=item.subject, outcome="passed" if item.passed else "failed"
    )


def sentences(items: Iterable[Finding | Check]) -> tuple[str, ...]:
    """The sentences of several findings or checks, in their order."""
    return tuple(map(sentence, items))


def text(value: Any) -> str:
    """A result in plain text: what ``print(value)`` shows."""
    if isinstance(value, (Finding, Check)):
        return sentence(value)
    for load in (_load_for, lambda _: _load_all()):
        for kind in type(value).__mro__:
            load(kind)
            if kind.__name__ in _writers:
                return _writers[kind.__name__](value)
    raise TypeError(f"no module of greybox.rendering writes a {type(value).__name__}")


@cache
def _load_for(kind: type) -> None:
    """Import the module that serves the package of ``kind``, if there is one: printing one result should not load the whole library."""
    package = kind.__module__.split(".")
    if package[0] == "greybox" and len(package) > 1:
        for name in WRITTEN_BY.get(package[1], (package[1],)):
            if name in _modules():
                import_module(f"greybox.rendering.{name}")


@cache
def _load_all() -> None:
    """Import every module of this package; each registers what it holds."""
    for name in _modules():
        import_module(f"greybox.rendering.{name}")


@cache
def _modules() -> tuple[str, ...]:
    return tuple(module.name for module in pkgutil.iter_modules([str(Path(__file__).parent)]))
