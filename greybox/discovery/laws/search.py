"""Laws as proposals of the one loop: the terms that an observer ranks first beside a set, refitted by simulation.

What they are worth is said on the table of sets, as of any other effect; so are a second term, and each term without the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from greybox.base.values import Finding
from greybox.discovery.execution import RefitJob, SearchStage
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import HoldoutScores
from greybox.discovery.laws import screening
from greybox.discovery.laws.terms import LAW, is_law
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate, clean_cost_limit
from greybox.model.model import Model

# Terms of a law.
MOST_TERMS = 2
# Terms that are run through the observer after the linear ranking, those that promise most first; the next batch only where none of the
# one before leaves mere noise.
OBSERVED_TERMS: tuple[int, ...] = (18, 24)
# Of these a term is refitted only if its objective there (minus twice the log-likelihood) is within this of the best.
LEADING_DECREASE = 100.0
# Distance of the objective of a term from the best one up to which it is refitted once a term leaves only noise: it may do so as well.
RIVAL_DECREASE = 30.0
# Terms that are refitted by simulation after that: alone, and as a second one.
REFITTED_TERMS, SECOND_TERMS = 10, 4
# Laws that come on the table, those of the least criterion.
LEADING_LAWS = 6
# Iterations of such a refit.
LAW_REFIT_ITERATIONS = 40
# Gauss-Newton steps in the observer of the constants beside which terms are ranked.
OBSERVER_STEPS = 4
# Rms error over noise on the validation records, constants moved within their uncertainty, up to which a law leaves only noise.
CLEAN_SCORE = 1.15


@dataclass
class LawProposer:
    """Proposes the terms that a model may lack.

    Parameters
    ----------
    problem
        The estimation records; its model has the constants as the user gave them.
    scores
        The validation records.
    on_message
        Called with a line about each step.
    tried
        How many terms were ranked.
    """

    problem: DiscoveryProblem
    scores: HoldoutScores
    on_message: Callable[[str], None]
    tried: int = field(init=False, default=0)

    @cached_property
    def nominal(self) -> Mapping[str, float]:
        """The constants as the user gave them: they are known to about that."""
        return {q.name: q.value for q in self.problem.model.free_parameters}

    def propose(self, base: FittedCandidate) -> list[FittedCandidate]:
        """``base`` with one term more, for each of the terms that promise most; and itself from where the observer has it."""
        known = sum(is_law(e.name) for e in base.model.effects)
        if known >= MOST_TERMS:
            return []
        if known:
            observed = self._observe(base.model, _first_states(base))
        else:
            # From the constants that it came with, as those of its fit have swallowed the missing term; effects keep their fitted ones.
            observed = self._observe(base.model.start(**{**base.model.values, **self.nominal}), {})
        if observed is None:
            return []
        fits = [] if known else self._refit([observed])
        if any(map(self.is_clean, (base, *fits))):
            return fits
        # Beside a law whose constants the records have settled there is one variant.
        variants = [observed] if known else screening.observe_variants(self.problem, observed, self.nominal)
        ranked = screening.rank_everywhere(variants)
        self.tried += len(ranked)
        self.on_message(str(Finding(DiscoveryCode.LAW_TERMS_RANKED, values={"terms": self.tried})))
        chosen = screening.choose_terms(ranked, sum(OBSERVED_TERMS))
        most = SECOND_TERMS if known else REFITTED_TERMS
        name = next(n for n in (LAW, f"{LAW}_2") if n not in base.effects)
        laws: list[tuple[float, FittedCandidate]] = []
        first = 0
        for count in OBSERVED_TERMS[: 1 if known else None]:
            batch = screening.observe_terms(self.problem, self.nominal, chosen[first : first + count], name)
            first += count
            laws += self._refit_leading(batch[:most])
            if any(self.is_clean(fit) for _, fit in laws) or self.problem.executor.is_late:
                break
        if known:
            # The second term alone: the first may have stood in for it.
            first_law = next(e.name for e in base.model.effects if is_law(e.name))
            alone = [self.problem.refit_without(fit, first_law, 1, LAW_REFIT_ITERATIONS) for _, fit in laws]
            fits += [fit for fit in alone if fit is not None]
        return [*fits, *(fit for _, fit in sorted(laws, key=lambda law: law[0])[:LEADING_LAWS])]

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

    def _observe(self, model: Model, initial: Mapping[str, Sequence[float]]) -> screening.ObservedModel | None:
        """A model in the observer."""
        given = (self.problem, model, self.nominal, initial, screening.LAW_INTENSITIES, OBSERVER_STEPS)
        fit = partial(screening.fit_in_observer, *given)
        names = tuple(e.name for e in model.effects)
        return self.problem.failures.attempt(SearchStage.SCREENING, names, fit, None)

    def _refit_leading(
        self, batch: Sequence[tuple[screening.TermStart, screening.ObservedModel]]
    ) -> list[tuple[float, FittedCandidate]]:
        """Refits by simulation with Schwarz's criterion and a cost for complexity: no more than may do as well once one is clean."""
        fits: list[tuple[float, FittedCandidate]] = []
        for start, one in batch:
            limit = RIVAL_DECREASE if any(self.is_clean(fit) for _, fit in fits) else LEADING_DECREASE
            if one.objective - batch[0][1].objective > limit:
                break
            cost = screening.COMPLEXITY_COST * start.term.complexity
            fits += [(fit.criterion + cost, fit) for fit in self._refit([one])]
        return fits

    def _refit(self, observed: Sequence[screening.ObservedModel]) -> list[FittedCandidate]:
        jobs = [RefitJob(one.model, (one.values,), 1, LAW_REFIT_ITERATIONS, one.initial) for one in observed]
        return [fit for fit in self.problem.refit_all(jobs) if fit is not None]


def _first_states(candidate: FittedCandidate) -> dict[str, tuple[float, ...]]:
    columns = candidate.variables.initial.guess.T.tolist()
    return dict(zip(candidate.model.system.state_names, map(tuple, columns), strict=True))
