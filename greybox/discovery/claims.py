"""What a discovery says, as a tree: where something is missing, as a function of what, of which family, which effect.

Every resample of the records has a winner on the table of fitted sets (`greybox.discovery.table`). A claim holds in a resample if it holds
in the winner, so its raw weight is how often it would be made again if the records were drawn again; sets that win by nothing share
the resample. A curve in the winner beside an effect at the same place says that the effect has not the right form: it supports the
place and the variable, and denies the name. A map of four numbers a depth, fitted to a study of cases with known answers, turns that
weight, whether more than noise is left, and whether only sensors are accused of it, into a probability (`certainty.json`): where the true
effect is not in the catalogue something is left, and a sensor can imitate whatever the plant does.
"""

from __future__ import annotations

import json
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache, lru_cache
from importlib.resources import files
from typing import ClassVar, NamedTuple

import casadi as ca
import numpy as np

from greybox.base.numerics import TINY
from greybox.base.values import ReadOnly
from greybox.discovery.candidates import family_of
from greybox.discovery.curve_shape import TIME
from greybox.discovery.decision import Conclusion, Decision, Grade, Verdict, make_check
from greybox.discovery.disturbance_sites import SiteKind, list_disturbance_sites, site_label
from greybox.discovery.findings import DiscoveryRule
from greybox.discovery.laws.terms import claimed_name
from greybox.discovery.residual_noise import SECOND_BRANCH, has_memory
from greybox.discovery.surrogate_effects import CLOCK, CURVE, LINEAR_DYNAMICS, TONE
from greybox.discovery.table import BlockSums, Draws
from greybox.model import Effect, Model
from greybox.model.effects.catalogue import AT, all_effects
from greybox.model.parts import Occurrence
from greybox.model.system import BoundEffect


class Depth(IntEnum):
    """How much a claim says."""

    MISSING = 0
    """Something is missing in an output."""
    PLACE = 1
    """Where: at a balance, an input, a sensor."""
    VARIABLES = 2
    """As a function of which variables."""
    FAMILY = 3
    """Which family of effects."""
    NAME = 4
    """Which effect."""


@dataclass(frozen=True)
class Claim(ReadOnly):
    """One statement about what the plain model lacks.

    Parameters
    ----------
    depth
        How much it says.
    output
        The output of whose error what is claimed takes the largest share.
    sites
        Labels of the places that the sensors cannot tell apart; empty at depth 0.
    variables
        States and inputs on which it depends; empty above that depth, and where only the time is left.
    form
        ``static``, ``with memory``, ``timing`` (a lag or a delay), or "" where that is open.
    family
        Names of the effects of the catalogue that belong together.
    name
        The effect; of a law its formula.
    probability, grade
        How probable it is that the claim holds, and what may be said because of that.
    share
        Share of the rms error that what is claimed takes away on the records that judge, 0 to 1.
    rival
        What wins most often where the claim does not hold: "" where it always does.
    equals
        Of a name: effects that neither contain it nor are contained that do the same in its place. No record of this kind separates them.
    has_twin
        Whether one of these does it with no more constants, and the claim is not true of it: neither is certain. A richer one is no
        objection to a simple one.
    is_matched
        Whether a set of which it is not true does as well, as often as not, where whatever was tried may leave more than noise.
    joint
        Of a name: how probable it is that it or one of its equals is right.
    size
        What is claimed, rms in the output, as a share of the range of its readings.
    frequency, left
        What the probability was computed from, beside the sites: the share of the resamples in which the claim
        holds; and of the set that won most often, the share of the rms error that is no noise.
    """

    depth: Depth
    output: str
    sites: tuple[str, ...] = ()
    variables: tuple[str, ...] = ()
    form: str = ""
    family: tuple[str, ...] = ()
    name: str = ""
    probability: float = 0.0
    grade: Grade = Grade.STAND_IN
    share: float = 0.0
    rival: str = ""
    equals: tuple[str, ...] = ()
    has_twin: bool = False
    is_matched: bool = False
    joint: float = 0.0
    size: float = 0.0
    frequency: float = 0.0
    left: float = 0.0

    KEYS: ClassVar[str] = "depth output site variables form family name probability grade share size rival equals"

    @property
    def site(self) -> str:
        """Its sites, joined by ``or`` where the sensors cannot tell them apart; empty at depth 0."""
        return " or ".join(self.sites)

    @property
    def is_established(self) -> bool:
        """Whether it may be said."""
        return self.grade is Grade.ESTABLISHED

    @property
    def is_lesser_part(self) -> bool:
        """Whether it takes less than half of the error where more than half of what is left is no noise: the greater part is not known,
        and may act elsewhere and show there as well.
        """
        return self.depth > Depth.MISSING and self.share < GREATER_PART < self.left


