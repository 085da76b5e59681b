"""Sets without a name that object to an answer: what corrects the shape of its effects, something simpler in their place, linear paths.

A model that fits better shows that something was missing, not that it has the right name. Each of these is a set like any other: it is
refitted, stands on the table and has to be beaten there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from greybox.data.closed_loop import find_loops
from greybox.discovery.candidates import generate_starting_points
from greybox.discovery.effect_signal import EffectSignal
from greybox.discovery.execution import RefitJob, SearchStage
from greybox.discovery.localisation import localise_residual
from greybox.discovery.problem import FittedCandidate
from greybox.discovery.residual_noise import (
    has_memory,
    is_shape_correction,
    list_shape_corrections,
    prepare_curve,
    prepare_power,
)
from greybox.discovery.search import HOPELESS_COST, EffectSearch
from greybox.discovery.surrogate import QUICK_ITERATIONS, refit_free_curves
from greybox.discovery.surrogate_effects import CURVE, make_linear_path
from greybox.model import Effect
from greybox.model.effects.catalogue import AT, find_placements
from greybox.model.effects.catalogue import effect as catalogue_effect
from greybox.model.effects.scales import AMPLITUDE_GRID

# Iterations of these refits; they start near where they end.
OBJECTION_ITERATIONS = 30
# Constants from which an effect without memory is held against a power of its variable: so many imitate other simple laws.
MANY_CONSTANTS = 3
# Effects of the catalogue that add a constant, at an input and at a balance.
CONSTANTS = ("input_offset", "constant_load")
# Rates at which a linear path begins, between one sample and the whole record.
PATH_RATES = 3


def add_objections(search: EffectSearch, answer: FittedCandidate, signals: Sequence[EffectSignal]) -> int:
    """The sets that object to an answer, refitted and on the table, and how many they are; ``signals`` are those of its effects."""
    problem, failures = search.problem, search.problem.failures
    corrections = partial(list_shape_corrections, problem, answer, search.scales)
    listed = failures.attempt(SearchStage.SHAPE_CORRECTION, answer.effects, corrections, [])
    jobs: list[RefitJob] = [job for _, job in listed]
    jobs += failures.attempt(SearchStage.EVIDENCE, answer.effects, partial(_plan_linear_paths, search), [])
    for effect in answer.model.effects:
        if effect.name not in answer.effects or is_shape_correction(effect.name):
            continue
        rest = search.table.get(set(answer.effects) - {effect.name})
        if rest is None:
            continue
        plans = (
            (SearchStage.SHAPE_CORRECTION, partial(_plan_simpler, answer, effect, rest, signals)),
            (SearchStage.EVIDENCE, partial(_plan_constants, search, effect, rest)),
        )
        for stage, plan in plans:
            jobs += failures.attempt(stage, answer.effects, plan, [])
    for fit in problem.refit_all(jobs):
        if fit is None:
            continue
        search.table.add(fit)
        if fit.cost <= HOPELESS_COST * answer.cost:
            search.table.add(problem.converge(fit, OBJECTION_ITERATIONS))
    return len(jobs)


def add_curves_in_place(search: EffectSearch, answer: FittedCandidate, name: str) -> None:
    """Smooth curves in the place of an effect, wherever the records would have one.

    The most that anything without memory could do there, and the dearest objections: for an effect that all others have left standing.
    """
    rest = search.table.get(set(answer.effects) - {name})
    if rest is None:
        return

    def refit() -> list[FittedCandidate]:
        return refit_free_curves(search.problem, rest, localise_residual(rest), answer.cost)

    curves: list[FittedCandidate] = search.problem.failures.attempt(SearchStage.EVIDENCE, rest.effects, refit, [])
    search.table.add(*curves)


def _plan_simpler(
    answer: FittedCandidate, effect: Effect, rest: FittedCandidate, signals: Sequence[EffectSignal]
) -> list[RefitJob]:
    """Something simpler in the place of an effect: where that does as well, the records do not show what the effect has beyond it.

    For an effect with memory a smooth curve without one, for one of many constants a power of its variable; nothing for all others.
    """
    signal = next((s for s in signals if s.effect == effect.name), None)
    if signal is None:
        return []
    names = answer.model.names_of(effect.name)
    free = sum(not answer.model.parameter(names[q.name]).fixed for q in effect.parameters)
    if has_memory(effect):
        return [prepare_curve(rest, signal)]
    return [prepare_power(answer, rest, signal)] if free >= MANY_CONSTANTS else []


def _plan_constants(search: EffectSearch, effect: Effect, rest: FittedCandidate) -> list[RefitJob]:
    """A constant in the place of an effect, without a name: it does as well where the motion never leaves one branch of the effect.

    An input that never changes its sign shows an offset of a dead zone, not the zone.
    """
    if effect.name.partition(AT)[0] in CONSTANTS:
        return []
    jobs = []
    nameless = tuple(replace(catalogue_effect(name), name=CURVE) for name in CONSTANTS)
    for placement in find_placements(rest.model, nameless):
        constant = placement.effect
        if constant is None or placement.site in rest.model.auxiliary:  # the plant has no place for it
            continue
        model = rest.model + constant
        amplitudes = AMPLITUDE_GRID
        grid = generate_starting_points(model, constant, rest, rest.model, search.scales, amplitudes)
        jobs.append(search.problem.plan_refit(model, [model.values, *grid], 1, QUICK_ITERATIONS, rest, refines=False))
    return jobs


def _plan_linear_paths(search: EffectSearch) -> list[RefitJob]:
    """In a loop, linear dynamics of no name from the inputs that answer the readings to every reading, beside the plain model.

    There what disturbs the plant is in its input, and passes for an answer to it: what does no better than any linear path from that
    input shows no name and no place.
    """
    problem, plain, scales = search.problem, search.baseline, search.scales
    loops = {loop.subject for e in problem.experiments for loop in find_loops(e.inputs, e.outputs)}
    answering = [i for i in plain.model.inputs if i.name in loops]
    if not answering:
        return []
    paths = [make_linear_path(o, answering) for o in plain.model.outputs if o.name in problem.noise_std]
    model = plain.model
    for path in paths:
        model = model + path
    rates = np.geomspace(1 / scales.duration, 1 / scales.period, PATH_RATES + 2)[1:-1]
    of_rate = [model.names_of(path.name)["a"] for path in paths]
    starts = [{**plain.model.values, **dict.fromkeys(of_rate, float(rate))} for rate in rates]
    return [problem.plan_refit(model, starts, PATH_RATES, OBJECTION_ITERATIONS, plain, refines=False)]
