"""Decisions of a comparison: which rows count, when two models are equally good, how black boxes are fitted."""

from __future__ import annotations

from dataclasses import dataclass, field

from greybox.comparison.blackbox.policy import StructureScanPolicy


@dataclass(frozen=True)
class ComparisonPolicy:
    """Which rows count, when two models are equally good, and how the black boxes beside a physical model are fitted."""

    scan: StructureScanPolicy = field(default_factory=StructureScanPolicy)
    """How the structures of the black boxes are chosen."""


DEFAULT_COMPARISON = ComparisonPolicy()
