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
from greybox.estimation.optim.minimisation import GaussNewtonPolicy, TerminationPolicy
from greybox.estimation.transcription.policy import SolverPolicy


@dataclass(frozen=True)
class NoiseLoopPolicy:
    """How often noise model and solution are estimated in turn, and when both stand still."""

    rounds: int = 8
    """Solutions under a new noise model at most. Most fits need none, one with a robust loss three or four."""

    last_digits: TerminationPolicy = field(
        default_factory=lambda: TerminationPolicy(negligible_decrease=1e-12, perfect_noise_ratio=0.0, little_gain=0.0)
    )
    """They end where the next one would move the parameters by a millionth of their standard deviations."""

    polishing: GaussNewtonPolicy = field(
        default_factory=lambda: GaussNewtonPolicy(initial_damping=0.0, max_rejections=1)
    )
    """Undamped, so that they go to the end along sloppy directions as well; the first that gains nothing is the last."""


# For noise that was measured or given: above the scatter of an estimated level.
NOISE_RATIO = 1.3
# For noise told by differences of the records alone, which may be coloured and that much too small.
DIFFERENCE_NOISE_RATIO = 10.0


@dataclass(frozen=True)
class ExcessPolicy:
    """From which misfit over noise a residual is more than noise."""

    def certain_ratio(self, noise: NoiseModel, output: str) -> float:
        """Misfit over the noise that is weighed with from which a residual is certainly more than noise."""
        if noise.sources.get(output) is NoiseSource.DIFFERENCES:
            return DIFFERENCE_NOISE_RATIO
        return NOISE_RATIO * noise.ceiling_ratio(output)


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


# Two-sided level of the chi-square point of an upper limit: one-sided 95 %, as the ratio is zero in half of all cases without any process
# noise.
LIMIT_LEVEL = 0.1


@dataclass(frozen=True)
class ProcessNoisePolicy:
    """From which intensities of process noise a search starts, and when there is none."""

    @property
    def limit_ratio(self) -> float:
        """Likelihood ratio at an upper limit."""
        return float(chdtri(1, LIMIT_LEVEL))


@dataclass(frozen=True)
class EstimationPolicy(SolverPolicy):
    """All decision numbers of an estimation, those of the steps it is made of included; see the class of each field."""

    noise_loop: NoiseLoopPolicy = field(default_factory=NoiseLoopPolicy)
    excess: ExcessPolicy = field(default_factory=ExcessPolicy)
    likelihood_search: LikelihoodSearchPolicy = field(default_factory=LikelihoodSearchPolicy)
    process_noise: ProcessNoisePolicy = field(default_factory=ProcessNoisePolicy)

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
