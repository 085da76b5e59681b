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


NOISE_POLICY = NoisePolicy()
