"""How large the noise of each sensor is, what colour it has, and how one knows."""

from greybox.noise.autoregression import AutoRegression, autoregression, segments
from greybox.noise.differences import difference_noise, record_noise
from greybox.noise.hierarchy import Noise, noise_of

__all__ = ["AutoRegression", "Noise", "autoregression", "difference_noise", "noise_of", "record_noise", "segments"]
