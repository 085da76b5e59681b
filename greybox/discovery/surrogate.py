"""What the catalogue does not explain: a fitted curve, or a tone, in the place of the unknown effect."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from greybox.base.numerics import TINY
from greybox.base.values import Printable, ReadOnly
from greybox.discovery.answer import SearchAnswer
from greybox.discovery.claims import LEAST_SHARE, Weights
from greybox.discovery.curve_shape import TIME, CurveShape, Dependence, ShapeKind, classify_shape
from greybox.discovery.disturbance_sites import DisturbanceSite, SiteKind
from greybox.discovery.holdout import (
    PARTIAL_SHARE,
    HoldoutError,
    RefitComparison,
    ValidationSet,
    compare_holdout_errors,
    finish_fit,
    validate_candidate,
    worst_output,
)
from greybox.discovery.localisation import ResidualLocalisation, ResidualSignal
from greybox.discovery.problem import MAX_SUBSTEPS, FittedCandidate
from greybox.discovery.proposers import add_free_forms
from greybox.discovery.search import EffectSearch
from greybox.discovery.surrogate_effects import CURVE, TONE, CurvePlace, evaluate_curve, levels_of
from greybox.discovery.table import BlockSums, FittedSet, draw_sets, key_of
from greybox.estimation.result import Fit
from greybox.estimation.validate import FIRST_ROWS, validate


@dataclass(frozen=True)
class SurrogateTone:
    """A sinusoid from outside.

    Parameters
    ----------
    frequency, std
        In Hz, and its standard deviation (None: not known).
    amplitude
        By record.
    beginning
        Seconds of each validation record from which amplitude and phase are estimated there.
    alike
        Labels of sites at which it would explain the records as well.
    """

    frequency: float
    std: float | None
    amplitude: Mapping[str, float]
    beginning: float
    alike: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Surrogate(Printable, ReadOnly):
    """What was fitted in the place of an unknown effect: a curve over a variable, or a tone in time.

    A straight line is shared with the model's own parameters (a damper, a spring) in a way that no data decide: the ``curve`` has the
    one that the signal has.

    Parameters
    ----------
    site, unit
        Label of the site, and unit of the signal there.
    fit
        The extended model with it as an effect.
    holdout
        Error on the validation records by output.
    values, curve
        The variable and the curve (M,).
    signal
        The unexplained signal that it was fitted to.
    dependence
        The signal as a function of the variable.
    shape
        What the curve looks like.
    tone
        The tone; None for a curve.
    amplitude
        Of a sinusoid over the variable, in ``unit``; None for others.
    finished
        What another fit that begins at ``fit`` would change; None where that was not tried.
    """

    site: str
    unit: str
    fit: Fit
    holdout: Mapping[str, HoldoutError]
    values: np.ndarray
    curve: np.ndarray
    signal: ResidualSignal
    dependence: Dependence
    shape: CurveShape
    tone: SurrogateTone | None = None
    amplitude: float | None = None
    finished: RefitComparison | None = None

    KEYS: ClassVar[str] = """
        site variable variable_unit unit closed=share shape=shape.kind parity=shape.parity downwards=shape.downwards
        position=shape.position period=dependence.period amplitude tone beside levels gap=holdout values curve
        """

    @property
    def variable(self) -> str:
        """Name of the state or input that the curve is over, or ``time``."""
        return self.dependence.variable

    @property
    def variable_unit(self) -> str:
        """Unit of the variable."""
        return self.dependence.unit

    @property
    def explained_fraction(self) -> float:
        """Share of the gap that it explains, in the output that the plain model misses most."""
        return self.holdout[worst_output(self.holdout)].explained_fraction

    @property
    def share(self) -> float:
        """Share of the error that it takes away on the validation records, in the output that the plain model misses most."""
        return self.holdout[worst_output(self.holdout)].share

    @property
    def beside(self) -> tuple[str, ...]:
        """Effects of the catalogue that the model has beside it."""
        return tuple(e.name for e in self.fit.model.effects if e.name not in (CURVE, TONE))

    @property
    def measured(self) -> np.ndarray:
        """The values (K,) of the variable along the signal."""
        return self.signal.time if self.variable == TIME else self.signal.variables[self.variable]

    @property
    def levels(self) -> int | None:
        """How many levels of the variable were seen, where these are so few that the curve is known at them only."""
        names = self.fit.model.names_of(CURVE) if CURVE in {e.name for e in self.fit.model.effects} else {}
        seen = levels_of({n: self.fit.model.values[in_model] for n, in_model in names.items()})
        return None if seen is None else len(seen)


def find_missing_sites(location: ResidualLocalisation, surrogate: Surrogate | None) -> tuple[str, ...]:
    """Labels of the sites where something may be missing: of the curve that explains the larger part of the gap, or the likeliest ones."""
    if surrogate is None or surrogate.tone is not None or surrogate.beside or surrogate.site in location.likeliest:
        return location.likeliest
    return (surrogate.site,) if surrogate.explained_fraction >= PARTIAL_SHARE else location.likeliest


# Share of the gap on validation records that a curve must explain to be shown.
USEFUL_SHARE = 0.1


def fit_stand_in(answer: SearchAnswer) -> Surrogate | None:
    """The best curve or tone of the table for all that the plain model lacks.

    Where that is not enough, and the nearest look-alike explains the larger part, one for what this leaves, if the two together do
    clearly better. None that explains less than the look-alike, and none that is hardly worth mentioning.
    """
    search, nearest = answer.search, answer.candidate
    explained = answer.explained_fraction
    helps = bool(explained > PARTIAL_SHARE and nearest.effects)
    add_free_forms(search, answer.plain)
    best = _find_best(search, nearest)
    plain, sums = search.table.sums(search.baseline), None if best is None else search.table.sums(best)
    if helps and (plain is None or sums is None or _closes(plain, sums) < search.policy.selection.holdout_share):
        add_free_forms(search, nearest)
        best = _find_best(search, nearest)
    if best is None:
        return None
    sums = search.table.sums(best)
    # To finish a curve of many heights may cost more than the search: not of one that the table has behind the look-alike.
    if helps and plain is not None and sums is not None and _closes(plain, sums) < min(explained, 1.0):
        return None
    place = search.places[key_of(best)]
    describe = _describe_tone if TONE in best.effects else _describe_curve
    surrogate = describe(answer, best, place)
    # Where hardly more than noise is left, all of the gap is no share of the error that anybody would see.
    is_seen = surrogate.share >= LEAST_SHARE
    return (
        surrogate
        if is_seen and surrogate.explained_fraction >= max(USEFUL_SHARE, explained if helps else 0.0)
        else None
    )


def _find_best(search: EffectSearch, nearest: FittedCandidate) -> FittedCandidate | None:
    """The set that wins most often of those with a curve or a tone beside the plain model or the nearest look-alike."""
    beside: tuple[set[str], ...] = (set(), set(nearest.effects))
    sets = [
        FittedSet(fit, sums)
        for fit in search.table.candidates
        if (place := search.places.get(key_of(fit))) is not None
        and set(fit.effects) - {CURVE, TONE} in beside
        # What goes on in time on one record says nothing of another, but for a tone.
        and (TONE in fit.effects or place.dependence.variable != TIME)
        and (sums := search.table.sums(fit)) is not None
    ]
    draws = draw_sets(sets)
    return draws.sets[Weights.of(draws).leading].candidate if draws.sets else None


def _closes(before: BlockSums, after: BlockSums) -> float:
    """Share of the gap to the noise that a set closes on the records that judge, in the output that the plain model misses most."""
    worst = int(np.nanargmax(before.judged_rms))
    gap = max(float(before.judged_rms[worst]) - 1, TINY)
    return float(before.judged_rms[worst] - after.judged_rms[worst]) / gap


# Points of the curve in the result.
CURVE_POINTS = 101
# Points of one period in the result.
SURROGATE_POINTS_PER_PERIOD = 24


# How often a curve is fitted as its user will: its many heights go on for long with what does not show.
CURVE_FINISHES = 2


def _describe_curve(answer: SearchAnswer, candidate: FittedCandidate, place: CurvePlace) -> Surrogate:
    """The surrogate of a refitted ``candidate``, validated, with its curve over the range of the signal."""
    site, dependence, signal = place.site, place.dependence, place.signal
    problem, validation, base = answer.scores.problem, answer.validation, answer.base
    # The refit is over: a curve of many heights would go on for long with what does not show, and with ever smaller steps.
    solver = problem.options.policy
    limited = replace(solver.step_refinement, max_substeps=MAX_SUBSTEPS)
    brief = replace(
        problem.options,
        transcription="single",
        policy=replace(solver, step_refinement=limited),
    )
    brief_fit = validate_candidate(replace(problem, options=brief), candidate, validation)
    finished = finish_fit(problem, brief_fit, validation, CURVE_FINISHES)
    fit = finished.fit
    holdout = compare_holdout_errors(base, fit)
    names = fit.model.names_of(CURVE)
    values = {n: fit.model.values[in_model] for n, in_model in names.items()}
    measured = signal.variables[dependence.variable]
    points = CURVE_POINTS
    if dependence.period is not None:
        points = max(int(SURROGATE_POINTS_PER_PERIOD * np.ptp(measured) / dependence.period), points)
    z = np.linspace(measured.min(), measured.max(), points)
    if dependence.period is not None:
        return Surrogate(
            signal.site,
            site.unit,
            fit,
            holdout,
            z,
            evaluate_curve(values, z),
            signal,
            replace(dependence, period=values["pitch"]),
            CurveShape(ShapeKind.PERIODIC),
            amplitude=float(np.hypot(values["cosine"], values["sine"])),
            finished=finished,
        )
    levels = levels_of(values)
    if levels is not None:  # nothing is known between them
        z = levels
    rest = signal.value - evaluate_curve(values, measured)
    curve = evaluate_curve(values, z) + np.polyval(np.polyfit(measured, rest, 1), z)
    count = np.bincount(np.abs(measured[:, None] - z).argmin(axis=1), minlength=len(z))
    shape = classify_shape(z[count > 0], curve[count > 0], count[count > 0])
    return Surrogate(signal.site, site.unit, fit, holdout, z, curve, signal, dependence, shape, finished=finished)


# A tone in time


# Models whose costs differ by less explain the records equally well.
TIE_COST = 10.0


# Periods at the start of a validation record from which amplitude and phase of the tone are estimated there.
TONE_PERIODS = 5


def _describe_tone(answer: SearchAnswer, candidate: FittedCandidate, place: CurvePlace) -> Surrogate:
    """The surrogate of a refitted ``candidate`` with a tone.

    One frequency looks alike at every site once it is steady; where several explain the records, balances come before sensors. On the
    validation records amplitude and phase are estimated from the first few periods, since no two records start at the same phase.
    """
    search, validation = answer.search, answer.validation
    tones = {key: fit for fit in search.table.candidates if TONE in fit.effects for key in [key_of(fit)]}
    alike = [
        (other, tones[key])
        for key, other in search.places.items()
        if key in tones
        and set(tones[key].effects) == set(candidate.effects)
        and tones[key].cost - candidate.cost < TIE_COST
    ]
    order = list(SiteKind)
    alike.sort(key=lambda one: order.index(one[0].site.kind))
    place, candidate = alike[0]
    fit = validate_candidate(answer.scores.problem, candidate, ())
    frequency = fit.parameters[_tone_names(fit)[0]].value
    rows, seconds = _first_periods(validation, frequency, TONE_PERIODS)
    options = answer.scores.problem.options
    validated = validate(
        fit.model,
        validation.records,
        noise=fit.noise.std,
        skip=validation.uncounted,
        initial_rows=rows,
        options=options,
    )
    fit = replace(fit, validation=validated)
    others = tuple(other.site.label for other, _ in alike[1:])
    holdout = compare_holdout_errors(answer.base, fit)
    return _to_tone_surrogate(place.site, place.signal, place.dependence, fit, holdout, seconds, others)


def _tone_names(fit: Fit) -> tuple[str, str, str]:
    """How the frequency and the two states of the tone are called in the model."""
    bound = next(b for b in fit.model.bound_effects if b.effect.name == TONE)
    first, second = (s.name for s in bound.states)
    return bound.model_names["frequency"], first, second


def _first_periods(validation: ValidationSet, frequency: float, periods: int) -> tuple[int, float]:
    """Rows of a validation record from which the tone's amplitude and phase are estimated, and their seconds."""
    step = max(float(np.median(np.diff(e.time))) for e in validation.records)
    half = min(e.rows for e in validation.records) // 2
    rows = (
        validation.beginning or validation.skip or min(max(math.ceil(periods / (frequency * step)), FIRST_ROWS), half)
    )
    return rows, rows * step


