"""Findings and checks: what a result has to say about itself, as data.

A `Finding` is a fact that a reader should know before trusting a number. A `Check` is one decision: the rule, the value that it was
applied to, the limit, and the outcome. Code branches on ``code`` and ``rule``, never on a sentence; `greybox.show.sentences` holds
one template for each code.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from greybox.base.values import Printable, ReadOnly


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
