"""The numbers that steer profiles and bootstraps, each with its meaning, unit and reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ProfilePolicy:
    """How a profile is followed to where it crosses its threshold."""

    tolerance: float = 0.01
    """The crossing is found to this share of the threshold, which is half a per cent of the interval's length."""


@dataclass(frozen=True)
class BootstrapPolicy:
    """How long the blocks of a bootstrap are."""

    correlation_times: float = 5.0
    """A block covers so many correlation times of the residual, and at least the cube root of the record (Kunsch 1989)."""

    least_blocks: int = 5
    """Blocks in a record at least: fewer cannot be drawn in enough different orders."""


DEFAULT_PROFILE_POLICY = ProfilePolicy()
DEFAULT_BOOTSTRAP_POLICY = BootstrapPolicy()
