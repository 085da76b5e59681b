"""The noise of a sensor from one record of any input: what no smooth frequency response explains.

A linear plant answers in the frequency domain with ``Y = G U + T``, where ``G`` is its frequency response and ``T`` the transient
of the record's ends, both smooth over frequency. Over a few neighbouring frequencies both are polynomials; what these do not
explain is noise, and what the plant does nonlinearly (the local polynomial method: Pintelon, Schoukens 2012, System
identification: a frequency domain approach, chapter 7). So the result is never less than the noise, however fast the signal is.

What is left is noise alone where it has the spectrum of a sensor: flat, or that of one time constant. Such a band is looked for from
the highest frequency down. A record that was filtered or sampled far above what its sensor follows has no such band: what is left
falls off up to half the sampling rate, or down to the rounding of the numbers, and says nothing of the noise that was let through.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import chdtri, expit, fdtr

from greybox.base.numerics import MAD_TO_STD, TINY
from greybox.data.noise.noise_model import AutoRegression
from greybox.data.problems import is_constant


@dataclass(frozen=True)
class LeftoverSpectrum:
    """Power that a smooth frequency response leaves, in bands of frequency from low to high.

    Parameters
    ----------
    frequency : array (m,)
        Middle of each band in radians per sample, 0 to pi.
    power : array (m,)
        Variance per sample of white noise with this power: its mean over all frequencies is the variance of the rest.
    freedom : array (m,)
        Degrees of freedom of each.
    measured : array (m,)
        Power of the output itself, in the same unit.
    """

    frequency: np.ndarray
    power: np.ndarray
    freedom: np.ndarray
    measured: np.ndarray


@dataclass(frozen=True)
class SpectralLevel:
    """The noise that a `LeftoverSpectrum` shows.

    Parameters
    ----------
    std
        Standard deviation.
    most
        What it does not exceed.
    is_noise
        Whether a band has the spectrum of a sensor's noise; otherwise the level is one that the noise does not exceed.
    correlation
        From sample to sample.
    freedom
        Degrees of freedom of the level.
    is_filtered
        Whether a filter took the noise at high frequencies away: then neither they nor differences of the record show its level.
    """

    std: float
    most: float
    is_noise: bool
    correlation: float
    freedom: float
    is_filtered: bool = False

    @property
    def colour(self) -> AutoRegression:
        """The noise as an autoregression of first order, or white."""
        return AutoRegression((self.correlation,)) if self.correlation else AutoRegression()


# Order of the polynomials by which frequency response and transient are smooth over a band.
RESPONSE_ORDER = 2
# Frequencies of a band beyond its unknowns: they carry the estimate.
FREE_FREQUENCIES = 12
# Fewest bands of a record that is long enough to separate noise from a response.
FEWEST_BANDS = 4
# Bands that a spectrum is averaged to at most: each with little scatter.
MOST_BANDS = 48
# Singular value, over the largest, below which two inputs are the same in a band.
SAME_RESPONSE = 1e-10


def leftover_spectrum(inputs: np.ndarray, output: np.ndarray) -> LeftoverSpectrum | None:
    """What a smooth frequency response from ``inputs`` (N, nu) leaves of ``output`` (N,); None for a record that is too short."""
    rows = len(output)
    moving = inputs[:, np.ptp(inputs, axis=0) > 0] if rows else inputs
    order = RESPONSE_ORDER + 1
    unknowns = order * (moving.shape[1] + 1)
    width = unknowns + FREE_FREQUENCIES
    # Y(k) = G(k) U(k) + T(k) + V(k), unitary: |V|^2 is then the variance of white noise.
    y = np.fft.rfft(output - output.mean())[1:] / np.sqrt(rows)
    u = np.fft.rfft(moving - moving.mean(axis=0), axis=0)[1:] / np.sqrt(rows)
    blocks = len(y) // width
    if blocks < FEWEST_BANDS:
        return None
    edges = np.linspace(0, len(y), blocks + 1).astype(int)
    position, power, freedom, measured = [], [], [], []
    for start, end in pairwise(edges):
        away = np.linspace(-1.0, 1.0, end - start)
        # G and the transient T are polynomials of the frequency within a band (local polynomial method, Pintelon and Schoukens 2012).
        shape = away[:, None] ** np.arange(order)
        response = (u[start:end, :, None] * shape[:, None, :]).reshape(end - start, -1)
        basis = np.hstack([shape.astype(complex), response])
        scale = np.linalg.norm(basis, axis=0)
        basis = basis[:, scale > 0] / scale[scale > 0]
        left, singular, _ = np.linalg.svd(basis, full_matrices=False)
        left = left[:, singular > SAME_RESPONSE * singular[0]]
        # Least squares by projection: what the band's response cannot explain, over the degrees of freedom that are left.
        rest = y[start:end] - left @ (left.conj().T @ y[start:end])
        free = end - start - left.shape[1]
        position.append(np.pi * (start + end + 1) / 2 / len(y))
        power.append(float(np.sum(np.abs(rest) ** 2)) / free)
        # Real and imaginary part count each.
        freedom.append(2 * free)
        measured.append(float(np.mean(np.abs(y[start:end]) ** 2)))
    columns = (np.array(each, float) for each in (position, power, freedom, measured))
    return LeftoverSpectrum(*columns)


# Shares of half the sampling rate above which a band without signal is looked for, the widest first.
NOISE_BAND_BEGINS: tuple[float, ...] = (0.0, 0.1, 0.25, 0.4, 0.55, 0.7)
# Power of an output over what a linear response leaves of it, up to which a band holds no signal to speak of: what the plant does
# nonlinearly there is a share of the signal, and less than the noise.
SIGNAL_SHARE = 4.0


def spectral_level(spectra: list[LeftoverSpectrum], rounding: float = 0.0) -> SpectralLevel:
    """The noise of a sensor from what is left of its records, whose numbers have an error of rounding of this standard deviation."""
    frequency, power, freedom, measured = _concatenate([_join_bands(s, MOST_BANDS) for s in spectra])
    is_filtered = _is_filtered(frequency, power, freedom, rounding)
    without_signal = measured <= SIGNAL_SHARE * power
    most = _most_of_a_sensor(frequency, power, freedom)
    for begin in NOISE_BAND_BEGINS:
        if begin and is_filtered:  # the upper bands alone show what a filter left there
            # a filter may act far below half the sampling rate: its pass band is seen in bands as narrow as they come
            most = _most_of_a_filter(*_concatenate(spectra)[:3], rounding)
            break
        band = frequency >= begin * np.pi
        level = _fit_sensor(frequency[band], power[band], freedom[band])
        if level is not None and level.is_noise and without_signal[band].all():
            return level
        if level is not None:
            most = min(most, level.most)
    return SpectralLevel(most, most, False, 0.0, float(freedom.sum()), is_filtered)


# Times the rounding of the numbers up to which the floor of the highest frequencies shows this rounding, and no sensor.
ROUNDING_FLOOR = 2.0
# Pairs of bands, as shares of half the sampling rate, the upper one directly above the lower one. In each the power left falls where
# a filter acts; above the end of an excitation it does not in the second.
END_BANDS: tuple[tuple[float, float], ...] = ((0.55, 0.85), (0.7, 0.9))
# Probability that the power left by a sensor without a filter falls by so much.
FALL_CHANCE = 0.001


def _is_filtered(frequency: np.ndarray, power: np.ndarray, freedom: np.ndarray, rounding: float) -> bool:
    """Whether a filter took the noise away at high frequencies.

    What is left then falls up to half the sampling rate by more than the noise of any sensor, or down to the rounding.
    """
    relative = power / sensor_shape(frequency, NOISE_LONGEST_CORRELATION)
    pairs = [(frequency >= begin * np.pi, frequency >= end * np.pi) for begin, end in END_BANDS]
    if not all(upper.any() and (above & ~upper).any() for above, upper in pairs):
        return False
    upper = pairs[0][1]
    if np.average(power[upper], weights=freedom[upper]) <= (ROUNDING_FLOOR * rounding) ** 2:
        return True
    chances = []
    for above, upper in pairs:
        lower = above & ~upper
        high, low = (float(np.average(relative[band], weights=freedom[band])) for band in (upper, lower))
        # Two mean powers of the same noise have a ratio of Fisher's distribution.
        chances.append(fdtr(freedom[upper].sum(), freedom[lower].sum(), high / low) if low > 0 else 1.0)
    return max(chances) <= FALL_CHANCE


def _concatenate(spectra: list[LeftoverSpectrum]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Frequency, power, freedom and measured power of all bands."""
    frequency, power, freedom, measured = (
        np.concatenate([getattr(s, name) for s in spectra]) for name in ("frequency", "power", "freedom", "measured")
    )
    return frequency, power, freedom, measured


