"""What every result value shares: contents that nobody changes by accident, what is said of it, and what it has to say, as data.

A `Finding` is a fact that a reader should know before trusting a number. A `Check` is one decision: the rule, the value that it was
applied to, the limit, and the outcome. Code branches on ``code`` and ``rule``, never on a sentence; `greybox.show.sentences` holds
one template for each code.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from html import escape
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from greybox.base.document import Document


class Printable:
    """A result: ``describe()`` gives what is said of it as a `Document`, ``str(value)`` prints that as plain text.

    Sentences and figures stand in a later layer, which looks the class up by its name.
    """

    # The module with ``text`` and ``describe``, by its name as an entry point has it: loaded when somebody prints.
    PRINTER: ClassVar[str] = "greybox.show"

    def __str__(self) -> str:
        text: str = import_module(self.PRINTER).text(self)
        return text

    def describe(self, **options: Any) -> Document:
        """What is said of it: facts, sentences, tables, equations and figures.

        Parameters
        ----------
        **options
            What its page shows beside it, such as ``command``, the command that made it.
        """
        document: Document = import_module(self.PRINTER).describe(self, **options)
        return document

    def _repr_html_(self) -> str:
        """What a notebook shows: the plain text."""
        return f"<pre>{escape(str(self))}</pre>"


class ReadOnly:
    """A frozen dataclass whose mappings and arrays are read-only views; it can still be pickled and copied."""

    def __post_init__(self) -> None:
        for f in fields(self):  # type: ignore[arg-type]
            object.__setattr__(self, f.name, _protected(getattr(self, f.name)))

    def __reduce__(self) -> tuple[Any, ...]:
        values = {f.name: _open(getattr(self, f.name)) for f in fields(self) if f.init}  # type: ignore[arg-type]
        return _rebuilt, (type(self), values)


def _rebuilt(kind: type, values: Mapping[str, Any]) -> Any:
    return kind(**values)


def _protected(value: Any) -> Any:
    if isinstance(value, dict):
        return MappingProxyType({name: _protected(each) for name, each in value.items()})
    if hasattr(value, "setflags"):  # an array; asking NumPy itself would load it for every command's help
        if not value.flags.writeable:
            return value  # itself and no view of it: who owns its memory need not be copied again
        view = value.view()
        view.setflags(write=False)
        return view
    return value


def _open(value: Any) -> Any:
    """Read-only mappings as dictionaries: they cannot be pickled."""
    return {name: _open(each) for name, each in value.items()} if isinstance(value, MappingProxyType) else value


class Severity(StrEnum):
    """How much a finding affects the use of a result."""

    NOTE = "note"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class Finding(Printable, ReadOnly):
    """One fact about a result.

    Parameters
    ----------
    code
        What was found, a member of the ``StrEnum`` of codes of the package that found it. Codes are unique in the library.
    severity
        How much it matters.
    subject
        What it is about: the name of an output, a constant, a record, an effect. Empty if it is about the whole.
    values
        The figures and names that the sentence needs, ready for JSON: numbers, strings, lists and mappings of these.

    Examples
    --------
    >>> finding = Finding("residual_above_noise", Severity.WARNING, "x", {"ratio": 113.0})
    >>> finding.values["ratio"]
    113.0
    """

    code: str
    severity: Severity = Severity.NOTE
    subject: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Check(Printable):
    """One decision: ``value`` was held against ``limit`` under ``rule``, and passed or not.

    Parameters
    ----------
    rule
        Which rule decided, a short name that stays the same from version to version.
    value, limit
        What was compared, in the same unit. NaN where the value could not be computed; such a check does not pass.
    passed
        The outcome.
    subject
        What was judged: an effect, an output, a constant.
    """

    rule: str
    value: float
    limit: float
    passed: bool
    subject: str = ""

    @classmethod
    def at_most(cls, rule: str, value: float, limit: float, subject: str = "") -> Check:
        """A check that passes where ``value <= limit``."""
        return cls(rule, float(value), float(limit), bool(value <= limit), subject)

    @classmethod
    def at_least(cls, rule: str, value: float, limit: float, subject: str = "") -> Check:
        """A check that passes where ``value >= limit``."""
        return cls(rule, float(value), float(limit), bool(value >= limit), subject)

    def __bool__(self) -> bool:
        return self.passed


def with_code(findings: Iterable[Finding], *codes: str) -> tuple[Finding, ...]:
    """The findings whose code is one of ``codes``, in their order."""
    return tuple(finding for finding in findings if finding.code in codes)
