"""Physical and black-box models on the same records: errors, number of parameters, stability, and which is best where."""

from greybox.comparison.black_box_candidates import fit_black_boxes
from greybox.comparison.compare import compare
from greybox.comparison.result import (
    BoxKind,
    Comparison,
    ComparisonEntry,
    ComparisonFinding,
    ComparisonPolicy,
    ComparisonScore,
    load_comparison,
    save_comparison,
)

__all__ = [
    "BoxKind",
    "Comparison",
    "ComparisonEntry",
    "ComparisonFinding",
    "ComparisonPolicy",
    "ComparisonScore",
    "compare",
    "fit_black_boxes",
    "load_comparison",
    "save_comparison",
]
