"""Forward, backward and swap: which effects, if any, turn the plain model into one that explains the records."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from greybox.discovery import decision
from greybox.discovery.execution import RefitJob
from greybox.discovery.problem import ITERATIONS, CandidateFit, DiscoveryProblem, StartValues
from greybox.discovery.residual_noise import LEFT_OVER, excess_autocorrelation
from greybox.discovery.shape_correction import fit_shape_correction
from greybox.discovery.starting_points import (
    LADDER,
    count_shapes,
    generate_child_starting_points,
    generate_starting_points,
)
from greybox.effects import Scales
from greybox.model import Effect, Model

# First picks that a second effect is looked for beside, and how many of them at a time: two effects may explain together what
# neither does alone, so the later ones count where the leading ones lead nowhere.
BEAM, ABREAST = 6, 3
# Further effects that are refitted beside each of the leading first picks, or beside all the later ones; and effects at most.
SECONDS, MOST_EFFECTS = 4, 3
# Amplitude at which an effect is nearly absent, as a multiple of its probe: what a first effect left over may be that small.
FAINT = 0.01
# Iterations of a first, short refit; effects that are then refitted thoroughly; generations of children (Coulomb, Stribeck, LuGre).
SHORT, LEADING, GENERATIONS = 12, 5, 2
# A short refit this many times as far from the records as another one that leaves only noise is out of the running.
FAR = 4.0
# Models with a further effect that are refitted to convergence.
FINISHED = 3
# Shapes of one effect from which each is refitted; so many that the leading effect is refitted from more starts, and from how many.
MANY_SHAPES = 15
FEW_SHAPES, MANY_STARTS = 4, 5
# Effects put in the place of one that was chosen, refitted.
SWAPS = 4

Say = Callable[[str], None]


@dataclass
class StepwiseSelection:
    """A search in progress over ``candidates`` (in catalogue order, parents before children)."""

    bench: DiscoveryProblem
    candidates: Sequence[Effect]
    scales: Scales
    say: Say
    seeds: Mapping[frozenset[str], CandidateFit] = field(default_factory=dict)
    base: CandidateFit = field(init=False)
    singles: list[CandidateFit] = field(init=False, default_factory=list)
    tried: dict[frozenset[str], CandidateFit] = field(init=False, default_factory=dict)
    form: dict[frozenset[str], CandidateFit] = field(init=False, default_factory=dict)
    hopes: dict[frozenset[str], dict[tuple[str, float], float]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.base = self.bench.base

    def first(self) -> CandidateFit:
        """The best model with a single effect, whether or not the data demand it."""
        if not self.singles:
            self._try([e for e in self.candidates if not self._parents(e)])
            for _ in range(GENERATIONS):  # children of parents that did well, and theirs
                leading = {t.effects[0] for t in sorted(self.singles, key=lambda t: t.criterion)[:LEADING]}
                done = {t.effects[0] for t in self.singles}
                self._try([e for e in self.candidates if e.name not in done and set(e.parents) & leading])
            self._polish()
        if not self.singles:
            return self.base
        return self._parsimonious(min(self.singles, key=lambda t: t.criterion), self.singles)

    def _try(self, effects: Sequence[Effect]) -> None:
        """Each effect alone, one short refit from its most promising start."""
        # A child starts from its parent, so it waits for one that is tried at the same time.
        names = {e.name for e in effects}
        waiting = [e for e in effects if set(e.parents) & names]
        self.singles += self._added_all(self.base, [e for e in effects if e not in waiting])
        if waiting:
            self._try(waiting)

    def _polish(self) -> None:
        """The leading effects once more, thoroughly: from several starts and to convergence."""
        ranked = sorted(self.singles, key=lambda t: t.criterion)
        done = ranked[0].per_sample <= decision.noise_cost_limit(ranked[0].count)
        parents = set(self._effect(ranked[0].effects[0]).parents) if done else set()
        leading = [t for t in ranked[:LEADING] if self._open(t, ranked[0]) and t.effects[0] not in parents]
        # A parent caught in a minimum of its own would leave its name to its child.
        leading += [t for t in ranked if t.effects[0] in parents]
        jobs = []
        for t in leading:
            effect = self._effect(t.effects[0])
            model = self.base.model + effect
            # The cost of an effect of many shapes has many minima, and the name may be right in a wrong one.
            many = effect.name in parents or (t is ranked[0] and count_shapes(effect, self.scales) >= FEW_SHAPES)
            keep = MANY_STARTS if many else 2
            jobs.append(
                RefitJob(model, tuple(self._starts(self.base, effect, model, [t.model.values])), keep, ITERATIONS)
            )
        for t, again in zip(leading, self.bench.every(jobs), strict=True):
            best = again if again is not None and again.cost < t.cost else t
            self.tried[frozenset(t.effects)] = best
            self.singles[self.singles.index(t)] = best

    def _open(self, t: CandidateFit, best: CandidateFit) -> bool:
        """Whether a thorough refit of ``t`` may change anything: not where a parent of it leaves only noise already, nor where another
        effect does and this one is far from it."""
        noise = decision.noise_cost_limit(t.count)
        parents = [p for p in self.singles if p.effects[0] in self._effect(t.effects[0]).parents]
        if any(p.per_sample <= noise for p in parents):
            return False
        return best.per_sample > noise or t.per_sample <= FAR * best.per_sample

    def run(self) -> CandidateFit:
        """The model that explains the records best without a part that is not needed; the plain one if nothing is missing."""
        chosen = self.first()
        if chosen is self.base:
            return self.base
        self._retest_base(chosen)
        if not decision.is_effect_accepted(self.base, self.base, chosen):
            return self.base
        self.say(
            f"{chosen.effects[0]}: misfit {self.base.per_sample**0.5:.3g} -> {chosen.per_sample**0.5:.3g} times the noise"
        )
        while self._suspicious(chosen) and len(chosen.effects) < MOST_EFFECTS:
            larger = self._extended(chosen)
            if larger is None or not decision.is_effect_accepted(self.base, chosen, larger):
                break
            if self._of_form(chosen, larger):
                self.say(f"what is left is of the form of {' + '.join(chosen.effects)}: no further effect")
                break
            chosen = larger
            self.say(f"{' + '.join(chosen.effects)}: misfit {chosen.per_sample**0.5:.3g} times the noise")
        return self._swapped(self._pruned(chosen))

    def _of_form(self, chosen: CandidateFit, larger: CandidateFit) -> bool:
        """Whether a refinement of the effects at hand explains what is left as well as a further effect does."""
        better = fit_shape_correction(self.bench, chosen, self.scales)
        if better is None or better.criterion > larger.criterion:
            return False
        self.form[frozenset(chosen.effects)] = better
        return True

    def _suspicious(self, chosen: CandidateFit) -> bool:
        """Whether a further effect is worth looking for: the misfit, or the residual's memory, is more than chance."""
        return chosen.per_sample > decision.noise_cost_limit(chosen.count) or excess_autocorrelation(chosen) > LEFT_OVER

    def rivals(self, chosen: CandidateFit) -> list[CandidateFit]:
        """Other models of the same size that explain the records as well, and are not the chosen one with more or less in it."""
        same = [
            t
            for t in self.tried.values()
            if len(t.effects) == len(chosen.effects) and set(t.effects) != set(chosen.effects)
        ]
        return [t for t in same if t.criterion - chosen.criterion < decision.TIE and not self._related(t, chosen)]

    def _added_all(self, trial: CandidateFit, effects: Sequence[Effect]) -> list[CandidateFit]:
        """``trial`` with each effect in turn, one short refit from its most promising start: independent of one another."""
        keys = [frozenset((*trial.effects, e.name)) for e in effects]
        new = [(key, e) for key, e in zip(keys, effects, strict=True) if key not in self.tried]
        jobs = []
        for _, e in new:
            model = trial.model + e
            starts, shapes = self._starts(trial, e, model), count_shapes(e, self.scales)
            # Where there are so many shapes (frequencies of a sharp resonance), a step from afar foresees nothing: refit from each.
            narrow = shapes > MANY_SHAPES and not trial.effects
            jobs.append(RefitJob(model, tuple(starts), shapes if narrow else 1, SHORT))
        for (key, _), found in zip(new, self.bench.every(jobs), strict=True):
            if found is not None:
                self.tried[key] = found
        return [self.tried[key] for key in keys if key in self.tried]

    def _starts(
        self, trial: CandidateFit, effect: Effect, model: Model, more: Sequence[StartValues] = ()
    ) -> list[StartValues]:
        """Where the refit of ``model``, which is ``trial`` with ``effect``, begins."""
        seed = self.seeds.get(frozenset((*trial.effects, effect.name)))
        starts: list[StartValues]
        if seed is not None:  # refitted before, with another idea of the noise
            starts = [seed.model.values]
        else:
            nominal = trial.model if count_shapes(effect, self.scales) > MANY_SHAPES else self.bench.plain
            starts = [*more, *generate_starting_points(model, effect, trial, nominal, self.scales)]
        for name in effect.parents:
            parent = self.tried.get(frozenset((*trial.effects, name)))
            if parent is not None:
                starts += generate_child_starting_points(model, effect, parent, self._effect(name), self.scales)
        return starts

    def _extended(self, chosen: CandidateFit) -> CandidateFit | None:
        """The best model with one effect more, from the chosen one and (for a second effect) from the other good first picks."""
        firsts = [chosen]
        if len(chosen.effects) == 1:
            # A family is carried on by its plainest member: the others cost more and say the same.
            ranked = [self._plainest(t) for t in (chosen, *sorted(self.singles, key=lambda t: t.criterion))]
            firsts = list({t.effects: t for t in ranked}.values())[:BEAM]
        best: CandidateFit | None = None
        for k in range(0, len(firsts), ABREAST):
            found = self._beside(firsts[k : k + ABREAST], leading=k == 0)
            best = min((t for t in (best, found) if t is not None), key=lambda t: t.criterion, default=None)
            if best is not None and not self._suspicious(best):
                break
        return best and self._parsimonious(best, list(self.tried.values()))

    def _beside(self, firsts: Sequence[CandidateFit], leading: bool) -> CandidateFit | None:
        """The best model with one effect more than one of ``firsts``; less is tried where these are not the ``leading`` ones."""
        rungs, most = (LADDER, SECONDS * len(firsts)) if leading else ((), SECONDS)
        promising = self._promising(firsts, most, rungs)
        grouped = [(first, [e for trial, e in promising if trial is first]) for first in firsts]
        found = [t for first, effects in grouped for t in self._added_all(first, effects)]
        if not found:
            return None
        finished = [self._finished(t) for t in sorted(found, key=lambda t: t.criterion)[:FINISHED]]
        return self._grown(min(finished, key=lambda t: t.criterion))

    def _plainest(self, trial: CandidateFit) -> CandidateFit:
        """The tried parent of a single effect, or its parent's parent."""
        parents = [t for name in self._effect(trial.effects[0]).parents for t in self.singles if t.effects == (name,)]
        return self._plainest(parents[0]) if parents else trial

    def _grown(self, trial: CandidateFit) -> CandidateFit:
        """With an effect replaced by its child, where that still leaves something and the child is better."""
        for name in trial.effects:
            for child in (e for e in self.candidates if name in e.parents and self._suspicious(trial)):
                rest = self._refitted(trial, name)
                grown = [] if rest is None else self._added_all(rest, [child])
                if grown and grown[0].criterion < trial.criterion:
                    trial = self._finished(grown[0])
                    break
        return trial

    def _promising(
        self, firsts: Sequence[CandidateFit], most: int, rungs: Sequence[float] = LADDER
    ) -> list[tuple[CandidateFit, Effect]]:
        """The ``most`` further effects, each beside one of ``firsts``, that promise most: all nearly absent, the better ones at the
        amplitudes ``rungs`` too."""
        plain = [e for e in self.candidates if not self._parents(e)]  # a family is represented by its plainest member
        room = [(t, e) for t in firsts for e in plain if e.name not in t.effects and not self._family(e, t)]
        best: dict[tuple[str, ...], float] = {}
        for rung in (FAINT, *rungs):
            few = len(room) if rung == FAINT else 2 * most
            for t, e in sorted(room, key=lambda one: self._hope(one[0], one[1], FAINT))[:few]:
                key = (*t.effects, e.name)
                best[key] = min(best.get(key, np.inf), self._hope(t, e, rung))
        once: dict[frozenset[str], tuple[CandidateFit, Effect]] = {}
        for t, e in sorted(room, key=lambda one: best[*one[0].effects, one[1].name]):
            once.setdefault(frozenset((*t.effects, e.name)), (t, e))
        return list(once.values())[:most]

    def _finished(self, trial: CandidateFit) -> CandidateFit:
        """A short refit carried on to convergence."""
        again = self.bench.best(trial.model, [trial.model.values], keep=1)
        best = again if again is not None and again.cost < trial.cost else trial
        self.tried[frozenset(best.effects)] = best
        return best

    def _hope(self, first: CandidateFit, effect: Effect, rung: float) -> float:
        """The cost that a step from ``first`` with some of ``effect`` foresees."""
        known = self.hopes.setdefault(frozenset(first.effects), {})
        if (effect.name, rung) not in known:
            model = first.model + effect
            starts = generate_starting_points(model, effect, first, first.model, self.scales, (rung,))
            known[effect.name, rung] = self.bench.promise(model, starts)
        return known[effect.name, rung]

    def _pruned(self, chosen: CandidateFit) -> CandidateFit:
        """Without every effect that the data do not need once the others are there."""
        for name in chosen.effects:
            if len(chosen.effects) == 1:
                break
            smaller = self._refitted(chosen, name)
            if smaller is not None and not decision.is_effect_accepted(self.base, smaller, chosen):
                chosen = smaller
        return chosen

    def _refitted(self, chosen: CandidateFit, without: str) -> CandidateFit | None:
        model = chosen.model.without(without)
        values = {name: value for name, value in chosen.model.values.items() if name in model.values}
        starts = [values, {**values, **self.bench.plain.values}]
        known = self.tried.get(frozenset(e.name for e in model.effects))
        found = [t for t in (self.bench.best(model, starts), known) if t is not None]
        return min(found, key=lambda t: t.cost, default=None)

    def _swapped(self, chosen: CandidateFit) -> CandidateFit:
        """With each effect replaced by a better one, if there is one."""
        if len(chosen.effects) == 1:
            return chosen  # every single effect has been refitted already
        for name in chosen.effects:
            rest = self._refitted(chosen, name)
            if rest is None:
                continue
            promising = [
                e for _, e in self._promising([rest], 2 * SWAPS) if e.name != name and not self._family(e, chosen)
            ]
            others = self._added_all(rest, promising[:SWAPS])
            better = [t for t in others if t.criterion < chosen.criterion - decision.TIE]
            if better:
                chosen = self._finished(min(better, key=lambda t: t.criterion))
        return self._parsimonious(chosen, list(self.tried.values()))

    def _retest_base(self, extended: CandidateFit) -> None:
        """The plain model once more, from the constants of the extended one: a base fit stuck in a wrong place is a false alarm."""
        values = {name: value for name, value in extended.model.values.items() if name in self.base.model.values}
        again = self.bench.best(self.base.model, [values], keep=1)
        if again is not None and again.cost < self.base.cost:
            self.base = again

    def _parsimonious(self, best: CandidateFit, among: Sequence[CandidateFit]) -> CandidateFit:
        """The simplest member of a family that does nearly as well as its best."""
        for name in best.effects:
            for parent in self._effect(name).parents:
                wanted = {parent if n == name else n for n in best.effects}
                simpler = next((t for t in among if set(t.effects) == wanted), None)
                if simpler is not None and simpler.cost - best.cost <= self._allowed(simpler, best):
                    return self._parsimonious(simpler, among)
        return best

    def _allowed(self, simpler: CandidateFit, best: CandidateFit) -> float:
        """By how much the simpler member of a family may do worse: a share of what ``best`` gains, but where only that one leaves noise."""
        if best.per_sample <= decision.clean_cost_limit(best.count) < simpler.per_sample:
            return decision.CHILD
        return max(decision.CHILD, decision.CHILD_SHARE * (self.base.cost - best.cost))

    def _parents(self, effect: Effect) -> set[str]:
        """The parents of ``effect`` that are candidates."""
        return set(effect.parents) & {e.name for e in self.candidates}

    def _family(self, effect: Effect, trial: CandidateFit) -> bool:
        """Whether ``effect`` is a parent or child of one in ``trial``: a family is represented once."""
        return any(effect.name in self._effect(n).parents or n in effect.parents for n in trial.effects)

    def _related(self, a: CandidateFit, b: CandidateFit) -> bool:
        """Whether one model is the other with a parent effect in the place of its child."""
        ours, theirs = set(a.effects) - set(b.effects), set(b.effects) - set(a.effects)
        pairs = [(x, y) for x in ours for y in theirs]
        return any(y in self._effect(x).parents or x in self._effect(y).parents for x, y in pairs)

    def _effect(self, name: str) -> Effect:
        return next(e for e in self.candidates if e.name == name)
