"""Sets without a name: what corrects the shape of an answer's effects, something simpler in their place, curves, tones, linear paths.

A model that fits better shows that something was missing, not that it has the right name. Each of these is a set like any other: it is
screened, refitted, stands on the table and has to be beaten there. The best curve or tone of the table is shown where nothing has a name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from greybox.data.closed_loop import find_loops
from greybox.discovery.claims import only_moves_in_time
from greybox.discovery.curve_shape import TIME, CurveShape, Dependence, ShapeKind, rank_dependences
from greybox.discovery.disturbance_sites import DisturbanceSite, SiteKind, list_disturbance_sites, site_label
from greybox.discovery.effect_signal import EffectSignal
from greybox.discovery.execution import RefitJob, SearchStage
from greybox.discovery.linear import EffectPromise
from greybox.discovery.localisation import ResidualLocalisation, ResidualSignal, localise_residual
from greybox.discovery.problem import FittedCandidate, share_values
from greybox.discovery.residual_noise import SECOND_BRANCH, has_memory, is_shape_correction
from greybox.discovery.search import EffectSearch
from greybox.discovery.surrogate_effects import (
    CURVE,
    CurvePlace,
    make_curve_effect,
    make_line_effect,
    make_linear_path,
    make_power_effect,
    make_sinusoid_effect,
    make_tone_effect,
)
from greybox.discovery.table import SetKey, key_of
from greybox.model import Effect, Model
from greybox.model.effects.catalogue import AT, find_placements
from greybox.model.effects.catalogue import effect as catalogue_effect
from greybox.model.effects.scales import within_bounds
from greybox.model.parts import read_parts

# Constants from which an effect is held against a straight line over its variable: an end stop that is never left is a spring...
LINE_CONSTANTS = 2
# ...and from which one without memory is held against a power of it: so many imitate other simple laws.
MANY_CONSTANTS = 3
# Effects of the catalogue that add a constant, at an input and at a balance.
CONSTANTS = ("input_offset", "constant_load", "heat_gain")
# Effects of the catalogue that are a lag, of an input and of a sensor.
LAGS = ("valve_lag", "drive_lag", "sensor_lag")
# Rates at which a linear path begins, between one sample and the whole record.
PATH_RATES = 3
# Iterations of a refit with such paths.
PATH_ITERATIONS = 30


def add_objections(search: EffectSearch, answer: FittedCandidate, signals: Sequence[EffectSignal]) -> bool:
    """The sets that object to an answer, refitted and on the table; ``signals`` are those of its effects."""
    failures, in_question = search.problem.failures, [e for e in answer.model.effects if e.name in answer.effects]
    offers: list[tuple[SearchStage, FittedCandidate, Callable[[], list[Effect]]]] = [
        (SearchStage.SHAPE_CORRECTION, answer, partial(list_shape_corrections, answer, signals))
    ]
    for effect in in_question:
        rest = search.table.without(answer, effect.name)
        if rest is None or is_shape_correction(effect.name):
            continue
        offers += [
            (SearchStage.SHAPE_CORRECTION, rest, partial(_list_simpler, answer, effect, rest, signals)),
            (SearchStage.EVIDENCE, rest, partial(list_constants_in_place, effect, rest)),
        ]
    search.add_in_place(answer)
    offered: list[tuple[FittedCandidate, Effect]] = []
    for stage, base, offer in offers:
        listed: list[Effect] = failures.attempt(stage, answer.effects, offer, [])
        offered += [(base, effect) for effect in listed]
    bases = {id(base): base for base, _ in offered}.values()
    for_each = [(base, [effect for beside, effect in offered if beside is base]) for base in bases]
    search.add_beside((base, promise) for base, effects in for_each for promise in search.promise(base, effects)[1])
    jobs = failures.attempt(SearchStage.EVIDENCE, answer.effects, partial(_plan_linear_paths, search), [])
    planned = [(search.baseline, job) for job in jobs]
    for effect in in_question:
        if only_moves_in_time(effect) and (rest := search.table.without(answer, effect.name)) is not None:
            plan = partial(_plan_lags_elsewhere, search, answer, effect, rest)
            planned += [(rest, job) for job in failures.attempt(SearchStage.EVIDENCE, answer.effects, plan, [])]
    search.add_refits(planned)
    return True


# Is what an effect leaves another effect, or its own shape that the catalogue does not quite have?
#
# A creep with three branches leaves something to a creep with one, and friction that depends on speed something to dry friction: a
# search that only adds effects then gives two or three wrong names. So a further effect has to beat a correction of those that are
# there: a second branch of the same kind, or a smooth curve at the same site over the same variable.

# Intervals of a curve that corrects the shape of an effect, or stands in its place.
CORRECTION_INTERVALS = 10


def list_shape_corrections(answer: FittedCandidate, signals: Sequence[EffectSignal]) -> list[Effect]:
    """Every correction of the shape of one effect of an answer."""
    corrections = []
    for effect in answer.model.effects:
        # A second branch of what has memory and a shape: a spectrum of times in the place of one. As it came from the catalogue: a
        # fitted one would start on top of the first.
        if effect.states and effect.balances and effect.terms and effect.grid:
            corrections.append(replace(effect, name=f"{effect.name}{SECOND_BRANCH}", parents=()))
        signal = next((s for s in signals if s.effect == effect.name), None)
        # What has memory is no function of a variable.
        if signal is not None and not (effect.states or effect.is_of_record):
            corrections.append(_make_curve_of(answer, signal, signal.value - signal.modelled))
    return corrections


def _make_curve_of(base: FittedCandidate, signal: EffectSignal, values: np.ndarray) -> Effect:
    """A curve at the site of an effect's signal over its variable, which begins as the regression of ``values`` (K,)."""
    dependence, site = signal.dependence, _site_of(base, signal)
    return make_curve_effect(site, dependence, signal.variable, values, signal.std, CORRECTION_INTERVALS)


