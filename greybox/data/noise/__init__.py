"""How large the noise of each sensor is, what colour it has, and where that is known from."""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.data.noise.growing import GrowingNoise
    from greybox.data.noise.noise_model import (
        NOISE_POLICY,
        AutoRegression,
        BoundDirection,
        NoiseBound,
        NoiseModel,
        NoisePolicy,
        NoiseSource,
        fit_autoregression,
        join_series,
    )
    from greybox.data.noise.noise_sources import estimate_noise
    from greybox.data.noise.spectrum import estimate_noise_from_differences, estimate_noise_of_records

__getattr__, __all__, __dir__ = lazy_face(__name__)
