"""What a selection weighs the residual with where the noise is not known from outside, and structure left in a residual.

The residual of a candidate is never taken for the noise: it holds what the candidate lacks. The records bound the noise
(`greybox.data.noise`), and a sensor bounds how long it remembers; within these bounds the weights follow the residual of the best model
found, because a correlated residual makes every likelihood ratio of white noise too large.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from greybox.data.noise import AutoRegression, BoundDirection, NoiseModel, NoiseSource, fit_autoregression, join_series
from greybox.discovery.candidates import generate_starting_points
from greybox.discovery.disturbance_sites import DisturbanceSite, list_disturbance_sites
from greybox.discovery.effect_signal import EffectSignal, estimate_effect_signals
from greybox.discovery.execution import RefitJob
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate
from greybox.discovery.surrogate_effects import CURVE, LINEAR_DYNAMICS, make_curve_effect, make_power_effect
from greybox.model.effect import Effect
from greybox.model.effects.scales import AMPLITUDE_GRID, Scales

# Sources of a noise level that do not depend on the records that are fitted.
INDEPENDENT_SOURCES = (NoiseSource.GIVEN, NoiseSource.QUIET_RECORD)


def is_level_known(noise: NoiseModel) -> bool:
    """Whether the level of every output is known, and not bounded only."""
    return noise.is_level_known


def estimate_residual_noise(candidate: FittedCandidate) -> NoiseModel:
    """The weights of a selection: no larger than the noise can be, and no longer remembered than a sensor remembers.

    A level that is known stays. One that is only bounded becomes what the model leaves where that is less; what it leaves beyond the
    bound, or remembers for longer than a sensor, is the model's error and shows as such. The colour follows the residual up to there,
    unless the records show it themselves.
    """
    noise = candidate.problem.noise
    std, colour = noise.std.copy(), list(noise.colour)
    for j, series in _normalised_residuals(candidate):
        name = candidate.problem.model.outputs[j].name
        bound = noise.bound(name)
        left = noise.std[j] * float(np.sqrt(np.nanmean(series**2)))
        if bound is None:
            std[j] = left
        elif bound.direction is BoundDirection.AT_MOST:
            std[j] = min(left, bound.level)
        elif bound.direction is BoundDirection.AT_LEAST:
            std[j] = max(left, bound.level)
        if bound is None or bound.correlation_time is None:
            fitted = fit_autoregression(series, max_order=1, policy=candidate.problem.policy.noise)
            colour[j] = _limit_memory(fitted)
    return replace(noise, std=std, colour=tuple(colour))


# Correlation from sample to sample below which a residual counts as white.
WHITE_CORRELATION = 0.1
# Largest correlation from sample to sample of a sensor's noise, as in `greybox.data.noise.NoisePolicy`: a residual that remembers for
# longer is a model's error.
RESIDUAL_NOISE_LONGEST_CORRELATION = 0.95


def _limit_memory(fitted: AutoRegression) -> AutoRegression:
    """Noise of first order that a sensor can have; white where it hardly remembers."""
    if not fitted.order or abs(fitted.reflection[0]) <= WHITE_CORRELATION:
        return AutoRegression()
    return AutoRegression((min(fitted.reflection[0], RESIDUAL_NOISE_LONGEST_CORRELATION),))


def excess_autocorrelation(candidate: FittedCandidate, lags: int) -> float:
    """Sum of squared autocorrelations of the whitened residual over ``lags``, beyond chance, of the worst output: zero for noise."""
    worst = 0.0
    for j, series in _normalised_residuals(candidate):
        white = candidate.problem.noise.colour[j].whiten(series)
        values = white[np.isfinite(white)]
        values = values - values.mean()
        energy = float(values @ values)
        correlations = [float(values[k:] @ values[:-k]) / energy for k in range(1, lags + 1)] if energy > 0 else []
        worst = max(worst, sum(r * r for r in correlations) - 2 * lags / max(len(values), 1))
    return worst


def _normalised_residuals(candidate: FittedCandidate) -> list[tuple[int, np.ndarray]]:
    """Residual over noise of each measured output, the records one after the other with a gap between."""
    problem = candidate.problem
    shooting = problem.with_plain_squares().shooting(candidate.variables)
    simulated = shooting.simulate(candidate.variables.here)
    runs = [
        (record.samples(y), record.samples(record.y))
        for (y, _), record in zip(simulated, shooting.records, strict=True)
    ]
    series = []
    for j in range(len(problem.noise.std)):
        parts = [(measured[:, j] - y[:, j]) / problem.noise.std[j] for y, measured in runs]
        if any(np.isfinite(part).any() for part in parts):
            series.append((j, join_series(parts)))
    return series


# Is what an effect leaves another effect, or its own shape that the catalogue does not quite have?
#
# A creep with three branches leaves something to a creep with one, and friction that depends on speed something to dry friction: a
# selection that only adds effects then gives two or three wrong names. So before a further effect is accepted it has to beat a
# correction of those that are there: a second branch of the same kind, or a smooth curve at the same site over the same variable.

# Appended to the name of an effect for a second branch of it.
SECOND_BRANCH = "_second_branch"


def is_shape_correction(name: str) -> bool:
    """Whether an effect of this name has none of its own: it corrects the shape of another one, or is linear dynamics of no name."""
    return name == CURVE or name.endswith(SECOND_BRANCH) or name.startswith(LINEAR_DYNAMICS)


def list_shape_corrections(
    problem: DiscoveryProblem, candidate: FittedCandidate, scales: Scales
) -> list[tuple[str, RefitJob]]:
    """Every correction of the shape of one effect: the effect's name, and the refit."""
    return [*_second_branches(candidate, scales), *_curves(problem, candidate)]


