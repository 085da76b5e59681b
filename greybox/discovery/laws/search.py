"""From terms to a law: the leading terms refitted by simulation, judged on the validation records, and set against a free curve.

A law is accepted where the model with it follows the validation records, no law that is simpler or as simple does so as well, and a free
curve in the place of one of its factors does not do better. Else the answer is the set of laws that do equally well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from greybox.base.findings import Check, Finding
from greybox.base.values import ReadOnly
from greybox.discovery.decision import Grade, make_check
from greybox.discovery.execution import RefitJob, SearchStage
from greybox.discovery.findings import DiscoveryCode, DiscoveryRule
from greybox.discovery.holdout import HoldoutScores, validate_candidate
from greybox.discovery.laws import screening
from greybox.discovery.laws.terms import (
    LAW,
    LawTerm,
    Likeness,
    curve_effects,
    find_likeness,
    law_values,
    write_equation,
)
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate, clean_cost_limit
from greybox.discovery.residual_noise import is_level_known
from greybox.discovery.selection import TIE_COST
from greybox.estimation.result import Fit


@dataclass(frozen=True)
class FittedLaw:
    """A law of one or two terms, fitted, and its rms error over noise on the validation records (infinite: not run there)."""

    terms: tuple[LawTerm, ...]
    candidate: FittedCandidate
    score: float = math.inf

    @property
    def complexity(self) -> int:
        """Of its terms together."""
        return sum(term.complexity for term in self.terms)

    def criterion(self) -> float:
        """Schwarz's criterion with a cost for complexity."""
        return self.candidate.criterion + screening.COMPLEXITY_COST * self.complexity


@dataclass(frozen=True, eq=False)
class Law(ReadOnly):
    """One term of the answer as an equation.

    Parameters
    ----------
    name, site
        The effect in the model that it is, and the balance that it acts on.
    equation
        The term with its constants as numbers, in the names of the model, as SymPy reads it.
    formula
        The same with its constants by name.
    unit
        Unit of the balance.
    grade
        What may be said of it.
    seen
        Variable -> least and largest value in the records: beyond that range the law is a guess.
    units
        Their units.
    likeness
        What it behaves as, where that has a name.
    memory
        Unit of what passes through its lag; empty for a law without memory.
    """

    name: str
    site: str
    equation: str
    formula: str
    unit: str
    grade: Grade
    seen: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]
    likeness: Likeness | None = None
    memory: str = ""


@dataclass(frozen=True, eq=False)
class LawSearch(ReadOnly):
    """What a search for laws ended with.

    Parameters
    ----------
    laws
        The terms of the law; none where nothing is missing or no equation explains it.
    alternatives
        Equations that explain the records as well: for each law the text of its terms.
    plain, fit
        The plain model and the model with the law as fits, validated; ``fit`` is None without a law.
    candidate, baseline
        Both as candidates.
    is_clean
        Whether only noise is left with the law.
    checks
        What the decision rests on.
    tried
        How many terms were ranked.
    is_missing
        Whether the plain model lacks something.
    """

    laws: tuple[Law, ...]
    alternatives: tuple[tuple[str, ...], ...]
    baseline: FittedCandidate
    candidate: FittedCandidate | None
    fit: Fit | None
    is_clean: bool
    checks: tuple[Check, ...] = ()
    tried: int = 0
    is_missing: bool = True

    @property
    def grade(self) -> Grade | None:
        """That of the law; None without one."""
        return self.laws[0].grade if self.laws else None


# Terms that are run through the observer after the linear ranking, those that promise most first; the next batch only where none of the
# one before leaves mere noise.
OBSERVED_TERMS: tuple[int, ...] = (18, 24)
# Of these a term is refitted only if its objective there (minus twice the log-likelihood) is within this of the best.
LEADING_DECREASE = 100.0
# The same once a term leaves only noise: others are refitted that may do so as well.
RIVAL_DECREASE = 30.0
# Iterations of such a refit.
LAW_REFIT_ITERATIONS = 40
# Second terms that are refitted beside each of these.
SECOND_TERMS = 4
# Laws that are refitted to the end and judged on the validation records.
FINISHED_LAWS = 6
# Iterations of that.
FINISH_ITERATIONS = 80
# Rms error over noise on the validation records, constants moved within their uncertainty, up to which a law leaves only noise.
CLEAN_SCORE = 1.15


