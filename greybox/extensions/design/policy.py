"""The numbers that steer the design of an experiment."""

from __future__ import annotations

from dataclasses import dataclass, field

from greybox.discovery.policy import ProposalPolicy


@dataclass(frozen=True)
class PlayPolicy:
    """What every input that is played has in common."""

    soft_start: float = 0.04
    """Share of the duration in which an input rises from rest at the start, and falls back at the end: a step into a plant at rest
    excites every resonance, and a rig wants to end where it began."""
    rest_share: float = 0.02
    """Share of the duration at the end in which the input is at rest: the plant settles, and the noise shows."""
    smoothing: int = 5
    """Samples over which a generator that is not held (``hold`` first or band-limited) averages a designed input: what it cannot play
    above half the sampling frequency is gone."""
    share_of_nyquist: float = 0.8
    """Share of half the sampling frequency up to which inputs are designed."""


@dataclass(frozen=True)
class MarginPolicy:
    """How far predicted states and outputs stay away from their limits."""

    samples: int = 4
    """Constants drawn from what is known of them, beside the best ones: each must keep the limits."""
    deviations: float = 3.0
    """Standard deviations, over these draws, that the predicted range is widened by at every time."""
    reserve: float = 0.02
    """Share of the distance from rest to a limit that stays free in any case: rounding of the generator, noise."""
    assumed_spread: float = 0.2
    """Standard deviation of the logarithm of each free constant where no record has been taken: a data sheet's 20 %."""
    largest_deviation: float = 0.7
    """Largest change of a drawn constant, in its logarithm or as a share of its value: what is not determined at all is not drawn at
    a thousand times its value."""
    tries: int = 14
    """Times that an input is made smaller until every limit holds; each comes close, so that more would mean that none does."""
    least_amplitude: float = 1e-4
    """Share of the input's range below which an input counts as none."""


@dataclass(frozen=True)
class InputSearchPolicy:
    """Which inputs are tried, and how the best one is refined."""

    bands: int = 4
    """Upper ends of the band of sweeps and multisines that are tried, evenly on a logarithmic scale."""
    amplitudes: tuple[float, ...] = (1.0, 0.4)
    """Shares of the largest allowed amplitude that are tried: a nonlinear effect may show at a small one."""
    spectrum_lines: int = 12
    """Lines of the spectrum whose power is optimised."""
    prbs_order: int = 12
    """Stages of the shift register: the sequence repeats after 4095 values."""
    staircase_levels: int = 7
    """Levels of a staircase up and down."""
    step_count: int = 12
    """Random levels of a sequence of steps at the lowest band, more for higher ones."""
    crest_iterations: int = 400
    """Steps in which the phases of a multisine are improved."""
    most_rows: int = 1200
    """Samples that are refined one by one: a longer record repeats them or holds each for several samples."""
    points_per_period: float = 5.0
    """Samples that the refined input has in a period of the highest frequency of the input that it starts from."""
    starts: int = 6
    """Inputs, the best of their kinds, that are refined: each ends at a best input of its own, by up to a factor of two apart."""
    least_starts: int = 2
    """Fewest of them, where several models are run: the number above is for one."""
    rounds: int = 4
    """Rounds of the refinement, one where only the ranges of the inputs are limited."""
    violation_growth: float = 3.0
    """Factor on the weight of violated limits from round to round."""
    iterations: int = 120
    """Most iterations of L-BFGS-B in a round."""
    least_iterations: int = 8
    """Fewest of them."""
    work: float = 2e8
    """Samples times substeps times states with their sensitivities that a round may run: some seconds."""
    violation_weight: float = 600.0
    """Weight of half the mean square of what limits are passed by, as a share of the room to them, in the first round; multipliers make
    the limits exact afterwards."""
    refined_scenarios: int = 4
    """Drawn constants that the refinement looks at beside the best ones: with two it made inputs for these two."""
    seed: int = 1
    """Seed of random phases, levels and constants: the same question has the same answer."""