# Iterations of the refit with such a correction.
CORRECTION_ITERATIONS = 20


def _second_branches(candidate: FittedCandidate, scales: Scales) -> Iterator[tuple[str, RefitJob]]:
    """A second branch of every effect that has memory and a shape: a spectrum of times in the place of one."""
    for effect in candidate.model.effects:
        if effect.states and effect.balances and effect.terms and effect.grid:
            # As it came from the catalogue: a fitted one would start on top of the first.
            branch = replace(effect, name=f"{effect.name}{SECOND_BRANCH}", parents=())
            model = candidate.model + branch
            starts = generate_starting_points(model, branch, candidate, candidate.model, scales, AMPLITUDE_GRID)
            yield effect.name, RefitJob(model, tuple(starts), 1, CORRECTION_ITERATIONS)


def has_memory(effect: Effect) -> bool:
    """Whether an effect is no function of what is there at the moment: it has states, delays a signal or moves it between samples."""
    return bool(effect.states or effect.delay or effect.is_of_record)


def prepare_curve(rest: FittedCandidate, signal: EffectSignal) -> RefitJob:
    """The refit of ``rest`` with a curve that stands for the whole ``signal`` of an effect that it does not have."""
    return _prepare_curve(rest, signal, signal.value)


# Iterations of the refit.
SURROGATE_REFIT_ITERATIONS = 30


def prepare_power(selected: FittedCandidate, rest: FittedCandidate, signal: EffectSignal) -> RefitJob:
    """The refit of ``rest`` with a power of the variable of ``signal`` that stands for the whole signal of an effect of ``selected``."""
    power, values = make_power_effect(_site_of(rest, signal), signal.dependence, signal.variable, signal.value)
    model = rest.model + power
    names = model.names_of(CURVE)
    begin = {names[n]: v for n, v in values.items()}
    kept = {n: v for n, v in selected.model.values.items() if n in rest.model.values}
    starts = ({**rest.model.values, **begin}, {**rest.model.values, **kept, **begin})
    return RefitJob(model, starts, 2, SURROGATE_REFIT_ITERATIONS)


def _curves(problem: DiscoveryProblem, candidate: FittedCandidate) -> Iterator[tuple[str, RefitJob]]:
    """A curve at the site of every effect, over the variable that its signal depends on most."""
    for signal in estimate_effect_signals(problem, candidate):
        corrected: Effect | None = next((e for e in candidate.model.effects if e.name == signal.effect), None)
        if corrected is not None and not (
            corrected.states or corrected.is_of_record
        ):  # these are no function of a variable
            yield corrected.name, _prepare_curve(candidate, signal, signal.value - signal.modelled)


# Intervals of the curve that corrects the shape of an effect.
CORRECTION_HEIGHTS = 10


def _prepare_curve(candidate: FittedCandidate, signal: EffectSignal, values: np.ndarray) -> RefitJob:
    """``candidate`` with a curve at the site of ``signal`` over its variable, which begins as the regression of ``values`` (K,)."""
    curve, heights = make_curve_effect(
        _site_of(candidate, signal),
        signal.dependence,
        signal.variable,
        values,
        signal.std,
        CORRECTION_HEIGHTS,
    )
    model = candidate.model + curve
    names = model.names_of(CURVE)
    starts = ({**candidate.model.values, **{names[n]: v for n, v in heights.items()}}, candidate.model.values)
    return RefitJob(model, starts, 1, CORRECTION_ITERATIONS)


def _site_of(candidate: FittedCandidate, signal: EffectSignal) -> DisturbanceSite:
    sites = list_disturbance_sites(candidate.model, [o.name for o in candidate.model.outputs])
    return next(s for s in sites if s.label == signal.site)
