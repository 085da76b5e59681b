"""Models on records that no parameter has seen: the holdout error, and the rejection of a model that explains nothing there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.discovery.failures import SearchStage
from greybox.discovery.findings import DiscoveryRule
from greybox.discovery.policy import SelectionPolicy
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.estimation import fit as estimate
from greybox.estimation import validate
from greybox.experiment import Experiment
from greybox.findings import Check
from greybox.result import Fit, Misfit
from greybox.values import Printable


@dataclass(frozen=True)
class HoldoutError(Printable):
    """Rms simulation error of one output on the validation records.

    Parameters
    ----------
    before, after
        Error of the plain and of the extended model, in ``unit``.
    floor
        Standard deviation of the noise: the error of a perfect model.
    unit
        Unit of the output.
    """

    before: float
    after: float
    floor: float
    unit: str

    @property
    def explained_fraction(self) -> float:
        """Share of the gap between ``before`` and ``floor`` that the extended model removes; negative where it is worse."""
        return (self.before - self.after) / max(self.before - self.floor, 1e-12 * self.before)


def compare_holdout_errors(base: Fit, best: Fit) -> dict[str, HoldoutError]:
    """By output, from two fits that were validated on the same records."""
    after = best.validation.misfit
    return {name: _compare(before, after[name]) for name, before in base.validation.misfit.items()}


def _compare(before: Misfit, after: Misfit) -> HoldoutError:
    return HoldoutError(before.rmse, after.rmse, before.rmse / before.noise_ratio, before.unit)


def worst_output(holdout: Mapping[str, HoldoutError]) -> str:
    """The output that the plain model misses most, in units of its noise."""
    return max(holdout, key=lambda name: holdout[name].before / holdout[name].floor)


def validate_candidate(
    problem: DiscoveryProblem, candidate: CandidateFit, validation: Sequence[Experiment], skip: int = 0
) -> Fit:
    """The candidate as a fit with intervals, from its own parameters and initial states, validated on other records.

    ``skip`` rows at the start of each validation record do not count.
    """
    quick = replace(problem.options, progressive=False, thorough=False)
    initial = estimated_initial_states(candidate)
    fit = estimate(candidate.model, problem.experiments, noise=candidate.problem.noise, initial=initial, options=quick)
    if not validation:
        return fit
    validated = validate(fit.model, validation, noise=fit.noise.std, skip=skip, options=quick)
    return replace(fit, validation=validated)


def estimated_initial_states(candidate: CandidateFit) -> list[dict[str, float]]:
    """The estimated initial states of each record where a refit ended."""
    initial, names = candidate.variables.initial, np.array(candidate.model.system.state_names)
    return [dict(zip(names[initial.free].tolist(), row[initial.free].tolist(), strict=True)) for row in initial.guess]


def score_holdout(
    problem: DiscoveryProblem, candidate: CandidateFit, validation: Sequence[Experiment], skip: int = 0
) -> float:
    """Rms simulation error over noise on the validation records, all outputs together; infinite where the model fails there."""

    def score() -> float:
        quick = replace(problem.options, progressive=False, thorough=False)
        validated = validate(candidate.model, validation, noise=problem.noise_std, skip=skip, options=quick)
        return float(np.sqrt(np.mean([m.noise_ratio**2 for m in validated.misfit.values()])))

    return problem.failures.attempt(SearchStage.HOLDOUT, candidate.effects, score, np.inf)


def reject_on_validation(
    problem: DiscoveryProblem,
    baseline: CandidateFit,
    selected: CandidateFit,
    candidates: Sequence[CandidateFit],
    validation: Sequence[Experiment],
    policy: SelectionPolicy,
    skip: int = 0,
) -> tuple[CandidateFit, tuple[Check, ...]]:
    """``selected``, or another candidate where ``selected`` explains less than half of the gap on the validation records.

    The likeliest of ``candidates`` that explains most of the gap replaces it. If none does, ``selected`` remains, and its effect will
    be called unknown.

    Returns
    -------
    tuple
        The candidate to go on with, and the checks that this rests on.
    """
    before = score_holdout(problem, baseline, validation, skip)

    def explained_share(candidate: CandidateFit) -> float:
        after = score_holdout(problem, candidate, validation, skip)
        return (before - after) / (before - 1) if np.isfinite(after) else -np.inf

    checks: list[Check] = []

    def explains(candidate: CandidateFit, rule: DiscoveryRule, limit: float) -> bool:
        checks.append(Check.at_least(rule, explained_share(candidate), limit, " + ".join(candidate.effects)))
        return checks[-1].passed

    partly, mostly = DiscoveryRule.HOLDOUT_PARTLY_EXPLAINED, DiscoveryRule.HOLDOUT_EXPLAINED
    if before <= policy.visible_rms or explains(selected, partly, policy.partial_share):
        return selected, tuple(checks)
    ranked = sorted(candidates, key=lambda c: c.criterion)
    others = [c for c in ranked if c.effects and c.effects != selected.effects]
    for candidate in others[: problem.budget.holdout_candidates]:
        again = problem.refit_best(candidate.model, [candidate.model.values], keep=1, like=candidate)
        better = again if again is not None and again.cost < candidate.cost else candidate
        if explains(better, mostly, policy.holdout_share):
            return better, tuple(checks)
    return selected, tuple(checks)