# Probability from which a claim is established, and from which it is probable; below it is a stand-in.
ESTABLISHED_FROM = 0.75
PROBABLE_FROM = 0.5
# Share of the resamples from which a claim is listed.
LEAST_FREQUENCY = 0.2
# Share of the error that what is claimed must take: less is no answer to what is missing.
LEAST_SHARE = 0.05
# Share of the rms error that is its greater part: what takes less, where more of the rest is no noise, is not what most of the error is.
GREATER_PART = 0.5
# Difference of the logarithms of two errors below which two sets win together.
SAME_LOG_ERROR = 1e-3
# Share of the resamples, of those in which a set is good, from which another one that is good too does the same.
EQUAL_FREQUENCY = 0.5
# The name of the plain model as a rival.
PLAIN = "plain_model"
# Forms of a claim.
STATIC, WITH_MEMORY, TIMING = "static", "with memory", "timing"
# Share of the resamples in which the form must be the same for a claim to say it.
AGREED = 0.8


@dataclass(frozen=True)
class EffectForm:
    """What an effect in a model says at each depth.

    Parameters
    ----------
    name
        Its name; "" for a curve or a tone, which stand for any.
    site
        Label of the balance, input or sensor at which it acts; "" for a linear path beside the plant.
    variables
        States and inputs that what it adds depends on.
    form
        ``static``, ``with memory`` (it has states of its own, or moves a signal in time), or ``timing``.
    family
        Names of its relatives and its own.
    """

    name: str
    site: str
    variables: tuple[str, ...]
    form: str
    family: tuple[str, ...]


def describe_effect(model: Model, bound: BoundEffect) -> EffectForm:
    """The form of one effect of ``model``."""
    effect = bound.effect
    sites = list_disturbance_sites(model, [o.name for o in model.outputs])
    label = next((s.label for s in sites if s.name == bound.site), bound.site)
    variables = _find_variables(model, bound)
    if effect.name.startswith(LINEAR_DYNAMICS):  # beside the plant, and so nowhere in it
        return EffectForm("", "", variables, WITH_MEMORY, ())
    if effect.name in (CURVE, TONE):
        is_over_time = effect.name == TONE or any(s.name == CLOCK for s in effect.states)
        form = TIMING if only_moves_in_time(effect) else STATIC
        return EffectForm("", label, (TIME,) if is_over_time else variables, form, ())
    name = claimed_name(effect).removesuffix(SECOND_BRANCH)
    base = name.partition(AT)[0]
    if only_moves_in_time(effect):
        return EffectForm(name, label, variables, TIMING, tuple(e.name for e in all_effects() if only_moves_in_time(e)))
    form = WITH_MEMORY if has_memory(effect) else STATIC
    return EffectForm(name, label, variables, form, family_of(base) or (base,))


@lru_cache(maxsize=128)  # a table is weighed several times; it has sixty sets at most
def _describe_effects(model: Model, given: frozenset[str]) -> tuple[EffectForm, ...]:
    """The forms of all effects of a model that its user has not ``given``."""
    return tuple(describe_effect(model, b) for b in model.bound_effects if b.effect.name not in given)


def only_moves_in_time(effect: Effect) -> bool:
    """Whether an effect only moves a signal in time: a lag, a delay, another hold. To the first order in its time each does the same,
    1 / (1 + s tau) = 1 - s tau + ... = exp(-s tau).
    """
    return has_memory(effect) and effect.parity == "linear" and len(effect.parameters) <= 1