@dataclass
class _LawSelection:
    problem: DiscoveryProblem
    scores: HoldoutScores
    policy: DiscoveryPolicy
    nominal: Mapping[str, float]
    on_message: Callable[[str], None]
    fits: list[FittedLaw] = field(default_factory=list)
    tried: int = 0

    def is_clean(self, candidate: FittedCandidate) -> bool:
        return candidate.per_sample <= clean_cost_limit(candidate.count)

    def is_clean_everywhere(self, candidate: FittedCandidate) -> bool:
        """Whether only noise is left on the validation records too, within what the constants' uncertainty does there."""
        return self.is_clean(candidate) and self.judge(candidate) <= CLEAN_SCORE

    def judge(self, candidate: FittedCandidate) -> float:
        """Rms error over noise on the validation records once constants and first states have moved within their uncertainty.

        Infinite where the model fails. A law that was learnt in another range is not to blame for what its constants leave open.
        """
        run, adapted = self.scores.run(candidate), self.scores.adapt(candidate)
        if run is None or adapted is None:
            return math.inf
        charge, noise = self.scores.charge(adapted), self.problem.noise_std
        ratios = [
            (charge[name] + float(np.nanmean(np.concatenate(r) ** 2))) / noise[name] ** 2
            for name, r in adapted.residuals.items()
        ]
        score = math.sqrt(float(np.mean(ratios)))
        return score if math.isfinite(score) else math.inf

    # Terms beside a model

    def find_terms(self, observed: screening.ObservedModel, terms: tuple[LawTerm, ...], most: int) -> None:
        """The laws that have one term more than the observed model: the leading ones refitted, more of them while none is clean."""
        name = LAW if not terms else f"{LAW}_{len(terms) + 1}"
        # Beside a law whose constants the records have settled there is one variant.
        variants = [observed] if terms else screening.observe_variants(self.problem, observed, self.nominal)
        ranked = screening.rank_everywhere(variants)
        self.tried += len(ranked)
        chosen = screening.choose_terms(ranked, sum(OBSERVED_TERMS))
        first = 0
        for count in OBSERVED_TERMS[: 1 if terms else None]:
            batch = screening.observe_terms(self.problem, self.nominal, chosen[first : first + count], name)
            first += count
            if self._refit_leading(terms, batch, most) or self.problem.executor.is_late:
                return

    def _refit_leading(
        self,
        terms: tuple[LawTerm, ...],
        batch: Sequence[tuple[screening.TermStart, screening.ObservedModel]],
        most: int,
    ) -> bool:
        """Refits by simulation, best first; whether one of them leaves only noise."""
        is_any_clean = False
        for k, (start, one) in enumerate(batch[:most]):
            behind = one.objective - batch[0][1].objective
            if k and behind > (RIVAL_DECREASE if is_any_clean else LEADING_DECREASE):
                break
            fit = self.refit(one, LAW_REFIT_ITERATIONS)
            if fit is not None:
                self.fits.append(FittedLaw((*terms, start.term), fit))
                is_any_clean = is_any_clean or self.is_clean_everywhere(fit)
        return is_any_clean

    def refit_second_terms(self) -> None:
        """The second term of each of the leading laws of two terms alone: the first may have stood in for it."""
        tried = {law.terms for law in self.fits}
        for law in [law for law in self.ranked() if len(law.terms) > 1][:SECOND_TERMS]:
            term, model = law.terms[-1], law.candidate.model
            names = [e.name for e in model.effects if e.name.partition("_")[0] == LAW]
            if (term,) in tried or self.problem.executor.is_late:
                continue
            tried.add((term,))
            values, constants = law_values(model, names[-1]), term.constants
            bound = next(b for b in model.bound_effects if b.effect.name == names[-1])
            limits = model.parameter(bound.model_names[constants.shape]).bounds if term.shape else (-np.inf, np.inf)
            duration = max(float(e.time[-1] - e.time[0]) for e in self.problem.experiments)
            effect = term.to_effect(
                LAW,
                values[constants.amplitude],
                values.get(constants.shape, 1.0),
                values.get(constants.lag, 0.0),
                limits,
                duration,
            )
            for name in names:
                model = model.without(name)
            alone = model + effect
            job = RefitJob(alone, (alone.values,), 1, LAW_REFIT_ITERATIONS, _first_states(law.candidate))
            fit = self.problem.refit_all([job])[0]
            if fit is not None:
                self.fits.append(FittedLaw((term,), fit))
        if any(len(law.terms) == 1 and self.is_clean_everywhere(law.candidate) for law in self.fits):
            self.fits = [law for law in self.fits if len(law.terms) == 1]

    def refit(self, observed: screening.ObservedModel, iterations: int) -> FittedCandidate | None:
        job = RefitJob(observed.model, (observed.values,), 1, iterations, observed.initial)
        return self.problem.refit_all([job])[0]

    # Judging

    def ranked(self) -> list[FittedLaw]:
        return sorted(self.fits, key=lambda law: law.criterion())

    def finish_leading(self) -> None:
        """The leading laws refitted to the end and run over the validation records."""
        best: dict[tuple[LawTerm, ...], FittedLaw] = {}
        for law in self.ranked():
            best.setdefault(tuple(sorted(law.terms, key=str)), law)
        leading = list(best.values())[:FINISHED_LAWS]
        finished = []
        for law in leading:
            fit = law.candidate
            if fit.promised_decrease > screening.SETTLED_DECREASE:
                again = self.problem.refit_best(fit.model, [fit.model.values], 1, FINISH_ITERATIONS, like=fit)
                fit = again if again is not None and again.cost < fit.cost else fit
            finished.append(replace(law, candidate=fit, score=self.judge(fit)))
        self.fits = finished