def _join_bands(spectrum: LeftoverSpectrum, most: int) -> LeftoverSpectrum:
    """The same in at most ``most`` bands, each the mean of neighbours."""
    groups = np.array_split(np.arange(len(spectrum.power)), min(len(spectrum.power), most))
    weights = [spectrum.freedom[g] for g in groups]

    def mean(values: np.ndarray) -> np.ndarray:
        return np.array([np.average(values[g], weights=w) for g, w in zip(groups, weights, strict=True)])

    total = np.array([w.sum() for w in weights])
    return LeftoverSpectrum(mean(spectrum.frequency), mean(spectrum.power), total, mean(spectrum.measured))


def sensor_shape(frequency: np.ndarray, correlation: float) -> np.ndarray:
    """Spectrum of an autoregression of first order with variance one, whose mean over all frequencies is one."""
    # |1 / (1 - c e^{-jw})|^2 times the variance of its innovations, 1 - c^2.
    return (1 - correlation**2) / np.abs(1 - correlation * np.exp(-1j * frequency)) ** 2


# Fewest bands that can show the shape of a spectrum.
FEWEST_NOISE_BANDS = 6
# Probability by chance below which a spectrum is not that of a sensor.
NOISE_BAND_CHANCE = 0.001
# Largest correlation of a sensor's noise from sample to sample, twenty samples of memory: what remembers for longer is something else.
NOISE_LONGEST_CORRELATION = 0.95
# Twice the log-likelihood by which two correlations must differ for one of them to be unlikely: three standard deviations.
COLOUR_GAIN = 9.0
# Ratio of the largest to the smallest likely level up to which a level is known, and not bounded only.
ABOUT_RATIO = 1.6
# Standard deviations of chance by which these levels are widened.
SPECTRAL_DEVIATIONS = 2.0
# Steps of the search over correlations.
CORRELATION_STEPS = 50


