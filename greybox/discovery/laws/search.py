"""Laws as candidates: the terms that an observer ranks first, refitted by simulation. What they are worth is said on the table of sets."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from greybox.base.values import Finding
from greybox.discovery.execution import RefitJob, SearchStage
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import HoldoutScores
from greybox.discovery.laws import screening
from greybox.discovery.laws.terms import LAW, LawTerm, is_law, own_values
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate, clean_cost_limit, share_values
from greybox.model.model import Model


@dataclass(frozen=True)
class FittedLaw:
    """A law of one or two terms, fitted."""

    terms: tuple[LawTerm, ...]
    candidate: FittedCandidate

    def criterion(self) -> float:
        """Schwarz's criterion with a cost for complexity."""
        return self.candidate.criterion + screening.COMPLEXITY_COST * sum(term.complexity for term in self.terms)


@dataclass(frozen=True, eq=False)
class LawProposal:
    """What may be missing as an equation.

    Parameters
    ----------
    beside
        The model without it, fitted again.
    laws
        That model with each of the laws, best first; none where it lacks nothing.
    tried
        How many terms were ranked.
    """

    beside: FittedCandidate
    laws: tuple[FittedCandidate, ...] = ()
    tried: int = 0


# Terms that are run through the observer after the linear ranking, those that promise most first; the next batch only where none of the
# one before leaves mere noise.
OBSERVED_TERMS: tuple[int, ...] = (18, 24)
# Of these a term is refitted only if its objective there (minus twice the log-likelihood) is within this of the best.
LEADING_DECREASE = 100.0
# Distance of the objective of a term from the best one up to which it is refitted once a term leaves only noise: it may do so as well.
RIVAL_DECREASE = 30.0
# Terms that are refitted by simulation after that: alone, and as a second one.
REFITTED_TERMS, SECOND_TERMS = 10, 4
# Iterations of such a refit, and of those that go to the end.
LAW_REFIT_ITERATIONS, FINISH_ITERATIONS = 40, 80
# Laws that are refitted to the end.
FINISHED_LAWS = 6
# Gauss-Newton steps in the observer of the constants beside which terms are ranked.
OBSERVER_STEPS = 4
# Rms error over noise on the validation records, constants moved within their uncertainty, up to which a law leaves only noise.
CLEAN_SCORE = 1.15


def propose_laws(
    problem: DiscoveryProblem,
    scores: HoldoutScores,
    beside: FittedCandidate,
    on_message: Callable[[str], None],
) -> LawProposal:
    """The equations that a model may lack.

    Parameters
    ----------
    problem
        The estimation records; its model has the constants as the user gave them.
    scores
        The validation records.
    beside
        The model without the law, fitted.
    on_message
        Called with a line about each step.
    """
    search = _LawSearch(problem, scores, {q.name: q.value for q in problem.model.free_parameters})
    # From the constants that it came with, as those of its fit have swallowed the missing term; effects keep their fitted ones.
    observed = search.observe(beside.model.start(**{**beside.model.values, **search.nominal}), {})
    if observed is not None:
        beside = _better(search.refit(observed, FINISH_ITERATIONS), beside)
    if observed is None or search.is_clean(beside):
        return LawProposal(beside)
    search.find_terms(observed, (), REFITTED_TERMS)
    on_message(str(Finding(DiscoveryCode.LAW_TERMS_RANKED, values={"terms": search.tried})))
    ranked = search.ranked()
    if ranked and not any(search.is_clean(law.candidate) for law in ranked):
        with_law = search.observe(ranked[0].candidate.model, _first_states(ranked[0].candidate))
        if with_law is not None:
            search.find_terms(with_law, ranked[0].terms, SECOND_TERMS)
            search.refit_second_terms()
    laws = search.finish_leading()
    if laws:
        # Once more from the constants of the best law: a model that is stuck elsewhere would make a law of nothing.
        values = share_values(laws[0].model, beside.model)
        beside = _better(problem.refit_best(beside.model, [values], 1, FINISH_ITERATIONS), beside)
    return LawProposal(beside, laws, search.tried)


def _better(again: FittedCandidate | None, before: FittedCandidate) -> FittedCandidate:
    return again if again is not None and again.cost < before.cost else before


def _first_states(candidate: FittedCandidate) -> dict[str, tuple[float, ...]]:
    columns = candidate.variables.initial.guess.T.tolist()
    return dict(zip(candidate.model.system.state_names, map(tuple, columns), strict=True))


