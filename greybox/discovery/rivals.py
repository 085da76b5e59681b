"""Every objection to an answer is a rival model: refitted, it stands on the table beside the answer and has to be beaten there.

A model that fits better shows that something was missing, not that it has the right name. So each effect of the answer is held against
the model without it, against the best effects of other families in its place, against something simpler in its place, against itself with
a curve (or a second branch) beside it, and against a free curve wherever the records would have one. Nothing is decided here: every refit
is kept with the problem (`DiscoveryProblem.fitted`), and `greybox.discovery.table` says which of them wins.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from greybox.data.closed_loop import find_loops
from greybox.discovery.candidates import family_of
from greybox.discovery.effect_signal import EffectSignal
from greybox.discovery.execution import SearchStage
from greybox.discovery.localisation import localise_residual
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate
from greybox.discovery.residual_noise import (
    has_memory,
    is_shape_correction,
    list_shape_corrections,
    prepare_curve,
    prepare_power,
)
from greybox.discovery.selection import HOPELESS_COST, list_extension_starts, rank_extensions
from greybox.discovery.surrogate import QUICK_ITERATIONS, refit_free_curves
from greybox.discovery.surrogate_effects import CURVE, make_linear_path
from greybox.model.effect import Effect
from greybox.model.effects.catalogue import effect as catalogue_effect
from greybox.model.effects.placement import AT, find_placements
from greybox.model.effects.scales import Scales


@dataclass(frozen=True)
class RivalSearch:
    """What the rivals of an answer are fitted from.

    Parameters
    ----------
    problem, scales, candidates
        The records, their peaks and times, and all effects that are candidates.
    selected, baseline
        The answer and the plain model.
    known
        Fits of other sets of effects.
    signals
        The signal of each effect of the answer, from the data and from the model.
    """

    problem: DiscoveryProblem
    scales: Scales
    candidates: Sequence[Effect]
    selected: FittedCandidate
    baseline: FittedCandidate
    known: Mapping[frozenset[str], FittedCandidate]
    signals: Sequence[EffectSignal]

    def attempt(self, run: partial[FittedCandidate | None]) -> FittedCandidate | None:
        """A refit; None where it fails, with the reason kept."""
        return self.problem.failures.attempt(SearchStage.EVIDENCE, self.selected.effects, run, None)


def refit_rivals(search: RivalSearch) -> dict[str, FittedCandidate]:
    """The rivals of each effect of the answer; by effect, the answer without it, where that can be fitted."""
    problem, selected = search.problem, search.selected
    listing = partial(list_shape_corrections, problem, selected, search.scales)
    jobs = problem.failures.attempt(SearchStage.SHAPE_CORRECTION, selected.effects, listing, [])
    problem.refit_all([job for _, job in jobs])
    _refit_linear_paths(search)
    without: dict[str, FittedCandidate] = {}
    for effect in selected.model.effects:
        if effect.name not in selected.effects or is_shape_correction(effect.name):
            continue
        rest = _refit_without(search, effect.name)
        if rest is not None:
            without[effect.name] = rest
            _refit_others(search, effect.name, rest)
            _refit_simpler(search, effect, rest)
            _refit_constant(search, effect, rest)
    return without


def refit_curves_in_place(search: RivalSearch, rest: FittedCandidate) -> None:
    """Smooth curves in the place of an effect, wherever the records would have one; ``rest`` is the answer without the effect.

    The most that anything without memory could do there, and the dearest rivals: for an effect that all others have left standing.
    """

    def refit() -> None:
        refit_free_curves(search.problem, rest, localise_residual(rest), search.selected.cost)

    search.problem.failures.attempt(SearchStage.EVIDENCE, rest.effects, refit, None)


# Iterations of these refits; they start near where they end.
RIVAL_ITERATIONS = 30


def _refit_without(search: RivalSearch, name: str) -> FittedCandidate | None:
    """The selected model without one effect, everything else refitted."""
    selected = search.selected
    if len(selected.effects) == 1:
        return search.baseline
    known = search.known.get(frozenset(selected.effects) - {name})
    again = search.attempt(partial(search.problem.refit_without, selected, name, 1, RIVAL_ITERATIONS, refines=False))
    if again is not None and _is_hopeful(search, again):
        again = search.problem.converge(again, RIVAL_ITERATIONS)
    return min((fit for fit in (known, again) if fit is not None), key=lambda fit: fit.cost, default=None)


# Effects of other families that are fitted in the place of each effect.
MOST_RIVALS = 4


def _refit_others(search: RivalSearch, name: str, rest: FittedCandidate) -> None:
    """The best effects of other families in the place of one, to the end where they may still come near."""
    selected = search.selected
    kept, family = frozenset(selected.effects) - {name}, set(family_of(name, search.candidates))
    sets = {
        key: fit for key, fit in search.known.items() if len(key) == len(kept) + 1 and kept < key and name not in key
    }
    near = sorted((fit for key, fit in sets.items() if not key - kept & family), key=lambda fit: fit.cost)[:MOST_RIVALS]
    if len(near) < MOST_RIVALS:
        others = [(rest, e) for e in search.candidates if e.name not in family | set(selected.effects)]
        for _, e in rank_extensions(search.problem, others, search.scales, MOST_RIVALS):
            starts = list_extension_starts(rest, e, search.scales)
            refit = partial(search.problem.refit_best, rest.model + e, starts, 1, QUICK_ITERATIONS, rest, refines=False)
            near += [fit for fit in [search.attempt(refit)] if fit is not None]
    for fit in near:
        if _is_hopeful(search, fit):
            search.problem.converge(fit, RIVAL_ITERATIONS)


def _is_hopeful(search: RivalSearch, fit: FittedCandidate) -> bool:
    """Whether a model that was fitted with the step it started with may still come near the answer."""
    return fit.cost <= HOPELESS_COST * search.selected.cost


# Constants from which an effect without memory is held against a power of its variable: so many imitate other simple laws.
MANY_CONSTANTS = 3


def _refit_simpler(search: RivalSearch, effect: Effect, rest: FittedCandidate) -> None:
    """Something simpler in the place of an effect: where that does as well, the records do not show what the effect has beyond it.

    For an effect with memory a smooth curve without one, for one of many constants a power of its variable; nothing for all others.
    """
    signal = next((s for s in search.signals if s.effect == effect.name), None)
    if signal is None:
        return
    if has_memory(effect):
        prepare = partial(prepare_curve, rest, signal)
    elif _count_free(search.selected, effect) >= MANY_CONSTANTS:
        prepare = partial(prepare_power, search.selected, rest, signal)
    else:
        return
    job = search.problem.failures.attempt(SearchStage.SHAPE_CORRECTION, search.selected.effects, prepare, None)
    search.problem.refit_all([] if job is None else [job])


# Effects of the catalogue that add a constant, at an input and at a balance.
CONSTANTS = ("input_offset", "constant_load")


def _refit_constant(search: RivalSearch, effect: Effect, rest: FittedCandidate) -> None:
    """A constant in the place of an effect, without a name: it does as well where the motion never leaves one branch of the effect.

    An input that never changes its sign shows an offset of a dead zone, not the zone.
    """
    if effect.name.partition(AT)[0] in CONSTANTS:
        return
    nameless = tuple(replace(catalogue_effect(name), name=CURVE) for name in CONSTANTS)
    for placement in find_placements(rest.model, nameless):
        constant = placement.effect
        if constant is None or placement.site in rest.model.auxiliary:  # the plant has no place for it
            continue
        starts = list_extension_starts(rest, constant, search.scales)
        refit = partial(
            search.problem.refit_best, rest.model + constant, starts, 1, QUICK_ITERATIONS, rest, refines=False
        )
        quick = search.attempt(refit)
        if quick is not None and _is_hopeful(search, quick):
            search.problem.converge(quick, RIVAL_ITERATIONS)


# Rates at which a linear path begins, between one sample and the whole record.
PATH_RATES = 3


def _refit_linear_paths(search: RivalSearch) -> None:
    """In a loop, linear dynamics of no name from the inputs that answer the readings to every reading, beside the plain model.

    There what disturbs the plant is in its input, and passes for an answer to it: what does no better than any linear path from that
    input shows no name and no place.
    """
    problem, plain, scales = search.problem, search.baseline, search.scales
    loops = {loop.subject for e in problem.experiments for loop in find_loops(e.inputs, e.outputs)}
    answering = [i for i in plain.model.inputs if i.name in loops]
    if not answering:
        return
    paths = [make_linear_path(o, answering) for o in plain.model.outputs if o.name in problem.noise_std]
    model = plain.model
    for path in paths:
        model = model + path
    rates = np.geomspace(1 / scales.duration, 1 / scales.period, PATH_RATES + 2)[1:-1]
    of_rate = [model.names_of(path.name)["a"] for path in paths]
    starts = [{**plain.model.values, **dict.fromkeys(of_rate, float(rate))} for rate in rates]
    quick = search.attempt(
        partial(problem.refit_best, model, starts, PATH_RATES, RIVAL_ITERATIONS, plain, refines=False)
    )
    if quick is not None and _is_hopeful(search, quick):
        problem.converge(quick, RIVAL_ITERATIONS)


def _count_free(candidate: FittedCandidate, effect: Effect) -> int:
    """How many constants of an effect are not fixed."""
    names = candidate.model.names_of(effect.name)
    return sum(not candidate.model.parameter(names[q.name]).fixed for q in effect.parameters)
