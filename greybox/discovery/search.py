"""The loop of a discovery: sets of effects on one table, the most promising of one screen refitted, until nothing gets better.

Each round screens every effect beside the leading sets (`greybox.discovery.linear`), refits the first of each family and site, the
relatives of those that lead and the leader without each of its parts, and puts all of them on the table. What wins there is the answer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial

import numpy as np

from greybox.base.numerics import TINY
from greybox.base.values import Check, Finding
from greybox.discovery.candidates import family_of, generate_child_starting_points, generate_starting_points
from greybox.discovery.claims import SOME_LEFT, Weights, only_moves_in_time
from greybox.discovery.decision import EXCESS_AUTOCORRELATION, make_check
from greybox.discovery.execution import RefitJob, SearchStage
from greybox.discovery.findings import DiscoveryCode, DiscoveryRule
from greybox.discovery.holdout import measure_structure
from greybox.discovery.laws.search import LawProposer
from greybox.discovery.linear import EffectPromise, LinearRun
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate, StartValues, noise_cost_limit, share_values
from greybox.discovery.residual_noise import excess_autocorrelation, is_level_known, is_shape_correction
from greybox.discovery.surrogate_effects import CurvePlace
from greybox.discovery.table import Draws, FitTable, SetKey, draw_sets, key_of
from greybox.model import Effect
from greybox.model.effects.catalogue import AT
from greybox.model.effects.scales import AMPLITUDE_GRID, FEW_SHAPES, Scales, count_shapes, count_starts, within_bounds
from greybox.model.parts import Occurrence, read_parts

MessageCallback = Callable[[str], None]


class StepKind(StrEnum):
    """What a round of the search comes to."""

    ADD = "add"
    """Another set of effects wins."""
    KEEP = "keep"
    """The best of the new sets, which does not win: the one before stays."""


@dataclass(frozen=True)
class SelectionStep:
    """One round of the search.

    Parameters
    ----------
    kind
        What the round comes to.
    effects
        The set of effects that it is about.
    accepted
        Whether the search went on with it.
    checks
        The checks that this rests on.
    """

    kind: StepKind
    effects: tuple[str, ...]
    accepted: bool
    checks: tuple[Check, ...]


# Effects in a set at most: a fifth shares its error among four others, and no resample tells which.
MOST_EFFECTS = 4
# Sets beside which effects are screened in a round: two may explain together what neither explains alone.
MOST_BASES = 4
# Refits of a round: a one-step promise ranks the right effect first in four of five cases, and among the first ten nearly always.
MOST_TRIED = 12
# Of the plain model: one of each family and site of a usual rig. Far from its run an effect may do what no small amount of it promises.
MOST_ALONE = 24
# Refits beside each base at least.
LEAST_TRIED = 2
# Twice the log-likelihood that an effect must promise: of the best of fifty without meaning one in ten exceeds it.
LEAST_PROMISE = 10.0
# Iterations of a look; those of which a further step promises this share of the cost go on to the end...
LOOK_ITERATIONS, FALLING_SHARE = 4, 0.1
# ...or so much of it where they may still come near the best.
NEGLIGIBLE_SHARE = 1e-3
# Iterations of an effect that is there whole: the constants have to come back from where they had gone without it.
WHOLE_ITERATIONS = 12
# A set may still come near if after a look its cost is at most so many times that of the best: twice the rms error...
NEAR_COST = 4.0
# ...and it is not worth a finer step from five times on.
HOPELESS_COST = 25.0
# Sets that are refitted to the end in a round, and how near the best they must be in rms.
MOST_FINISHED, FINISHED_RATIO = 4, 1.5
# Share of the error on the fitted records that an effect takes which does not win, from which others are tried beside it.
PAIR_SHARE = 0.1
# Leading sets whose relatives are fitted in a round.
MOST_RELATED = 2
# Resamples that a round reads, and those that take part of the sets that were fitted.
ROUND_RESAMPLES = 60
# Columns of an effect, best first beside the plain model, that are screened beside others.
KEPT_SHAPES = 4
# Lags over which the correlation of a residual is summed.
AUTOCORRELATION_LAGS = 30
# Classes of which every effect is fitted, and how many.
EXPECTED, MOST_EXPECTED = (Occurrence.USUAL, Occurrence.COMMON), 8


@dataclass
class EffectSearch:
    """A search in progress.

    Parameters
    ----------
    problem
        Fits the candidate models.
    table
        The sets that were fitted.
    candidates
        Effects in catalogue order, parents before children.
    scales
        Peaks and times of the records, from which starting points follow.
    policy
        The decision numbers.
    on_message
        Called with a line about each step.
    further
        Whether the search goes on where only noise is left.
    left_out
        Effects on the table that are none of its candidates: a set with one of them is not read.
    laws
        Proposes terms of equations in the place of the candidates; None for these.
    places
        Of each set with a curve or a tone where that stands, and the signal that it was proposed for.
    """

    problem: DiscoveryProblem
    table: FitTable
    candidates: Sequence[Effect]
    scales: Scales
    policy: DiscoveryPolicy
    on_message: MessageCallback
    further: bool = False
    left_out: frozenset[str] = frozenset()
    laws: LawProposer | None = None
    baseline: FittedCandidate = field(init=False)
    steps: list[SelectionStep] = field(init=False, default_factory=list)
    places: dict[SetKey, CurvePlace] = field(init=False, default_factory=dict)
    _screened: set[tuple[SetKey, str]] = field(init=False, default_factory=set)
    _related: set[tuple[SetKey, str, str]] = field(init=False, default_factory=set)
    _shapes: dict[str, Sequence[Mapping[str, float]]] = field(init=False, default_factory=dict)
    # The same search among the usual effects alone: begun once, it goes on with what came to the table since.
    _usual: EffectSearch | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.baseline = self.problem.baseline
        self.table.add(self.baseline)

    def run(self, begin: FittedCandidate | None = None) -> FittedCandidate:
        """The set that wins, the plain model among them; all that was fitted is on the table. It begins at a set, the plain one if none."""
        winner = begin or self.baseline
        self.table.add(winner)
        for _ in range(MOST_EFFECTS + 1):
            if self.laws is None:
                self._add_promising(self._list_bases(winner))
            else:
                self.table.add(*self.laws.propose(winner))
                self.baseline = self.table.get(()) or self.baseline
            for fit in self._best(MOST_RELATED):
                self._add_relatives(fit)
            self._finish_leading()
            best = self.find_winner()
            self.drop_parts(best)
            best = self.find_winner()
            is_new = key_of(best) != key_of(winner)
            self._keep_step(best, winner, is_new)
            winner = best
            if (
                self.problem.executor.is_late
                or self._is_finished(winner)
                or not (is_new or self._is_worth_pairs(winner))
            ):
                break
        return winner

    # What leads

    def draw(self, resamples: int = ROUND_RESAMPLES, always: Sequence[FittedCandidate] = ()) -> Draws:
        """What resampling says of the table."""
        return self.table.draw(self.table.leading((self.baseline, *always), self._is_own), resamples)

    def find_winner(self, draws: Draws | None = None) -> FittedCandidate:
        """The set that wins most often of those with names, and the plain model: a curve that wins takes no place."""
        draws = self.draw() if draws is None else draws
        return find_named_winner(draws, self.baseline)

    def _best(self, most: int) -> list[FittedCandidate]:
        """The sets that leave least."""
        named = [c for c in self.table.candidates if c.effects and not any(map(is_shape_correction, c.effects))]
        return [c for c in named if self._is_own(c)][:most]

    def _is_own(self, fit: FittedCandidate) -> bool:
        """Whether a set on the table holds nothing that this search leaves out."""
        return not self.left_out.intersection(fit.effects)

    def _list_bases(self, winner: FittedCandidate) -> list[FittedCandidate]:
        """The sets beside which effects are screened: the winner, what it is without each part, and the best of other families."""
        if winner is self.baseline and not self._screened:
            return [self.baseline]
        most = MOST_EFFECTS
        rests = [self.table.without(winner, name) for name in winner.effects if len(winner.effects) > 1]
        ranked = sorted(self._best(3 * MOST_BASES), key=lambda fit: fit.noise_ratio)
        bases: dict[frozenset[str], FittedCandidate] = {}
        # Beside two effects the others come one at a time.
        others = ranked if len(winner.effects) < 2 else []
        for fit in (winner, *(rest for rest in rests if rest is not None), *others):
            bases.setdefault(frozenset(self._root(name) for name in fit.effects), fit)
        return [fit for fit in bases.values() if len(fit.effects) < most][:MOST_BASES]

    def _is_finished(self, fit: FittedCandidate) -> bool:
        """Whether nothing is worth looking for: only noise is left of a level that somebody told, or the set is full."""
        if len(fit.effects) >= MOST_EFFECTS:
            return True
        if self.laws is not None:
            return self.laws.is_clean(fit)
        if self.further or not is_level_known(self.problem.noise_model):
            return False
        is_clean = fit.per_sample <= noise_cost_limit(fit.count)
        if not is_clean or excess_autocorrelation(fit, AUTOCORRELATION_LAGS) > EXCESS_AUTOCORRELATION:
            return False
        # Beside an output whose noise is told too high another's rest is lost in the sum; on the records that judge nothing was fitted.
        return not fit.effects or measure_structure(self.table.scores, fit, only_visible=True) < SOME_LEFT

    def _is_worth_pairs(self, winner: FittedCandidate) -> bool:
        """Whether two effects may do together what none did alone: one takes much of what the fitted records show, and none wins."""
        if winner.effects or any(len(fit.effects) > 1 for fit in self._best(MOST_BASES)):
            return False
        best = self._best(1)
        return bool(best) and best[0].noise_ratio <= (1 - PAIR_SHARE) * winner.noise_ratio

    # What is tried

    def _add_promising(self, bases: Sequence[FittedCandidate], anew: bool = False) -> None:
        """The most promising effects beside each base, the first of each family and site, refitted; ``anew`` as in `_screen`."""
        promises = [promise for base in bases for promise in self._screen(base, anew)]
        chosen = list(self._choose(promises))
        planned = [self._plan(one) for one in chosen]
        for base in bases:
            if not base.effects:
                planned += [self._plan_whole(base, e) for e in self.candidates if not e.parameters]
        # A lag has no size either: less of it is another lag. From a longer one the constants come back on the way, from a shorter one not.
        for base, promise in chosen:
            if not base.effects and only_moves_in_time(promise.effect):
                seconds = [max(shape.values(), default=0.0) for shape in promise.shapes]
                longer = [shape for shape, lag in zip(promise.shapes, seconds, strict=True) if lag > seconds[0]]
                planned += [self._plan_whole(base, promise.effect, shape) for shape in longer]
        self.add_refits(planned)

    def _screen(self, base: FittedCandidate, anew: bool = False) -> list[tuple[FittedCandidate, EffectPromise, float]]:
        """What each further effect promises beside a set, and the sum of squares that it would leave.

        Each is looked at once; ``anew`` those too that were not among the first then, if nobody has fitted them.
        """
        left = [
            e
            for e in self.candidates
            if (anew or (key_of(base), e.name) not in self._screened)
            and e.name not in base.effects
            and not any(self._root(e.name) == self._root(name) for name in base.effects)
        ]
        if self.problem.executor.is_late:
            self.problem.executor.skipped += len(left)
            return []
        self._screened |= {(key_of(base), e.name) for e in left}
        if self.left_out or anew:
            # The usual effects alone are searched for the sets that nobody has fitted, and so is what may stand in the place of an effect.
            left = [e for e in left if self.table.get({*base.effects, e.name}) is None]
        cost, promises = self.promise(base, left, self._shapes)
        if not (base.effects or self.left_out):
            self._shapes = {p.effect.name: p.shapes[:KEPT_SHAPES] for p in promises}
        return [(base, promise, cost - promise.decrease) for promise in promises]

    def promise(
        self, base: FittedCandidate, effects: Sequence[Effect], shapes: Mapping[str, Sequence[Mapping[str, float]]] = {}
    ) -> tuple[float, list[EffectPromise]]:
        """The sum of squares that a set leaves, and what each of ``effects`` promises beside it, best first."""
        slopes = self.table.slopes(base)
        if slopes is None:
            return 0.0, []
        look = partial(LinearRun(slopes).screen, effects, self.scales, self.problem.failures, shapes)
        promises: list[EffectPromise] = self.problem.failures.attempt(SearchStage.SCREENING, base.effects, look, [])
        return sum(float((r**2).sum()) for r in slopes.residuals[: slopes.fitted]), promises

    def _choose(
        self, promises: Sequence[tuple[FittedCandidate, EffectPromise, float]]
    ) -> Iterator[tuple[FittedCandidate, EffectPromise]]:
        """The first of each base, family and site with the simplest of its family, best first; of the plain model the usual ones too."""
        # Beside another set what chance promises as well is no proposal; beside the plain model it shows what these records would show.
        worth = [one for one in promises if not one[0].effects or self._is_worth(one)]
        ranked = sorted(worth, key=lambda one: one[2])
        of_base: dict[int, int] = {}
        taken: set[tuple[int, str, str]] = set()
        chosen: dict[tuple[int, str], tuple[FittedCandidate, EffectPromise]] = {}
        count = 0
        for base, promise, _ in ranked:
            # A constant at an input and one at a balance are of one family, and each other's equal.
            root = self._root(promise.effect.name)
            place = id(base), root, promise.effect.site
            most = MOST_TRIED if base.effects else MOST_ALONE
            if place in taken or (count >= most and of_base.get(id(base), 0) >= LEAST_TRIED):
                continue
            taken.add(place)
            count, of_base[id(base)] = count + 1, of_base.get(id(base), 0) + 1
            chosen[id(base), promise.effect.name] = base, promise
            simplest = next((p for b, p, _ in ranked if b is base and p.effect.name == root), None)
            if simplest is not None:
                chosen.setdefault((id(base), root), (base, simplest))
        for base, promise, _ in ranked:
            if not base.effects and promise.effect.name in self.expected:
                chosen.setdefault((id(base), promise.effect.name), (base, promise))
        yield from chosen.values()

    def _is_worth(self, one: tuple[FittedCandidate, EffectPromise, float]) -> bool:
        """Whether a promise is more than chance: twice the gain of the log-likelihood, N ln(before / after)."""
        base, promise, left = one
        return base.count * float(np.log1p(promise.decrease / max(left, TINY))) > LEAST_PROMISE if left > 0 else True

    @property
    def screened(self) -> set[str]:
        """Names of the effects that were looked at."""
        return {name for _, name in self._screened}

    @property
    def expected(self) -> list[str]:
        """Names of the effects that rigs with such parts usually have, the likeliest first."""
        parts = read_parts(self.problem.model)
        usual = [e for e in self.candidates if parts.occurrence(e) in EXPECTED]
        return [e.name for e in sorted(usual, key=lambda e: -parts.occurrence(e).probability)][:MOST_EXPECTED]

    def _plan(self, chosen: tuple[FittedCandidate, EffectPromise]) -> tuple[FittedCandidate, RefitJob] | None:
        """A look at a set with one effect more, from where the screen has it."""
        base, promise = chosen
        effect = promise.effect

        def plan() -> RefitJob:
            model = base.model + effect
            first, nominal = promise.starts[0], self.problem.model.values
            starts = [*promise.starts, {**first, **nominal}]
            if not promise.decrease:
                # The screen has nowhere to begin: far from the run of the base it may lead somewhere.
                starts += generate_starting_points(model, effect, base, self.problem.model, self.scales, AMPLITUDE_GRID)
            # The cost of an effect of many shapes has many minima: of one with few the most promising start is enough.
            shapes = count_shapes(effect, self.scales)
            keep = 1 if shapes < FEW_SHAPES else count_starts(effect, self.scales)
            return self.problem.plan_refit(model, starts, keep, LOOK_ITERATIONS, base, refines=False)

        job = self.problem.failures.attempt(SearchStage.PREPARATION, (*base.effects, effect.name), plan, None)
        return None if job is None else (base, job)

    def _plan_whole(
        self, base: FittedCandidate, effect: Effect, shape: Mapping[str, float] = {}
    ) -> tuple[FittedCandidate, RefitJob] | None:
        """A look at a set with an effect that has no size: it is there whole, and no multiple of it says what it does.

        ``shape`` holds values of its constants, by its own names.
        """

        def plan() -> RefitJob:
            model = base.model + effect
            names = model.names_of(effect.name)
            begun = {**base.model.values, **{names[n]: within_bounds(model, names[n], v) for n, v in shape.items()}}
            if shape:  # to the end: on the way it may be far above the set without it
                return self.problem.plan_refit(model, [begun], 1, like=base, refines=False)
            starts = (begun, {**begun, **share_values(self.problem.model, base.model)})
            return self.problem.plan_refit(model, starts, 2, WHOLE_ITERATIONS, base, refines=False)

        job = self.problem.failures.attempt(SearchStage.PREPARATION, (*base.effects, effect.name), plan, None)
        return None if job is None else (base, job)

    # Refits

    def add_refits(self, planned: Iterable[tuple[FittedCandidate, RefitJob] | None]) -> None:
        """Looks, carried on where they fall or may come near the best, put on the table."""
        jobs = [one for one in planned if one is not None]
        looks = self.problem.refit_all([job for _, job in jobs])
        # It contains the smaller set: from where that ended, the effect absent, it cannot do worse. A look that promises to get there goes
        # on beside it: from constants at their bounds, where the smaller set may have ended, nothing leads away.
        behind = [k for k, fit in enumerate(looks) if fit is None or fit.cost > jobs[k][0].cost]
        # Of several looks at one set the effect is absent once.
        absent = {
            (id(base), tuple(e.name for e in job.model.effects)): (base, job)
            for base, job in map(jobs.__getitem__, behind)
        }
        again = self.problem.refit_all([self._plan_absent(*one) for one in absent.values()])
        for k in behind:
            fit = looks[k]
            looks[k] = None if fit is None or fit.cost - fit.promised_decrease > jobs[k][0].cost else fit
        fits = [fit for fit in (*looks, *again) if fit is not None]
        near = NEAR_COST * min((fit.cost for fit in (*fits, *self._best(1))), default=0.0)
        falling = [
            fit
            for fit in fits
            if fit.promised_decrease > (NEGLIGIBLE_SHARE if fit.cost <= near else FALLING_SHARE) * fit.cost
        ]
        carried = self.problem.refit_all(
            [self.problem.plan_refit(f.model, [f.model.values], 1, like=f, refines=False) for f in falling]
        )
        self.table.add(*fits, *carried)

    def _plan_absent(self, base: FittedCandidate, job: RefitJob) -> RefitJob:
        return self.problem.plan_refit(job.model, [share_values(base.model, job.model)], 1, like=base, refines=False)

    def _finish_leading(self) -> None:
        """The sets that may win, refitted to the end."""
        best = self._best(MOST_FINISHED)
        near = [fit for fit in best if fit.noise_ratio <= FINISHED_RATIO * best[0].noise_ratio]
        self.table.add(*(self.problem.converge(fit) for fit in near))

    def _add_relatives(self, fit: FittedCandidate) -> None:
        """A set with each of its effects replaced by a simpler or richer one of its family, or one elsewhere, from where it stands."""
        planned = []
        for name in fit.effects:
            effect = self._find(name)
            if effect is None:
                continue
            simpler = (*effect.parents, *effect.approaches)
            # One of its family elsewhere may do the same: from the plain model's valley it may not have come to where this one ended.
            moved = [
                e.name for e in self.candidates if e.site != effect.site and self._root(e.name) == self._root(name)
            ]
            related = {e.name for e in self.candidates if name in (*e.parents, *e.approaches)}.union(simpler, moved)
            for relative in [e for e in self.candidates if e.name in related]:
                key = (key_of(fit), name, relative.name)
                if key in self._related or relative.name in fit.effects:
                    continue
                self._related.add(key)
                plan = partial(self._plan_relative, fit, effect, relative)
                planned.append(
                    self.problem.failures.attempt(SearchStage.PREPARATION, (*fit.effects, relative.name), plan, None)
                )
        self.add_refits(one for one in planned if one is not None)

    def _plan_relative(
        self, fit: FittedCandidate, effect: Effect, relative: Effect
    ) -> tuple[FittedCandidate, RefitJob] | None:
        """A look at the set with ``relative`` in the place of ``effect``; None where it is known and leaves no more than the set."""
        known = self.table.get((set(fit.effects) - {effect.name}) | {relative.name})
        is_child = effect.name in relative.parents
        if known is not None and (is_child or known.cost <= fit.cost):
            return None
        model = fit.model.without(effect.name) + relative
        kept = share_values(fit.model, model)
        of_old, of_new = fit.model.names_of(effect.name), model.names_of(relative.name)
        shared = {
            of_new[q]: fit.model.values[of_old[q]]
            for q in of_new.keys() & of_old.keys()
            if of_old[q] in fit.model.values
        }
        starts: list[StartValues] = [{**kept, **{n: v for n, v in shared.items() if n in model.values}}]
        starts += generate_child_starting_points(model, relative, fit, effect, self.scales) if is_child else []
        rest = self.table.without(fit, effect.name) or self.baseline
        starts += generate_starting_points(model, relative, fit, fit.model.without(effect.name), self.scales, (1.0,))
        starts = [{n: v for n, v in start.items() if n in model.values} for start in starts]
        return rest, self.problem.plan_refit(model, starts, 1, LOOK_ITERATIONS, fit, refines=False)

    def drop_parts(self, best: FittedCandidate) -> None:
        """A winner without each of its effects: what a part takes is the difference, and a plain model that was stuck is no ground."""
        for name in best.effects:
            # What stands beside an effect may need it: a curve over its state has no place without it.
            others, without = [e for e in best.effects if e != name], partial(self.problem.refit_without, best, name)
            rest = self.problem.failures.attempt(SearchStage.EVIDENCE, tuple(others), without, None)
            if rest is None:
                continue
            self.table.add(rest)
            if not rest.effects and rest.cost < self.baseline.cost:
                self.baseline = rest

    def add_in_place(self, chosen: FittedCandidate) -> None:
        """What else may stand in the place of each effect of a set of several: the most promising of the others.

        Beside a rest that was one of several bases two effects were tried, and beside one that was none nothing: an equal of what the set
        has may be the next. Beside the plain model each family and site was.
        """
        if len(chosen.effects) < 2:
            return
        rests = [self.table.without(chosen, name) for name in chosen.effects]
        self._add_promising([rest for rest in rests if rest is not None], anew=True)

    def add_beside(self, promises: Iterable[tuple[FittedCandidate, EffectPromise]]) -> None:
        """Sets with an effect more, each refitted from where the screen has it and on the table."""
        self.add_refits([self._plan(one) for one in promises])

    def add_usual(self) -> None:
        """The same search among the effects that such rigs usually have alone: a set that nobody fitted cannot come first."""
        if self._usual is None:
            expected = set(self.expected)
            candidates = [e for e in self.candidates if e.name in expected]
            left_out = frozenset(e.name for e in self.candidates) - expected
            self._usual = replace(self, candidates=candidates, left_out=left_out, on_message=lambda _: None)
            self._usual._shapes = self._shapes
        self._usual.baseline = self.baseline
        if self._usual.candidates:
            self._usual.run()

    # Families and steps

    def _root(self, name: str) -> str:
        """The simplest candidate of the family of an effect, at its place."""
        names = [e.name for e in self.candidates]
        family = [other for other in family_of(name, self.candidates) if other in names]
        return family[0] if family else name.partition(AT)[0]

    def _find(self, name: str) -> Effect | None:
        return next((e for e in self.candidates if e.name == name), None)

    def _keep_step(self, best: FittedCandidate, before: FittedCandidate, is_new: bool) -> None:
        shown = best if is_new else next((c for c in self._best(2) if key_of(c) != key_of(before)), best)
        names = " + ".join(shown.effects)
        ratio = shown.noise_ratio / max(before.noise_ratio, 1e-300)
        check = make_check(DiscoveryRule.WINS, ratio, 1.0, is_new, names)
        self.steps.append(SelectionStep(StepKind.ADD if is_new else StepKind.KEEP, shown.effects, is_new, (check,)))
        if is_new and shown.effects:
            values = {"before": before.noise_ratio, "after": shown.noise_ratio, "bounded": shown.is_noise_bounded}
            code = DiscoveryCode.FURTHER_EFFECT if before.effects else DiscoveryCode.FIRST_EFFECT
            self.on_message(str(Finding(code, subject=names, values=values)))


# Share of the resamples that the plain model must win to be the answer.
PLAIN_SHARE = 0.5


def find_named_winner(draws: Draws, plain: FittedCandidate) -> FittedCandidate:
    """The set that wins most often among those whose effects have names, and the plain one where that wins as often as not.

    A curve that wins says that no name is right: it takes no place, and leaves the names little weight. Sets that resemble each other
    share what they win: where most resamples refuse the plain model, something is missing, however little each of them wins.
    """
    named = [s for s in draws.sets if not any(map(is_shape_correction, s.candidate.effects))]
    if not named:
        return plain
    if draws.sets[Weights.of(draws).leading] not in named:
        draws = draw_sets(named)
    totals, sets = Weights.of(draws).totals, [s.candidate for s in draws.sets]
    eligible = [k for k, c in enumerate(sets) if not any(map(is_shape_correction, c.effects))]
    if totals[[not c.effects for c in sets]].sum() < PLAIN_SHARE:
        eligible = [k for k in eligible if sets[k].effects] or eligible
    return sets[max(eligible, key=lambda k: totals[k])] if eligible else plain
