"""Numbers that steer how records become an optimisation problem and how it is solved."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from greybox.data.noise.policy import NoisePolicy
from greybox.estimation.optim.minimisation import GaussNewtonPolicy, MinimisationPolicy, TerminationPolicy
from greybox.simulation.integrators.discretisation import DiscretisationPolicy


@dataclass(frozen=True)
class TranscriptionChoicePolicy:
    """Which transcription suits a model and its record."""

    max_error_growth: float = 20.0
    """Factor by which errors may grow over the record. Beyond it a free run loses the constants."""


@dataclass(frozen=True)
class SegmentPolicy:
    """How long the segments of a record are."""

    max_segments: int = 50
    """Segments of a record, unless the growth of errors asks for more."""

    usual_rows: int = 20
    """Fewest samples of a segment, unless the growth of errors asks for shorter ones."""


@dataclass(frozen=True)
class MultipleShootingPolicy:
    """When a search over segments has converged, and which steps it takes."""

    termination: TerminationPolicy = field(
        default_factory=lambda: TerminationPolicy(negligible_decrease=1e-6, patience=8)
    )
    """When nothing is left to gain: within a thousandth of a standard deviation."""


@dataclass(frozen=True)
class RelaxationPolicy:
    """How the constants are first fitted to segments that need not meet; the result is only a start."""

    termination: TerminationPolicy = field(
        default_factory=lambda: TerminationPolicy(negligible_decrease=1e-6, patience=1, little_gain=1e-2)
    )
    """When a step is the last one, in shares of the cost: it gained less than a hundredth, or hardly anything is left."""

    damped: GaussNewtonPolicy = field(default_factory=lambda: GaussNewtonPolicy(damping_growth=100.0, max_rejections=5))
    """How the steps are damped: quickly, as the start need not be good."""


@dataclass(frozen=True)
class ProjectionPolicy(TerminationPolicy):
    """How well the initial state of each record is found for the constants of the moment."""

    negligible_decrease: float = 1e-8
    """Found when a further step would lower chi-square by less than this many residual variances ..."""

    perfect_noise_ratio: float = 1e-8
    """... or the misfit over noise by less than this: data without noise end at rounding errors."""


@dataclass(frozen=True)
class RobustLossPolicy:
    """What a robust loss takes for an outlier."""

    huber_threshold: float = 1.345
    """Threshold in noise standard deviations: 95 % of the efficiency of least squares on normal noise (Huber 1981)."""


# The negligible decrease over part of a record, which is only a way to a start: a tenth of a standard deviation will do.
NEGLIGIBLE_DECREASE_IN_PART = 0.01


@dataclass(frozen=True)
class ConvergencePolicy(TerminationPolicy):
    """When a search by simulation error has converged."""

    @property
    def in_part(self) -> TerminationPolicy:
        """When a search over part of a record has converged."""
        return replace(self, negligible_decrease=NEGLIGIBLE_DECREASE_IN_PART)


@dataclass(frozen=True)
class StepRefinementPolicy:
    """How small the integration step has to be at the optimum."""

    halvings: int = 4
    """Times the step is halved at most."""

    max_substeps: int = 16_000
    """Substeps of a sample from which a step is made no finer."""


@dataclass(frozen=True)
class TranscriptionPolicy:
    """All numbers that steer a transcription; see the class of each field."""

    choice: TranscriptionChoicePolicy = field(default_factory=TranscriptionChoicePolicy)
    segments: SegmentPolicy = field(default_factory=SegmentPolicy)
    multiple_shooting: MultipleShootingPolicy = field(default_factory=MultipleShootingPolicy)
    relaxation: RelaxationPolicy = field(default_factory=RelaxationPolicy)
    projection: ProjectionPolicy = field(default_factory=ProjectionPolicy)
    robust_loss: RobustLossPolicy = field(default_factory=RobustLossPolicy)


DEFAULT_POLICY = TranscriptionPolicy()


@dataclass(frozen=True)
class SolverPolicy:
    """All numbers that lay out a problem and steer its solution; see the class of each field."""

    noise: NoisePolicy = field(default_factory=NoisePolicy)
    discretisation: DiscretisationPolicy = field(default_factory=DiscretisationPolicy)
    transcription: TranscriptionPolicy = field(default_factory=TranscriptionPolicy)
    minimisation: MinimisationPolicy = field(default_factory=MinimisationPolicy)

    convergence: ConvergencePolicy = field(default_factory=ConvergencePolicy)
    step_refinement: StepRefinementPolicy = field(default_factory=StepRefinementPolicy)


DEFAULT_SOLVER_POLICY = SolverPolicy()
"""What every solution uses unless it is given another policy."""
