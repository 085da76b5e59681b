"""Long records in few points: smallest and largest value of each stretch, so that no peak is lost."""

from __future__ import annotations

import numpy as np

MOST = 1500  # stretches of a record, about the pixels of a wide axis


def min_max_envelope(time: np.ndarray, values: np.ndarray, most: int = MOST) -> tuple[np.ndarray, np.ndarray]:
    """``time`` and ``values`` (N,), or the extremes of ``most`` stretches in the order of their time (2 most,).

    A stretch without any value is a gap (NaN).
    """
    n = len(time)
    if n <= 2 * most:
        return time, values
    edges = np.linspace(0, n, most + 1).astype(int)[:-1]
    known = np.where(np.isfinite(values), values, np.inf)
    low = np.minimum.reduceat(known, edges)
    high = np.maximum.reduceat(np.where(np.isfinite(values), values, -np.inf), edges)
    low, high = np.where(np.isfinite(low), low, np.nan), np.where(np.isfinite(high), high, np.nan)
    last = np.append(edges[1:], n) - 1
    return np.column_stack([time[edges], time[last]]).ravel(), np.column_stack([low, high]).ravel()
