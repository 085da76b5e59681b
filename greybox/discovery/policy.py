"""Every decision number of a discovery: what counts as missing, as an effect, as a name, and how hard to look for it.

`DiscoveryPolicy` groups the policies of the stages. It is an argument of `discover`, is stored in the result and written to
``discovery.json``. Costs are sums of squared whitened residuals, so that a difference in cost is a likelihood ratio.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from greybox.discovery.laws.policy import LawPolicy


@dataclass(frozen=True)
class SelectionPolicy:
    """When something is missing, when an effect is accepted, and when it may be named."""

    criterion_gain: float = 20.0
    """An effect must lower Schwarz's criterion by more than this. Twenty is odds of about 20000 to 1, which leaves room for noise
    whose level is not known exactly."""
    first_share: float = 0.1
    """Share of the plain model's excess cost that the first effect must explain: one that explains less is a look-alike."""
    further_share: float = 0.01
    """The same for every further effect, as a share of the plain model's excess cost."""
    child_cost: float = 10.0
    """A richer member of a family replaces a simpler one only if its cost is lower by more than this."""
    child_share: float = 0.003
    """The same as a share of what the richer member gains over the plain model; the larger of the two counts."""
    tie_cost: float = 10.0
    """Models whose criterion differs by less explain the records equally well."""
    floor_margin: float = 0.05
    """Cost per sample beyond chance that is still clean: for a noise level that is not exact, and for the integrator's error."""
    clean_share: float = 0.003
    """A remainder below this share of the plain model's excess is clean as well: beside a strong effect a weak rest is no objection."""
    clean_cost: float = 1.6
    """Cost per sample above which `clean_share` does not apply."""
    excess_autocorrelation: float = 0.03
    """Sum of squared autocorrelations of the whitened residual, beyond chance, above which it still holds structure."""
    autocorrelation_lags: int = 30
    """Lags that this sum runs over."""
    visible_rms: float = 1.05
    """Rms over noise on validation records below which there is no gap to explain."""
    noise_memory: int = 500
    """Samples over which the correlation of coloured noise is summed for the number of independent samples in a record."""
    holdout_share: float = 0.9
    """Share of the gap on validation records that a model must explain before its effect is named."""
    partial_share: float = 0.5
    """Share of that gap below which a model explains nothing there; above it, reaching the noise is enough."""
    validation_only_ratio: float = 2.0
    """A misfit shows on the validation records only if it exceeds the noise there by this many times as much as on the others."""


@dataclass(frozen=True)
class ResidualNoisePolicy:
    """How the noise is identified where neither the user nor a quiet record gives it."""

    white_correlation: float = 0.1
    """Correlation from sample to sample below which a residual counts as white."""
    longest_correlation: float = 0.95
    """Largest correlation from sample to sample of a sensor's noise, as in `greybox.data.noise.NoisePolicy`: a residual that remembers for
    longer is a model's error."""
    level_tolerance: float = 0.05
    """Relative change of the level below which the noise stands still."""
    rounds: int = 2
    """Times that the noise is read off the residual and the selection repeated."""
    carried_sets: int = 8
    """Sets of effects, best first, whose effects remain candidates when the selection is repeated."""