def _find_variables(model: Model, bound: BoundEffect) -> tuple[str, ...]:
    """The states of the plant and the inputs that what an effect adds depends on: those of its slopes along its own constants."""
    system = model.system
    dry = [system.state_names[d.state] for d in system.dry if d.effect == bound.effect.name]
    if dry:
        return tuple(dry)
    index = [system.parameter_names.index(n) for n in bound.model_names.values() if n in system.parameter_names]
    # d (rates, outputs, states that are set) / d constants. Without a constant an effect on a reading adds what the reading depends on.
    equations = ca.vertcat(system.rhs, system.outputs, *(u.value for u in system.updates))
    slopes = ca.jacobian(equations, system.p)[:, index]
    if not index and bound.site in system.output_names:
        slopes = system.outputs[system.output_names.index(bound.site)]
    used = {s.name() for s in ca.symvar(ca.vec(slopes))}
    # What drives a state of an effect, its own or that of another through which its signal comes (a lag before it), drives the effect.
    places = {s.name: system.state_names.index(s.name) for each in model.bound_effects for s in each.states}
    followed = set[str]()
    while driving := ({s.name for s in bound.states} | (used & places.keys())) - followed:
        followed |= driving
        rows = [places[name] for name in driving]
        updates = [u.value for u in system.updates if u.state in rows]
        used |= {s.name() for s in ca.symvar(ca.vertcat(system.rhs[rows], *updates))}
    names = [*(name for name in system.state_names if name not in places), *system.input_names]
    # A delay, or a signal between its samples, is of the input at which it acts.
    return tuple(n for n in names if n in used) or tuple(n for n in system.input_names if n == bound.site)


@dataclass(frozen=True, eq=False)
class Weights:
    """How often each set of a table won: ``weight`` (R, S), rows that add up to one; sets that win by nothing share a resample."""

    draws: Draws
    weight: np.ndarray

    @classmethod
    def of(cls, draws: Draws) -> Weights:
        """Of the winners of a table's resamples."""
        rounds = np.arange(len(draws.winner))
        free = np.array([s.candidate.free for s in draws.sets])
        behind = draws.errors - draws.errors[rounds, draws.winner][:, None]
        alike = draws.good & (free[None] == free[draws.winner][:, None]) & (np.abs(behind) < SAME_LOG_ERROR)
        alike[rounds, draws.winner] = True
        # Of laws that do the same the shortest: |v| is v where v is never negative.
        length = np.array([len("".join(s.candidate.laws)) for s in draws.sets])
        alike &= length <= np.where(alike, length, np.inf).min(axis=1, keepdims=True)
        return cls(draws, alike / alike.sum(axis=1, keepdims=True))

    @property
    def totals(self) -> np.ndarray:
        """Share of the resamples that each set won (S,)."""
        return np.asarray(self.weight.mean(axis=0))

    @property
    def leading(self) -> int:
        """The number of the set that won most often."""
        return int(self.totals.argmax())

    def share(self, holds: Sequence[bool]) -> float:
        """Share of the resamples won by sets of which something ``holds`` (S,)."""
        return float(self.totals @ np.array(holds, float))


def weigh_claims(
    draws: Draws,
    alike_sites: Sequence[Sequence[str]],
    given: Collection[str],
    left: float,
    answer: Collection[str] = (),
    is_open: bool = False,
) -> tuple[Claim, ...]:
    """The tree of claims, depth by depth, most frequent first; empty where no set could be run.

    Parameters
    ----------
    draws
        What resampling says of the table of fitted sets.
    alike_sites
        Labels of sites in groups that the sensors cannot tell apart.
    given
        Names of the effects that the user's model holds: they are claimed by nobody.
    left
        Share of the rms error that is no noise of the set that won most often (`measure_structure`).
    answer
        Names of the effects of the answer: each is claimed, however seldom it wins.
    is_open
        Whether more than noise may be left whatever is tried. What is there has more effects than the set that wins then, and the fewest
        are no ground for certainty.
    """
    if not draws.sets:
        return ()
    weights = Weights.of(draws)
    forms = [_describe_effects(s.candidate.model, frozenset(given)) for s in draws.sets]
    groups = {label: tuple(group) for group in alike_sites for label in group}
    leading = draws.sets[weights.leading]
    names = [o.name for o in leading.candidate.model.outputs]
    context = _Context(draws, weights, forms, groups, names, left, is_open)
    missing = context.claim(Depth.MISSING, ())
    claims = [missing] if missing is not None and missing.frequency else []
    for depth, key in KEYS.items():
        keys = Counter(
            {
                k: context.frequency(depth, k)
                for set_ in forms
                for f in set_
                if f.site
                for k in [key(context.group(f), f)]
            }
        )
        for value, frequency in keys.most_common():
            is_meant = depth is Depth.NAME and value[-1] in answer
            if (frequency >= LEAST_FREQUENCY or is_meant) and (made := context.claim(depth, value)):
                claims.append(_hold_below(made, claims))
    return grade_claims(claims)


