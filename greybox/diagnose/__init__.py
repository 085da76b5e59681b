"""After a fit: what its residual says, and how well it predicts."""

from greybox.diagnose.residuals import ResidualSeries, ResidualTest, ResidualTests, diagnose_residuals
from greybox.diagnose.scores import Score, Scores, scores

__all__ = ["ResidualSeries", "ResidualTest", "ResidualTests", "Score", "Scores", "diagnose_residuals", "scores"]