def _site_of(base: FittedCandidate, signal: EffectSignal) -> DisturbanceSite:
    sites = list_disturbance_sites(base.model, [o.name for o in base.model.outputs])
    return next(s for s in sites if s.label == signal.site)


def add_curves_in_place(search: EffectSearch, answer: FittedCandidate, name: str) -> None:
    """Smooth curves in the place of an effect, wherever the records would have one.

    The most that anything without memory could do there, and the dearest objections: for an effect that all others have left standing.
    """
    rest = search.table.without(answer, name)
    if rest is None:
        return
    propose = partial(add_free_forms, search, rest)
    search.problem.failures.attempt(SearchStage.EVIDENCE, rest.effects, propose, None)


# Sites that the sensors cannot separate at which a free curve is tried, and variables that it is tried over at each.
FREE_SITES, FREE_VARIABLES = 3, 2
# Curves over a variable that are refitted beside a set, those that promise most first.
MOST_CURVES = 3
# Intervals of a curve.
CURVE_INTERVALS = 20
# Periods from which a sinusoid is screened, over the one that the signal shows.
PERIOD_STARTS: tuple[float, ...] = (1.0, 0.985, 1.015)


def add_free_forms(search: EffectSearch, base: FittedCandidate) -> None:
    """Curves and tones beside a set, wherever the records would have one; those that promise most are refitted and on the table.

    A curve at each of the likeliest sites of what it leaves, over the likeliest variables and over time, with a sinusoid where the signal
    repeats; a curve where static curves are usual: an input over itself, a sensor over what it shows, a body. The localisation ranks
    sites by a signal that varies slowly, along a linearised run, and does not see a dead zone through a resonance. A tone at every site.
    """
    location = localise_residual(base)
    if location.signal is None or any(map(is_shape_correction, base.effects)):
        return
    sites = list_disturbance_sites(base.model, [o.name for o in base.model.outputs])
    begins = {e.name: float(e.time[0]) for e in base.problem.experiments}
    passed = {TIME: location.signal.time - begins[location.signal.record]}
    signals = {s.site: replace(s, variables={**s.variables, **passed}) for s in location.signals}
    places = [
        CurvePlace(site, d, signals[site.label]) for site, d in _list_curves(base.model, sites, location, signals)
    ]
    forms = [(effect, place) for place in places if place.shows_curve for effect in _make_curves(place)]
    tone = location.dependences[0].tone if location.dependences else None
    if tone is not None:
        for site in sites:
            if (signal := signals.get(site.label)) is not None:
                effect = make_tone_effect(site, signal, begins[signal.record], tone)
                forms.append((effect, CurvePlace(site, location.dependences[0], signal)))
    place_of = {id(effect): place for effect, place in forms}
    chosen: dict[SetKey, EffectPromise] = {}
    for promise in search.promise(base, [effect for effect, _ in forms])[1]:
        effect, place = promise.effect, place_of[id(promise.effect)]
        key = key_of(base) | {(effect.name, effect.site, effect.equation)}
        is_static = effect.name == CURVE and place.dependence.variable != TIME
        kinds = [search.places[k].site.kind for k in chosen if search.places[k].dependence.variable != TIME]
        # The best at an input, at a balance and at a sensor each: what a step promises in the records says little beyond their range.
        full = len(kinds) >= MOST_CURVES and place.site.kind in kinds
        if key not in search.places and not (is_static and full):
            search.places[key], chosen[key] = place, promise
    search.add_beside((base, promise) for promise in chosen.values())


