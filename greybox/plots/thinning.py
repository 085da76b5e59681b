"""Long records and spectra in few points, so that no peak is lost."""

from __future__ import annotations

import numpy as np

from greybox.plots.figure import Thinning


def thin_curve(x: np.ndarray, y: np.ndarray, thinning: Thinning, stretches: int) -> tuple[np.ndarray, np.ndarray]:
    """``x`` and ``y`` (N,) with so many stretches at most, thinned by the rule for this kind of curve."""
    if thinning is Thinning.ENVELOPE:
        return min_max_envelope(x, y, stretches)
    if thinning is Thinning.PEAKS:
        return thin_spectrum(x, y, stretches)
    return x, y


def min_max_envelope(time: np.ndarray, values: np.ndarray, stretches: int) -> tuple[np.ndarray, np.ndarray]:
    """The smallest and the largest value of each stretch of a long record, in the order of their time.

    Parameters
    ----------
    time, values
        The record (N,), NaN in gaps.
    stretches
        So many of them, equally long.

    Returns
    -------
    time, values
        (2 stretches,); the record itself where it is not longer. A stretch without any value stays a gap.
    """
    n = len(time)
    if n <= 2 * stretches:
        return time, values
    edges = np.linspace(0, n, stretches + 1).astype(int)[:-1]
    known = np.isfinite(values)
    low = np.minimum.reduceat(np.where(known, values, np.inf), edges)
    high = np.maximum.reduceat(np.where(known, values, -np.inf), edges)
    low, high = np.where(np.isfinite(low), low, np.nan), np.where(np.isfinite(high), high, np.nan)
    last = np.append(edges[1:], n) - 1
    return np.column_stack([time[edges], time[last]]).ravel(), np.column_stack([low, high]).ravel()


def thin_spectrum(frequency: np.ndarray, values: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """A long spectrum (N,) by the largest value of each of at most ``most`` stretches, equally wide on a logarithmic axis."""
    if len(frequency) <= most:
        return frequency, values
    edges = np.unique(np.geomspace(1, len(frequency), most).astype(int) - 1)
    return frequency[edges], np.maximum.reduceat(values, edges)


def choose_evenly(count: int, most: int) -> np.ndarray:
    """Indices of at most ``most`` of ``count`` points, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, most).astype(int)) if count > most else np.arange(count)
