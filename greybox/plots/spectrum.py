"""The spectrum of a residual, as pages draw it and take it anew over the stretch that a reader zooms into."""

from __future__ import annotations

import numpy as np

from greybox.plots.policy import DRAWING


def amplitude_density(values: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """One-sided amplitude density by a Hann window.

    Gaps count as the mean of the rest, and not as rows: white noise has the same density with gaps and without.

    Parameters
    ----------
    values
        Evenly sampled (N,), NaN in gaps.
    step
        Between them, in s.

    Returns
    -------
    frequency, density
        In Hz and in the unit of ``values`` per root hertz, (N // 2,); empty for fewer than four values.
    """
    known = np.isfinite(values)
    if len(values) < 4 or not known.any():
        return np.array([]), np.array([])
    window = np.hanning(len(values) + 1)[:-1]
    centred = np.where(known, values - values[known].mean(), 0.0)
    spectrum = np.fft.rfft(window * centred)
    frequency = np.fft.rfftfreq(len(values), step)
    return frequency[1:], np.sqrt(2 * step * np.abs(spectrum[1:]) ** 2 / np.sum(window[known] ** 2))


def uniform_sampling_time(time: np.ndarray) -> float | None:
    """Seconds between rows, None where they are not evenly spaced."""
    steps = np.diff(time)
    even = len(steps) > 0 and float(np.ptp(steps)) < DRAWING.uneven * float(steps.mean())
    return float(steps.mean()) if even else None
