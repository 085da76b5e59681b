"""What the catalogue does not explain: a fitted curve, or a tone, in the place of the unknown effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.discovery.curve_effects import NAME, evaluate_curve, make_curve_effect, make_sinusoid_effect
from greybox.discovery.curve_shape import classify_shape
from greybox.discovery.dependence import TIME, WORTH, Dependence
from greybox.discovery.disturbance_sites import DisturbanceSite, list_disturbance_sites
from greybox.discovery.effect_test import finish_and_validate
from greybox.discovery.holdout_error import HoldoutError, compare_holdout_errors
from greybox.discovery.localisation import ResidualLocalisation, ResidualSignal
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.estimation.select_transcription import select_transcription
from greybox.experiment import Experiment
from greybox.result import Fit
from greybox.values import ReadOnly

# Variables that a curve is tried over; iterations of a refit, and of the fit that tells its intervals; starts; periods, as shares of the
# one seen.
TRIED, ITERATIONS, LAST, KEPT, PERIODS = 2, 30, 10, 1, (1.0, 0.985, 1.015)
# Name of a tone as an effect; share of the gap that a curve must close to stand in for anything.
TONE, USEFUL = "tone", 0.1
# Points of a drawn curve; of a period.
POINTS, FINE = 101, 24


@dataclass(frozen=True)
class SurrogateTone:
    """A sinusoid from outside: ``frequency`` and its standard deviation ``std`` (None: not known) in Hz, ``amplitude`` by record.

    ``beginning``: seconds of each validation record from which its amplitude and phase are read there; ``alike``: places at which it
    would explain the records as well.
    """

    frequency: float
    std: float | None
    amplitude: Mapping[str, float]
    beginning: float
    alike: tuple[str, ...]

    def __str__(self) -> str:
        return f"a tone of {f'{self.frequency:#.4g}'.rstrip('.')} Hz"


@dataclass(frozen=True, eq=False)
class Surrogate(ReadOnly):
    """What was fitted in the place of an unknown effect at ``site``: a curve over the variable of ``region``, or a ``tone`` in time.

    ``fit`` is the extended model with it as an effect; ``gap`` by output on the validation records. ``values`` (M,) of the
    variable and the ``curve`` (M,) there, in ``variable_unit`` and ``unit``, through the unexplained ``signal``. A straight line is shared
    with the model's own constants (a damper, a spring) in a way that no data decide: the ``curve`` has the one that the signal has.
    ``shape``: that of the curve in words.
    """

    site: str
    unit: str
    fit: Fit
    gap: Mapping[str, HoldoutError]
    values: np.ndarray
    curve: np.ndarray
    signal: ResidualSignal
    region: Dependence
    shape: str = ""
    tone: SurrogateTone | None = None

    @property
    def variable(self) -> str:
        """Name of the state or input that the curve is over, or ``time``."""
        return self.region.variable

    @property
    def variable_unit(self) -> str:
        """Unit of the variable."""
        return self.region.unit

    @property
    def explained_fraction(self) -> float:
        """Share of the gap that it closes, in the output that the plain model misses most."""
        return max(self.gap.values(), key=lambda g: g.before / g.floor).explained_fraction

    @property
    def title(self) -> str:
        """``a curve over x`` or ``a tone of 50.00 Hz``."""
        if self.tone is not None:
            return str(self.tone)
        return f"a {'curve' if self.region.period is None else 'sinusoid'} over {self.variable}"

    @property
    def beside(self) -> tuple[str, ...]:
        """Effects of the catalogue that the model has beside it."""
        return tuple(e.name for e in self.fit.model.effects if e.name not in (NAME, TONE))

    @property
    def seen(self) -> np.ndarray:
        """The values (K,) of the variable along the signal."""
        return self.signal.time if self.variable == TIME else self.signal.variables[self.variable]

    def __str__(self) -> str:
        if self.tone is None:
            smooth = self.title.replace("a curve", "a smooth curve")
            beside = f", beside {' + '.join(self.beside)}," if self.beside else ""
            return (
                f"{smooth} ({self.shape})"
                f" at the {self.site}{beside} {describe_explained_share(self.explained_fraction)} on the validation records"
            )
        sizes = sorted(self.tone.amplitude.values())
        size = f"{sizes[0]:.3g}" if sizes[-1] <= 1.05 * sizes[0] else f"{sizes[0]:.3g} to {sizes[-1]:.3g}"
        also = f" (or the {', the '.join(self.tone.alike)}: these records cannot tell)" if self.tone.alike else ""
        return (
            f"{self.tone} at the {self.site}{also}, of amplitude {size} {self.unit}".rstrip()
            + f", {describe_explained_share(self.explained_fraction)} on the validation records (amplitude and phase there from the first"
            f" {self.tone.beginning:.2g} s)"
        )


def describe_explained_share(share: float) -> str:
    """``closes 98.8 % of the gap``; a model that is farther off than the plain one closes nothing."""
    return f"closes {100 * min(share, 1.0):.3g} % of the gap" if share > 0 else "closes nothing of the gap"


def fit_curve_surrogate(
    bench: DiscoveryProblem,
    trial: CandidateFit,
    found: ResidualLocalisation,
    judges: Sequence[Experiment],
    base: Fit,
    skip: int = 0,
) -> Surrogate | None:
    """The curve for what ``trial`` leaves over; None where that is no function of any one variable, or cannot be simulated, or where it
    closes nothing worth mentioning on the judging records.

    ``base``: the plain model judged on the same records, which the gap is counted from. The model is refitted with a curve over each of
    the likeliest variables, with a sinusoid where the signal repeats over it; what explains the records best by Schwarz's criterion stays.
    """
    worth = [r for r in found.dependences if r.variable != TIME and r.share + r.loop > WORTH][:TRIED]
    if not worth or found.signal is None:
        return None
    measured = [o.name for o in trial.model.outputs]
    place = next(p for p in list_disturbance_sites(trial.model, measured) if str(p) == found.signal.site)
    refits = [(r, _refitted(bench, trial, place, r, found.signal)) for r in worth]
    tried = [
        (r, t) for r, t in refits if t is not None and (_by_segments(bench, bench.base) or not _by_segments(bench, t))
    ]
    if not tried:
        return None
    region, better = min(tried, key=lambda one: one[1].criterion)
    drawn = _drawn(bench, better, place, region, found.signal, judges, base, skip)
    return drawn if drawn.explained_fraction >= USEFUL else None


def _by_segments(bench: DiscoveryProblem, trial: CandidateFit) -> bool:
    """Whether the model is so unstable that it cannot be run freely; a curve that makes a stable one so stands in for nothing."""
    there = replace(trial.problem, variables=trial.variables)
    return select_transcription(there, replace(bench.options, progressive=False)).transcription == "multiple"


def _refitted(
    bench: DiscoveryProblem, trial: CandidateFit, place: DisturbanceSite, region: Dependence, signal: ResidualSignal
) -> CandidateFit | None:
    """``trial`` with a curve over the variable of ``region``, from its own constants and from those that the user came with."""
    z = signal.variables[region.variable]
    if region.period is None:
        effect, start = make_curve_effect(place, region, z, signal.value, signal.std)
        starts = [start, {}]
    else:
        effect, _ = make_sinusoid_effect(place, region, region.period, z, signal.value)
        starts = [make_sinusoid_effect(place, region, share * region.period, z, signal.value)[1] for share in PERIODS]
    model = trial.model + effect
    names = next(b.model_names for b in model.bound_effects if b.effect.name == NAME)
    nominal = {q.name: q.value for q in bench.plain.free_parameters}
    begins = [
        {**trial.model.values, **values, **{names[n]: v for n, v in start.items()}}
        for start in starts
        for values in ({}, nominal)
    ]
    return bench.best(model, begins, KEPT, ITERATIONS, like=trial)


def _drawn(
    bench: DiscoveryProblem,
    trial: CandidateFit,
    place: DisturbanceSite,
    region: Dependence,
    signal: ResidualSignal,
    judges: Sequence[Experiment],
    base: Fit,
    skip: int,
) -> Surrogate:
    """The stand-in of a refitted ``trial``, judged, with its curve over the range of the ``signal``."""
    # The refit is over: a curve of many heights would go on for long with what does not show.
    brief = replace(bench.options, transcription="single", iterations=LAST)
    fitted = finish_and_validate(trial, replace(bench, options=brief), judges, skip)
    names = next(b.model_names for b in trial.model.bound_effects if b.effect.name == NAME)
    values = {n: trial.model.values[there] for n, there in names.items()}
    seen = signal.variables[region.variable]
    points = POINTS if region.period is None else max(int(FINE * np.ptp(seen) / region.period), POINTS)
    z = np.linspace(seen.min(), seen.max(), points)
    if region.period is not None:
        curve, region = evaluate_curve(values, z), replace(region, period=values["pitch"])
        size = f"{np.hypot(values['cosine'], values['sine']):.3g} {place.unit}".rstrip()
        told = f"every {values['pitch']:.3g} {region.unit}".rstrip() + f", of {size}"
        return Surrogate(
            signal.site, place.unit, fitted, compare_holdout_errors(base, fitted), z, curve, signal, region, told
        )
    curve = evaluate_curve(values, z) + np.polyval(np.polyfit(seen, signal.value - evaluate_curve(values, seen), 1), z)
    there = np.histogram(seen, points, (z[0], z[-1]))[0]
    told = classify_shape(z[there > 0], curve[there > 0], there[there > 0], region.unit)[1]
    return Surrogate(
        signal.site, place.unit, fitted, compare_holdout_errors(base, fitted), z, curve, signal, region, told
    )
