"""The numbers by which the noise of a sensor is estimated."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NoisePolicy:
    """Rules for level and colour of the noise. Shares and ratios have no unit."""

    max_order: int = 12
    """Highest order of an autoregression that is tried; the noise of sensors and filters needs no more."""
    samples_per_order: int = 10
    """Samples that a record must have for each order: with fewer a coefficient is chance."""

    max_difference_order: int = 8
    """Highest order of differences; each removes a smoother part of the signal, and the smallest result counts."""
    min_differences: int = 10
    """Fewest differences from which a standard deviation is computed."""
    memory_samples: int = 500
    """Samples over which the autocorrelation of coloured noise is summed."""
    longest_memory: float = 20.0
    """Sum of autocorrelations, in samples, beyond which a series is no sensor's noise: something moves, or a model lacks something."""
    min_relative_level: float = 1e-6
    """Least noise over the movement of the signal: where a record shows none (a simulation), misfits are judged against this."""

    quiet_input_share: float = 0.05
    """Largest movement of an input in a quiet record, over its movement in the other records, for it to be at rest."""
    quiet_min_samples: int = 20
    """Fewest samples of a quiet record from which the level is taken."""
    same_pace: float = 0.01
    """Sampling times that differ by more than this share of the longest do not share a colour."""

    same_input: float = 1e-6
    """Two inputs are the same where they differ by less than this share of their range."""
    min_period_rows: int = 20
    """Fewest rows of a period, and fewest values of repeats, from which noise is estimated."""
    settled_ratio: float = 1.5
    """Ratio of early to late variance from which a repeat still shows how its record began."""

    flat_min_rows: int = 10
    """Fewest rows of the settled end of a stretch with the input at rest."""
    flat_min_samples: int = 60
    """Fewest rows of all such ends together."""
    flat_drift: float = 0.3
    """Energy of a straight line over that of the rest above which an end is still moving: noise that remembers ten samples seldom
    reaches it."""
    flat_quantiles: tuple[float, float] = (0.1, 0.9)
    """Shares of the rows below which the quietest and the loudest pieces lie."""
    flat_ratio: float = 3.0
    """Ratio of their levels up to which all pieces have one level; beyond it the noise depends on what the sensor shows."""
    code_share: float = 0.5
    """Different readings over all readings up to which a sensor shows codes."""
    code_step: float = 0.1
    """Share of the distances between neighbouring readings that are shorter than one step of the sensor: averaged or filtered codes."""

    response_order: int = 2
    """Order of the polynomials by which frequency response and transient are smooth over a band."""
    free_frequencies: int = 12
    """Frequencies of a band beyond its unknowns: they carry the estimate."""
    fewest_bands: int = 4
    """Fewest bands of a record that is long enough to separate noise from a response."""
    most_bands: int = 48
    """Bands that a spectrum is averaged to at most: each with little scatter."""
    same_response: float = 1e-10
    """Singular value, over the largest, below which two inputs are the same in a band."""
    noise_band_begins: tuple[float, ...] = (0.0, 0.1, 0.25, 0.4, 0.55, 0.7)
    """Shares of half the sampling rate above which a band without signal is looked for, the widest first."""
    fewest_noise_bands: int = 6
    """Fewest bands that can show the shape of a spectrum."""
    noise_band_chance: float = 1e-3
    """Probability by chance below which a spectrum is not that of a sensor."""
    signal_share: float = 4.0
    """Power of an output over what a linear response leaves of it, up to which a band holds no signal to speak of: what the plant does
    nonlinearly there is a share of the signal, and less than the noise."""
    lowest_band_chance: float = 0.2
    """Probability that the lowest of all bands falls short by more than is allowed for."""
    longest_correlation: float = 0.95
    """Largest correlation of a sensor's noise from sample to sample, twenty samples of memory: what remembers for longer is something
    else."""
    colour_gain: float = 9.0
    """Twice the log-likelihood by which two correlations must differ for one of them to be unlikely: three standard deviations."""
    about_ratio: float = 1.6
    """Ratio of the largest to the smallest likely level up to which a level is known, and not bounded only."""
    spectral_deviations: float = 2.0
    """Standard deviations of chance by which these levels are widened."""
    correlation_steps: int = 50
    """Steps of the search over correlations."""


NOISE_POLICY = NoisePolicy()
