"""Monte-Carlo smoothing of a step response, as one paper defines it (Wang, Micro motion actuator of compliant mechanism, 4.2)."""

from greybox.blackbox.monte_carlo_smoothing.estimate import SmoothingProgress, monte_carlo_smoothing
from greybox.blackbox.monte_carlo_smoothing.result import MonteCarloSmoothing

__all__ = ["MonteCarloSmoothing", "SmoothingProgress", "monte_carlo_smoothing"]
