"""An answer in the making: the set that wins, both models as validated fits, what is claimed, and the verdict that follows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

from greybox.base import Check, Finding
from greybox.discovery.claims import NO_GROUNDS, Claim, Grounds, grade_claims, name_claim, order_of_name, read_verdict
from greybox.discovery.decision import Conclusion, Decision, Grade, Verdict, judge_rest, make_check, visible_rms_limit
from greybox.discovery.effect_signal import EffectSignal
from greybox.discovery.execution import SearchStage
from greybox.discovery.false_names import FalseNameRate
from greybox.discovery.findings import DiscoveryRule
from greybox.discovery.holdout import (
    VISIBLE_RMS,
    HoldoutError,
    HoldoutScores,
    ValidationSet,
    compare_holdout_errors,
    validate_candidate,
    worst_output,
)
from greybox.discovery.laws.terms import claimed_name
from greybox.discovery.localisation import ResidualLocalisation
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate
from greybox.discovery.residual_noise import (
    estimate_residual_noise,
    excess_autocorrelation,
    is_level_known,
    is_shape_correction,
)
from greybox.discovery.search import AUTOCORRELATION_LAGS, EffectSearch
from greybox.estimation import Fit
from greybox.model import Effect
from greybox.model.parts import read_parts


@dataclass(frozen=True)
class SearchAnswer:
    """An answer in the making, as each step of the conclusion leaves it.

    Parameters
    ----------
    search
        The search with its table.
    scores
        The validation records, under the noise that is judged with.
    plain, candidate
        The plain model and that of the answer, under this noise.
    base, best
        Both as fits that were validated.
    location
        What the plain model leaves unexplained, and where; None before anybody looked.
    weighed
        What resampling the records says, with its probabilities.
    grounds
        What the grades of these rest on beside.
    rates
        How often signals without meaning would have been established in the place of its effects.
    signals
        The signal of each effect of the answer.
    terms
        How many terms of equations were tried; 0 where none were looked for.
    findings
        What a user should know beside the verdict.
    checks
        Those against the plain model, on the records that judge and on those that took no part.
    rejected
        Names of its effects where the plain model is the answer in their place; "" for an answer that stands.
    usual
        What the records alone say, where what such rigs usually have comes first.
    question
        The part of the rig that nobody has spoken of, and on which the name hangs.
    on_test
        Whether the records that took no part bear out that only noise is left; None without such records.
    """

    search: EffectSearch
    scores: HoldoutScores
    plain: FittedCandidate
    candidate: FittedCandidate
    base: Fit
    best: Fit
    location: ResidualLocalisation | None = None
    weighed: tuple[Claim, ...] = ()
    grounds: Grounds = NO_GROUNDS
    rates: tuple[FalseNameRate, ...] = ()
    signals: tuple[EffectSignal, ...] = ()
    terms: int = 0
    findings: tuple[Finding, ...] = ()
    checks: tuple[Check, ...] = ()
    rejected: str = ""
    usual: Finding | None = None
    question: Finding | None = None
    on_test: Decision | None = None

    @property
    def problem(self) -> DiscoveryProblem:
        """The records and the noise of its search."""
        return self.search.problem

    @property
    def validation(self) -> ValidationSet:
        """The records that judge."""
        return self.scores.validation

    @cached_property
    def holdout(self) -> Mapping[str, HoldoutError]:
        """Error of both models on these, by output."""
        return self.compare(self.base, self.best)

    def compare(self, plain: Fit, best: Fit) -> dict[str, HoldoutError]:
        """Errors of two validated fits, by output, beside the noise that is judged with: a fit of one's own may estimate another."""
        errors = compare_holdout_errors(plain, best)
        return {name: replace(error, floor=self.noise_std[name]) for name, error in errors.items()}

    @property
    def noise_std(self) -> Mapping[str, float]:
        """The noise that is judged with, by output."""
        noise = self.plain.problem.noise
        return dict(zip(noise.outputs, map(float, noise.std), strict=True))

    @property
    def explained_fraction(self) -> float:
        """Share of the gap that the extended model explains, in the output that the plain model misses most."""
        return self.holdout[worst_output(self.holdout)].explained_fraction

    @property
    def added(self) -> list[Effect]:
        """The effects of the extended model that the plain one has not."""
        given = {e.name for e in self.base.model.effects}
        return [e for e in self.best.model.effects if e.name not in given]

    @property
    def named(self) -> list[str]:
        """Those that have a name, without curves that correct them, as they are called in claims, in the order of an answer."""
        parts = read_parts(self.base.model)
        named = [(claimed_name(e), parts.occurrence(e)) for e in self.added if not is_shape_correction(e.name)]
        return [name for name, _ in sorted(named, key=lambda each: order_of_name(self.claims, *each))]

    @cached_property
    def noise_limits(self) -> dict[str, float]:
        """Rms over noise that noise and the uncertainty of the constants hardly ever exceed on the validation records, by output."""
        return self.limit_noise(self.scores)

    def limit_noise(self, scores: HoldoutScores) -> dict[str, float]:
        """The same on the records of ``scores``."""
        run, drift = scores.run(self.candidate), scores.measure_drift(self.candidate)
        noise = self.plain.problem.noise
        if run is None:
            return dict.fromkeys(self.holdout, VISIBLE_RMS)
        colours = dict(zip(noise.outputs, noise.colour, strict=True))
        return {
            name: math.hypot(
                visible_rms_limit(misfit.samples, colours[name]),
                math.sqrt(drift.get(name, 0.0)) / self.noise_std[name],
            )
            for name, misfit in run.misfit.items()
        }

    @cached_property
    def rest(self) -> Decision:
        """Whether its model leaves only noise, on the records that were fitted, on those that judge and on those that took no part."""
        correlation = excess_autocorrelation(self.candidate, AUTOCORRELATION_LAGS) if self.candidate.effects else 0.0
        policy = self.search.policy.selection
        rest = judge_rest(self.plain, self.candidate, self.holdout, self.noise_limits, correlation, policy)
        if self.on_test is None:
            return rest
        return Decision(rest.passed and self.on_test.passed, (*rest.checks, *self.on_test.checks))

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """What is said, with its grades."""
        return grade_claims(self.weighed, self.grounds)

    @cached_property
    def decided(self) -> Conclusion:
        """The verdict, with the checks that it rests on."""
        rest = self.rest
        # Of a plain model whose fit ends elsewhere when it is repeated nobody knows what it lacks.
        if rest and not self.named and not self.grounds.is_settled:
            rest = Decision(False, (*rest.checks, make_check(DiscoveryRule.SETTLED, 0.0, 1.0, False)))
        return read_verdict(rest, self.claims, self.named)

    @property
    def verdict(self) -> Verdict:
        """What may be said so far."""
        return self.decided.verdict

    @property
    def names(self) -> list[Claim]:
        """The claims of its effects by name."""
        return [c for e in self.named if (c := name_claim(self.claims, e)) is not None]

    @property
    def is_open(self) -> bool:
        """Whether something is missing that no effect is certain to be."""
        return self.verdict in (Verdict.UNKNOWN, Verdict.PARTLY)

    @property
    def is_nameless(self) -> bool:
        """Whether something is missing, and no name of an effect is even probable."""
        return self.is_open and all(claim.grade is Grade.STAND_IN for claim in self.names)

    @property
    def has_certain_name(self) -> bool:
        """Whether an effect is established, or one of a few that the records cannot tell apart."""
        return not self.is_open or any(claim.is_established for claim in self.names)


def make_answer(search: EffectSearch, winner: FittedCandidate) -> SearchAnswer:
    """The set that wins as an answer: both models validated, under the noise that the records leave open at most.

    The plain model where the other cannot be run over the records that judge.
    """
    problem, validation = search.problem, search.table.scores.validation
    plain, candidate = search.baseline, winner
    if not is_level_known(problem.noise_model):
        # The one place where what is left is read as noise: within the bounds that the records set, to say whether anything is left.
        noise = estimate_residual_noise(winner)
        problem = replace(problem, noise=noise, options=problem.refit_options)
        plain, candidate = (problem.restore(c.model, problem.to_outcome(c)) for c in (plain, winner))
    if not winner.effects:
        candidate = plain
    scores = HoldoutScores(problem, validation)
    base = validate_candidate(problem, plain, validation)
    best: Fit | None = base
    if candidate is not plain:
        finish = partial(validate_candidate, problem, candidate, validation)
        best = problem.failures.attempt(SearchStage.HOLDOUT, candidate.effects, finish, None)
    if best is None:  # it fails on other records than those that it was fitted to
        candidate, best = plain, base
    return SearchAnswer(search, scores, plain, candidate, base, best)