def _hold_below(claim: Claim, claims: Sequence[Claim]) -> Claim:
    """The claim no likelier than the ones that it implies: its variables, its place, that something is missing."""
    implied = [
        c.probability
        for c in claims
        if c.depth < claim.depth
        and (c.depth < Depth.PLACE or c.sites == claim.sites)
        and (c.depth < Depth.VARIABLES or c.variables == claim.variables)
        and (c.depth < Depth.FAMILY or c.family == claim.family)
    ]
    return replace(claim, probability=min([claim.probability, *implied]))


@dataclass(frozen=True)
class Grounds:
    """What a grade rests on beside the probability of a claim.

    Parameters
    ----------
    names
        What the effects of the model that is handed over are called; None where no model is meant.
    laws
        Those of them that are terms of one equation.
    nonsense
        Labels of the sites at which signals without meaning are established more often than a claim may be wrong.
    has_rivals
        Whether the rivals of these effects could be fitted.
    is_cut
        Whether the time was over before all rivals were tried.
    is_settled
        Whether another fit that begins where the models ended ends there too.
    is_contradicted
        Whether records that took no part speak against the model: that something is missing remains.
    """

    names: Collection[str] | None = None
    laws: Collection[str] = ()
    nonsense: Collection[str] = ()
    has_rivals: bool = True
    is_cut: bool = False
    is_settled: bool = True
    is_contradicted: bool = False

    def object_to(self, claim: Claim) -> bool:
        """Whether something else than its probability keeps a claim from being established."""
        if self.is_cut or not self.is_settled:
            return True
        if claim.is_matched or claim.is_lesser_part or (self.is_contradicted and claim.depth is not Depth.MISSING):
            return True
        # A signal over time has no variables, no family and no name; where it acts it has as well.
        if claim.depth >= Depth.VARIABLES and set(self.nonsense) & set(claim.sites):
            return True
        if claim.has_twin or not claim.name:
            return claim.has_twin
        # The certain answer is the model that is handed over, and a name that was held against no rival is not certain.
        return not self.has_rivals or (self.names is not None and claim.name not in self.names)


NO_GROUNDS = Grounds()


def grade_claims(claims: Sequence[Claim], grounds: Grounds = NO_GROUNDS) -> tuple[Claim, ...]:
    """What may be said of each claim: by its probability, and no more than probable where something else objects to it."""

    def grade(claim: Claim, is_open: bool) -> Claim:
        """Established only where nothing leaves it open."""
        made = to_grade(claim.probability)
        return replace(claim, grade=Grade.PROBABLE if is_open and made is Grade.ESTABLISHED else made)

    graded = [grade(c, grounds.object_to(c)) for c in claims]
    # The terms of a law are one equation, and none is certain where another is not: what the one has too much the other takes back.
    certain = {c.name for c in graded if c.name and c.is_established}
    if not certain >= set(grounds.laws):
        graded = [grade(c, grounds.object_to(c) or c.name in grounds.laws) for c in graded]
    # That something acts at a sensor, or at the plant or that sensor, is true of every record where it is no more than any sensor may be
    # off by. A name that is established has beaten what a sensor does, and keeps its place.
    named_at = {c.sites for c in graded if c.name and c.is_established}
    return tuple(
        grade(c, not c.is_established or (_is_within_sensor_class(c) and c.sites not in named_at and not c.name))
        for c in graded
    )


# Share of its range by which a sensor is commonly off: a scale that bends, a gain, a slow drift. Class 1 of industrial meters.
SENSOR_CLASS = 0.01


def _is_within_sensor_class(claim: Claim) -> bool:
    """Whether a sensor at one of the claim's places is commonly off by as much as what is claimed."""
    return claim.size < SENSOR_CLASS and any(map(_is_sensor, claim.sites))