@dataclass(frozen=True)
class SearchBudget:
    """How much is tried, which is what a discovery spends its time on."""

    amplitude_grid: tuple[float, ...] = (1.0, 10.0)
    """Amplitudes at which a refit starts, in multiples of the effect's probe (about a hundredth of the balance it enters)."""
    near_zero_amplitude: float = 0.01
    """Amplitude at which an effect is nearly absent, in the same unit: what a first effect leaves may be that small."""
    refit_iterations: int = 60
    """Iterations of a refit: what has not converged by then is not the answer, or is finished in the last fit."""
    max_substeps: int = 32
    """Substeps of a sample that a refit of the search takes at most, unless the plain model needs more: a candidate that does is stiff by
    its constants alone, and minutes would not make it the answer. The last fit knows no such limit."""
    prediction_substeps: int = 8
    """The same where a cost is only predicted, to rank candidates: with the steps of a refit a stiff model would take minutes to extend."""
    unstable_factor: int = 2
    """How many times as many it takes if it is unstable with so few. One that is so still is out."""
    refit_starts: int = 2
    """Most promising starting points from which a model is refitted."""
    screening_iterations: int = 12
    """Iterations of the first, short refit of every candidate."""
    falling_share: float = 0.1
    """Share of its cost that a further step must promise for a short refit to go on: it was stopped in the middle of a descent."""
    refit_top: int = 5
    """Leading candidates that are refitted to convergence."""
    generations: int = 2
    """Generations of children that are tried (Coulomb friction, then Stribeck, then LuGre)."""
    prune_ratio: float = 4.0
    """A candidate whose short refit is this many times as far from the records as one that leaves only noise is out."""
    many_shapes: int = 15
    """Shapes of an effect above which it is refitted from each of them: a step from afar predicts nothing for a sharp resonance."""
    few_shapes: int = 4
    """Shapes from which the leading effect is refitted from more starting points: its cost has many minima."""
    many_shapes_starts: int = 5
    """The number of these starting points."""
    beam_width: int = 6
    """First effects beside which a second one is tried: two effects may explain together what neither explains alone."""
    batch_size: int = 3
    """How many of them at a time; the later ones count where the leading ones lead nowhere."""
    second_candidates: int = 4
    """Further effects that are refitted beside each leading first effect, or beside all later ones together."""
    finished_candidates: int = 3
    """Models with a further effect that are refitted to convergence."""
    most_effects: int = 3
    """Effects in a model at most."""
    swaps: int = 4
    """Effects tried in the place of one that was chosen."""
    holdout_candidates: int = 8
    """Other sets of effects that are scored on the validation records where the chosen one fails there."""
    correction_heights: int = 10
    """Intervals of the curve that corrects the shape of an effect."""
    correction_iterations: int = 20
    """Iterations of the refit with such a correction."""
    effect_test_starts: int = 3
    """Starting points from which an effect that is tried by hand is refitted."""
    least_noise_share: float = 0.01
    """Share of a residual's variance that counts as noise at least where what is left is localised."""
    search_share: float = 0.6
    """Share of a limited time that the search for effects may take; the rest is for the evidence of what it finds."""
    parallel_seconds: float = 20.0
    """Expected seconds of refits from which starting processes pays."""


@dataclass(frozen=True)
class RefinementPolicy:
    """When a further, small effect is accepted on measured records, whose residual hardly ever reaches the noise."""

    estimation_share: float = 0.02
    """Share of the remaining rms misfit that the effect must remove on the estimation records."""
    validation_share: float = 0.05
    """The same on the validation records."""
    least_deviations: float = 2.0
    """Standard errors, over blocks of the validation records, of what an added effect removes there at least: what helps in a few blocks
    and harms in others is chance, and makes the other effects less certain for nothing."""
    alike_share: float = 0.1
    """Models whose misfits differ by less than this share explain a measured record equally well: an effect that takes the place of
    another must remove more than that."""
    most_steps: int = 5
    """Effects added or replaced at most."""
    most_effects: int = 4
    """Effects in a model from which none is added: a fifth shares its error among four others, and its evidence is worth little."""
    promising_candidates: int = 8
    """Candidates that are refitted for each step."""
    refit_starts: int = 2
    """Starting points of each of these refits, which are short."""
    finished_candidates: int = 3
    """Those that are refitted to convergence: the ones that promise the lowest cost."""
    replacements: int = 3
    """Effects that are refitted in the place of each effect of the model, where none is to be added."""


@dataclass(frozen=True)
class ShapePolicy:
    """When a curve has a shape that can be named. Shares are of the curve's energy after a straight line was removed from it."""

    parity_share: float = 0.75
    """Share of an odd (or even) part from which a curve is odd (or even)."""
    named_share: float = 0.6
    """Share that a template must explain to give its name."""
    bend_share: float = 0.9
    """Share that a bend between two straight lines must explain."""
    one_side_share: float = 0.2
    """Share of the reach below which a curve lies on one side of zero."""
    positions: int = 33
    """Positions of a bend, and widths of a flat middle, that are tried."""
    narrowest_middle: float = 0.2
    """Half-width of a flat middle over the reach: a narrower one is the far side of a step."""
    free_width_ratio: float = 0.5
    """A shape with a free position must reduce what the others leave unexplained to this share of it."""
    fewest_periods: float = 3.0
    """Periods over the range from which a curve counts as periodic."""
    most_periods: float = 40.0
    """Periods over the range up to which one is looked for."""
    steps_per_period: int = 20
    """Steps of the search over the number of periods."""