# Terms that are refitted by simulation after that.
REFITTED_TERMS = 10
# Single terms beside which a second one is looked for.
STARTING_LAWS = 1


def search_laws(
    problem: DiscoveryProblem,
    scores: HoldoutScores,
    baseline: FittedCandidate,
    policy: DiscoveryPolicy,
    on_message: Callable[[str], None],
) -> LawSearch:
    """The equation that a model lacks.

    Parameters
    ----------
    problem
        The estimation records; its model has the constants as the user gave them.
    scores
        The validation records.
    baseline
        The model without the law, fitted.
    policy
        The decision numbers.
    on_message
        Called with a line about each step.
    """
    free = {q.name: q.value for q in problem.model.free_parameters}
    search = _LawSelection(problem, scores, policy, free, on_message)
    observed = _observe_plain(search, baseline)
    if observed is not None:
        again = search.refit(observed, FINISH_ITERATIONS)
        if again is not None and again.cost < baseline.cost:
            baseline = again
    if observed is None or not _lacks_something(search, baseline):
        is_missing = _lacks_something(search, baseline)
        return LawSearch((), (), baseline, None, None, search.is_clean(baseline), is_missing=is_missing)
    search.find_terms(observed, (), REFITTED_TERMS)
    on_message(str(Finding(DiscoveryCode.LAW_TERMS_RANKED, values={"terms": search.tried})))
    ranked = search.ranked()
    if not any(search.is_clean_everywhere(law.candidate) for law in ranked):
        for law in ranked[:STARTING_LAWS]:
            beside = _observe_law(search, law)
            if beside is not None:
                search.find_terms(beside, law.terms, SECOND_TERMS)
        search.refit_second_terms()
    search.finish_leading()
    return _judge(search, _retest_baseline(search, baseline))


# Gauss-Newton steps of the plain model's constants in the observer.
OBSERVER_STEPS = 4


def _observe_plain(search: _LawSelection, baseline: FittedCandidate) -> screening.ObservedModel | None:
    """The plain model in the observer, from the constants that it came with: those of its fit have swallowed the missing term."""
    # An effect that the model has already keeps its fitted constants.
    values = {**baseline.model.values, **search.nominal}
    fit = partial(
        screening.fit_in_observer,
        search.problem,
        baseline.model.start(**values),
        search.nominal,
        {},
        screening.LAW_INTENSITIES,
        OBSERVER_STEPS,
    )
    return search.problem.failures.attempt(SearchStage.SCREENING, baseline.effects, fit, None)