def _is_sensor(label: str) -> bool:
    return label.startswith(site_label(SiteKind.SENSOR, ""))


Key = Callable[[tuple[str, ...], EffectForm], tuple[Hashable, ...]]

# What a form says at each depth.
KEYS: Mapping[Depth, Key] = {
    Depth.PLACE: lambda sites, f: (sites,),
    Depth.VARIABLES: lambda sites, f: (sites, f.variables),
    Depth.FAMILY: lambda sites, f: (sites, f.variables, f.family),
    Depth.NAME: lambda sites, f: (sites, f.variables, f.family, f.name),
}


@dataclass(frozen=True, eq=False)
class _Context:
    """A table's draws with the forms of each set, from which claims are made."""

    draws: Draws
    weights: Weights
    forms: Sequence[Sequence[EffectForm]]
    groups: Mapping[str, tuple[str, ...]]
    outputs: Sequence[str]
    left: float
    is_open: bool

    def group(self, form: EffectForm) -> tuple[str, ...]:
        return self.groups.get(form.site, (form.site,))

    def holds(self, depth: Depth, value: Hashable) -> list[bool]:
        """In which sets a claim holds."""
        if depth is Depth.MISSING:
            return [bool(forms) for forms in self.forms]
        return [any(self._says(forms, f, depth, value) for f in forms) for forms in self.forms]

    def _says(self, forms: Sequence[EffectForm], form: EffectForm, depth: Depth, value: Hashable) -> bool:
        if KEYS[depth](self.group(form), form) != value:
            return False
        if depth < Depth.FAMILY:
            return True
        # A curve beside it at the same place: its form is not right. A curve has no name.
        curves = [f for f in forms if not f.name and self.group(f) == self.group(form)]
        return bool(form.name) and not curves

    def frequency(self, depth: Depth, value: Hashable) -> float:
        return self.weights.share(self.holds(depth, value))

    def claim(self, depth: Depth, value: Hashable) -> Claim | None:
        """The claim with this content; None where no set makes it, or where it takes hardly anything."""
        holds = self.holds(depth, value)
        if not any(holds):
            return None
        totals, frequency = self.weights.totals, self.weights.share(holds)
        # The set that wins most often; of those that never do, the one that leaves least.
        best = max(np.flatnonzero(holds).tolist(), key=lambda k: (totals[k], -np.median(self.draws.errors[:, k])))
        shown = next((f for f in self.forms[best] if depth and self._says(self.forms[best], f, depth, value)), None)
        removed = {f.name for f in self.forms[best] if not depth or KEYS[depth](self.group(f), f) == value}
        share, size, output = self._share(best, removed)
        if depth and share < LEAST_SHARE:
            return None
        others = [k for k in range(len(holds)) if not holds[k] and totals[k] > 0]
        rival = max(others, key=lambda k: totals[k], default=None)
        claim = Claim(
            depth,
            output,
            sites=() if shown is None else self.group(shown),
            variables=shown.variables if shown is not None and depth >= Depth.VARIABLES else (),
            form=self._form(value, depth) if shown is not None and depth >= Depth.VARIABLES else "",
            family=shown.family if shown is not None and depth >= Depth.FAMILY else (),
            name=shown.name if shown is not None and depth >= Depth.NAME else "",
            share=share,
            size=size,
            rival="" if rival is None else _title(self.forms[rival]),
            is_matched=self.is_open and depth > Depth.MISSING and self._is_matched(depth, holds),
            frequency=frequency,
            left=self.left,
        )
        claim = replace(claim, probability=weigh_claim(claim))
        if depth < Depth.VARIABLES or shown is None or not shown.name:
            return claim
        equal_sets, same = self._equals(best, shown), _list_same_equations(self.forms[best], shown)
        free = [s.candidate.free for s in self.draws.sets]
        # One of whom the claim is true as well is no objection to it: to a family, none of its members.
        is_same = any(depth is Depth.NAME or name not in shown.family for name in same)
        has_twin = is_same or any(free[k] <= free[best] and not holds[k] for k in equal_sets)
        if depth < Depth.NAME:
            return replace(claim, has_twin=has_twin)
        equals = tuple(dict.fromkeys((*equal_sets.values(), *same)))
        either = [h or any(f.name in equals for f in forms) for h, forms in zip(holds, self.forms, strict=True)]
        return replace(
            claim,
            equals=equals,
            has_twin=has_twin,
            joint=weigh_claim(replace(claim, frequency=self.weights.share(either))),
        )

    def _is_matched(self, depth: Depth, holds: Sequence[bool]) -> bool:
        """Whether a set that does not make a claim does as well as often as not."""
        # A curve has no name that would speak against another one.
        speaks = [depth < Depth.FAMILY or all(f.name for f in forms) for forms in self.forms]
        others = [k for k, held in enumerate(holds) if not held and speaks[k]]
        return bool((self.draws.good[:, others].mean(axis=0) >= EQUAL_FREQUENCY).any())

    def _equals(self, best: int, form: EffectForm) -> dict[int, str]:
        """The effects, no relatives, with which a set that is good does without this one, as often as not, by the set's number."""
        rest = Counter(f.name for f in self.forms[best]) - Counter([form.name])
        rounds = self.draws.good[:, best]
        if not rounds.any():
            return {}
        equals = {}
        for k, forms in enumerate(self.forms):
            others = list((Counter(f.name for f in forms) - rest).elements())
            is_exchange = len(forms) == len(self.forms[best]) and len(others) == 1
            if not is_exchange or not others[0] or _are_related(others[0], form.name):
                continue
            # A law of more constants does what one of fewer does: that is no objection.
            sets = self.draws.sets
            if sets[k].candidate.laws and sets[k].candidate.free > sets[best].candidate.free:
                continue
            if float(self.draws.good[rounds, k].mean()) >= EQUAL_FREQUENCY:
                equals[k] = others[0]
        return equals

    def _form(self, value: Hashable, depth: Depth) -> str:
        """The form of what makes the claim, where the winners agree."""
        shares: dict[str, float] = defaultdict(float)
        for total, forms in zip(self.weights.totals, self.forms, strict=True):
            made = next((f.form for f in forms if KEYS[depth](self.group(f), f) == value), None)
            if made is not None:
                shares[made] += float(total)
        form = max(shares, key=lambda made: shares[made])
        return form if shares[form] >= AGREED * sum(shares.values()) else ""

    def _share(self, best: int, removed: Collection[str]) -> tuple[float, float, str]:
        """Share of the error that effects of a set take, beside the largest set on the table without them, and in which output most;
        what that is over the range of the output.
        """
        sets = self.draws.sets
        kept = [k for k, s in enumerate(sets) if not {f.name for f in self.forms[k]} & set(removed)]
        rest = frozenset(f.name for f in self.forms[best]) - set(removed)
        nested = [k for k in kept if {f.name for f in self.forms[k]} <= rest]
        if not nested:  # not even the plain model: its run goes astray, which is infinitely wrong
            return 1.0, 1.0, self.outputs[0]
        without = max(nested, key=lambda k: (len(self.forms[k]), -float(np.median(self.draws.errors[:, k]))))
        before, after = (sets[k].sums.judged_rms for k in (without, best))
        shares = 1 - after / np.maximum(before, TINY)
        output = int(np.nanargmax(np.where(before > 0, shares, -np.inf)))
        share, name = float(np.clip(shares[output], 0.0, 1.0)), self.outputs[output]
        # What is claimed and what is left add up in squares: before^2 - after^2 = before^2 (1 - (1 - share)^2).
        taken = before[output] * math.sqrt(1 - (1 - share) ** 2)
        return share, float(taken / max(sets[best].sums.reach[output], TINY)), name


