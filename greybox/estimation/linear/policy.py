"""Decisions of the hand-over to controller design: operating points, sampling times, families of models, discrete steps."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class OperatingPointPolicy:
    """How an equilibrium is sought."""

    iterations: int = 60
    """Newton steps of one search."""
    halvings: int = 30
    """How often a step is halved until it helps."""
    restarts: int = 25
    """Searches from random points, where the first one finds nothing."""
    restart_reach: float = 0.1
    """Standard deviation of a restart, relative to the typical size of a variable that is not zero at the start."""
    restart_decades: int = 5
    """A variable that is zero at the start is moved by 1 to ``10 ** (restart_decades - 1)`` times its typical size."""
    extrapolation: float = 0.5
    """A point further outside the records than this share of their range is reported."""


@dataclass(frozen=True)
class SamplingPolicy:
    """When a sampling time is too long for the dynamics, and which delays can be represented."""

    samples_per_period: int = 10
    """Samples in a period of an oscillating mode that a controller needs."""
    ringing_damping: float = 0.7
    """A mode of a lower damping ratio oscillates."""
    samples_per_decay: float = 5.0
    """Samples within the slowest time constant that are proposed where every mode decays within one."""
    most_delay_states: int = 1000
    """Longest delay in samples: each sample is a state."""
    largest_pade_order: int = 10
    """Highest order of a Pade approximation; beyond it the coefficients lose all digits."""


@dataclass(frozen=True)
class FamilyPolicy:
    """How the models of a family are drawn, and how their worst case is sought."""

    redraws: int = 100
    """How often a draw outside the bounds is repeated; what is left then is put on the bound."""
    logarithmic_std: float = 0.25
    """A positive parameter with a larger relative standard deviation is drawn by its logarithm: it would often come out negative.
    The others are not: where only a sum of parameters is well determined, logarithms would lose that."""
    worst_case_starts: int = 5
    """Searches for the worst case, from the worst of the draws."""


@dataclass(frozen=True)
class DiscreteStepPolicy:
    """How fine the step of exported code is."""

    precision: float = 1e-7
    """The step is halved until that changes a run over the estimation record by less than this share of its movement."""
    rows: int = 2000
    """Rows of that record."""


DEFAULT_OPERATING_POINT = OperatingPointPolicy()
DEFAULT_SAMPLING = SamplingPolicy()
DEFAULT_FAMILY = FamilyPolicy()
DEFAULT_STEP = DiscreteStepPolicy()
