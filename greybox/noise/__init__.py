"""How large the noise of each sensor is, what colour it has, and where that is known from."""

from greybox.noise.autoregression import AutoRegression, fit_autoregression, join_series
from greybox.noise.differences import estimate_noise_from_differences, estimate_noise_of_records
from greybox.noise.noise_model import BoundDirection, NoiseBound, NoiseModel, NoiseSource
from greybox.noise.noise_sources import estimate_noise
from greybox.noise.policy import NOISE_POLICY, NoisePolicy

__all__ = [
    "NOISE_POLICY",
    "AutoRegression",
    "BoundDirection",
    "NoiseBound",
    "NoiseModel",
    "NoisePolicy",
    "NoiseSource",
    "estimate_noise",
    "estimate_noise_from_differences",
    "estimate_noise_of_records",
    "fit_autoregression",
    "join_series",
]
