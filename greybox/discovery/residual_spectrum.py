"""The residual of a fit by frequency, beside the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from greybox.errors import DataError, nearest
from greybox.noise import AutoRegression
from greybox.result import Fit
from greybox.values import ReadOnly


@dataclass(frozen=True, eq=False)
class ResidualSpectrum(ReadOnly):
    """Amplitude density of the free-run error of ``output``, and of its noise ``floor``: ``frequency`` (F,) in Hz, both (F,) in ``unit``.

    The square, summed over the frequencies, is the mean square of the error.
    """

    output: str
    frequency: np.ndarray
    density: np.ndarray
    floor: np.ndarray
    unit: str


def estimate_residual_spectrum(
    fit: Fit, output: str, *, coloured: bool = True, segment: int = 512, stretches: int = 8
) -> ResidualSpectrum:
    """Spectrum of the residual of one output, by Welch's method; gaps count as zero.

    Parameters
    ----------
    fit
        Its validation records count, or the estimation records where there are none.
    output
        A measured output.
    coloured
        Whether the floor has the colour that the fit took the noise for; a missing effect may have passed for it.
    segment
        Samples of one stretch at most.
    stretches
        Stretches that a record gives at least.

    Returns
    -------
    ResidualSpectrum
        Frequencies (F,) in Hz, the density of the residual and that of the noise (F,) in the unit of the output.

    Raises
    ------
    DataError
        For an output that was not measured.
    """
    traces = [t for t in (fit.validation.traces or fit.traces) if output in t.measured]
    if not traces:
        raise DataError(f"spectrum of {output!r}: not measured; {nearest(output, list(fit.misfit))}")
    period = float(np.median(np.diff(traces[0].time)))
    shortest = min(len(t.time) for t in traces)
    length = min(segment, max(shortest // stretches * 2, 8), shortest)
    powers = [estimate_power_density(np.nan_to_num(t.residual(output)), period, length) * len(t.time) for t in traces]
    power = sum(powers) / sum(len(t.time) for t in traces)
    frequency = np.fft.rfftfreq(length, period)
    step = frequency[1] - frequency[0]
    std, reflection = fit.noise.std.get(output, np.nan), fit.noise.colour.get(output, ()) if coloured else ()
    floor = std**2 * 2 * period * _noise_shape(AutoRegression(tuple(reflection)), frequency * period)
    unit = next(o.unit for o in fit.model.outputs if o.name == output)
    return ResidualSpectrum(output, frequency[1:], np.sqrt(power * step)[1:], np.sqrt(floor * step)[1:], unit)


def estimate_power_density(values: np.ndarray, period: float, length: int) -> np.ndarray:
    """One-sided power density (length // 2 + 1,) of ``values`` (N,), sampled every ``period`` seconds, by Welch's method.

    The mean over stretches of ``length`` samples that overlap by half, each under a Hann window; what is constant stays in.
    """
    # As `scipy.signal.welch` without detrending: that takes half a second to import.
    stretches = np.lib.stride_tricks.sliding_window_view(values, length)[:: length - length // 2]
    window = np.hanning(length + 1)[:-1]
    power = (np.abs(np.fft.rfft(window * stretches)) ** 2).mean(axis=0) * period / (window @ window)
    # A frequency stands for its negative too, but for zero and half the sampling rate.
    power[1 : None if length % 2 else -1] *= 2
    return np.asarray(power)


def _noise_shape(colour: AutoRegression, cycles: np.ndarray) -> np.ndarray:
    """Power spectrum of noise of this colour and unit variance over that of white noise, at ``cycles`` per sample."""
    lags = np.arange(1, colour.order + 1)
    response = 1 - np.exp(-2j * np.pi * np.outer(cycles, lags)) @ colour.coefficients
    return colour.innovation_variance / np.abs(response) ** 2
