"""The noise level of a sensor from the record itself, where it is not given."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from greybox.experiment.problems import is_constant
from greybox.noise.policy import NOISE_POLICY, NoisePolicy
from greybox.numerics import MAD_TO_STD


def estimate_noise_from_differences(
    values: np.ndarray, *, robust: bool = False, policy: NoisePolicy = NOISE_POLICY
) -> float:
    """Standard deviation of white noise on a sampled signal, from its high-order differences.

    The difference of order ``d`` has variance ``binomial(2 d, d) sigma^2`` for white noise, and little left of a smooth signal. An
    upper estimate where the signal itself moves from sample to sample; too low where the noise is coloured. ``values`` (N,)
    may contain NaN (differences that touch a gap are left out). ``robust`` takes the median of the differences' sizes, which a few
    outliers do not move (each of them is in ``d + 1`` differences). Returns NaN with fewer than ten usable differences.
    """
    estimates = []
    variance, difference = 1.0, np.asarray(values, float)
    for order in range(1, policy.max_difference_order + 1):
        difference = np.diff(difference)
        variance *= 2 * (2 * order - 1) / order
        usable = difference[np.isfinite(difference)]
        if len(usable) >= policy.min_differences:
            estimates.append(estimate_spread(usable, robust=robust) / float(np.sqrt(variance)))
    return min(estimates, default=float("nan"))


def estimate_noise_of_records(
    records: Iterable[np.ndarray], *, robust: bool = False, policy: NoisePolicy = NOISE_POLICY
) -> float:
    """`estimate_noise_from_differences` over several records of one sensor, pooled by their number of samples.

    A record in which the sensor does not move at all tells nothing of its noise, and is left out if there are others.
    """
    columns = list(records)
    columns = [c for c in columns if not is_constant(c)] or columns
    levels = [estimate_noise_from_differences(values, robust=robust, policy=policy) for values in columns]
    pairs = [(level, int(np.isfinite(values).sum())) for level, values in zip(levels, columns, strict=True)]
    usable = [(noise, count) for noise, count in pairs if np.isfinite(noise)]
    total = sum(count for _, count in usable)
    return float(np.sqrt(sum(noise**2 * count for noise, count in usable) / total)) if total else float("nan")


def estimate_spread(values: np.ndarray, *, robust: bool = False) -> float:
    """Root mean square of a series of mean zero, NaN left out; ``robust``: 1.48 times the median size, the same for normal values.

    More than half of the values may be exactly zero (a coarse sensor); then the root mean square says more.
    """
    usable = values[np.isfinite(values)]
    if not len(usable):
        return 0.0
    middle = MAD_TO_STD * float(np.median(np.abs(usable))) if robust else 0.0
    return middle or float(np.sqrt(np.mean(usable**2)))
