"""How large the noise of each sensor is, what colour it has, and how one knows."""

from greybox.noise.autoregression import AutoRegression, fit_autoregression, join_series
from greybox.noise.differences import estimate_noise_from_differences, estimate_noise_of_records
from greybox.noise.noise_sources import NoiseModel, estimate_noise

__all__ = [
    "AutoRegression",
    "NoiseModel",
    "estimate_noise",
    "estimate_noise_from_differences",
    "estimate_noise_of_records",
    "fit_autoregression",
    "join_series",
]