def _observe_law(search: _LawSelection, law: FittedLaw) -> screening.ObservedModel | None:
    fit = law.candidate
    columns = fit.variables.initial.guess.T.tolist()
    initial = dict(zip(fit.model.system.state_names, map(tuple, columns), strict=True))
    return search.problem.failures.attempt(
        SearchStage.SCREENING,
        fit.effects,
        partial(
            screening.fit_in_observer,
            search.problem,
            fit.model,
            search.nominal,
            initial,
            screening.LAW_INTENSITIES,
            OBSERVER_STEPS,
        ),
        None,
    )


def _lacks_something(search: _LawSelection, baseline: FittedCandidate) -> bool:
    return not search.is_clean_everywhere(baseline)


def _retest_baseline(search: _LawSelection, baseline: FittedCandidate) -> FittedCandidate:
    """The plain model once more, from the constants of the best law: one that is stuck elsewhere would make a law of nothing."""
    ranked = search.ranked()
    if not ranked:
        return baseline
    best = ranked[0].candidate
    values = {n: v for n, v in best.model.values.items() if n in baseline.model.values}
    again = search.problem.refit_best(baseline.model, [values], 1, FINISH_ITERATIONS, like=None)
    return again if again is not None and again.cost < baseline.cost else baseline


# Laws whose error on the validation records is within this share of the least do as well.
LAW_SAME_ERROR = 0.1
# Share of the plain model's error above the noise on the validation records that a law must take away.
LAW_LEAST_SHARE = 0.5
# The same for a law that counts as established where it does not reach the noise.
ESTABLISHED_SHARE = 0.9
# Share of the law's error on the validation records that a free curve must take away to beat it.
CURVE_GAIN = 0.25


def _judge(search: _LawSelection, baseline: FittedCandidate) -> LawSearch:
    """The law, or the laws that do equally well."""
    selection = search.policy.selection
    nothing = LawSearch((), (), baseline, None, None, search.is_clean(baseline), tried=search.tried)
    laws = [law for law in search.ranked() if np.isfinite(law.score)]
    if not laws or not _lacks_something(search, baseline):
        return replace(nothing, is_missing=_lacks_something(search, baseline))
    # Constants and first states of both move within their uncertainty: like is compared with like.
    before, least = search.judge(baseline), min(law.score for law in laws)
    near = [law for law in laws if law.score <= (1 + LAW_SAME_ERROR) * max(least, 1.0)]
    best = near[0]
    subject = " + ".join(write_equation(best.candidate.model, best.terms))
    gain = baseline.criterion - best.criterion()
    explained = _share_of_gap(before, best.score)
    checks = [
        make_check(
            DiscoveryRule.CRITERION_GAIN, gain, selection.criterion_gain, gain > selection.criterion_gain, subject
        ),
        Check.at_least(DiscoveryRule.HOLDOUT_PARTLY_EXPLAINED, explained, LAW_LEAST_SHARE, subject),
    ]
    if not all(check.passed for check in checks):
        return replace(nothing, checks=tuple(checks))
    scale = max(best.candidate.per_sample, 1.0)
    rivals = [
        law
        for law in near
        if law is not best
        and law.complexity <= best.complexity
        and (law.candidate.criterion - best.candidate.criterion) / scale < TIE_COST
    ]
    checks += [
        make_check(
            DiscoveryRule.TIE,
            (law.candidate.criterion - best.candidate.criterion) / scale,
            TIE_COST,
            True,
            " + ".join(write_equation(law.candidate.model, law.terms)),
        )
        for law in rivals
    ]
    is_clean = search.is_clean(best.candidate) and best.score <= CLEAN_SCORE
    explains = Check.at_least(DiscoveryRule.HOLDOUT_EXPLAINED, explained, ESTABLISHED_SHARE, subject)
    curve = make_check(DiscoveryRule.LAW_CURVE, 0.0, CURVE_GAIN, True, subject)
    if not is_clean:
        taken = _share_of_curve(search, best)
        curve = make_check(DiscoveryRule.LAW_CURVE, taken, CURVE_GAIN, taken <= CURVE_GAIN, subject)
    checks += [explains, curve]
    if not curve.passed:
        grade = Grade.STAND_IN
    elif rivals or not (is_clean or (explains.passed and not is_level_known(search.problem.noise_model))):
        # Beyond a noise that is known something is missing still, and that may be the right law.
        grade = Grade.PROBABLE
    else:
        grade = Grade.ESTABLISHED
    fit = search.problem.failures.attempt(
        SearchStage.HOLDOUT,
        best.candidate.effects,
        partial(validate_candidate, search.problem, best.candidate, search.scores.validation),
        None,
    )
    if fit is None:
        return replace(nothing, checks=tuple(checks))
    # What a user sees is the free run of the finished fit: there too the law must take what makes it one.
    taken = _share_of_gap(search.scores.score(baseline), fit.validation.noise_ratio)
    checks.append(Check.at_least(DiscoveryRule.HOLDOUT_PARTLY_EXPLAINED, taken, LAW_LEAST_SHARE, subject))
    if not checks[-1].passed:
        return replace(nothing, checks=tuple(checks))
    return LawSearch(
        _to_laws(best, fit, grade),
        tuple(write_equation(law.candidate.model, law.terms) for law in rivals),
        baseline,
        best.candidate,
        fit,
        is_clean,
        tuple(checks),
        search.tried,
    )


