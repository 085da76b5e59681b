"""Numbers that steer how records become an optimisation problem and how it is solved."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from greybox.data.noise.policy import NoisePolicy
from greybox.estimation.optim.policy import GaussNewtonPolicy, MinimisationPolicy, TerminationPolicy
from greybox.simulation.integrators.policy import DiscretisationPolicy
from greybox.simulation.records import BandLimitedPolicy


@dataclass(frozen=True)
class TranscriptionChoicePolicy:
    """Which transcription suits a model and its record."""

    linearisation_points: int = 9
    """Points along the record in which the equations are linearised."""

    growth_points: int = 1000
    """Points along the record from which the growth of errors is computed, where one of the first points is unstable."""

    max_error_growth: float = 20.0
    """Factor by which errors may grow over the record. Beyond it a free run loses the constants."""

    forgotten_share: float = 0.03
    """A mode that forgets less than this share of its state over the record counts as an integrator."""

    long_run: float = 50.0
    """Time constants of the slowest other mode after which an integrator's drift leaves the data."""

    max_explicit_substeps: float = 32
    """Explicit substeps a sample beyond which a model counts as stiff."""

    explicit_step: float = 0.5
    """``|h lambda|`` of an explicit substep in that count, as in `DiscretisationPolicy.eigenvalue_step`."""

    max_collocation_samples: int = 10_000
    """Samples up to which collocation is chosen: its program grows with the record, by some tens of kilobytes a sample."""


@dataclass(frozen=True)
class SegmentPolicy:
    """How long the segments of a record are."""

    max_growth: float = 5.0
    """Factor by which an error may grow over one segment of an unstable plant."""

    max_segments: int = 50
    """Segments of a record, unless the growth of errors asks for more."""

    usual_rows: int = 20
    """Fewest samples of a segment, unless the growth of errors asks for shorter ones."""

    least_rows: int = 8
    """Fewest samples of a segment in any case: its first states are estimated from them."""

    least_arc_rows: int = 3
    """Fewest samples of an arc whose length was asked for."""


@dataclass(frozen=True)
class MultipleShootingPolicy:
    """When a search over segments has converged, and which steps it takes."""

    termination: TerminationPolicy = field(
        default_factory=lambda: TerminationPolicy(negligible_decrease=1e-6, patience=8)
    )
    """When nothing is left to gain: within a thousandth of a standard deviation."""

    continuity: float = 1e-7
    """Largest gap between segments of a converged solution, as a share of each state's range."""

    step_lengths: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1, 0.03)
    """Shares of a step that are tried in turn, until the cost or the gaps come down."""

    dampings: tuple[float, ...] = (0.0, 1e-2, 1.0, 1e2)
    """Dampings, as shares of the curvature, that are tried in turn with all step lengths."""

    filter_margin: float = 1e-3
    """Share of the gaps by which a step has to be better than every point before it, in the gaps or in the cost."""

    rounding_slack: float = 1e4
    """Where no step helps any more, a point that meets the convergence test this many times less strictly is an optimum to within
    rounding errors."""


@dataclass(frozen=True)
class RelaxationPolicy:
    """How the constants are first fitted to segments that need not meet; the result is only a start."""

    max_log_change: float = 4.6
    """A positive constant stays within a factor ``e^4.6``, a hundred, of its start; no step of a joined search is longer."""

    termination: TerminationPolicy = field(
        default_factory=lambda: TerminationPolicy(negligible_decrease=1e-6, patience=1, little_gain=1e-2)
    )
    """When a step is the last one, in shares of the cost: it gained less than a hundredth, or hardly anything is left."""

    max_steps: int = 15
    """Steps at most."""

    damped: GaussNewtonPolicy = field(default_factory=lambda: GaussNewtonPolicy(damping_growth=100.0, max_rejections=5))
    """How the steps are damped: quickly, as the start need not be good."""

    prior_weight: float = 0.25
    """Short segments may leave a constant open, so positive ones are held weakly: a factor ``e^2`` is one standard deviation."""


@dataclass(frozen=True)
class ProjectionPolicy(TerminationPolicy):
    """How well the initial state of each record is found for the constants of the moment."""

    negligible_decrease: float = 1e-8
    """Found when a further step would lower chi-square by less than this many residual variances ..."""

    perfect_noise_ratio: float = 1e-8
    """... or the misfit over noise by less than this: data without noise end at rounding errors."""

    max_steps: int = 12
    """Gauss-Newton steps at most; from the state of the last point one or two are enough."""


@dataclass(frozen=True)
class RobustLossPolicy:
    """What a robust loss takes for an outlier."""

    huber_threshold: float = 1.345
    """Threshold in noise standard deviations: 95 % of the efficiency of least squares on normal noise (Huber 1981)."""

    student_freedom: float = 4.0
    """Degrees of freedom: tails heavier than those of any sensor that is in order."""

    outlier_weight: float = 0.35
    """A residual that counts less than this share of its least-squares weight is an outlier."""

    least_curvature: float = 0.05
    """The mean curvature of a loss does not fall below this, however many residuals are outliers."""


