"""What is decided in a discovery: whether an effect is in the data, whether only noise is left, and whether a name may be given.

Every function takes fitted candidates and a `SelectionPolicy` and returns a decision with the checks that it rests on. Nothing is
fitted or simulated here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from greybox.base.values import Check
from greybox.data.noise.noise_model import AutoRegression
from greybox.discovery.findings import DiscoveryRule
from greybox.discovery.holdout import PARTIAL_SHARE, VISIBLE_RMS, HoldoutError, count_independent, worst_output
from greybox.discovery.policy import SelectionPolicy
from greybox.discovery.problem import FittedCandidate, clean_cost_limit, noise_cost_limit


class Verdict(StrEnum):
    """What may be said about a model that was looked at."""

    COMPLETE = "complete"
    """Nothing is missing beyond the noise."""
    NAMED = "named"
    """The missing effects have names, and nothing visible is left."""
    PARTLY = "partly"
    """Some effects are established, and more than noise is left."""
    AMBIGUOUS = "ambiguous"
    """Several sets of effects explain the records equally well."""
    UNKNOWN = "unknown"
    """Something is missing, and no effect of the catalogue is established."""


class Grade(StrEnum):
    """What may be said of a claim, or of an effect in a model."""

    ESTABLISHED = "established"
    """It holds: nothing else that was fitted does as well."""
    PROBABLE = "probable"
    """It explains a part of the error, and another claim might do so as well."""
    STAND_IN = "stand_in"
    """It represents something that has another form."""


@dataclass(frozen=True)
class Decision:
    """A yes or a no, and the checks that it rests on."""

    passed: bool
    checks: tuple[Check, ...]

    def __bool__(self) -> bool:
        return self.passed


@dataclass(frozen=True)
class Conclusion:
    """The verdict on a model, and the checks that it rests on."""

    verdict: Verdict
    checks: tuple[Check, ...]


def make_check(rule: DiscoveryRule, value: float, limit: float, passed: bool, subject: str = "") -> Check:
    """A check whose outcome is more than a comparison of ``value`` and ``limit``."""
    return Check(rule, float(value), float(limit), bool(passed), subject)


def visible_rms_limit(samples: int, colour: AutoRegression) -> float:
    """Rms over noise above which a record of ``samples`` shows more than noise; coloured noise has fewer independent samples."""
    return VISIBLE_RMS + 4 / math.sqrt(2 * count_independent(samples, colour))


def excess_cost(candidate: FittedCandidate) -> float:
    """Cost beyond that of the noise."""
    return max(candidate.cost - candidate.count, 0.0)


def criterion_gain(smaller: FittedCandidate, larger: FittedCandidate) -> float:
    """Decrease of Schwarz's criterion from the smaller model to the larger."""
    return smaller.criterion - larger.criterion


# Share of the plain model's excess cost that the first effect must explain: one that explains less is a look-alike.
SELECTION_FIRST_SHARE = 0.1
# Share of it that every further effect must explain.
FURTHER_SHARE = 0.01


def judge_effect(
    baseline: FittedCandidate, smaller: FittedCandidate, larger: FittedCandidate, policy: SelectionPolicy
) -> Decision:
    """Whether the effect that leads from ``smaller`` to ``larger`` is in the data.

    Beside a strong effect a weak one is a small share of the whole, and yet plain to see: it is accepted if only noise is left.
    """
    subject = " + ".join(name for name in larger.effects if name not in smaller.effects)
    gain = criterion_gain(smaller, larger)
    gains = make_check(DiscoveryRule.CRITERION_GAIN, gain, policy.criterion_gain, gain > policy.criterion_gain, subject)
    share = SELECTION_FIRST_SHARE if smaller is baseline else FURTHER_SHARE
    explains = Check.at_least(
        DiscoveryRule.EXPLAINED_EXCESS, smaller.cost - larger.cost, share * excess_cost(baseline), subject
    )
    if smaller is baseline:
        return Decision(gains.passed and explains.passed, (gains, explains))
    limit = noise_cost_limit(larger.count)
    completes = bool(larger.per_sample <= limit < smaller.per_sample)
    leaves_noise = make_check(DiscoveryRule.ONLY_NOISE_LEFT, larger.per_sample, limit, completes, subject)
    return Decision(gains.passed and (completes or explains.passed), (gains, explains, leaves_noise))


# A remainder below this share of the plain model's excess is clean as well: beside a strong effect a weak rest is no objection.
CLEAN_SHARE = 0.003
# Cost per sample above which `clean_share` does not apply.
CLEAN_COST = 1.6


def judge_residual(baseline: FittedCandidate, candidate: FittedCandidate) -> Decision:
    """Whether nothing visible is left, so that a name may be given."""
    subject = " + ".join(candidate.effects)
    clean = Check.at_most(
        DiscoveryRule.CLEAN_RESIDUAL, candidate.per_sample, clean_cost_limit(candidate.count), subject
    )
    rest, limit = excess_cost(candidate), CLEAN_SHARE * excess_cost(baseline)
    small = bool(rest <= limit and candidate.per_sample < CLEAN_COST)
    remainder = make_check(DiscoveryRule.SMALL_REMAINDER, rest, limit, small, subject)
    return Decision(clean.passed or small, (clean, remainder))


