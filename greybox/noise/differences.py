"""How large is the noise of a sensor? From the record itself, where nobody says."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

# Differences of these orders are looked at; each removes a smoother part of the signal, the smallest result counts.
ORDERS = range(1, 9)
# Standard deviation of normal values over the median of their sizes.
NORMAL = 1.482602218505602


def estimate_noise_from_differences(values: np.ndarray, *, robust: bool = False) -> float:
    """Standard deviation of white noise on a sampled signal, from its high-order differences.

    The difference of order ``d`` has variance ``binomial(2 d, d) sigma^2`` for white noise, and little left of a smooth signal. An
    upper estimate where the signal itself moves from sample to sample; too low where the noise is coloured. ``values`` (N,)
    may contain NaN (differences that touch a gap are left out). ``robust`` takes the median of the differences' sizes, which a few
    outliers do not move (each of them is in ``d + 1`` differences). Returns NaN with fewer than ten usable differences.
    """
    estimates = []
    variance, difference = 1.0, np.asarray(values, float)
    for order in ORDERS:
        difference = np.diff(difference)
        variance *= 2 * (2 * order - 1) / order
        usable = difference[np.isfinite(difference)]
        if len(usable) >= 10:
            estimates.append(estimate_spread(usable, robust=robust) / float(np.sqrt(variance)))
    return min(estimates, default=float("nan"))


def estimate_noise_of_records(records: Iterable[np.ndarray], *, robust: bool = False) -> float:
    """`estimate_noise_from_differences` over several records of one sensor, pooled by their number of samples.

    A record in which the sensor does not move at all tells nothing of its noise, and is left out if there are others.
    """
    columns = list(records)
    columns = [c for c in columns if not is_constant_signal(c)] or columns
    pairs = [
        (estimate_noise_from_differences(values, robust=robust), int(np.isfinite(values).sum())) for values in columns
    ]
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
    middle = NORMAL * float(np.median(np.abs(usable))) if robust else 0.0
    return middle or float(np.sqrt(np.mean(usable**2)))


def is_constant_signal(values: np.ndarray) -> bool:
    """Whether a sensor reads the same in every row (gaps aside)."""
    usable = values[np.isfinite(values)]
    return bool(len(usable) == 0 or np.ptp(usable) == 0)
