"""The residual of a fit by frequency, beside the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from greybox.errors import DataError, nearest
from greybox.noise import AutoRegression
from greybox.result import Fit
from greybox.result.frozen import ReadOnly

# Samples of one stretch of Welch's method at most; a record gives at least this many stretches.
SEGMENT, STRETCHES = 512, 8


@dataclass(frozen=True, eq=False)
class Spectrum(ReadOnly):
    """Amplitude density of the free-run error of ``output``, and of its noise ``floor``: ``frequency`` (F,) in Hz, both (F,) in ``unit``.

    The square, summed over the frequencies, is the mean square of the error.
    """

    output: str
    frequency: np.ndarray
    density: np.ndarray
    floor: np.ndarray
    unit: str


def residual_spectrum(fit: Fit, output: str, *, coloured: bool = True) -> Spectrum:
    """Of ``fit`` on its validation records (on the fitted ones where there are none), by Welch's method; gaps count as zero.

    ``coloured``: whether the floor has the colour that the fit took the noise for; a missing effect may have passed for it.

    Raises DataError for an output that was not measured.
    """
    traces = [t for t in (fit.validation_traces or fit.traces) if output in t.measured]
    if not traces:
        raise DataError(f"spectrum of {output!r}: not measured; {nearest(output, list(fit.misfit))}")
    from scipy.signal import welch  # half a second to import

    period = float(np.median(np.diff(traces[0].time)))
    length = min(SEGMENT, max(min(len(t.time) for t in traces) // STRETCHES * 2, 8))
    length = min(length, min(len(t.time) for t in traces))
    powers = []
    for t in traces:
        frequency, power = welch(np.nan_to_num(t.residual(output)), 1 / period, nperseg=length, detrend=False)
        powers.append(power * len(t.time))
    power = sum(powers) / sum(len(t.time) for t in traces)
    step = frequency[1] - frequency[0]
    std, reflection = fit.noise.get(output, np.nan), fit.noise_colour.get(output, ()) if coloured else ()
    floor = std**2 * 2 * period * _shape(AutoRegression(tuple(reflection)), frequency * period)
    unit = next(o.unit for o in fit.model.outputs if o.name == output)
    return Spectrum(output, frequency[1:], np.sqrt(power * step)[1:], np.sqrt(floor * step)[1:], unit)


def _shape(colour: AutoRegression, cycles: np.ndarray) -> np.ndarray:
    """Power spectrum of noise of this colour and unit variance over that of white noise, at ``cycles`` per sample."""
    lags = np.arange(1, colour.order + 1)
    response = 1 - np.exp(-2j * np.pi * np.outer(cycles, lags)) @ colour.coefficients
    return colour.innovation / np.abs(response) ** 2
