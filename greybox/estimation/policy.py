"""The numbers that steer decisions of an estimation, each with its meaning, unit and reason.

`EstimationPolicy` holds one policy for each decision; `greybox.estimation.FitOptions` carries it into a fit, and the result keeps it
with the options. A decision number changes by ``replace``::

    FitOptions(policy=EstimationPolicy(reporting=ReportingPolicy(prior_conflict=2.0)))
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

from scipy.special import chdtri

from greybox.data.noise.noise_model import NoiseModel, NoiseSource
from greybox.estimation.optim.policy import GaussNewtonPolicy, TerminationPolicy
from greybox.estimation.transcription.policy import SolverPolicy


@dataclass(frozen=True)
class NoiseLoopPolicy:
    """How often noise model and solution are estimated in turn, and when both stand still."""

    settled_size: float = 0.02
    """The level of a noise, or the scale of a robust loss, stands still when it changes by less than this share from round to round."""

    rounds: int = 8
    """Solutions under a new noise model at most. Most fits need none, one with a robust loss three or four."""

    least_scale: float = 0.3
    """Lower limit of the scale of a robust loss over an estimated noise, which outliers may have made so much too large; less is
    rounding."""

    polishing_steps: int = 3
    """Gauss-Newton steps after the last round at most, which give the parameters their last digits."""

    robust_polishing_steps: int = 30
    """The same with a robust loss, where each step of reweighted least squares is nearer by about the same share."""

    last_digits: TerminationPolicy = field(
        default_factory=lambda: TerminationPolicy(negligible_decrease=1e-12, perfect_noise_ratio=0.0, little_gain=0.0)
    )
    """They end where the next one would move the parameters by a millionth of their standard deviations."""

    polishing: GaussNewtonPolicy = field(
        default_factory=lambda: GaussNewtonPolicy(initial_damping=0.0, max_rejections=1)
    )
    """Undamped, so that they go to the end along sloppy directions as well; the first that gains nothing is the last."""


@dataclass(frozen=True)
class IntervalPolicy:
    """How intervals allow for a coloured residual, and how the observed information is computed."""

    least_samples: int = 50
    """A residual of fewer samples shows no colour that could be told from chance: it counts as white."""

    correlation_times: float = 5.0
    """The kernel estimate of the scores' covariance looks so many correlation times back."""

    record_share: float = 0.125
    """It looks back over this share of a record at most."""

    difference_share: float = 1e-2
    """The gradient of a likelihood is differenced over this share of a standard deviation either way."""

    longest_difference: float = 1e-2
    """The same at most, in the scaled unknowns."""


@dataclass(frozen=True)
class ExcessPolicy:
    """From which misfit over noise a residual is more than noise."""

    noise_ratio: float = 1.3
    """For noise that was measured or given: above the scatter of an estimated level."""

    difference_noise_ratio: float = 10.0
    """For noise told by differences of the records alone, which may be coloured and that much too small."""

    def certain_ratio(self, noise: NoiseModel, output: str) -> float:
        """Misfit over the noise that is weighed with from which a residual is certainly more than noise."""
        if noise.sources.get(output) is NoiseSource.DIFFERENCES:
            return self.difference_noise_ratio
        return self.noise_ratio * noise.ceiling_ratio(output)


@dataclass(frozen=True)
class ConstancyPolicy:
    """When parameters that differ between parts of the data count as not constant."""

    least_deviations: float = 3.0
    """Standard deviations apart from which a shift counts."""

    false_alarm_rate: float = 0.01
    """Rate of false alarms over all comparisons of a fit."""

    least_noise_ratio: float = 0.1
    """A residual below this share of the noise is rounding or integration error, which is not random."""

    residuals_per_unknown: int = 10
    """Parts with fewer residuals for each unknown say nothing."""

    motion_windows: int = 50
    """Small and large motion are told apart in so many windows of a record ..."""

    correlation_times: float = 5.0
    """... over so many correlation times of the residual at least ..."""

    motion_ratio: float = 1.5
    """... if the upper quarter of the motion is so many times as large as the lower."""


@dataclass(frozen=True)
class LikelihoodSearchPolicy:
    """When the search for the most likely parameters of a model with process noise has converged."""

    termination: TerminationPolicy = field(
        default_factory=lambda: TerminationPolicy(negligible_decrease=1e-6, little_gain=1e-2)
    )
    """A thousandth of a standard deviation, squared; acceptable where -2 log L fell by less than a hundredth within the patience, as a
    filter of a model with dry friction is not smooth everywhere."""

    last_digits: TerminationPolicy = field(
        default_factory=lambda: TerminationPolicy(negligible_decrease=1e-12, little_gain=0.0)
    )
    """The same for the steps after it, so that the parameters have their digits."""

    scoring_steps: int = 10
    """Damped steps of Fisher scoring, or Gauss and Newton's, at most where a minimum is near."""

    least_noise: float = 1e-4
    """The noise of an output is not followed below this share of what the records' differences say."""

    greatest_noise: float = 25.0
    """Nor above its start times the exponential of this."""


