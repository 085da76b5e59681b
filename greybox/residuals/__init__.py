"""After a fit: what its residual says, and how well it predicts."""

from greybox.residuals.hypothesis_tests import ResidualSeries, ResidualTest, ResidualTests, residual_tests
from greybox.residuals.scores import OutputScore, PredictionScores, score

__all__ = [
    "OutputScore",
    "PredictionScores",
    "ResidualSeries",
    "ResidualTest",
    "ResidualTests",
    "residual_tests",
    "score",
]
