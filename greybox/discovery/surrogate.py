"""What the catalogue does not explain: a fitted curve, or a tone, in the place of the unknown effect."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from greybox.base.values import Printable, ReadOnly
from greybox.data.experiment import Experiment
from greybox.discovery.curve_shape import (
    FEWEST_LEVELS,
    TIME,
    CurveShape,
    Dependence,
    ShapeKind,
    classify_shape,
    find_levels,
    rank_dependences,
)
from greybox.discovery.disturbance_sites import DisturbanceSite, SiteKind, list_disturbance_sites
from greybox.discovery.holdout import (
    PARTIAL_SHARE,
    HoldoutError,
    RefitComparison,
    ValidationSet,
    compare_holdout_errors,
    estimated_initial_states,
    finish_fit,
    validate_candidate,
    worst_output,
)
from greybox.discovery.localisation import (
    ResidualLocalisation,
    ResidualSignal,
    estimate_site_signals,
    localise_residual,
)
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import MAX_SUBSTEPS, DiscoveryProblem, FittedCandidate
from greybox.discovery.residual_noise import SURROGATE_REFIT_ITERATIONS
from greybox.discovery.surrogate_effects import (
    CURVE,
    TONE,
    evaluate_curve,
    levels_of,
    make_curve_effect,
    make_sinusoid_effect,
    make_tone_effect,
)
from greybox.estimation.fit import fit as estimate
from greybox.estimation.result import Fit
from greybox.estimation.validate import FIRST_ROWS, validate
from greybox.model.model import Model


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


# Further share of the gap that a surrogate beside a look-alike must explain over one in its place.
BESIDE_GAIN = 0.02


def fit_surrogate(
    problem: DiscoveryProblem,
    baseline: FittedCandidate,
    look_alike: FittedCandidate,
    holdout: Mapping[str, HoldoutError],
    validation: ValidationSet | Sequence[Experiment],
    base: Fit,
    policy: DiscoveryPolicy,
) -> Surrogate | None:
    """A tone or a smooth curve for all that the plain model lacks.

    Where that is not enough, and the nearest look-alike explains the larger part, one for what this leaves, if the two together do
    clearly better. None that explains less than the look-alike.

    Parameters
    ----------
    problem
        Records and noise, with the plain model as the user gave it.
    baseline, look_alike
        The fits of the plain model and of the selected one.
    holdout, base
        Error of both on the validation records, and the plain model as a fit that was validated there.
    validation
        These records.
    policy
        The decision numbers.
    """
    explained = holdout[worst_output(holdout)].explained_fraction
    helps = bool(explained > PARTIAL_SHARE and look_alike.effects)
    best: Surrogate | None = None
    for candidate in (baseline, look_alike) if helps else (baseline,):
        if best is not None and best.explained_fraction >= policy.selection.holdout_share:
            break
        location = localise_residual(candidate)
        given = (problem, candidate, location, validation, base)
        surrogate = fit_tone_surrogate(*given) or fit_curve_surrogate(*given)
        if surrogate is None or (helps and surrogate.explained_fraction < explained):
            continue
        if best is None or surrogate.explained_fraction > best.explained_fraction + BESIDE_GAIN:
            best = surrogate
    return best


# A curve over a variable


# Share of the gap on validation records that a curve must explain to be shown.
USEFUL_SHARE = 0.1


def fit_curve_surrogate(
    problem: DiscoveryProblem,
    candidate: FittedCandidate,
    location: ResidualLocalisation,
    validation: ValidationSet | Sequence[Experiment],
    base: Fit,
) -> Surrogate | None:
    """The curve for what ``candidate`` leaves unexplained.

    The model is refitted with a curve over each of the likeliest variables, with a sinusoid where the signal repeats over it, and where
    static curves are usual; what explains the records best by Schwarz's criterion stays. None where the model cannot be simulated, or
    where the curve explains nothing worth mentioning on the validation records. ``base`` is the plain model validated on them.
    """
    places = [*_localised_places(candidate, location), *_usual_places(problem, candidate, location)]
    limits = (SURROGATE_REFIT_STARTS, SURROGATE_REFIT_ITERATIONS)
    refits = [
        (place, problem.refit_best(*_prepare_curve(problem, candidate, place), *limits, like=candidate))
        for place in places
    ]
    stable = [
        (place, fit)
        for place, fit in refits
        if fit is not None
        and fit.criterion < candidate.criterion  # each height is a constant
        and (_needs_segments(problem, problem.baseline) or not _needs_segments(problem, fit))
    ]
    if not stable:
        return None
    place, best = min(stable, key=lambda one: one[1].criterion)
    surrogate = _to_curve_surrogate(problem, best, place, ValidationSet.of(validation), base)
    return surrogate if surrogate.explained_fraction >= USEFUL_SHARE else None


@dataclass(frozen=True)
class CurvePlace:
    """A site at which a curve may stand, the variable that it is over, and the signal that the residual asks for there."""

    site: DisturbanceSite
    dependence: Dependence
    signal: ResidualSignal

    @property
    def shows_curve(self) -> bool:
        """Whether enough levels of the variable were seen for more than a straight line."""
        return len(find_levels(self.signal.variables[self.dependence.variable])) >= FEWEST_LEVELS


# Variables over which a curve is tried.
SURROGATE_VARIABLES = 2


def _localised_places(candidate: FittedCandidate, location: ResidualLocalisation) -> list[CurvePlace]:
    """The likeliest site, over the variables that its signal is a function of."""
    relevant = [d for d in location.dependences if d.variable != TIME and d.is_relevant]
    if location.signal is None:
        return []
    sites = list_disturbance_sites(candidate.model, [o.name for o in candidate.model.outputs])
    site = next(s for s in sites if s.label == location.signal.site)
    places = [CurvePlace(site, d, location.signal) for d in relevant]
    return [place for place in places if place.shows_curve][:SURROGATE_VARIABLES]


def _usual_places(
    problem: DiscoveryProblem, candidate: FittedCandidate, location: ResidualLocalisation
) -> list[CurvePlace]:
    """The places that promise most of those where static curves are usual: an input over itself, a sensor over what it shows, a body.

    The localisation ranks sites by a signal that varies slowly, along a linearised run, and does not see a dead zone through a
    resonance. A curve there is refitted with the model itself.
    """
    if location.signal is None:
        return []
    signals = estimate_site_signals(candidate)
    likeliest = {(location.signal.site, d.variable) for d in location.dependences if d.is_relevant}
    places = []
    for site in list_disturbance_sites(candidate.model, [o.name for o in candidate.model.outputs]):
        signal = signals.get(site.label)
        for variable in _usual_variables(candidate.model, site):
            if signal is None or variable not in signal.variables or (site.label, variable) in likeliest:
                continue
            over = {variable: (signal.variables[variable], signal.units[variable])}
            ranked = rank_dependences(signal.time, signal.value, over)
            likeliest_of_it = [
                CurvePlace(site, replace(d, period=None), signal) for d in ranked if d.variable == variable
            ][:1]
            places += [place for place in likeliest_of_it if place.shows_curve]
    # The cost that one step predicts for a curve at each.
    costs = [problem.predict_cost(*_prepare_curve(problem, candidate, place), like=candidate) for place in places]
    order = sorted(range(len(places)), key=costs.__getitem__)
    return [places[k] for k in order[:SURROGATE_VARIABLES] if costs[k] < (1 - USEFUL_SHARE) * candidate.cost]


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


# Sites that the sensors cannot separate at which a free curve is tried in the place of an effect.
FREE_SITES = 3


def refit_free_curves(
    problem: DiscoveryProblem,
    candidate: FittedCandidate,
    location: ResidualLocalisation,
    enough: float = math.inf,
) -> list[FittedCandidate]:
    """``candidate`` with a smooth curve at each of the likeliest sites of what it leaves, over the likeliest variables and over time.

    The most that anything without memory could do there, whatever its name. Empty where nothing is left, or ``candidate`` has a curve.
    One that is far above the cost ``enough`` (`HOPELESS_CURVE`) after a few iterations stays as it is then.
    """
    if location.signal is None or CURVE in candidate.effects:
        return []
    signals = estimate_site_signals(candidate)
    # Sites at which the same signal reaches the sensors have the same gain: there a curve is the same in another unit.
    gains = {site.label: site.gain for site in location.sites}
    labels = [label for label in location.sets[0] if label in signals][:FREE_SITES]
    labels = [label for k, label in enumerate(labels) if gains[label] not in [gains[one] for one in labels[:k]]]
    sites = {s.label: s for s in list_disturbance_sites(candidate.model, [o.name for o in candidate.model.outputs])}
    none = np.zeros(0)
    over_time = Dependence(TIME, "s", 0.0, CurveShape(ShapeKind.TOO_FEW_VALUES), 0.0, None, none, none, none)
    curves = []
    for label in labels:
        signal = signals[label]
        variables = {name: (values, signal.units[name]) for name, values in signal.variables.items()}
        ranked = rank_dependences(signal.time, signal.value, variables)
        signal = replace(signal, variables={**signal.variables, TIME: signal.time - signal.time[0]})
        places = [CurvePlace(sites[label], d, signal) for d in ranked if d.variable != TIME]
        places = [place for place in places if place.shows_curve][:SURROGATE_VARIABLES]
        # Time is no matter of the site: what drifts at one drifts at another that the sensors cannot tell from it.
        drift = [CurvePlace(sites[label], over_time, signal)] if label == labels[0] else []
        for place in (*places, *drift):
            fit = _refit_free_curve(problem, candidate, place, enough)
            if fit is not None:
                curves.append(fit)
    return curves


# Most promising starting points from which it is refitted.
SURROGATE_REFIT_STARTS = 1
# Iterations of a rival after which it goes on only if it may come near the answer.
QUICK_ITERATIONS = 8
# Cost of a free curve after these, over that of the answer, from which it is given up: twice the rms error. It is hardly above where it
# would end.
HOPELESS_CURVE = 4.0


def _refit_free_curve(
    problem: DiscoveryProblem, candidate: FittedCandidate, place: CurvePlace, enough: float
) -> FittedCandidate | None:
    """``candidate`` with a curve there, refitted; to the end only where it may come near the cost ``enough``."""
    model, starts = _prepare_curve(problem, candidate, place)
    quick = problem.refit_best(model, starts, SURROGATE_REFIT_STARTS, QUICK_ITERATIONS, like=candidate, refines=False)
    if quick is None or quick.cost > HOPELESS_CURVE * enough:
        return quick
    return problem.refit_best(model, [quick.model.values], 1, SURROGATE_REFIT_ITERATIONS, like=quick) or quick


def _needs_segments(problem: DiscoveryProblem, candidate: FittedCandidate) -> bool:
    """Whether the model is too unstable for a free run; a curve that makes a stable model unstable is rejected."""
    return candidate.choose_transcription(problem.options).transcription == "multiple"


# Intervals of the curve.
SURROGATE_INTERVALS = 20
# Periods from which a sinusoid is refitted, over the one that the signal shows.
PERIOD_STARTS: tuple[float, ...] = (1.0, 0.985, 1.015)


def _prepare_curve(
    problem: DiscoveryProblem, candidate: FittedCandidate, place: CurvePlace
) -> tuple[Model, list[dict[str, float]]]:
    """``candidate`` with a curve, and where to start: from its own parameters and from those that the user gave."""
    dependence, signal = place.dependence, place.signal
    z, period = signal.variables[dependence.variable], dependence.period
    if period is None:
        effect, heights = make_curve_effect(place.site, dependence, z, signal.value, signal.std, SURROGATE_INTERVALS)
        curve_starts = [heights, {}]
    else:
        effect, _ = make_sinusoid_effect(place.site, dependence, period, z, signal.value)
        curve_starts = [
            make_sinusoid_effect(place.site, dependence, share * period, z, signal.value)[1] for share in PERIOD_STARTS
        ]
    model = candidate.model + effect
    names = model.names_of(CURVE)
    nominal = {q.name: q.value for q in problem.model.free_parameters if q.name in model.values}
    return model, [
        {**candidate.model.values, **values, **{names[n]: v for n, v in start.items()}}
        for start in curve_starts
        for values in ({}, nominal)
    ]


# Points of the curve in the result.
CURVE_POINTS = 101
# Points of one period in the result.
SURROGATE_POINTS_PER_PERIOD = 24


# How often a curve is fitted as its user will: its many heights go on for long with what does not show.
CURVE_FINISHES = 2


def _to_curve_surrogate(
    problem: DiscoveryProblem,
    candidate: FittedCandidate,
    place: CurvePlace,
    validation: ValidationSet | Sequence[Experiment],
    base: Fit,
) -> Surrogate:
    """The surrogate of a refitted ``candidate``, validated, with its curve over the range of the signal."""
    site, dependence, signal = place.site, place.dependence, place.signal
    # The refit is over: a curve of many heights would go on for long with what does not show, and with ever smaller steps.
    solver = problem.options.policy
    limited = replace(solver.step_refinement, max_substeps=MAX_SUBSTEPS)
    brief = replace(
        problem.options,
        transcription="single",
        policy=replace(solver, step_refinement=limited),
    )
    brief_fit = validate_candidate(replace(problem, options=brief), candidate, validation)
    finished = finish_fit(problem, brief_fit, ValidationSet.of(validation), CURVE_FINISHES)
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


def fit_tone_surrogate(
    problem: DiscoveryProblem,
    candidate: FittedCandidate,
    location: ResidualLocalisation,
    validation: ValidationSet | Sequence[Experiment],
    base: Fit,
) -> Surrogate | None:
    """The tone for what ``candidate`` leaves unexplained; None where that is no tone, or the model with it does no better.

    One frequency looks alike at every site once it is steady, so the model is fitted with the tone at each; where several explain the
    records, balances come before sensors. On the validation records amplitude and phase are estimated from the first few periods, since
    no two records start at the same phase. ``base`` is the plain model validated on them.
    """
    if not location.dependences or location.dependences[0].tone is None:
        return None
    validation = ValidationSet.of(validation)
    signals = estimate_site_signals(candidate)
    measured = {name for e in candidate.problem.experiments for name in e.outputs}
    sites = [s for s in list_disturbance_sites(candidate.model, sorted(measured)) if s.label in signals]
    fits = [_fit_tone(problem, candidate, s, signals[s.label], location.dependences[0].tone) for s in sites]
    least = min((fit.solver.cost for fit in fits), default=np.inf)
    if not least < candidate.cost:  # nor where it is not a number
        return None
    alike = [(s, fit) for s, fit in zip(sites, fits, strict=True) if fit.solver.cost - least < TIE_COST]
    site, fit = alike[0]
    frequency = fit.parameters[_tone_names(fit)[0]].value
    rows, seconds = _first_periods(validation, frequency, TONE_PERIODS)
    skip = validation.uncounted
    validated = validate(
        fit.model, validation.records, noise=fit.noise.std, skip=skip, initial_rows=rows, options=problem.options
    )
    fit = replace(fit, validation=validated)
    others = tuple(s.label for s, _ in alike[1:])
    holdout = compare_holdout_errors(base, fit)
    return _to_tone_surrogate(site, signals[site.label], location.dependences[0], fit, holdout, seconds, others)


def _fit_tone(
    problem: DiscoveryProblem,
    candidate: FittedCandidate,
    site: DisturbanceSite,
    signal: ResidualSignal,
    frequency: float,
) -> Fit:
    """The model of ``candidate`` with a tone at ``site``, fitted to the records."""
    record = next(e for e in candidate.problem.experiments if e.name == signal.record)
    model = candidate.model + make_tone_effect(site, signal, float(record.time[0]), frequency)
    # The fitted parameters have adapted to the tone, so the ones that the user gave are a start as well.
    origins: tuple[dict[str, float], ...] = ({}, {q.name: q.value for q in problem.model.free_parameters})
    fits = [
        estimate(
            model.start(**values),
            problem.experiments,
            noise=candidate.problem.noise,
            initial=estimated_initial_states(candidate),
            options=replace(problem.options, progressive=False),
        )
        for values in origins
    ]
    finite = (fit for fit in fits if np.isfinite(fit.solver.cost))
    return min(finite, key=lambda fit: fit.solver.cost, default=fits[0])


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