@dataclass(frozen=True)
class LocalisationPolicy:
    """Localisation of the residual: site, time and dependence."""

    most_rows: int = 1200
    """Rows of the stretch in which the signal is estimated: where the misfit varies most."""
    knot_spacing: int = 4
    """Rows between the knots of the signal."""
    intensities: tuple[float, float, int] = (1e-3, 1e4, 29)
    """Lowest, highest and number of intensities of the signal that are tried: the rms of its response over the noise."""
    memory: float = 0.5
    """Correlation time of the signal, in stretches."""
    site_lead: float = 10.0
    """Log-likelihood in nats by which a site must lead, over no signal and over the next site."""
    site_lead_share: float = 0.001
    """The same as a share of the leading site's gain; the larger of the two counts."""
    measured_ratio: float = 2.0
    """A reading replaces the simulated state where the two differ by more than this many standard deviations of the noise."""
    bins: int = 16
    """Bins of a variable in which the signal is averaged."""
    dependence_share: float = 0.15
    """Share of the signal's variance from which it counts as a function of a variable."""
    loop_share: float = 0.12
    """Further share that the direction of motion must explain for a loop."""
    tone_share: float = 0.5
    """Share of the signal's power in one spectral line from which it is a tone."""
    driven_share: float = 0.25
    """Share of the power of an input or a state in that line above which it is driven and no tone from outside."""
    periodic_gain: float = 0.1
    """Share by which a sinusoid over the variable must explain more than the bins."""
    periodic_gain_of_rest: float = 0.25
    """The same as a share of what the bins leave; the smaller of the two counts."""
    windows: int = 20
    """Windows of time in which each record is divided."""
    concentrated_misfit: float = 0.6
    """Share of the misfit that is concentrated..."""
    concentrated_time: float = 0.25
    """...if it happens in at most this share of the windows."""
    shape: ShapePolicy = field(default_factory=ShapePolicy)
    """How the curve over the best variable is classified."""
    function_scatter: float = 0.15
    """How far what an effect adds may be from a function of one variable, over its standard deviation, for that to be its own variable.
    Neighbouring samples of a smooth law differ by a few percent, those of a step by a tenth."""


@dataclass(frozen=True)
class SurrogatePolicy:
    """How a curve or a tone is fitted in the place of an unknown effect, and when it is worth showing."""

    variables: int = 2
    """Variables over which a curve is tried."""
    free_sites: int = 3
    """Sites that the sensors cannot separate at which a free curve is tried in the place of an effect."""
    intervals: int = 20
    """Intervals of the curve."""
    margin: float = 0.15
    """Share of the range by which the curve extends beyond what was seen."""
    height_prior: float = 5.0
    """Standard deviation of the prior of each height, over the signal's rms: weak, it separates what the model's constants do as well."""
    period_margin: float = 0.1
    """Share by which a period may move from the one that the signal shows."""
    period_starts: tuple[float, ...] = (1.0, 0.985, 1.015)
    """Periods from which a sinusoid is refitted, over the one that the signal shows."""
    powers: tuple[float, ...] = (0.1, 0.3, 0.5, 0.7, 1.5, 2.0, 3.0)
    """Exponents from which a power is fitted; it stays between the first and the last. The straight line is the model's own."""
    straight_share: float = 0.01
    """Share of the variable's rms below which a power is straight."""
    refit_iterations: int = 30
    """Iterations of the refit."""
    refit_starts: int = 1
    """Most promising starting points from which it is refitted."""
    interval_iterations: int = 10
    """Iterations of the last fit, which gives the intervals: many heights would go on for long without showing it."""
    useful_share: float = 0.1
    """Share of the gap on validation records that a curve must explain to be shown."""
    beside_gain: float = 0.02
    """Further share of the gap that a surrogate beside a look-alike must explain over one in its place."""
    tone_periods: int = 5
    """Periods at the start of a validation record from which amplitude and phase of the tone are estimated there."""
    curve_points: int = 101
    """Points of the curve in the result."""
    points_per_period: int = 24
    """Points of one period in the result."""


