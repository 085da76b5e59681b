"""Decisions of a comparison: which rows count, when two models are equally good, how black boxes are fitted."""

from __future__ import annotations

from dataclasses import dataclass, field

from greybox.comparison.blackbox.policy import StructureScanPolicy


@dataclass(frozen=True)
class ComparisonPolicy:
    """Which rows count, when two models are equally good, and how the black boxes beside a physical model are fitted."""

    initial_rows: int = 50
    """Rows that determine the initial state of a validation record, where ``skip`` is 0."""
    fewest_rows: int = 2
    """Rows of a validation record that must be left after ``skip``."""
    equally_good: float = 0.02
    """Relative difference of two errors that counts as none."""
    filtered_rows: int = 50_000
    """Rows of all records up to which the best prediction filter is searched for; the search takes longer with more."""
    dense_share: float = 0.5
    """An output measured in fewer than this share of the rows has its black boxes on the rows where it is measured."""
    rest_share: float = 0.1
    """Share of its range by which an output may begin away from zero and still count as at rest."""
    smoothing_seed: int = 1
    """Seed of Monte-Carlo smoothing, so that a comparison can be repeated."""
    scan: StructureScanPolicy = field(default_factory=StructureScanPolicy)
    """How the structures of the black boxes are chosen."""


DEFAULT_COMPARISON = ComparisonPolicy()