def _fit_sensor(frequency: np.ndarray, power: np.ndarray, freedom: np.ndarray) -> SpectralLevel | None:
    """The noise with the spectrum of a sensor that explains these bands; None where it does not, by more than chance."""
    if len(power) < FEWEST_NOISE_BANDS or not (power > 0).all():
        return None
    correlations = np.linspace(0.0, NOISE_LONGEST_CORRELATION, CORRELATION_STEPS)
    # P(w) = sigma^2 S(w; c): for each correlation the most likely variance is the weighted mean of P / S.
    shares = power / np.array([sensor_shape(frequency, c) for c in correlations])
    variances = shares @ freedom / freedom.sum()
    ratios = shares / variances[:, None]
    # Whittle's likelihood of means of freedom / 2 exponential periodograms
    deviances = (ratios - 1 - np.log(ratios)) @ freedom
    best = int(np.argmin(deviances))
    if deviances[best] > chdtri(len(power) - 1, NOISE_BAND_CHANCE):
        return None
    likely = deviances <= deviances[best] + COLOUR_GAIN
    chosen = 0 if likely[0] else best
    levels = np.sqrt(variances)
    # A variance from f degrees of freedom scatters by sqrt(2 / f), its root by half of that.
    chance = 1 + SPECTRAL_DEVIATIONS / np.sqrt(2 * freedom.sum())
    high, low = levels[likely].max() * chance, levels[likely].min() / chance
    is_noise = bool(high <= ABOUT_RATIO * low)
    return SpectralLevel(
        float(levels[chosen]), float(high), is_noise, float(correlations[chosen]), float(freedom.sum())
    )


# Probability that the lowest of all bands falls short by more than is allowed for.
LOWEST_BAND_CHANCE = 0.2


