"""After a fit: what its residual says, and how well it predicts."""

from greybox.residuals.hypothesis_tests import (
    ResidualSeries,
    ResidualTest,
    ResidualTestKind,
    ResidualTests,
    residual_tests,
)
from greybox.residuals.policy import ResidualTestPolicy
from greybox.residuals.scores import OutputScore, PredictionScores, score

__all__ = [
    "OutputScore",
    "PredictionScores",
    "ResidualSeries",
    "ResidualTest",
    "ResidualTestKind",
    "ResidualTestPolicy",
    "ResidualTests",
    "residual_tests",
    "score",
]
