"""Physical and black-box models on the same records: errors, number of constants, stability, and which is best where."""

from greybox.comparison.compare import compare
from greybox.comparison.contestants import black_contestants
from greybox.comparison.values import Comparison, Entry, Run, Score

__all__ = ["Comparison", "Entry", "Run", "Score", "black_contestants", "compare"]
