"""How large is the noise of a sensor? From the record itself, where nobody says."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

# Differences of these orders are looked at; each removes a smoother part of the signal, the smallest result counts.
ORDERS = range(1, 9)


def difference_noise(values: np.ndarray) -> float:
    """Standard deviation of white noise on a sampled signal, from its high-order differences.

    The difference of order ``d`` has variance ``binomial(2 d, d) sigma^2`` for white noise, and little left of a smooth signal. An
    upper estimate where the signal itself moves from sample to sample; too low where the noise is coloured. ``values`` (N,)
    may contain NaN (differences that touch a gap are left out). Returns NaN with fewer than ten usable differences.
    """
    estimates = []
    variance, difference = 1.0, np.asarray(values, float)
    for order in ORDERS:
        difference = np.diff(difference)
        variance *= 2 * (2 * order - 1) / order
        usable = difference[np.isfinite(difference)]
        if len(usable) >= 10:
            estimates.append(float(np.sqrt(np.mean(usable**2) / variance)))
    return min(estimates, default=float("nan"))


def record_noise(records: Iterable[np.ndarray]) -> float:
    """`difference_noise` over several records of one sensor, pooled by their number of samples."""
    pairs = [(difference_noise(values), int(np.isfinite(values).sum())) for values in records]
    usable = [(noise, count) for noise, count in pairs if np.isfinite(noise)]
    total = sum(count for _, count in usable)
    return float(np.sqrt(sum(noise**2 * count for noise, count in usable) / total)) if total else float("nan")
