"""Physical and black-box models on the same records: errors, number of constants, stability, and which is best where."""

from greybox.comparison.black_box_candidates import fit_black_boxes
from greybox.comparison.compare import compare
from greybox.comparison.result import Comparison, ComparisonEntry, ComparisonRun, ComparisonScore

__all__ = ["Comparison", "ComparisonEntry", "ComparisonRun", "ComparisonScore", "compare", "fit_black_boxes"]