def _are_related(one: str, other: str) -> bool:
    """Whether an effect contains or approaches another at its place, through others too: to do what its richer relative does is no tie."""
    (base, _, place), (other_base, _, other_place) = one.partition(AT), other.partition(AT)
    is_one_simpler = base in _list_simpler(other_base) or other_base in _list_simpler(base)
    return place == other_place and (base == other_base or is_one_simpler)


def _list_same_equations(forms: Sequence[EffectForm], form: EffectForm) -> list[str]:
    """Effects of the catalogue that are the same equation as one of a set together with others of it: no fit is needed to know that."""
    names = {f.name for f in forms}
    _, at, place = form.name.partition(AT)
    twins = {e.name + at + place: {other + at + place for other in e.stands_for} for e in all_effects() if e.stands_for}
    return [
        twin for twin, others in twins.items() if form.name in others <= names and not _are_related(twin, form.name)
    ]


@lru_cache(maxsize=256)
def _list_simpler(name: str) -> frozenset[str]:
    direct = {simpler for e in all_effects() if e.name == name for simpler in (*e.parents, *e.approaches)}
    return frozenset(direct | {further for simpler in direct for further in _list_simpler(simpler)})


def measure_share(before: BlockSums, after: BlockSums) -> float:
    """Share of the rms error on the records that judge that one set takes beside another, in the output of which it takes most."""
    return float(np.nanmax(1 - after.judged_rms / np.maximum(before.judged_rms, TINY)))


