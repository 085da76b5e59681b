"""The numbers that steer the design of an experiment."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class PlayPolicy:
    """What every input that is played has in common."""

    soft_start: float = 0.04
    """Share of the duration in which an input rises from rest at the start, and falls back at the end: a step into a plant at rest
    excites every resonance, and a rig wants to end where it began."""
    rest_share: float = 0.02
    """Share of the duration at the end in which the input is at rest: the plant settles, and the noise shows."""


@dataclass(frozen=True)
class MarginPolicy:
    """How far predicted states and outputs stay away from their limits."""

    samples: int = 4
    """Constants drawn from what is known of them, beside the best ones: each must keep the limits."""


@dataclass(frozen=True)
class InputSearchPolicy:
    """Which inputs are tried, and how the best one is refined."""

    bands: int = 4
    """Upper ends of the band of sweeps and multisines that are tried, evenly on a logarithmic scale."""
    crest_iterations: int = 400
    """Steps in which the phases of a multisine are improved."""
    starts: int = 6
    """Inputs, the best of their kinds, that are refined: each ends at a best input of its own, by up to a factor of two apart."""
    rounds: int = 4
    """Rounds of the refinement, one where only the ranges of the inputs are limited."""
    iterations: int = 120
    """Most iterations of L-BFGS-B in a round."""
    refined_scenarios: int = 4
    """Drawn constants that the refinement looks at beside the best ones: with two it made inputs for these two."""


@dataclass(frozen=True)
class DesignPolicy:
    """The numbers behind a design."""

    play: PlayPolicy = field(default_factory=PlayPolicy)
    margin: MarginPolicy = field(default_factory=MarginPolicy)
    search: InputSearchPolicy = field(default_factory=InputSearchPolicy)
    least_rows: int = 40
    """Rows below which there is nothing to design."""


DESIGN_POLICY = DesignPolicy()


@dataclass(frozen=True)
class RigPolicy:
    """How a rig program is run and its record judged."""

    timeout: float = 600.0
    """Seconds after which a rig program that has not ended is stopped, beyond the duration of the record."""


@dataclass(frozen=True)
class CampaignPolicy:
    """How a campaign goes on and when it ends."""

    experiments: int = 3
    """Records that may be taken."""
    contradiction: float = 3.0
    """Misfit over noise from which the best explanation is contradicted: what it predicts far from where the rig has been says little."""
    rig: RigPolicy = field(default_factory=RigPolicy)
    """How the rig is run."""


CAMPAIGN_POLICY = CampaignPolicy()