def _list_curves(
    model: Model,
    sites: Sequence[DisturbanceSite],
    location: ResidualLocalisation,
    signals: dict[str, ResidualSignal],
) -> Iterator[tuple[DisturbanceSite, Dependence]]:
    """Where a curve may stand, and the variable that it is over."""
    # Sites at which the same signal reaches the sensors have the same gain: there a curve is the same in another unit.
    gains = {site.label: site.gain for site in location.sites}
    likeliest = [label for label in location.sets[0] if label in signals][:FREE_SITES]
    likeliest = [
        label for k, label in enumerate(likeliest) if gains[label] not in [gains[one] for one in likeliest[:k]]
    ]
    for site in sites:
        signal = signals.get(site.label)
        if signal is None:
            continue
        usual, listed = _usual_variables(model, site), 0
        shown = signal.units.keys() if site.label in likeliest else usual
        variables = {name: (z, signal.units[name]) for name, z in signal.variables.items() if name in shown}
        for d in rank_dependences(signal.time, signal.value, variables):
            at_input = site_label(SiteKind.INPUT, d.variable)
            # What the sensors cannot tell from a curve of an input over itself is that.
            if d.variable == TIME or (
                at_input != site.label and at_input in gains and gains[at_input] == gains[site.label]
            ):
                continue
            if site.label in likeliest and listed < FREE_VARIABLES:
                listed += 1
                yield site, d
            elif d.variable in usual:
                yield site, replace(d, period=None)
        # Time is no matter of the site: what drifts at one drifts at another that the sensors cannot tell from it.
        if site.label == likeliest[0]:
            none = np.zeros(0)
            yield site, Dependence(TIME, "s", 0.0, CurveShape(ShapeKind.TOO_FEW_VALUES), 0.0, None, none, none, none)


def _usual_variables(model: Model, site: DisturbanceSite) -> list[str]:
    """Names of the states or the input of which a static effect at ``site`` is usually a function."""
    if site.kind is SiteKind.INPUT:
        return [site.name]
    if site.kind is SiteKind.SENSOR:
        equation = model.system.outputs[site.column]
        return [equation.name()] if equation.is_symbolic() else []
    states = next((s.states for s in model.sites if s.name == site.name), {})
    motion = [states.get(role, "") for role in ("velocity", "displacement")]
    return list(dict.fromkeys(name for name in (model.system.state_names[site.column], *motion) if name))


def _make_curves(place: CurvePlace) -> list[Effect]:
    """The curve at a place; of one that repeats sinusoids of nearly the period that its signal shows."""
    site, d, signal = place.site, place.dependence, place.signal
    z = signal.variables[d.variable]
    if d.period is None:
        return [make_curve_effect(site, d, z, signal.value, signal.std, CURVE_INTERVALS)]
    return [make_sinusoid_effect(site, d, share * d.period, z, signal.value) for share in PERIOD_STARTS]


def _list_simpler(
    answer: FittedCandidate, effect: Effect, rest: FittedCandidate, signals: Sequence[EffectSignal]
) -> list[Effect]:
    """Something simpler in the place of an effect: where that does as well, the records do not show what the effect has beyond it.

    For an effect of several constants a straight line over its variable, for one of many a power of it; for an effect with memory also a
    smooth curve without one. Nothing for all others.
    """
    signal = next((s for s in signals if s.effect == effect.name), None)
    if signal is None:
        return []
    names = answer.model.names_of(effect.name)
    free = sum(not answer.model.parameter(names[q.name]).fixed for q in effect.parameters)
    place = _site_of(rest, signal), signal.dependence, signal.variable, signal.value
    simpler = [make_line_effect(*place)] if free >= LINE_CONSTANTS else []
    if has_memory(effect):
        return [*simpler, _make_curve_of(rest, signal, signal.value)]
    return [*simpler, make_power_effect(*place)] if free >= MANY_CONSTANTS else simpler


def list_constants_in_place(effect: Effect, rest: FittedCandidate) -> list[Effect]:
    """A constant in the place of an effect, without a name: it does as well where the motion never leaves one branch of the effect.

    An input that never changes its sign shows an offset of a dead zone, not the zone.
    """
    if effect.name.partition(AT)[0] in CONSTANTS:
        return []
    placements = find_placements(rest.model, tuple(map(catalogue_effect, CONSTANTS)))
    # The plant may have no place for it. At whatever site, it has no name.
    places = [p.effect for p in placements if p.effect is not None and p.site not in rest.model.auxiliary]
    return [replace(constant, name=CURVE) for constant in places]


def _plan_lags_elsewhere(
    search: EffectSearch, answer: FittedCandidate, effect: Effect, rest: FittedCandidate
) -> list[RefitJob]:
    """A lag at every other input and sensor in the place of an effect that only moves a signal in time, without a name.

    From an input to a reading of a linear plant, a lag does the same at either end.
    """
    parts, listed = read_parts(search.problem.model), {e.name for e in search.candidates}
    names, jobs = answer.model.names_of(effect.name), []
    seconds = next((answer.model.values[names[q.name]] for q in effect.parameters), search.scales.period)
    site = next(b.site for b in answer.model.bound_effects if b.effect.name == effect.name)
    for place in find_placements(rest.model, tuple(map(catalogue_effect, LAGS))):
        # One that is a candidate is on the table by its name, and what the rig cannot have objects to nothing.
        if place.effect is None or place.site == site or place.effect.name in listed or parts.missing(place.effect):
            continue
        model = rest.model + replace(place.effect, name=CURVE)
        lag = model.names_of(CURVE)[place.effect.parameters[0].name]
        start = {**share_values(answer.model, model), lag: within_bounds(model, lag, seconds)}
        jobs.append(search.problem.plan_refit(model, [start], 1, like=answer, refines=False))
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
    return [problem.plan_refit(model, starts, PATH_RATES, PATH_ITERATIONS, plain, refines=False)]