def _title(forms: Sequence[EffectForm]) -> str:
    """The effects of a rival: names, ``fitted_curve`` for a curve, ``linear_dynamics`` for those, and `PLAIN` where it has none."""
    return " + ".join(dict.fromkeys(f.name or (CURVE if f.site else LINEAR_DYNAMICS) for f in forms)) or PLAIN


def split_names(rival: str) -> list[str]:
    """The names in the text of a rival; the sum within a formula is a part of it."""
    names: list[str] = []
    for part in rival.split(" + "):
        if names and names[-1].count("(") > names[-1].count(")"):
            names[-1] += f" + {part}"
        else:
            names.append(part)
    return names


# From the raw weight to a probability

# Weights closer to 0 and 1 than this are as good as these: of two hundred resamples none says more.
LEAST_WEIGHT = 0.005
# Share of the rms error that is no noise at which something is half as good as certainly left: a quarter of a per cent of its square.
SOME_LEFT = 0.05


@cache
def read_certainty() -> Mapping[int, tuple[float, ...]]:
    """By depth, the constants of the map: intercept, then the slopes along `to_features`."""
    data = json.loads((files("greybox.discovery") / "certainty.json").read_text(encoding="utf-8"))
    return {int(depth): tuple(entry["constants"]) for depth, entry in data["depths"].items()}


def weigh_claim(claim: Claim) -> float:
    """The probability of a claim: what would be said again in so many of the resamples is no likelier than that."""
    return min(to_probability(claim.depth, to_features(claim)), claim.frequency)


def reweigh_claims(claims: Sequence[Claim], left: float) -> tuple[Claim, ...]:
    """Claims where the share ``left`` of the rms error is no noise: constants of more records leave less, and draw no sets anew."""
    changed = [replace(claim, left=left) for claim in claims]
    return tuple(replace(claim, probability=weigh_claim(claim)) for claim in changed)


class Features(NamedTuple):
    """What the map multiplies."""

    weight: float
    """Log odds of the share of the resamples."""

    left: float
    """Whether something is left, 0 to 1: one half where `SOME_LEFT` of the rms error is no noise."""

    sensors: float
    """The same of a claim about sensors alone, 0 of any other: where something is left, a sensor imitates it best."""


def to_features(claim: Claim) -> Features:
    """The features of a claim."""
    weight = min(max(claim.frequency, LEAST_WEIGHT), 1 - LEAST_WEIGHT)
    # The true effect leaves nothing, another something: how much of it says little more.
    excess = max(claim.left, 0.0)
    left = excess / (excess + SOME_LEFT)
    is_of_sensors = bool(claim.sites) and all(map(_is_sensor, claim.sites))
    return Features(math.log(weight / (1 - weight)), left, left * is_of_sensors)


def to_probability(depth: Depth, features: Features) -> float:
    """The probability that a claim holds: a logistic function of its features."""
    intercept, *slopes = read_certainty()[int(depth)]
    score = intercept + sum(s * f for s, f in zip(slopes, features, strict=True))
    return 1 / (1 + math.exp(-min(max(score, -30.0), 30.0)))


def to_grade(probability: float) -> Grade:
    """What may be said at a probability."""
    if probability >= ESTABLISHED_FROM:
        return Grade.ESTABLISHED
    return Grade.PROBABLE if probability >= PROBABLE_FROM else Grade.STAND_IN