def judge_holdout(
    holdout: Mapping[str, HoldoutError], noise_limits: Mapping[str, float], policy: SelectionPolicy
) -> Decision:
    """Whether a model explains the gap on the validation records, if there is one.

    It explains `SelectionPolicy.holdout_share` of it; or the larger part, and what it leaves is within ``noise_limits``: by output, the
    rms over noise that noise of this level and colour may leave by chance.
    """
    output = worst_output(holdout)
    error = holdout[output]
    gap = error.before / error.floor
    visible = make_check(DiscoveryRule.HOLDOUT_GAP, gap, VISIBLE_RMS, not gap <= VISIBLE_RMS, output)
    explained = Check.at_least(DiscoveryRule.HOLDOUT_EXPLAINED, error.explained_fraction, policy.holdout_share, output)
    partly = Check.at_least(DiscoveryRule.HOLDOUT_PARTLY_EXPLAINED, error.explained_fraction, PARTIAL_SHARE, output)
    noise = Check.at_most(DiscoveryRule.HOLDOUT_NOISE, error.after / error.floor, noise_limits[output], output)
    passed = not visible.passed or explained.passed or (partly.passed and noise.passed)
    return Decision(passed, (visible, explained, partly, noise))


# A misfit shows on the validation records only if it exceeds the noise there by this many times as much as on the others.
VALIDATION_ONLY_RATIO = 2.0


def judge_validation_only(
    baseline: FittedCandidate,
    holdout: Mapping[str, HoldoutError],
    noise_limits: Mapping[str, float],
) -> Decision:
    """Whether the plain model fails on the validation records and not on the estimation records."""
    output = worst_output(holdout)
    error = holdout[output]
    excess, limit = error.before / error.floor - 1, VALIDATION_ONLY_RATIO * (baseline.per_sample**0.5 - 1)
    elsewhere = make_check(DiscoveryRule.VALIDATION_ONLY, excess, limit, not excess < limit, output)
    above = tuple(
        make_check(DiscoveryRule.VALIDATION_ABOVE_NOISE, g.before / g.floor, limit, g.before / g.floor > limit, name)
        for name, g in holdout.items()
        for limit in (noise_limits[name],)
    )
    return Decision(elsewhere.passed and any(above), (elsewhere, *above))


def judge_test(
    errors: Mapping[str, HoldoutError], noise_limits: Mapping[str, float], policy: SelectionPolicy
) -> Decision:
    """Whether a model leaves only noise on records that took no part, or explains enough of the gap there, in every output."""
    checks = []
    for output, error in errors.items():
        ratio, limit = error.after / error.floor, noise_limits[output]
        passed = ratio <= limit or error.explained_fraction >= policy.holdout_share
        checks.append(make_check(DiscoveryRule.TEST_NOISE, ratio, limit, passed, output))
    return Decision(all(check.passed for check in checks), tuple(checks))


# Sum of squared autocorrelations of the whitened residual, beyond chance, above which it still holds structure.
EXCESS_AUTOCORRELATION = 0.03


# Rms of the residual over the noise below which it is the integrator's error: that is no noise, and says nothing of the plant.
NUMERICAL_ERROR = 1e-3


def judge_rest(
    baseline: FittedCandidate,
    selected: FittedCandidate,
    holdout: Mapping[str, HoldoutError],
    noise_limits: Mapping[str, float],
    autocorrelation: float,
    policy: SelectionPolicy,
) -> Decision:
    """Whether a model leaves only noise, on the records that were fitted and on those that judge it.

    Parameters
    ----------
    baseline, selected
        The plain model and the one that the selection ended with, its shape corrected where the records asked for that.
    holdout
        Error of both on the validation records, by output.
    noise_limits
        Rms over noise on these records that noise may leave by chance, by output.
    autocorrelation
        Excess autocorrelation of the residual of ``selected``.
    policy
        The limits.
    """
    if not selected.effects:
        limit = clean_cost_limit(baseline.count)
        above = make_check(DiscoveryRule.BASELINE_ABOVE_NOISE, baseline.per_sample, limit, baseline.per_sample > limit)
        elsewhere = judge_validation_only(baseline, holdout, noise_limits)
        return Decision(not (above or elsewhere), (above, *elsewhere.checks))
    subject = " + ".join(selected.effects)
    clean = judge_residual(baseline, selected)
    white = make_check(
        DiscoveryRule.WHITE_RESIDUAL,
        autocorrelation,
        EXCESS_AUTOCORRELATION,
        selected.per_sample < NUMERICAL_ERROR**2 or not autocorrelation > EXCESS_AUTOCORRELATION,
        subject,
    )
    explained = judge_holdout(holdout, noise_limits, policy)
    return Decision(bool(clean and white and explained), (*clean.checks, white, *explained.checks))