def _to_tone_surrogate(
    site: DisturbanceSite,
    signal: ResidualSignal,
    dependence: Dependence,
    fit: Fit,
    holdout: Mapping[str, HoldoutError],
    seconds: float,
    others: tuple[str, ...],
) -> Surrogate:
    """The surrogate with the tone along the stretch of ``signal``."""
    frequency, *states = _tone_names(fit)
    estimated = fit.parameters[frequency]
    trace = next(t for t in fit.traces if t.name == signal.record)
    points = max(int(SURROGATE_POINTS_PER_PERIOD * np.ptp(signal.time) * estimated.value), SURROGATE_POINTS_PER_PERIOD)
    time = np.linspace(signal.time[0], signal.time[-1], points)
    angle = 2 * np.pi * estimated.value * (time - trace.time[0])
    cosine, sine = (trace.initial_state[n] for n in states)
    amplitude = {t.name: math.hypot(*(t.initial_state[n] for n in states)) for t in fit.traces}
    return Surrogate(
        site.label,
        site.unit,
        fit,
        holdout,
        time,
        cosine * np.cos(angle) + sine * np.sin(angle),
        signal,
        dependence,
        CurveShape(ShapeKind.TONE),
        SurrogateTone(estimated.value, estimated.std, amplitude, seconds, others),
    )