def name_claim(claims: Sequence[Claim], effect: str) -> Claim | None:
    """What is claimed of one effect by name; None where it is not."""
    return next((c for c in claims if c.depth is Depth.NAME and c.name == effect), None)


def order_of_name(claims: Sequence[Claim], effect: str, occurrence: Occurrence) -> tuple[int, float, float]:
    """Where an effect stands in an answer: what is established first, then what takes most of the error, then what such rigs have."""
    claim = name_claim(claims, effect) or Claim(Depth.NAME, "")
    return list(Grade).index(claim.grade), -claim.share, -occurrence.probability


def deepest_established(claims: Sequence[Claim]) -> Claim | None:
    """The claim that says most of those that are established; of several the one that takes most."""
    established = [c for c in claims if c.is_established and c.depth > Depth.MISSING]
    return max(established, key=lambda c: (c.depth, c.share), default=None)


def place_within_sensor_class(claims: Sequence[Claim]) -> Claim | None:
    """The likeliest place of what is missing, where it is not established only because a sensor there may be off by as much."""
    doubted = [
        c
        for c in claims
        if c.depth is Depth.PLACE
        and not c.is_established
        and c.probability >= ESTABLISHED_FROM
        and _is_within_sensor_class(c)
    ]
    return max(doubted, key=lambda c: c.probability, default=None)


def read_verdict(
    rest: Decision, claims: Sequence[Claim], effects: Sequence[str], rivals: Sequence[Sequence[str]] = ()
) -> Conclusion:
    """The verdict: this is where it is decided what is said.

    Parameters
    ----------
    rest
        Whether the model of the answer leaves only noise (`greybox.discovery.decision.judge_rest`).
    claims
        What is claimed, graded.
    effects
        What the effects of that model are called; none for the plain one.
    rivals
        Sets of effects that the records cannot tell from these.

    Returns
    -------
    Conclusion
        ``complete`` for a plain model that leaves only noise. One with effects is ``named`` only if each of them is established as well.
        Where some are, and the residual is not noise or others are doubtful, it is ``partly``, and so it is where a place, a variable or
        a family is established and no name; where nothing is, ``unknown``. Sets that the records cannot tell apart are ``ambiguous``
        where one of them is probable, and so is a model whose names fall short of certainty by nothing but their equals.
    """
    made = [name_claim(claims, effect) for effect in effects]
    checks = tuple(
        make_check(
            DiscoveryRule.ESTABLISHED,
            0.0 if claim is None else claim.probability,
            ESTABLISHED_FROM,
            claim is not None and claim.is_established,
            effect,
        )
        for effect, claim in zip(effects, made, strict=True)
    )
    established = [check.passed for check in checks]
    if not rest:
        verdict = Verdict.UNKNOWN
    elif not effects:
        verdict = Verdict.COMPLETE
    else:
        verdict = Verdict.AMBIGUOUS if rivals else Verdict.NAMED
    if verdict is Verdict.NAMED and not all(established):
        tied = [c is not None and bool(c.equals) and c.joint >= ESTABLISHED_FROM for c in made]
        certain = [sure or tie for sure, tie in zip(established, tied, strict=True)]
        verdict = Verdict.AMBIGUOUS if all(certain) else Verdict.UNKNOWN
    # Which of several holds is open: their probabilities add up.
    others = {name for rival in rivals for name in rival} - set(effects)
    besides = sum(claim.probability for claim in claims if claim.depth is Depth.NAME and claim.name in others)
    if verdict is Verdict.AMBIGUOUS and any(c is None or c.joint + besides < PROBABLE_FROM for c in made):
        verdict = Verdict.UNKNOWN
    if verdict is Verdict.UNKNOWN and (any(established) or deepest_established(claims) is not None):
        verdict = Verdict.PARTLY
    return Conclusion(verdict, (*rest.checks, *checks))


def list_tied_sets(claims: Sequence[Claim], effects: Sequence[str]) -> list[tuple[str, ...]]:
    """The sets of effects that would do the same as those of a model, with one of them, and what its equal contains, replaced by that."""
    return [
        tuple(other if name == effect else name for name in effects if name == effect or not _are_related(name, other))
        for effect in effects
        if (claim := name_claim(claims, effect)) is not None
        for other in claim.equals
    ]
