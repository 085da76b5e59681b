"""Findings of a result by their code."""

from __future__ import annotations

from collections.abc import Iterable

from greybox.base.values import Finding


def find(findings: Iterable[Finding], code: str) -> Finding | None:
    """The first finding of a code, or None."""
    return next((finding for finding in findings if finding.code == code), None)


def codes(findings: Iterable[Finding]) -> set[str]:
    """The codes of findings."""
    return {str(finding.code) for finding in findings}