def _allow_for_chance(power: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """The power of each band that its measured power hardly ever falls short of: the lowest of many bands is low by chance."""
    return power * freedom / chdtri(freedom, 1 - LOWEST_BAND_CHANCE / len(power))


def _most_of_a_sensor(frequency: np.ndarray, power: np.ndarray, freedom: np.ndarray) -> float:
    """The largest standard deviation of a sensor whose spectrum nowhere exceeds what is left."""
    power = _allow_for_chance(power, freedom)
    correlations = np.linspace(0.0, NOISE_LONGEST_CORRELATION, CORRELATION_STEPS)
    most = max(float(np.min(power / sensor_shape(frequency, c))) for c in correlations)
    return float(np.sqrt(most))


# Corners of the filters that are tried in each octave.
CORNERS_AN_OCTAVE = 12
# Orders of the filters that are tried: from the gentlest to one that is as good as a cut.
FILTER_ORDERS: tuple[int, ...] = (1, 2, 4, 8, 32)
# Lowest corner, as a share of half the sampling rate, that is tried of any filter: its noise remembers twenty samples, as the longest of a
# sensor does.
LOWEST_CORNER = 0.05
# Order of the steepest fall that motion leaves: a force that jumps moves a mass by its reciprocal over the cube of the frequency. What
# falls more steeply is the flank of a filter, whose pass band lies lower.
MOTION_ORDER = 3


def _most_of_a_filter(frequency: np.ndarray, power: np.ndarray, freedom: np.ndarray, rounding: float) -> float:
    """The largest standard deviation of white noise behind a filter whose spectrum nowhere exceeds what is left.

    The lower the corner, the more noise a flank allows: corners are tried down to `LOWEST_CORNER`, and on as long as what is left shows
    the rounding of the numbers or the flank of a filter. Where this goes on to the lowest band the noise is at most all that is left.
    """
    left = float(np.average(power, weights=freedom))
    power = _allow_for_chance(power, freedom)
    # prewarped frequencies of the bilinear transform
    warped = np.log(np.tan(frequency / 2))
    # variance that noise with a corner has at most; on a flank of order n it grows by 2^(2 n) / 2 in an octave
    steepest = 2.0 ** (2 * MOTION_ORDER - 1)
    most: list[float] = []
    corner = np.pi
    while (corner := corner * 2 ** (-1 / CORNERS_AN_OCTAVE)) > frequency.min():
        variance = 0.0
        for order in FILTER_ORDERS:
            # Butterworth's filter, |H|^2 = 1 / (1 + (w / wc)^(2 n))
            shape = expit(-2 * order * (warped - np.log(np.tan(corner / 2))))
            passed = float(np.average(shape, weights=freedom))
            variance = max(variance, passed * float(np.min(power / np.maximum(shape, TINY))))
        most.append(variance)
        before, octave = max(most[:-CORNERS_AN_OCTAVE][-1:], default=0.0), max(most[-CORNERS_AN_OCTAVE:])
        is_flank = octave > steepest * before or octave <= (ROUNDING_FLOOR * rounding) ** 2
        if corner <= LOWEST_CORNER * np.pi and not is_flank:
            return float(np.sqrt(min(max(most), left)))
    return float(np.sqrt(left))


# The noise level of a sensor from the record itself, where it is not given.


# Highest order of differences; each removes a smoother part of the signal, and the smallest result counts.
MAX_DIFFERENCE_ORDER = 8
# Fewest differences from which a standard deviation is computed.
MIN_DIFFERENCES = 10
# Share of the estimate from the order below that the highest order leaves at least of a sensor's noise: 0.99 of a correlated one. Of what
# a filter made smooth it leaves less, however high the order.
LEAST_LAST_SHARE = 0.9


def estimate_noise_from_differences(values: np.ndarray, *, robust: bool = False) -> float:
    """Standard deviation of white noise on a sampled signal, from its high-order differences.

    The difference of order ``d`` has variance ``binomial(2 d, d) sigma^2`` for white noise, and little left of a smooth signal. An
    upper estimate where the signal itself moves from sample to sample; too low where the noise is coloured. ``values`` (N,)
    may contain NaN (differences that touch a gap are left out). ``robust`` takes the median of the differences' sizes, which a few
    outliers do not move (each of them is in ``d + 1`` differences). Returns NaN with fewer than ten usable differences.
    """
    return min(_estimate_by_order(values, robust), default=float("nan"))


def is_smooth(values: np.ndarray) -> bool:
    """Whether the differences of ``values`` (N,) still fall at the highest order: noise of a sensor would have stopped them.

    Such a record was filtered, or has no noise at all.
    """
    estimates = _estimate_by_order(values, robust=False)
    return len(estimates) == MAX_DIFFERENCE_ORDER and estimates[-1] < LEAST_LAST_SHARE * estimates[-2]


def most_behind_a_filter(records: Iterable[np.ndarray]) -> float:
    """The largest standard deviation of noise behind a filter that the first differences of several records allow.

    Noise below the corner ``c`` (a share of half the sampling rate) has the correlation ``sin(pi c) / (pi c)`` from sample to sample, and
    differences of the variance ``2 sigma^2`` times what is missing to one.
    """
    steps = np.concatenate([np.diff(np.asarray(values, float)) for values in records])
    return estimate_spread(steps) / float(np.sqrt(2 * (1 - np.sinc(LOWEST_CORNER))))


def _estimate_by_order(values: np.ndarray, robust: bool) -> list[float]:
    """The standard deviation that the differences of order 1, 2, ... show."""
    estimates = []
    variance, difference = 1.0, np.asarray(values, float)
    for order in range(1, MAX_DIFFERENCE_ORDER + 1):
        difference = np.diff(difference)
        # binomial(2 d, d) from binomial(2 d - 2, d - 1): times 2 (2 d - 1) / d.
        variance *= 2 * (2 * order - 1) / order
        usable = difference[np.isfinite(difference)]
        if len(usable) >= MIN_DIFFERENCES:
            estimates.append(estimate_spread(usable, robust=robust) / float(np.sqrt(variance)))
    return estimates


def estimate_noise_of_records(records: Iterable[np.ndarray], *, robust: bool = False) -> float:
    """`estimate_noise_from_differences` over several records of one sensor, pooled by their number of samples.

    A record in which the sensor does not move at all tells nothing of its noise, and is left out if there are others.
    """
    columns = list(records)
    columns = [c for c in columns if not is_constant(c)] or columns
    levels = [estimate_noise_from_differences(values, robust=robust) for values in columns]
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