@dataclass(frozen=True)
class ProcessNoisePolicy:
    """From which intensities of process noise a search starts, and when there is none."""

    start_decades: float = 6.0
    """Start values reach so many decades below the intensity that would explain every movement of a state by chance."""

    start_spacing: float = 0.5
    """Decades between two start values."""

    floor: float = 1e-8
    """An intensity below this share of the one that explains every movement counts as zero."""

    negligible_decrease: float = 0.1
    """Zero does as well where it costs less than this in -2 log L."""

    limit_level: float = 0.1
    """Two-sided level of the chi-square point of an upper limit: one-sided 95 %, as the ratio is zero in half of all cases without any
    process noise."""

    significance: float = 0.01
    """Level at which an intensity counts as clearly above zero."""

    limit_growth: float = 2.0
    """Factor between two trials on the way to an upper limit."""

    limit_steps: int = 40
    """Trials at most."""

    limit_tolerance: float = 0.02
    """The limit is found to this share of the likelihood ratio."""

    @property
    def limit_ratio(self) -> float:
        """Likelihood ratio at an upper limit."""
        return float(chdtri(1, self.limit_level))


@dataclass(frozen=True)
class InitialStatePolicy:
    """How first states are estimated where the parameters are known."""

    first_rows: int = 50
    """Rows from which they are estimated where the rest of the record is to be predicted or judged."""

    smoother_prior: float = 1e4
    """Variance of the first states' prior for a smoother, over what the record says of them: all but a ten-thousandth of the smoothed
    variance is left to the record."""


@dataclass(frozen=True)
class ReportingPolicy:
    """What is worth a finding."""

    validation_ratio: float = 1.5
    """Error on validation records over that on the fitted ones from which the difference wants an explanation."""

    correlation: float = 0.3
    """Sample-to-sample correlation of the residual."""

    least_noise_ratio: float = 0.1
    """Misfit over noise below which there is no residual to speak of."""

    followed_percent: float = 50.0
    """A model that follows less than this per cent of an output (best fit) ..."""

    far_noise_ratio: float = 3.0
    """... with a misfit so many times the noise describes another plant."""

    listed_shifts: int = 3
    """Parameters that are not constant are listed up to this number."""

    step_shift: float = 0.1
    """Share of a standard deviation that half the integration step may shift a parameter."""

    last_digit: float = 1e-6
    """Nobody asks for more digits of a parameter than this share of its value."""

    integration_error: float = 0.1
    """Integration error over the noise ..."""

    integration_share: float = 0.01
    """... and over the misfit."""

    prior_conflict: float = 2.6
    """Standard deviations by which a prior and the data disagree: one in a hundred where both are right."""

    prior_variance_reduction: float = 0.2
    """Share of the prior's variance that the data took away; below it the prior holds the parameter."""

    outlier_share: float = 0.2
    """Share of a sensor's samples that may be outliers; more are no outliers."""


@dataclass(frozen=True)
class MultistartPolicy:
    """Which ends of several starts are the same optimum."""

    same_cost: float = 0.01
    """Difference of two costs over the smaller one."""

    same_noise_ratio: float = 1e-3
    """Or difference of two misfits over noise."""


@dataclass(frozen=True)
class EstimationPolicy(SolverPolicy):
    """All decision numbers of an estimation, those of the steps it is made of included; see the class of each field."""

    noise_loop: NoiseLoopPolicy = field(default_factory=NoiseLoopPolicy)
    intervals: IntervalPolicy = field(default_factory=IntervalPolicy)
    excess: ExcessPolicy = field(default_factory=ExcessPolicy)
    constancy: ConstancyPolicy = field(default_factory=ConstancyPolicy)
    likelihood_search: LikelihoodSearchPolicy = field(default_factory=LikelihoodSearchPolicy)
    process_noise: ProcessNoisePolicy = field(default_factory=ProcessNoisePolicy)
    initial_state: InitialStatePolicy = field(default_factory=InitialStatePolicy)
    reporting: ReportingPolicy = field(default_factory=ReportingPolicy)
    multistart: MultistartPolicy = field(default_factory=MultistartPolicy)

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> EstimationPolicy:
        """The policy that a result has stored; what an older result lacks is the default, what this version lacks is left out."""
        return replace(DEFAULT_POLICY, **_restore_fields(DEFAULT_POLICY, data))


def _restore_fields(default: Any, data: Mapping[str, Any]) -> dict[str, Any]:
    """What stored ``data`` say of the fields of ``default``, groups within groups included."""
    restored: dict[str, Any] = {}
    for name in (f.name for f in fields(default) if f.name in data):
        usual, value = getattr(default, name), data[name]
        if is_dataclass(usual) and not isinstance(usual, type):
            restored[name] = replace(usual, **_restore_fields(usual, value))
        else:
            restored[name] = tuple(value) if isinstance(value, list) else value
    return restored


DEFAULT_POLICY = EstimationPolicy()
"""What every estimation uses unless it is given another policy."""