@dataclass
class _LawSearch:
    problem: DiscoveryProblem
    scores: HoldoutScores
    nominal: Mapping[str, float]
    fits: list[FittedLaw] = field(default_factory=list)
    tried: int = 0

    def is_clean(self, candidate: FittedCandidate) -> bool:
        """Whether only noise is left, on the validation records within what the uncertainty of constants and first states does there."""
        if candidate.per_sample > clean_cost_limit(candidate.count):
            return False
        run, adapted = self.scores.run(candidate), self.scores.adapt(candidate)
        if run is None or adapted is None:
            return False
        charge, noise = self.scores.charge(adapted), self.problem.noise_std
        ratios = [
            (charge[name] + float(np.nanmean(np.concatenate(r) ** 2))) / noise[name] ** 2
            for name, r in adapted.residuals.items()
        ]
        return math.sqrt(float(np.mean(ratios))) <= CLEAN_SCORE

    def observe(self, model: Model, initial: Mapping[str, Sequence[float]]) -> screening.ObservedModel | None:
        """A model in the observer."""
        fit = partial(
            screening.fit_in_observer,
            self.problem,
            model,
            self.nominal,
            initial,
            screening.LAW_INTENSITIES,
            OBSERVER_STEPS,
        )
        names = tuple(e.name for e in model.effects)
        return self.problem.failures.attempt(SearchStage.SCREENING, names, fit, None)

    def refit(self, observed: screening.ObservedModel, iterations: int) -> FittedCandidate | None:
        job = RefitJob(observed.model, (observed.values,), 1, iterations, observed.initial)
        return self.problem.refit_all([job])[0]

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
            if self._refit_leading(terms, batch[:most]) or self.problem.executor.is_late:
                return

    def _refit_leading(
        self, terms: tuple[LawTerm, ...], batch: Sequence[tuple[screening.TermStart, screening.ObservedModel]]
    ) -> bool:
        """Refits by simulation, best first; whether one of them leaves only noise."""
        is_any_clean = False
        for k, (start, one) in enumerate(batch):
            behind = one.objective - batch[0][1].objective
            if k and behind > (RIVAL_DECREASE if is_any_clean else LEADING_DECREASE):
                break
            fit = self.refit(one, LAW_REFIT_ITERATIONS)
            if fit is not None:
                self.fits.append(FittedLaw((*terms, start.term), fit))
                is_any_clean = is_any_clean or self.is_clean(fit)
        return is_any_clean

    def refit_second_terms(self) -> None:
        """The second term of each of the leading laws of two terms alone: the first may have stood in for it."""
        jobs: dict[LawTerm, RefitJob] = {}
        for law in [law for law in self.ranked() if len(law.terms) > 1][:SECOND_TERMS]:
            model = law.candidate.model
            first, second = [e for e in model.effects if is_law(e.name)][-2:]
            alone = model.without(second.name).without(first.name) + replace(second, name=LAW)
            kept = {name: value for name, value in model.values.items() if name in alone.values}
            constants = {alone.names_of(LAW)[name]: value for name, value in own_values(model, second).items()}
            first_states = _first_states(law.candidate)
            jobs.setdefault(
                law.terms[-1], RefitJob(alone, ({**kept, **constants},), 1, LAW_REFIT_ITERATIONS, first_states)
            )
        known = {law.terms for law in self.fits}
        jobs = {term: job for term, job in jobs.items() if (term,) not in known}
        fits = self.problem.refit_all(list(jobs.values()))
        self.fits += [FittedLaw((term,), fit) for term, fit in zip(jobs, fits, strict=True) if fit is not None]
        if any(len(law.terms) == 1 and self.is_clean(law.candidate) for law in self.fits):
            self.fits = [law for law in self.fits if len(law.terms) == 1]

    def ranked(self) -> list[FittedLaw]:
        return sorted(self.fits, key=lambda law: law.criterion())

    def finish_leading(self) -> tuple[FittedCandidate, ...]:
        """The leading laws refitted to the end, best first."""
        finished = []
        for law in self.ranked()[:FINISHED_LAWS]:
            fit = law.candidate
            if fit.promised_decrease > screening.SETTLED_DECREASE:
                fit = _better(
                    self.problem.refit_best(fit.model, [fit.model.values], 1, FINISH_ITERATIONS, like=fit), fit
                )
            finished.append(FittedLaw(law.terms, fit))
        return tuple(law.candidate for law in sorted(finished, key=lambda law: law.criterion()))