# Least error above the noise, over the noise, of which a share is taken: less is rounding.
LEAST_GAP = 1e-3


def _share_of_gap(before: float, after: float) -> float:
    """Share of the gap between an rms error over noise and the noise that is gone; all of it where the plain model runs away."""
    return (before - after) / max(before - 1, LEAST_GAP) if np.isfinite(before) else 1.0


# Iterations of its refit.
CURVE_ITERATIONS = 25


def _share_of_curve(search: _LawSelection, law: FittedLaw) -> float:
    """Share of the law's error on the validation records that the best free curve in the place of one of its factors takes away."""
    candidate = law.candidate
    seen = _ranges(candidate)
    best = 0.0
    for model, start in curve_effects(candidate.model, law.terms, seen):
        job = RefitJob(model, (start,), 1, CURVE_ITERATIONS, _first_states(candidate))
        fit = search.problem.refit_all([job])[0]
        if fit is not None and candidate.criterion - fit.criterion > search.policy.selection.criterion_gain:
            best = max(best, 1 - search.scores.score(fit) / law.score)
    return best


def _first_states(candidate: FittedCandidate) -> dict[str, tuple[float, ...]]:
    columns = candidate.variables.initial.guess.T.tolist()
    return dict(zip(candidate.model.system.state_names, map(tuple, columns), strict=True))


def _ranges(candidate: FittedCandidate) -> dict[str, tuple[float, float]]:
    """Least and largest value of each state and input along the fitted runs."""
    problem = candidate.problem
    runs = problem.shooting(candidate.variables).simulate(candidate.variables.here)
    states = np.concatenate([record.samples(x) for (_, x), record in zip(runs, problem.records, strict=True)])
    inputs = np.concatenate([record.samples(record.u) for record in problem.records])
    names = [*candidate.model.system.state_names, *(i.name for i in candidate.model.inputs)]
    values = np.column_stack([states, inputs[:, : len(candidate.model.inputs)]])
    return {n: (float(v.min()), float(v.max())) for n, v in zip(names, values.T, strict=True)}


def _to_laws(best: FittedLaw, fit: Fit, grade: Grade) -> tuple[Law, ...]:
    seen = _ranges(best.candidate)
    values = {n: e.value for n, e in fit.parameters.items()}
    model = fit.model.start(**{n: v for n, v in values.items() if n in fit.model.values})
    texts = write_equation(model, best.terms)
    laws = []
    names = [e.name for e in model.effects if e.name.partition("_")[0] == LAW]
    for name, term, text in zip(names, best.terms, texts, strict=True):
        within = {v: seen[v] for v in term.variables}
        units = {v: dict(term.units)[v] for v in within}
        likeness = find_likeness(model, name, term)
        laws.append(
            Law(
                name,
                term.site,
                text,
                term.formula,
                term.site_unit,
                grade,
                within,
                units,
                likeness,
                term.product_unit if term.has_memory else "",
            )
        )
    return tuple(laws)
