"""Every code has one template and every template belongs to a code; a template states the figures of its finding."""

from __future__ import annotations

import pkgutil
from enum import StrEnum
from importlib import import_module

import pytest

import greybox
from greybox.base.values import Check, Finding, Printable, Severity, with_code
from greybox.show import _find_describer, text
from greybox.show.sentences import _writers, register, sentence, templates


def codes() -> dict[str, str]:
    """Every code of findings and checks that a package declares in its ``findings.py`` -> the enumeration it belongs to."""
    declared: dict[str, str] = {}
    for module in pkgutil.walk_packages(greybox.__path__, "greybox."):
        if module.name.endswith(".findings") and module.name != "greybox.base.values":
            for value in vars(import_module(module.name)).values():
                if isinstance(value, type) and issubclass(value, StrEnum) and value.__module__ == module.name:
                    for code in value:
                        assert code not in declared, f"{code!r} stands in {declared[code]} and {value.__name__}"
                        declared[code] = value.__name__
    return declared


def test_every_code_has_a_template() -> None:
    assert not sorted(set(codes()) - set(templates()))


def test_a_code_cannot_get_a_second_template() -> None:
    taken = next(iter(templates()))
    with pytest.raises(ValueError, match=taken):
        register({taken: "another"})


def test_a_finding_without_a_template_is_refused() -> None:
    with pytest.raises(KeyError):
        sentence(Finding("nobody_wrote_this"))


def test_a_value_that_no_module_writes_is_refused() -> None:
    with pytest.raises(TypeError, match="int"):
        text(1)


def test_every_value_that_is_printed_has_words() -> None:
    modules = [m.name for m in pkgutil.walk_packages(greybox.__path__, "greybox.") if not m.name.endswith("__main__")]
    found = {value for name in modules for value in vars(import_module(name)).values() if isinstance(value, type)}
    printed = [kind for kind in found if issubclass(kind, Printable) and kind.__str__ is Printable.__str__]
    templates()  # loads every writer
    wordless = [
        k.__name__ for k in printed if not (_find_describer(k) or {b.__name__ for b in k.__mro__} & {*_writers})
    ]
    assert sorted(wordless) == ["Check", "Finding", "Printable"]  # the first two have templates


def test_findings_are_chosen_by_code() -> None:
    first, second = Finding("a", Severity.WARNING, "x", {"ratio": 2.0}), Finding("b")
    assert with_code((first, second), "a") == (first,)


@pytest.mark.parametrize(
    ("check", "passed"),
    [
        (Check.at_most("r", 1.0, 1.0), True),
        (Check.at_most("r", 1.1, 1.0), False),
        (Check.at_least("r", 1.0, 1.0), True),
        (Check.at_least("r", 0.9, 1.0), False),
        (Check.at_least("r", float("nan"), 1.0), False),
        (Check.at_most("r", float("nan"), 1.0), False),
    ],
)
def test_a_check_passes_on_its_limit_and_never_on_nan(check: Check, passed: bool) -> None:
    assert check.passed is passed
    assert bool(check) is passed
