"""Among sets of effects that do equally well, the one that rigs with such parts usually have; and the question that parts them.

On a measured rig no model is complete: strange effects with memory follow whatever is left, and no record refuses them. So where the
records do not decide, how often rigs have an effect does (`greybox.model.parts`): the family at a place first, then its member. That orders
names and never lifts a grade. What nobody has said of the rig, and would turn the order, is asked.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.base.values import Finding
from greybox.discovery.candidates import family_of
from greybox.discovery.claims import LEAST_SHARE, Weights
from greybox.discovery.decision import Grade
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.laws.terms import claimed_name
from greybox.discovery.problem import FittedCandidate
from greybox.discovery.residual_noise import is_shape_correction
from greybox.discovery.table import NEAR_RATIO, Draws, draw_sets
from greybox.model import Model
from greybox.model.effects.catalogue import AT, all_effects
from greybox.model.parts import PARTS, RigParts, read_parts


def weigh_set(model: Model, given: Collection[str], parts: RigParts) -> float:
    """How usual the effects of a model are on a rig with these parts, in nats of log odds: 0 for none, -inf for one that it cannot have.

    ``given`` are the effects of the user's own model.
    """
    weight = 0.0
    for bound in model.bound_effects:
        effect = bound.effect
        if effect.name in given or is_shape_correction(effect.name):
            continue
        if parts.missing(effect):
            return -math.inf
        probability, base = parts.occurrence(effect).probability, effect.name.partition(AT)[0]
        family = set(family_of(base)) - {base}
        others = [parts.occurrence(e).probability for e in all_effects() if e.name in family and not parts.missing(e)]
        # One or more of the family at this place; then which of them. What is as likely as not costs nothing.
        any_of_them = 1 - (1 - probability) * math.prod(1 - p for p in others)
        weight += min(math.log(any_of_them / (1 - any_of_them)), 0.0) + math.log(
            probability / (probability + sum(others))
        )
    return weight


@dataclass(frozen=True)
class Preference:
    """What such rigs usually have, beside what the records alone say.

    Parameters
    ----------
    candidate
        The set that comes first.
    finding
        What the records alone say, and what the weights make of it; None where both say the same.
    question
        The part that nobody has spoken of, and on which it hangs what comes first; None where none does.
    """

    candidate: FittedCandidate
    finding: Finding | None
    question: Finding | None


# Share of the resamples in which a set is within two standard errors of the best, from which it does equally well.
EQUAL_SHARE = 0.5
# Where more than noise is left whatever is tried, a set that takes so much of what the best of all takes does equally well: the rest is
# of a form that nobody has. On measured rigs the right usual sets take 0.67 to 0.99 of it, eight of nine 0.84 or more; of what is usual
# and wrong a lower share lets in more. On simulated cases that end without a certain name the right one keeps its place.
ENOUGH = 0.8
# The classes are good to a factor of two: weights closer than that (in nats) are alike, and the records decide.
SAME_WEIGHT = math.log(2)
# Odds that are said at most: a judgement on counts carries no more.
MOST_ODDS = 100.0


def prefer_usual(
    draws: Draws,
    answer: FittedCandidate,
    plain: Model,
    grades: Mapping[str, Grade],
    is_open: bool,
    refused: Collection[tuple[str, ...]] = (),
) -> Preference | None:
    """Among the sets that do equally well the usual one, and the question that would turn that; None where nothing is to be chosen.

    Parameters
    ----------
    draws
        What resampling says of the table, the plain model on it.
    answer
        The set that won by the records alone.
    plain
        The plain model: it says what the rig has.
    grades
        Name -> its grade by the records. What is established or probable stays in the answer.
    is_open
        Whether more than noise may be left whatever is tried: the level of the noise is not known, or the set that won leaves more.
    refused
        Names of sets that do not hold on the records that judge.
    """
    order = _Order(draws, answer, plain, grades, is_open, refused)
    equal = order.equal
    if not equal:
        return None
    parts = read_parts(plain)
    chosen = order.choose(equal, parts)
    if chosen is None:
        return None
    candidate = draws.sets[chosen].candidate
    finding = None
    if candidate.names != answer.names:
        finding = order.compare(chosen, parts)
    return Preference(candidate, finding, order.ask(equal, parts))


@dataclass(frozen=True, eq=False)
class _Order:
    """A table as it is ordered by what is usual."""

    draws: Draws
    answer: FittedCandidate
    plain: Model
    grades: Mapping[str, Grade]
    is_open: bool
    refused: Collection[tuple[str, ...]]

    @property
    def shares(self) -> np.ndarray:
        """Share of the plain model's error that each set takes, out of bag, all outputs together (S,)."""
        errors, plain = self.draws.errors, [k for k, s in enumerate(self.draws.sets) if not s.candidate.effects]
        # A plain model whose run goes astray is at least as wrong as the worst of the others.
        reference = errors[:, plain[:1]] if plain else errors.max(axis=1, keepdims=True)
        return np.asarray(1 - np.exp(np.median(errors - reference, axis=0)))

    @property
    def equal(self) -> list[int]:
        """The sets that do equally well: every effect with a name of the catalogue, and all that is probable of the answer among them."""
        sets, shares = [s.candidate for s in self.draws.sets], self.shares
        named = [
            k
            for k, c in enumerate(sets)
            if c.effects and not c.laws and c.names not in self.refused and not any(map(is_shape_correction, c.effects))
        ]
        # What takes hardly anything is no answer to what is missing.
        kept = self._kept
        named = [k for k in named if kept <= set(sets[k].names) and shares[k] >= LEAST_SHARE]
        good, best = self.draws.good.mean(axis=0), max((shares[k] for k in named), default=0.0)
        winner = next((k for k in named if sets[k].names == self.answer.names), None)

        def does_equally_well(k: int) -> bool:
            if good[k] >= EQUAL_SHARE or k == winner:
                return True
            # What takes less than the set that won is its equal with no more constants only.
            is_simple = winner is None or shares[k] >= shares[winner] or sets[k].free <= sets[winner].free
            # What leaves twice as much as the best shows something that a better one explains.
            is_near = ENOUGH * best <= shares[k] and 1 - shares[k] <= NEAR_RATIO * (1 - best)
            return self.is_open and is_simple and bool(is_near)

        return [k for k in named if does_equally_well(k)]

    @property
    def _kept(self) -> set[str]:
        """Names that stay: those with more than even odds by the records, but what is only probable and rare with a part that was told."""
        parts = read_parts(self.plain).told
        effects = {claimed_name(e): e for e in self.answer.model.effects}
        grades = {name: self.grades.get(name, Grade.STAND_IN) for name in self.answer.names}
        return {
            name
            for name, grade in grades.items()
            if grade is Grade.ESTABLISHED or (grade is Grade.PROBABLE and not parts.speak_against(effects[name]))
        }

    def choose(self, equal: Sequence[int], parts: RigParts) -> int | None:
        """Of the most usual sets the one that wins most often among themselves; None where the rig can have none of them."""
        weights = {k: self._weigh(k, parts) for k in equal}
        most = max(weights.values())
        if math.isinf(most):
            return None
        alike = [k for k in equal if weights[k] >= most - SAME_WEIGHT]
        if len(alike) == 1:
            return alike[0]
        drawn = draw_sets([self.draws.sets[k] for k in alike])
        leading = drawn.sets[Weights.of(drawn).leading] if drawn.sets else self.draws.sets[alike[0]]
        return next(k for k in alike if self.draws.sets[k] is leading)

    def _weigh(self, k: int, parts: RigParts) -> float:
        candidate = self.draws.sets[k].candidate
        return weigh_set(candidate.model, candidate.given, parts)

    def compare(self, chosen: int, parts: RigParts) -> Finding:
        """What the records alone say, and what is usual."""
        shares, candidates = self.shares, [s.candidate for s in self.draws.sets]
        winners = [k for k, c in enumerate(candidates) if c.names == self.answer.names]
        best = max(self.equal, key=lambda k: shares[k])
        first = winners[0] if winners else best
        others = [best] if candidates[best].names not in (candidates[first].names, candidates[chosen].names) else []
        odds = min(math.exp(self._weigh(chosen, parts) - self._weigh(first, parts)), MOST_ODDS)
        values = {
            "by_records": [" + ".join(candidates[k].names) for k in (first, *others)],
            "odds": odds,
            "share": float(shares[chosen]),
            "best_share": float(shares[best]),
            "best": " + ".join(candidates[best].names),
        }
        return Finding(DiscoveryCode.USUAL_FIRST, subject=" + ".join(candidates[chosen].names), values=values)

    def ask(self, equal: Sequence[int], parts: RigParts) -> Finding | None:
        """The question whose two answers lead to the likeliest two names; None where no part that is open turns what comes first."""
        effects = [bound.effect for k in equal for bound in self.draws.sets[k].candidate.model.bound_effects]
        # First of parts without which a set is impossible, then of those that make one likelier.
        needed, helpful = {name for e in effects for name in e.needs}, {name for e in effects for name in e.occurs_with}
        return self._ask_of(needed, equal, parts) or self._ask_of(helpful - needed, equal, parts)

    def _ask_of(self, names: Collection[str], equal: Sequence[int], parts: RigParts) -> Finding | None:
        asked: list[tuple[float, str, int, int]] = []
        for part in (p.name for p in PARTS if p.name in names and parts.is_open(p.name)):
            answers = [read_parts(self.plain.with_parts(**{key: [part]})) for key in ("has", "lacks")]
            yes, no = (self.choose(equal, each) for each in answers)
            if yes is None or no is None or yes == no:
                continue
            weight = self._weigh(yes, answers[0]) + self._weigh(no, answers[1])
            asked.append((weight, part, yes, no))
        if not asked:
            return None
        _, part, yes, no = max(asked, key=lambda each: each[0])
        values = {key: " + ".join(self.draws.sets[k].candidate.names) for key, k in (("yes", yes), ("no", no))}
        return Finding(DiscoveryCode.ASK_PART, subject=part, values=values)
