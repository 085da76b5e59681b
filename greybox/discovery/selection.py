"""Stepwise selection: which effects, if any, turn the plain model into one that explains the records.

Forward (every candidate alone, then beside the best ones), backward (without each effect in turn) and by exchange. What is
decided on the way is kept as steps, each with its checks.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from typing import Any

import numpy as np

from greybox.base.findings import Check, Finding
from greybox.discovery.candidates import generate_child_starting_points, generate_starting_points
from greybox.discovery.decision import EXCESS_AUTOCORRELATION, judge_effect, make_check
from greybox.discovery.execution import RefitJob, SearchStage
from greybox.discovery.findings import DiscoveryCode, DiscoveryRule
from greybox.discovery.policy import DiscoveryPolicy, SearchBudget
from greybox.discovery.problem import (
    SEARCH_REFIT_ITERATIONS,
    SEARCH_REFIT_STARTS,
    DiscoveryProblem,
    FittedCandidate,
    StartValues,
    clean_cost_limit,
    noise_cost_limit,
    share_values,
)
from greybox.discovery.residual_noise import excess_autocorrelation, fit_shape_correction
from greybox.model import Effect, Model
from greybox.model.effects.scales import Scales
from greybox.model.effects.starts import AMPLITUDE_GRID, FEW_SHAPES, MANY_SHAPES, MANY_SHAPES_STARTS, count_shapes

# Which further effects are worth a refit: those whose predicted cost is lowest.


# Amplitude at which an effect is nearly absent, in the same unit: what a first effect leaves may be that small.
NEAR_ZERO_AMPLITUDE = 0.01


# A fitted model and an effect that may be added to it.
Extension = tuple[FittedCandidate, Effect]


def rank_extensions(
    problem: DiscoveryProblem,
    extensions: Sequence[Extension],
    scales: Scales,
    most: int,
    amplitudes: Sequence[float] = AMPLITUDE_GRID,
) -> list[Extension]:
    """The ``most`` models with one effect more that predict the lowest cost, best first; none that cannot be simulated, each set once.

    All are predicted with the effect nearly absent, the better ones from its ``amplitudes`` too.
    """
    lowest = [_predict_extension(problem, each, scales, (NEAR_ZERO_AMPLITUDE,)) for each in extensions]
    possible = sorted((k for k, cost in enumerate(lowest) if np.isfinite(cost)), key=lowest.__getitem__)
    for k in possible[: 2 * most] if amplitudes else ():
        lowest[k] = min(lowest[k], _predict_extension(problem, extensions[k], scales, amplitudes))
    once: dict[Key, Extension] = {}
    for fit, effect in (extensions[k] for k in sorted(possible, key=lowest.__getitem__)):
        once.setdefault(frozenset((*fit.effects, effect.name)), (fit, effect))
    return list(once.values())[:most]


def _predict_extension(
    problem: DiscoveryProblem, extension: Extension, scales: Scales, amplitudes: Sequence[float]
) -> float:
    """The lowest cost that one step predicts from these amplitudes of the further effect; it is asked once for each."""
    fit, effect = extension
    key = (*fit.key, effect.name, *amplitudes)

    def predict() -> float:
        model = fit.model + effect
        starts = generate_starting_points(model, effect, fit, fit.model, scales, amplitudes)
        return problem.predict_cost(model, starts, fit)

    if key not in problem.predicted:
        effects = (*fit.effects, effect.name)
        problem.predicted[key] = problem.failures.attempt(SearchStage.SCREENING, effects, predict, np.inf)
    return problem.predicted[key]


def list_extension_starts(selected: FittedCandidate, effect: Effect, scales: Scales) -> list[StartValues]:
    """Where the refit with a further effect starts: with nothing of it, and at the usual amplitudes and shapes."""
    model = selected.model + effect
    amplitudes = AMPLITUDE_GRID
    return [model.values, *generate_starting_points(model, effect, selected, selected.model, scales, amplitudes)]


MessageCallback = Callable[[str], None]
Key = frozenset[str]


class StepKind(StrEnum):
    """What a step of the selection does."""

    ADD = "add"
    """An effect is added, or rejected where its checks do not pass."""
    CORRECT_SHAPE = "correct_shape"
    """A correction of the effects explains the rest as well as a further effect would: none is added."""
    DROP = "drop"
    """An effect is taken out that the others have made unnecessary."""
    SWAP = "swap"
    """An effect is replaced by a better one."""
    SIMPLIFY = "simplify"
    """An effect is replaced by a simpler one that does nearly as well: a member of its family, or another that does the same."""


@dataclass(frozen=True)
class SelectionStep:
    """One step of the selection.

    Parameters
    ----------
    kind
        What the step does.
    effects
        The set of effects that it proposes.
    accepted
        Whether the selection went on with it.
    checks
        The checks that this rests on.
    """

    kind: StepKind
    effects: tuple[str, ...]
    accepted: bool
    checks: tuple[Check, ...]


# A richer member of a family replaces a simpler one only if its cost is lower by more than this.
CHILD_COST = 10.0
# Share of what the richer member gains over the plain model that this difference is at least.
CHILD_SHARE = 0.003
# Models whose criterion differs by less explain the records equally well.
TIE_COST = 10.0
# Lags that this sum runs over.
AUTOCORRELATION_LAGS = 30
# Iterations of the first look at every candidate.
SCREENING_ITERATIONS = 4
# Share of its cost that a further step must promise for a look to go on: it was stopped in the middle of a descent...
FALLING_SHARE = 0.1
# ...or so much of it, where it may still come near the best.
NEGLIGIBLE_SHARE = 1e-3
# A model may still come near if after a short refit its cost is at most so many times that of the best: five times the rms error. Where
# an effect is left out that takes almost everything, the others turn stiff in its place, and each refit would take minutes to show that
# it is no rival.
HOPELESS_COST = 25.0
# Leading candidates that are refitted to convergence.
REFIT_TOP = 5
# Generations of children that are tried (Coulomb friction, then Stribeck, then LuGre).
SEARCH_GENERATIONS = 2
# A candidate whose short refit is this many times as far from the records as one that leaves only noise is out.
PRUNE_RATIO = 4.0
# How many of them at a time; the later ones count where the leading ones lead nowhere.
BATCH_SIZE = 3
# Further effects that are refitted beside each leading first effect, or beside all later ones together.
SECOND_CANDIDATES = 4
# Models with a further effect that are refitted to convergence.
SEARCH_FINISHED_CANDIDATES = 3
# Effects tried in the place of one that was chosen.
SEARCH_SWAPS = 4


@dataclass
class StepwiseSelection:
    """A selection in progress.

    Parameters
    ----------
    problem
        Fits the candidate models.
    candidates
        Effects in catalogue order, parents before children.
    scales
        Peaks and times of the records, from which starting points follow.
    policy
        The decision numbers.
    on_message
        Called with a line about each step.
    seeds
        Fits of the same sets of effects under another noise model, where there are any.
    firsts
        Names of the effects that are tried alone; None for all. Every candidate may come second.
    measure_autocorrelation, correct_shape
        How a fit's residual is tested for structure, and its effects for a shape that is not quite theirs.
    """

    problem: DiscoveryProblem
    candidates: Sequence[Effect]
    scales: Scales
    policy: DiscoveryPolicy
    on_message: MessageCallback
    seeds: Mapping[Key, FittedCandidate] = field(default_factory=dict)
    firsts: Collection[str] | None = None
    measure_autocorrelation: Callable[[FittedCandidate, int], float] = excess_autocorrelation
    correct_shape: Callable[[Any, FittedCandidate, Scales], FittedCandidate | None] = fit_shape_correction
    baseline: FittedCandidate = field(init=False)
    single_effects: list[FittedCandidate] = field(init=False, default_factory=list)
    fits: dict[Key, FittedCandidate] = field(init=False, default_factory=dict)
    shape_corrections: dict[Key, FittedCandidate] = field(init=False, default_factory=dict)
    steps: list[SelectionStep] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self.baseline = self.problem.baseline

    @property
    def budget(self) -> SearchBudget:
        """How much is tried."""
        return self.policy.budget

    def select(self) -> FittedCandidate:
        """The model that explains the records best without an effect that is not needed; the plain one if nothing is missing."""
        selected = self.select_first()
        if selected is self.baseline:
            return self.baseline
        self._retest_baseline(selected)
        if not self._accept(self.baseline, selected):
            return self.baseline
        self._tell(DiscoveryCode.FIRST_EFFECT, selected)
        while self._has_structure_left(selected) and len(selected.effects) < self.budget.most_effects:
            larger = self._extend(selected)
            if larger is None or not self._accept(selected, larger):
                break
            if self._explained_by_shape_correction(selected, larger):
                self._tell(DiscoveryCode.SHAPE_CORRECTION_SUFFICES, selected)
                break
            selected = larger
            self._tell(DiscoveryCode.FURTHER_EFFECT, selected)
        return self._choose_simplest_equal(self._swap(self._drop_needless(selected)))

    def select_first(self) -> FittedCandidate:
        """The best model with a single effect, whether or not the data demand it."""
        if not self.single_effects:
            alone = [e for e in self.candidates if self.firsts is None or e.name in self.firsts]
            self._screen([e for e in alone if not self._candidate_parents(e)])
            for _ in range(SEARCH_GENERATIONS):  # children of parents that did well, and theirs
                ranked = sorted(self.single_effects, key=lambda fit: fit.criterion)
                leading = {fit.effects[0] for fit in ranked[:REFIT_TOP]}
                done = {fit.effects[0] for fit in self.single_effects}
                self._screen([e for e in alone if e.name not in done and set(e.parents) & leading])
            self._refit_leading()
        if not self.single_effects:
            return self.baseline
        best = min(self.single_effects, key=lambda fit: fit.criterion)
        return self._simplify(best, self.single_effects)

    def find_rivals(self, selected: FittedCandidate) -> list[FittedCandidate]:
        """Other models of the same size that explain the records equally well.

        A model with a parent or a child of a selected effect is no rival.
        """
        rivals = []
        for fit in self.fits.values():
            if len(fit.effects) != len(selected.effects) or set(fit.effects) == set(selected.effects):
                continue
            behind, limit = fit.criterion - selected.criterion, TIE_COST
            if behind < limit and not self._are_related(fit, selected):
                rivals.append(fit)
        return rivals

    def tie_checks(self, selected: FittedCandidate, rivals: Sequence[FittedCandidate]) -> tuple[Check, ...]:
        """For each rival, how far its criterion is behind that of the selected model."""
        limit = TIE_COST
        return tuple(
            make_check(DiscoveryRule.TIE, rival.criterion - selected.criterion, limit, True, " + ".join(rival.effects))
            for rival in rivals
        )

    # Single effects

    def _screen(self, effects: Sequence[Effect]) -> None:
        """Each effect alone, one short refit from its most promising starting point."""
        # A child starts from its parent, so it waits for one that is screened at the same time.
        names = {e.name for e in effects}
        waiting = [e for e in effects if set(e.parents) & names]
        self.single_effects += self._add_each(self.baseline, [e for e in effects if e not in waiting])
        if waiting:
            self._screen(waiting)

    def _refit_leading(self) -> None:
        """The leading effects once more, from several starting points and to convergence."""
        if not self.single_effects:
            return
        ranked = sorted(self.single_effects, key=lambda fit: fit.criterion)
        best = ranked[0]
        only_noise_left = best.per_sample <= noise_cost_limit(best.count)
        parents = set(self._effect(best.effects[0]).parents) if only_noise_left else set()
        leading = [
            fit for fit in ranked[:REFIT_TOP] if self._is_worth_refitting(fit, best) and fit.effects[0] not in parents
        ]
        # A parent caught in a minimum of its own would leave its name to its child.
        leading += [fit for fit in ranked if fit.effects[0] in parents]
        jobs = [self._thorough_job(fit, fit is best, fit.effects[0] in parents) for fit in leading]
        for fit, again in zip(leading, self.problem.refit_all(jobs), strict=True):
            better = again if again is not None and again.cost < fit.cost else fit
            self.fits[frozenset(fit.effects)] = better
            self.single_effects[self.single_effects.index(fit)] = better

    def _thorough_job(self, fit: FittedCandidate, is_best: bool, is_parent_of_best: bool) -> RefitJob:
        effect = self._effect(fit.effects[0])
        model = self.baseline.model + effect
        # The cost of an effect of many shapes has many minima, and the name may be right in a wrong one.
        many_minima = is_parent_of_best or (is_best and count_shapes(effect, self.scales) >= FEW_SHAPES)
        keep = MANY_SHAPES_STARTS if many_minima else SEARCH_REFIT_STARTS
        starts = tuple(self._starting_points(self.baseline, effect, model, [fit.model.values]))
        return RefitJob(model, starts, keep, SEARCH_REFIT_ITERATIONS)

    def _is_worth_refitting(self, fit: FittedCandidate, best: FittedCandidate) -> bool:
        """Whether a thorough refit may change anything.

        It does not where a parent leaves only noise already, nor where another effect does and this one is far from it.
        """
        noise = noise_cost_limit(fit.count)
        parents = self._effect(fit.effects[0]).parents
        if any(other.per_sample <= noise for other in self.single_effects if other.effects[0] in parents):
            return False
        return best.per_sample > noise or fit.per_sample <= PRUNE_RATIO * best.per_sample

    def _retest_baseline(self, extended: FittedCandidate) -> None:
        """The plain model once more, from the constants of the extended one: a baseline stuck in a wrong place is a false alarm."""
        plain = self.baseline.model
        again = self.problem.refit_best(plain, [share_values(extended.model, plain)], keep=1)
        if again is not None and again.cost < self.baseline.cost:
            self.baseline = again

    # Further effects

    def _has_structure_left(self, fit: FittedCandidate) -> bool:
        """Whether a further effect is worth looking for: the misfit, or the residual's autocorrelation, is more than chance."""
        if fit.per_sample > noise_cost_limit(fit.count):
            return True
        return self.measure_autocorrelation(fit, AUTOCORRELATION_LAGS) > EXCESS_AUTOCORRELATION

    def _extend(self, selected: FittedCandidate) -> FittedCandidate | None:
        """The best model with one effect more, beside the selected effects and (for a second one) beside other good first effects."""
        firsts = [selected]
        if len(selected.effects) == 1:
            # Other families are represented by their simplest members, which cost less and say the same. The selected effect was
            # compared with its own simpler members, and stays.
            ranked = (selected, *sorted(self.single_effects, key=lambda fit: fit.criterion))
            simplest = [self._simplest_member(fit) for fit in ranked]
            firsts = list({fit.effects: fit for fit in (selected, *simplest)}.values())[: self.budget.beam_width]
        best: FittedCandidate | None = None
        size = BATCH_SIZE
        for k in range(0, len(firsts), size):
            batch = self._extend_batch(firsts[k : k + size], leading=k == 0)
            best = min((fit for fit in (best, batch) if fit is not None), key=lambda fit: fit.criterion, default=None)
            if best is not None and not self._has_structure_left(best):
                break
        return best and self._simplify(best, list(self.fits.values()))

    def _extend_batch(self, firsts: Sequence[FittedCandidate], leading: bool) -> FittedCandidate | None:
        """The best model with one effect more than one of ``firsts``; less is tried where these are not the ``leading`` ones."""
        if leading:
            amplitudes, most = AMPLITUDE_GRID, SECOND_CANDIDATES * len(firsts)
        else:
            amplitudes, most = (), SECOND_CANDIDATES
        promising = self._rank_further_effects(firsts, most, amplitudes)
        grouped = [(first, [e for fit, e in promising if fit is first]) for first in firsts]
        extended = [fit for first, effects in grouped for fit in self._add_each(first, effects)]
        if not extended:
            return None
        ranked = sorted(extended, key=lambda fit: fit.criterion)
        converged = [self._converge(fit) for fit in ranked[:SEARCH_FINISHED_CANDIDATES]]
        return self._replace_by_child(min(converged, key=lambda fit: fit.criterion))

    def _rank_further_effects(
        self, firsts: Sequence[FittedCandidate], most: int, amplitudes: Sequence[float]
    ) -> list[Extension]:
        """The ``most`` further effects, each beside one of ``firsts``, whose predicted cost is lowest (`rank_extensions`)."""
        simplest = [e for e in self.candidates if not self._candidate_parents(e)]
        pairs = [(f, e) for f in firsts for e in simplest if e.name not in f.effects and not self._is_in_family(e, f)]
        return rank_extensions(self.problem, pairs, self.scales, most, amplitudes)

    def _explained_by_shape_correction(self, selected: FittedCandidate, larger: FittedCandidate) -> bool:
        """Whether a correction of the shape of the effects explains the remaining misfit as well as a further effect."""
        correct = partial(self.correct_shape, self.problem, selected, self.scales)
        corrected = self._attempt(SearchStage.SHAPE_CORRECTION, selected.effects, correct, None)
        if corrected is None:
            return False
        suffices = not corrected.criterion > larger.criterion
        check = make_check(
            DiscoveryRule.SHAPE_CORRECTION,
            corrected.criterion,
            larger.criterion,
            suffices,
            " + ".join(selected.effects),
        )
        self.steps.append(SelectionStep(StepKind.CORRECT_SHAPE, corrected.effects, suffices, (check,)))
        if suffices:
            self.shape_corrections[frozenset(selected.effects)] = corrected
        return suffices

    # Backward, exchange, and simpler members of a family

    def _drop_needless(self, selected: FittedCandidate) -> FittedCandidate:
        """Without every effect that the data do not need once the others are there."""
        for name in selected.effects:
            if len(selected.effects) == 1:
                break
            smaller = self._refit_without(selected, name)
            if smaller is None:
                continue
            needed = judge_effect(self.baseline, smaller, selected, self.policy.selection)
            self.steps.append(SelectionStep(StepKind.DROP, smaller.effects, not needed, needed.checks))
            if not needed:
                selected = smaller
        return selected

    def _swap(self, selected: FittedCandidate) -> FittedCandidate:
        """With each effect replaced by a better one, if there is one."""
        if len(selected.effects) == 1:
            return selected  # every single effect has been refitted already
        for name in selected.effects:
            rest = self._refit_without(selected, name)
            if rest is None:
                continue
            ranked = self._rank_further_effects([rest], 2 * SEARCH_SWAPS, AMPLITUDE_GRID)
            others = [e for _, e in ranked if e.name != name and not self._is_in_family(e, selected)]
            swapped = self._add_each(rest, others[:SEARCH_SWAPS])
            limit = selected.criterion - TIE_COST
            better = [fit for fit in swapped if fit.criterion < limit]
            if better:
                best = min(better, key=lambda fit: fit.criterion)
                check = make_check(DiscoveryRule.SWAP, best.criterion, limit, True, name)
                self.steps.append(SelectionStep(StepKind.SWAP, best.effects, True, (check,)))
                selected = self._converge(best)
        return self._simplify(selected, list(self.fits.values()))

    def _simplify(self, best: FittedCandidate, among: Sequence[FittedCandidate]) -> FittedCandidate:
        """The simplest member of a family that does nearly as well as its best."""
        for name in best.effects:
            for parent in self._simpler(name):
                wanted = {parent if n == name else n for n in best.effects}
                simpler = next((fit for fit in among if set(fit.effects) == wanted), None)
                if simpler is None:
                    continue
                loss, limit = simpler.cost - best.cost, self._allowed_loss(simpler, best)
                if loss > limit:
                    simpler = self._refit_from_child(simpler, best, parent, name)
                    loss, limit = simpler.cost - best.cost, self._allowed_loss(simpler, best)
                check = Check.at_most(DiscoveryRule.SIMPLER_MEMBER, loss, limit, parent)
                self.steps.append(SelectionStep(StepKind.SIMPLIFY, simpler.effects, check.passed, (check,)))
                if check:
                    return self._simplify(simpler, among)
        return best

    def _refit_from_child(
        self, simpler: FittedCandidate, richer: FittedCandidate, parent: str, child: str
    ) -> FittedCandidate:
        """The simpler model from the constants of the richer one: caught in a minimum of its own it would leave its name to its child."""
        values = dict(richer.model.values)
        child_names = richer.model.names_of(child)
        parent_names = simpler.model.names_of(parent)
        shared = {parent_names[q]: values[child_names[q]] for q in parent_names.keys() & child_names.keys()}
        start = {**simpler.model.values, **{n: v for n, v in values.items() if n in simpler.model.values}, **shared}
        again = self.problem.refit_best(simpler.model, [start], keep=1)
        if again is None or again.cost >= simpler.cost:
            return simpler
        self.fits[frozenset(again.effects)] = again
        self.single_effects = [again if fit.effects == again.effects else fit for fit in self.single_effects]
        return again

    def _allowed_loss(self, simpler: FittedCandidate, best: FittedCandidate) -> float:
        """By how much the simpler member of a family may do worse: less where only the richer one leaves nothing but noise."""
        if best.per_sample <= clean_cost_limit(best.count) < simpler.per_sample:
            return CHILD_COST
        return max(CHILD_COST, CHILD_SHARE * (self.baseline.cost - best.cost))

    def _choose_simplest_equal(self, best: FittedCandidate) -> FittedCandidate:
        """Of the models that explain the records equally well, whatever their families, the one with the fewest constants."""
        simpler = [fit for fit in self.find_rivals(best) if fit.free < best.free]
        if not simpler:
            return best
        simplest = min(simpler, key=lambda fit: (fit.free, fit.criterion))
        checks = self.tie_checks(best, [simplest])
        self.steps.append(SelectionStep(StepKind.SIMPLIFY, simplest.effects, True, checks))
        return simplest

    def _replace_by_child(self, fit: FittedCandidate) -> FittedCandidate:
        """With an effect replaced by its child, where the effect leaves structure and the child is better."""
        for name in fit.effects:
            for child in (e for e in self.candidates if name in e.parents and self._has_structure_left(fit)):
                rest = self._refit_without(fit, name)
                with_child = [] if rest is None else self._add_each(rest, [child])
                if with_child and with_child[0].criterion < fit.criterion:
                    fit = self._converge(with_child[0])
                    break
        return fit

    # Refits

    def _add_each(self, fit: FittedCandidate, effects: Sequence[Effect]) -> list[FittedCandidate]:
        """``fit`` with each effect in turn, one short refit from its most promising starting point; independent of one another."""
        keys = [frozenset((*fit.effects, e.name)) for e in effects]
        new = [(key, e) for key, e in zip(keys, effects, strict=True) if key not in self.fits]
        prepared = [(key, self._prepare(fit, effect, partial(self._screening_job, fit, effect))) for key, effect in new]
        jobs = [(key, job) for key, job in prepared if job is not None]
        self._keep_better([key for key, _ in jobs], [job for _, job in jobs])
        self._carry_on([key for key, _ in jobs if key in self.fits])
        # It contains the smaller model: from where that ended, the effect absent, it cannot do worse.
        behind = [(key, job.model) for key, job in jobs if key not in self.fits or self.fits[key].cost > fit.cost]
        absent = [
            self.problem.plan_refit(model, [share_values(fit.model, model)], 1, like=fit, refines=False)
            for _, model in behind
        ]
        self._keep_better([key for key, _ in behind], absent)
        return [self.fits[key] for key in keys if key in self.fits]

    def _carry_on(self, keys: Sequence[Key]) -> None:
        """Looks that were stopped in the middle of a descent go on, and those that may still come near the best of all."""
        near = HOPELESS_COST * min((self.fits[key].cost for key in keys), default=0.0)
        jobs = {}
        for key in keys:
            fit = self.fits[key]
            if fit.promised_decrease > (NEGLIGIBLE_SHARE if fit.cost <= near else FALLING_SHARE) * fit.cost:
                jobs[key] = self.problem.plan_refit(fit.model, [fit.model.values], 1, like=fit, refines=False)
        self._keep_better(list(jobs), list(jobs.values()))

    def _keep_better(self, keys: Sequence[Key], jobs: Sequence[RefitJob]) -> None:
        """Refits of sets of effects, each kept where it leaves less than what is known of its set."""
        for key, fit in zip(keys, self.problem.refit_all(jobs), strict=True):
            if fit is not None and (key not in self.fits or fit.cost < self.fits[key].cost):
                self.fits[key] = fit

    def _prepare(self, fit: FittedCandidate, effect: Effect, prepare: Callable[[], RefitJob]) -> RefitJob | None:
        """A refit of ``fit`` with ``effect``; None where it cannot even begin."""
        return self._attempt(SearchStage.PREPARATION, (*fit.effects, effect.name), prepare, None)

    def _screening_job(self, fit: FittedCandidate, effect: Effect) -> RefitJob:
        model = fit.model + effect
        starts, shapes = self._starting_points(fit, effect, model), count_shapes(effect, self.scales)
        # With so many shapes (frequencies of a sharp resonance) a step from afar predicts nothing: refit from each.
        narrow = shapes > MANY_SHAPES and not fit.effects
        return RefitJob(model, tuple(starts), shapes if narrow else 1, SCREENING_ITERATIONS, refines=False)

    def _starting_points(
        self, fit: FittedCandidate, effect: Effect, model: Model, more: Sequence[StartValues] = ()
    ) -> list[StartValues]:
        """Where the refit of ``model``, which is that of ``fit`` with ``effect``, starts."""
        seed = self.seeds.get(frozenset((*fit.effects, effect.name)))
        starts: list[StartValues]
        if seed is not None:  # refitted before, under another noise model
            starts = [seed.model.values]
        else:
            many = count_shapes(effect, self.scales) > MANY_SHAPES
            nominal = fit.model if many else self.problem.model
            amplitudes = AMPLITUDE_GRID
            starts = [*more, *generate_starting_points(model, effect, fit, nominal, self.scales, amplitudes)]
        for name in effect.parents:
            parent = self.fits.get(frozenset((*fit.effects, name)))
            if parent is not None:
                starts += generate_child_starting_points(model, effect, parent, self._effect(name), self.scales)
        return starts

    def _converge(self, fit: FittedCandidate) -> FittedCandidate:
        """A short refit carried on to convergence."""
        better = self.problem.converge(fit)
        self.fits[frozenset(better.effects)] = better
        return better

    def _refit_without(self, fit: FittedCandidate, name: str) -> FittedCandidate | None:
        known = self.fits.get(frozenset(n for n in fit.effects if n != name))
        refits = [f for f in (self.problem.refit_without(fit, name), known) if f is not None]
        return min(refits, key=lambda f: f.cost, default=None)

    @property
    def _attempt(self) -> Callable[..., Any]:
        """Keeps the reason of what fails, and goes on."""
        return self.problem.failures.attempt

    # Families of effects

    def _candidate_parents(self, effect: Effect) -> set[str]:
        """The parents of ``effect`` that are candidates."""
        return set(effect.parents) & {e.name for e in self.candidates}

    def _simplest_member(self, fit: FittedCandidate) -> FittedCandidate:
        """The tried parent of a single effect, or its parent's parent."""
        names = self._effect(fit.effects[0]).parents
        parents = [f for name in names for f in self.single_effects if f.effects == (name,)]
        return self._simplest_member(parents[0]) if parents else fit

    def _is_in_family(self, effect: Effect, fit: FittedCandidate) -> bool:
        """Whether ``effect`` is a parent or child of one in ``fit``: a family is represented once."""
        return any(effect.name in self._effect(n).parents or n in effect.parents for n in fit.effects)

    def _are_related(self, a: FittedCandidate, b: FittedCandidate) -> bool:
        """Whether one model is the other with a parent effect in the place of its child."""
        only_a, only_b = set(a.effects) - set(b.effects), set(b.effects) - set(a.effects)
        pairs = [(x, y) for x in only_a for y in only_b]
        return any(y in self._simpler(x) or x in self._simpler(y) for x, y in pairs)

    def _simpler(self, name: str) -> tuple[str, ...]:
        """The effects that one contains or approaches."""
        effect = self._effect(name)
        return (*effect.parents, *effect.approaches)

    def _effect(self, name: str) -> Effect:
        return next(e for e in self.candidates if e.name == name)

    # Steps and messages

    def _accept(self, smaller: FittedCandidate, larger: FittedCandidate) -> bool:
        decision = judge_effect(self.baseline, smaller, larger, self.policy.selection)
        self.steps.append(SelectionStep(StepKind.ADD, larger.effects, decision.passed, decision.checks))
        return decision.passed

    def _tell(self, code: DiscoveryCode, fit: FittedCandidate) -> None:
        values = {"before": self.baseline.noise_ratio, "after": fit.noise_ratio, "bounded": fit.is_noise_bounded}
        self.on_message(str(Finding(code, subject=" + ".join(fit.effects), values=values)))


def checks_of(steps: Sequence[SelectionStep]) -> Iterator[Check]:
    """All checks of a path, in order."""
    for step in steps:
        yield from step.checks
