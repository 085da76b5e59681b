"""The numbers by which the noise of a sensor is estimated."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NoisePolicy:
    """Rules for level and colour of the noise. Shares and ratios have no unit."""

    max_order: int = 12
    """Highest order of an autoregression that is tried; the noise of sensors and filters needs no more."""

    min_relative_level: float = 1e-6
    """Least noise over the movement of the signal: where a record shows none (a simulation), misfits are judged against this."""


NOISE_POLICY = NoisePolicy()
