"""From a measured step response to the intervals in which the five constants of equation 17 are drawn.

``yhat(t) = A {1 - r e^(-sigma t) sin(w t + theta)}``: the frequency from the power spectral density, the amplitude from the
tail, decay and ratio from the envelope of the oscillation, the phase from the first passage through the final value.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.signal import welch

from greybox.blackbox.policy import DEFAULT_SMOOTHING, SmoothingPolicy
from greybox.errors import DataError, nearest

NO_OSCILLATION = "the response does not oscillate, so equation 17 does not describe it: use output_error"


@dataclass(frozen=True)
class DrawIntervals:
    """Lower and upper end of each constant of equation 17: ``amplitude`` A in the output's unit, ``ratio`` r, ``phase`` theta in
    rad, ``frequency`` w in rad/s, ``decay`` sigma in 1/s (the paper's zeta_M, which is not a damping ratio).

    Raises DataError for ends that are not finite or not in order, and for a frequency, decay or ratio below zero.
    """

    amplitude: tuple[float, float]
    ratio: tuple[float, float]
    phase: tuple[float, float]
    frequency: tuple[float, float]
    decay: tuple[float, float]

    def __post_init__(self) -> None:
        for axis in AXES:
            low, high = getattr(self, axis)
            if not (np.isfinite([low, high]).all() and low < high):
                raise DataError(
                    f"interval of {axis}: [{low:g}, {high:g}]; give two finite numbers, the lower one first"
                )
            if axis in POSITIVE and low < 0:
                raise DataError(f"interval of {axis}: [{low:g}, {high:g}] begins below zero; begin it at 0")
            object.__setattr__(self, axis, (float(low), float(high)))

    def with_some(self, given: Mapping[str, tuple[float, float]]) -> DrawIntervals:
        """These intervals with the ``given`` ones, by axis, put in. Raises DataError for an unknown axis."""
        for axis in given:
            if axis not in AXES:
                raise DataError(f"no parameter {axis!r} in equation 17; {nearest(axis, AXES)}")
        return replace(self, **given)

    def around(self, best: Mapping[str, float], policy: SmoothingPolicy = DEFAULT_SMOOTHING) -> DrawIntervals:
        """The adjusted intervals of figure 1: centred on the ``best`` values, half as wide where they lay well inside."""
        adjusted = {}
        for axis in AXES:
            low, high = getattr(self, axis)
            half, middle = (high - low) / 2, (high + low) / 2
            half *= 0.5 if abs(best[axis] - middle) < policy.well_inside * half else 1.0
            floor = policy.lower_end * high if axis in POSITIVE else -np.inf
            adjusted[axis] = (max(best[axis] - half, floor), best[axis] + half)
        return DrawIntervals(**adjusted)


AXES = tuple(f.name for f in fields(DrawIntervals))
POSITIVE = ("ratio", "frequency", "decay")


def estimate_spectrum(y: np.ndarray, sampling_time: float, points: int = 1024) -> tuple[np.ndarray, np.ndarray]:
    """One-sided power spectral density of ``y`` (N,): frequencies in rad/s and density in its unit squared per rad/s.

    Hann windows of ``points`` rows, side by side (a shorter record: one window, padded with zeros), the mean not taken out.
    """
    window = min(points, len(y))
    f, density = welch(y, 1 / sampling_time, "hann", nperseg=window, noverlap=0, nfft=points, detrend=False)
    return 2 * np.pi * f, density / (2 * np.pi)


def find_resonance(w: np.ndarray, density: np.ndarray) -> float:
    """The frequency of the highest peak beyond the one at zero, in the units of ``w`` (n,). Raises DataError without one."""
    # A one-sided density counts every line but the one at zero twice, so that a broad peak at zero may rise to its second line.
    change = np.diff(density)
    down = int(np.argmax(change < 0))
    rising = down + np.flatnonzero(change[down:] > 0)
    if len(rising) == 0 or rising[0] >= len(w) - 2:
        raise DataError(f"the power spectral density has no peak besides the one at 0 rad/s; {NO_OSCILLATION}")
    start = int(rising[0])
    return float(w[start + int(np.argmax(density[start:]))])


def estimate_intervals(
    time: np.ndarray, y: np.ndarray, sampling_time: float, points: int, policy: SmoothingPolicy = DEFAULT_SMOOTHING
) -> DrawIntervals:
    """The intervals that the step response ``y`` (N,) at ``time`` (N,) after the step itself suggests.

    Frequency: the spectrum's peak, one of its ``points`` bins to either side. Amplitude: extremes of the last quarter. Decay and
    ratio: a straight line through the logarithm of the envelope, by factors of 1.6 and 1.25. Phase: ``pi - w t`` of the first
    passage through that amplitude. Raises DataError for a response that does not oscillate about a final value.
    """
    tail = y[-max(len(y) // policy.tail, 2) :]
    level, low, high = float(tail.mean()), float(tail.min()), float(tail.max())
    if low <= 0 <= high:
        raise DataError(
            f"the last quarter of the response runs from {low:.4g} to {high:.4g}: its final value is not distinguishable from zero, but"
            " equation 17 oscillates about a final value; take a longer record, or use output_error"
        )
    if not low < high:
        low, high = level - policy.level_spread * abs(level), level + policy.level_spread * abs(level)
    w = _frequency(y, level, sampling_time, points)
    bin_width = 2 * np.pi / (points * sampling_time)
    decay, size = _estimate_envelope(time, y - level, w, sampling_time, policy)
    ratio = size / abs(level)
    first, last = (_first_passage(time, y, part * level) for part in _levels(level, low, high))
    if w * first > 2 * np.pi:
        raise DataError(
            f"the final value is first passed {first:.4g} s after the step, {w * first / (2 * np.pi):.1f} periods of the spectrum's"
            f" peak at {w:.4g} rad/s; {NO_OSCILLATION}"
        )
    slowest, fastest = max(w - bin_width, bin_width / 2), w + bin_width
    slack = w * sampling_time
    return DrawIntervals(
        amplitude=(low, high),
        ratio=(ratio / policy.ratio_factor, ratio * policy.ratio_factor),
        phase=(np.pi - fastest * last - slack, np.pi - slowest * first + slack),
        frequency=(slowest, fastest),
        decay=(decay / policy.decay_factor, decay * policy.decay_factor),
    )


def _frequency(y: np.ndarray, level: float, sampling_time: float, points: int) -> float:
    """The oscillation's frequency in rad/s: the spectrum's peak besides the one at zero."""
    if len(y) >= points:
        return find_resonance(*estimate_spectrum(y, sampling_time, points))
    # The one window of a shorter record is padded with zeros: the final value would leak over the oscillation, so it is taken out.
    w, density = estimate_spectrum(y - level, sampling_time, points)
    peak = int(np.argmax(density))
    if peak in (0, len(w) - 1):
        raise DataError(
            f"the power spectral density of the oscillation is largest at {w[peak]:.4g} rad/s; {NO_OSCILLATION}"
        )
    return float(w[peak])


def _levels(level: float, low: float, high: float) -> tuple[float, float]:
    """The smallest and the largest final value that the tail allows, over their mean."""
    return tuple(sorted((low / level, high / level)))  # type: ignore[return-value]


def _estimate_envelope(
    time: np.ndarray, swing: np.ndarray, w: float, sampling_time: float, policy: SmoothingPolicy
) -> tuple[float, float]:
    """Decay (1/s) and size at time zero of an oscillation of about ``w`` rad/s: its amplitude over each period, in a line."""
    period = max(round(2 * np.pi / (w * sampling_time)), 2)
    count = len(swing) // period
    if count < policy.fewest_periods:
        raise DataError(
            f"the record holds {count} periods of {w:.4g} rad/s; at least {policy.fewest_periods} show how the oscillation decays:"
            " take a longer record, or use output_error"
        )
    turned = swing[: count * period] * np.exp(-1j * w * time[: count * period])
    size = 2 * np.abs(turned.reshape(count, period).mean(axis=1))
    middle = time[: count * period].reshape(count, period).mean(axis=1)
    floor = float(np.median(size[-max(count // policy.tail, 1) :]))
    fading = floor < size[0] / policy.above_floor
    if not fading and size[0] <= policy.persistent * np.abs(swing).max():
        raise DataError(
            f"the oscillation at {w:.4g} rad/s is not larger after the step than at the end; {NO_OSCILLATION}"
        )
    clear = int(np.argmax(np.append(size, 0.0) <= policy.above_floor * floor)) if fading else count
    used = slice(0, max(clear, 2))
    size = np.maximum(size, policy.lower_end * size[0])
    slope, start = np.polyfit(middle[used], np.log(size[used]), 1, w=size[used])
    # an oscillation that does not fade within the record: a tenth of its length is the fastest that it could hide
    least = policy.hidden_decay / float(time[-1])
    return max(-float(slope), least), float(np.exp(start))


def _first_passage(time: np.ndarray, y: np.ndarray, level: float) -> float:
    """When ``y`` first passes ``level``, linear between rows, in seconds after the step."""
    share = y / level
    k = int(np.argmax(share >= 1))
    if share[k] < 1 or k == 0:
        return float(time[k])
    return float(time[k] - (time[k] - time[k - 1]) * (share[k] - 1) / (share[k] - share[k - 1]))