@dataclass(frozen=True)
class ProposalPolicy:
    """What is proposed next: experiments, sensors, checks of the rig."""

    mains_frequencies: tuple[float, ...] = (50.0, 60.0)
    """Frequencies of the mains in Hz."""
    mains_tolerance: float = 0.01
    """Share of the mains frequency within which a tone may be the mains or a multiple."""
    mains_multiples: int = 5
    """Highest multiple that is considered."""
    range_margin: float = 0.1
    """Share of the range of a variable by which validation records must extend beyond the estimation records to be reported."""
    detection_ratio: float = 3.3
    """Standard deviations of an amplitude that is detected nine times in ten at a false-alarm rate of one per cent."""
    most_samples: int = 4000
    """Samples on which experiments are compared: enough to rank them."""
    new_sensor_noise: float = 0.01
    """Noise of a sensor that is not installed yet, as a share of the largest value that it would show."""
    seed: int = 1
    """Seed of the multisine's phases."""
    most_separations: int = 2
    """Effects that are not established for which an experiment is asked, those that take the largest share of the error first."""


@dataclass(frozen=True)
class EvidencePolicy:
    """How the evidence for each effect is gathered."""

    many_constants: int = 3
    """Constants from which an effect without memory is held against a power of its variable: so many imitate other simple laws."""
    blocks: int = 24
    """Blocks in which the validation records are divided: errors of neighbouring samples are not independent."""
    resamples: int = 400
    """Resampled sets of blocks behind an interval."""
    confidence: float = 0.95
    """Coverage of that interval."""
    seed: int = 1
    """Seed of the resampling: the same records give the same interval."""
    rivals: int = 4
    """Effects of other families that are fitted in the place of each effect."""
    constant_spread: float = 0.1
    """Standard deviation of an effect's signal over its rms up to which it is constant."""
    same_signal: float = 0.02
    """The same of what it adds to the equations, sample by sample, up to which a constant does as well."""
    drift_correlation: float = 0.95
    """Correlation of an effect's signal with time from which it is a drift."""
    same_error: float = 0.01
    """Relative difference of mean square errors, over what the effect takes, below which a rival does the same."""
    iterations: int = 30
    """Iterations of these refits; they start near where they end."""
    quick_iterations: int = 8
    """Iterations after which a rival is given up..."""
    hopeless_cost: float = 25.0
    """...if its cost is still so many times that of the model in question: five times the rms error. Where an effect is left out that
    takes almost everything, the others turn stiff in its place, and each refit would take minutes to show that it is no rival."""
    hopeless_curve: float = 4.0
    """The same for a free curve in the place of an effect: twice the rms error. From twice the cost of the model on it counts as far
    behind, and after these iterations it is hardly above where it would end."""
    least_rows: int = 100
    """Rows of a record below which it is not halved."""
    most_correlation: float = 0.95
    """Correlation from sample to sample up to which a residual may be the noise of a sensor, where nobody knows the noise."""
    displacement: float = 0.5
    """Factor on an effect's amplitudes (and its inverse on its shape) for the refit from another start."""
    same_cost: float = 0.01
    """Relative difference in cost below which two refits ended in the same place."""
    least_blocks: int = 6
    """Blocks from which it is looked at whether the error grows with the amplitude..."""
    amplitude_range: float = 1.5
    """...if the largest amplitude of a block is so many times the smallest..."""
    amplitude_correlation: float = 0.6
    """...and it does so from this rank correlation of error and amplitude on."""