@dataclass(frozen=True)
class GoalPolicy:
    """How goals are measured."""

    prior_spread: float = 2.302585092994046
    """What is known without data, as a standard deviation of the logarithm of a constant: its order of magnitude (a factor of ten).
    Keeps criteria finite where a constant is not determined."""
    undetermined_share: float = 0.3
    """Share of that spread from which a predicted standard deviation says that the records do not determine a constant."""
    detection_ratio: float = ProposalPolicy.detection_ratio
    """Standard deviations of an amplitude that is detected nine times in ten at a false-alarm rate of one per cent."""
    detection_probe: float = 0.02
    """Multiple of an effect's usual amplitude at which its smallest visible amount is asked for: nearly absent."""
    least_prior: float = 1e-8
    """Share of that information that is assumed of the amplitude of an effect which may hide: an effect that no record shows has a
    large amount, not an infinite one."""
    held_amplitude: float = 1e4
    """Information that keeps such an amplitude where it is while the other constants are drawn."""
    deciding_cost: float = 20.0
    """Cost by which the wrong one of two explanations must lose, beyond chance, for the record to decide."""
    new_sensor_noise: float = ProposalPolicy.new_sensor_noise
    """Noise of a sensor that is not installed and not described, as a share of the largest value that it would show."""


@dataclass(frozen=True)
class DesignPolicy:
    """The numbers behind a design."""

    play: PlayPolicy = field(default_factory=PlayPolicy)
    margin: MarginPolicy = field(default_factory=MarginPolicy)
    search: InputSearchPolicy = field(default_factory=InputSearchPolicy)
    goal: GoalPolicy = field(default_factory=GoalPolicy)
    most_rows: int = 200_000
    """Rows of a designed record: its runs must fit into the memory several times."""
    least_rows: int = 40
    """Rows below which there is nothing to design."""


DESIGN_POLICY = DesignPolicy()


@dataclass(frozen=True)
class RigPolicy:
    """How a rig program is run and its record judged."""

    timeout: float = 600.0
    """Seconds after which a rig program that has not ended is stopped, beyond the duration of the record."""
    input_tolerance: float = 0.05
    """Rms difference between the input that was asked for and the one in the record, as a share of its range: more is another record."""
    limit_tolerance: float = 0.01
    """Share of the range of a limit by which a measured signal may pass it, beside three standard deviations of its noise."""
    noise_deviations: float = 4.0
    """Standard deviations of the noise by which a measured signal may pass a limit."""
    message_length: int = 200
    """Characters of a rig program's own last words that are shown."""


@dataclass(frozen=True)
class CampaignPolicy:
    """How a campaign goes on and when it ends."""

    experiments: int = 3
    """Records that may be taken."""
    first_share: float = 0.5
    """Share of the way to each limit that the first record may use: nothing is known yet."""
    unproven_share: float = 0.85
    """Share that later records may use as long as no discovery has named what is missing, or found nothing: an effect that a small
    motion hides grows with the amplitude."""
    contradiction: float = 3.0
    """Misfit over noise from which the best explanation is contradicted: what it predicts far from where the rig has been says little."""
    growth: float = 1.0
    """How far the next record may then go, over how far the rig has been, input by input and signal by signal; the share that is left
    unexplained comes off. What is missing shows already, and a contradicted model does not foresee a jump."""
    rivals: int = 3
    """Explanations, beside the best one, between which a record is to decide."""
    model_error: float = 3.0
    """By how many times the share of the movement that a model leaves unexplained its predictions are widened: an effect that is missing
    grows with the amplitude."""
    interval_deviations: float = 1.96
    """Standard deviations in half a 95 % interval."""
    rig: RigPolicy = field(default_factory=RigPolicy)
    """How the rig is run."""


CAMPAIGN_POLICY = CampaignPolicy()
