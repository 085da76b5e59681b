"""The numbers that steer profiles and bootstraps, each with its meaning, unit and reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ProfilePolicy:
    """How a profile is followed to where it crosses its threshold."""

    first_step: float = 1.0
    """First step, in standard deviations: well inside the 95 % point, so that two points bracket it."""

    growth: float = 1.6
    """Growth of the steps after it."""

    steps: int = 9
    """Steps to a side at most: 1.6^8 is 43 standard deviations, beyond which the side counts as open."""

    tolerance: float = 0.01
    """The crossing is found to this share of the threshold, which is half a per cent of the interval's length."""

    refits: int = 8
    """Refits for the crossing at most."""

    blind_step: float = 0.1
    """First step over the value of a parameter without a standard deviation: a factor of e^0.1."""

    cost_decrease: float = 1e-4
    """The cost of each point is minimised to this share of the residual's variance (of one, for a likelihood); the threshold is near 4."""


@dataclass(frozen=True)
class BootstrapPolicy:
    """How long the blocks of a bootstrap are."""

    correlation_times: float = 5.0
    """A block covers so many correlation times of the residual, and at least the cube root of the record (Kunsch 1989)."""

    least_blocks: int = 5
    """Blocks in a record at least: fewer cannot be drawn in enough different orders."""


DEFAULT_PROFILE_POLICY = ProfilePolicy()
DEFAULT_BOOTSTRAP_POLICY = BootstrapPolicy()