@dataclass(frozen=True)
class CertaintyPolicy:
    """How probable it is that an effect is right, and from which probability it may be called so."""

    intercept: float = -3.8
    """Constant of the logistic function."""
    weights: Mapping[str, float] = field(
        default_factory=lambda: {
            "share": 0.6,
            "loss_t": 0.6,
            "rival_size": 0.3,
            "rival_ratio": 1.3,
            "rival_t": 1.1,
            "rival_parameters": 0.4,
            "curve_size": -1.8,
            "curve_ratio": -0.3,
            "curve_t": -1.1,
            "curve_fit": -1.5,
            "curve_untested": -1.3,
            "untested_left": -3.8,
            "free_size": 2.4,
            "remainder": -2.2,
            "static_size": 0.3,
            "static_t": 0.1,
            "structure": -0.6,
            "left": -2.1,
            "change": -2.6,
            "start": 1.8,
            "several": -1.2,
            "undetermined": -1.3,
        }
    )
    """Weight of each feature of the evidence."""
    most_score: float = 30.0
    """Largest argument of the exponential: beyond it nothing changes and nothing overflows."""
    most_deviations: float = 10.0
    """Standard errors of a difference between models at which it counts in full."""
    established: float = 0.8
    """Probability from which an effect is established. Of the effects of the study (docs/certainty.md) from there on nineteen of twenty
    are right before any single test speaks."""
    probable: float = 0.5
    """Probability from which an effect is probable; below it is a stand-in."""
    least_rival: float = 0.3
    """The best rival must be behind by this share of `most_deviations`: three standard errors. So must be, of an effect with memory, a
    curve in its place, and of one of many constants a power law."""
    most_form: float = 0.5
    """What a flexible curve beside the effect takes more, over what the effect takes, in rms."""
    most_gain: float = 0.11
    """By how much a flexible curve beside the effect may lower the rms error (as a difference of logarithms): a tenth. More than that,
    and more than chance (`least_rival`), is another form."""
    most_own_form: float = 0.04
    """What a curve over the effect's own variable, beside it or in its place, takes more on the records it was fitted to, over what the
    effect takes, in rms. A curve beside the right form takes what its heights take from noise and, as no model is complete, a
    little more."""
    chance_gain: float = 0.02
    """By how much such a curve may lower the logarithm of the rms error of those records by chance: beside the right form it is half a
    percent."""
    least_worse: float = 1.0
    """Standard errors from which such a curve does worse on the validation records than the effect alone."""
    least_free: float = 0.2
    """Root of the relative difference by which a free curve in the effect's place must cost more, wherever it is and whatever it is over:
    4 %. Where one does as well, the place or the name is open."""
    most_remainder: float = 0.6
    """What the effect leaves over its own variable, over its signal, in rms. Much of a weak signal is noise: what is no noise, the curve
    beside the effect takes."""
    least_share: float = 0.05
    """Share of the error that an effect must take."""
    most_change: float = 0.4
    """Relative change of the effect's constants from one half of the records to the other: an imposter is fitted anew to each."""
    most_left: float = 0.3
    """What is left beyond noise, over what the effect takes, in rms: an imposter leaves more of the effect whose place it takes."""
    disguise_share: float = 0.3
    """Share of the error from which a stand-in without an equal puts the other effects in doubt, where `visible_structure` is left. It
    always puts those in doubt that take less than it."""
    visible_structure: float = 0.3
    """Share of the rms error that is more than noise from which something unknown still acts."""
    most_untested: float = 0.1
    """What is left beyond noise, over what the effect takes, in rms, for an effect whose form no curve can test (play, a delay)."""


@dataclass(frozen=True)
class DiscoveryPolicy:
    """The decision numbers of all stages of a discovery.

    Examples
    --------
    >>> from dataclasses import replace
    >>> policy = replace(DiscoveryPolicy(), selection=SelectionPolicy(criterion_gain=40.0))
    >>> policy.selection.criterion_gain
    40.0
    """

    selection: SelectionPolicy = field(default_factory=SelectionPolicy)
    """When an effect is accepted and named."""
    noise: ResidualNoisePolicy = field(default_factory=ResidualNoisePolicy)
    """How the noise is identified."""
    budget: SearchBudget = field(default_factory=SearchBudget)
    """How much is tried."""
    localisation: LocalisationPolicy = field(default_factory=LocalisationPolicy)
    """Where, when and as a function of what."""
    surrogate: SurrogatePolicy = field(default_factory=SurrogatePolicy)
    """A curve or a tone in the place of an unknown effect."""
    proposals: ProposalPolicy = field(default_factory=ProposalPolicy)
    """What is proposed next."""
    evidence: EvidencePolicy = field(default_factory=EvidencePolicy)
    """How the evidence for each effect is gathered."""
    certainty: CertaintyPolicy = field(default_factory=CertaintyPolicy)
    """How probable it is that an effect is right."""
    refinement: RefinementPolicy = field(default_factory=RefinementPolicy)
    """When a further, small effect is accepted on measured records (`refine`)."""
    laws: LawPolicy = field(default_factory=LawPolicy)
    """How an equation is looked for where the catalogue has no effect (``laws=True``)."""