@dataclass(frozen=True)
class ConvergencePolicy(TerminationPolicy):
    """When a search by simulation error has converged."""

    negligible_decrease_in_part: float = 1e-2
    """The negligible decrease over part of a record, which is only a way to a start: a tenth of a standard deviation will do."""

    weak_prior: float = 0.25
    """Precision of the prior on the logarithm of positive parameters while only part of the record is used: a factor e^2 is one
    standard deviation."""

    stiff_growth: int = 16
    """Growth of the number of substeps that a fit which is not thorough follows: candidates that stray to stiff parameters would take
    all the time."""

    @property
    def in_part(self) -> TerminationPolicy:
        """When a search over part of a record has converged."""
        return replace(self, negligible_decrease=self.negligible_decrease_in_part)


@dataclass(frozen=True)
class StepRefinementPolicy:
    """How small the integration step has to be at the optimum."""

    noise_share: float = 0.1
    """Change of an output with half the step that is allowed, over its noise (or its misfit where that is even less)."""

    misfit_share: float = 0.01
    """The same over a misfit far above the noise."""

    movement_share: float = 1e-7
    """The same over the output's standard deviation: a record without any noise leaves nothing but the integrator's own error."""

    few_steps: int = 2000
    """Records of so few steps altogether cost nothing, and get the share below."""

    noise_share_of_few: float = 1e-6
    """Allowed change over noise and misfit of records of few steps. An error of a share s of the residual changes the cost by 2 s at
    most, so the cost has its first six digits."""

    halvings: int = 4
    """Times the step is halved at most."""

    max_substeps: int = 16_000
    """Substeps of a sample from which a step is made no finer."""

    checked_rows: int = 2000
    """The change is looked at over the first quarter of every record, or so many rows: three more simulations of all of it cost too
    much."""


@dataclass(frozen=True)
class ProgressiveHorizonPolicy:
    """How much of a record is fitted first, and how much more next."""

    time_constants: float = 2.0
    """The first part holds so many of the slowest time constants: over them a start that is far off cannot run out of step."""

    movement: float = 0.1
    """It holds this share of an output's range as well, so that there is something to fit."""

    least_rows: int = 60
    """Rows of the first part at least."""

    rows_per_unknown: int = 5
    """Rows of the first part for each unknown at least."""

    inspected_rows: int = 2000
    """Rows of a record at which movement and sampling time are looked at."""

    growth: tuple[float, ...] = (10.0, 4.0, 2.0, 1.4)
    """The record grows by the first of these factors with which the model foretells the longer part."""

    surprise: float = 3.0
    """A longer part is foretold if the misfit grows at most so many times (of the noise at least)."""

    foretold_share: float = 0.8
    """It is foretold as well where the model still follows this share of the outputs' movement."""

    almost_whole: float = 0.5
    """From this share of the record on the next part is the whole."""

    followed_share: float = 0.5
    """A first part of whose movement less than this can be followed is too long for that start."""

    shrink: float = 3.0
    """It is shortened by this factor."""

    least_shrink: float = 1.2
    """A part less than so many times the shortest one is not shortened."""


@dataclass(frozen=True)
class JoiningPolicy:
    """When a run of segments, arcs or collocation points counts as a free run."""

    free_run_noise_share: float = 0.1
    """A free run from the initial states is that of the segments if it differs by at most this share of the noise anywhere."""

    cost_ratio: float = 1.1
    """A free run follows the joined one if its cost is at most so many times as large ..."""

    perfect_noise_ratio: float = 1e-3
    """... or larger by this misfit over noise squared for each sample."""

    most_unknowns: int = 1000
    """Unknowns of a fit by arcs with coloured noise, robust loss or priors at most: its Hessian is dense."""

    length_tolerance: float = 0.01
    """Arcs longer than the longest record by at most this share are the whole record, and no mistake."""


@dataclass(frozen=True)
class TranscriptionPolicy:
    """All numbers that steer a transcription; see the class of each field."""

    choice: TranscriptionChoicePolicy = field(default_factory=TranscriptionChoicePolicy)
    segments: SegmentPolicy = field(default_factory=SegmentPolicy)
    multiple_shooting: MultipleShootingPolicy = field(default_factory=MultipleShootingPolicy)
    relaxation: RelaxationPolicy = field(default_factory=RelaxationPolicy)
    projection: ProjectionPolicy = field(default_factory=ProjectionPolicy)
    band_limited: BandLimitedPolicy = field(default_factory=BandLimitedPolicy)
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
    progressive_horizon: ProgressiveHorizonPolicy = field(default_factory=ProgressiveHorizonPolicy)
    joining: JoiningPolicy = field(default_factory=JoiningPolicy)


DEFAULT_SOLVER_POLICY = SolverPolicy()
"""What every solution uses unless it is given another policy."""
