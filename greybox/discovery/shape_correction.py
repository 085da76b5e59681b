"""Is what an effect leaves another effect, or its own shape that the catalogue does not quite have?

A creep with three branches leaves something to a creep with one, and friction that depends on speed something to dry friction: a
selection that only adds effects then gives two or three wrong names. So before a further effect is accepted it has to beat a
correction of those that are there: a second branch of the same kind, or a smooth curve at the same site over the same variable.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from greybox.discovery.disturbance_sites import DisturbanceSite, list_disturbance_sites
from greybox.discovery.effect_signal import EffectSignal, estimate_effect_signals
from greybox.discovery.execution import RefitJob
from greybox.discovery.policy import DiscoveryPolicy, SurrogatePolicy
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.discovery.starting_points import generate_starting_points
from greybox.discovery.surrogate_effects import CURVE, make_curve_effect, make_power_effect
from greybox.effects import Scales
from greybox.model import Effect

# Appended to the name of an effect for a second branch of it.
SECOND_BRANCH = "_second_branch"


def is_shape_correction(name: str) -> bool:
    """Whether an effect of this name only corrects the shape of another one."""
    return name == CURVE or name.endswith(SECOND_BRANCH)


def fit_shape_correction(
    problem: DiscoveryProblem, candidate: CandidateFit, scales: Scales, policy: DiscoveryPolicy
) -> CandidateFit | None:
    """The best correction of one effect by Schwarz's criterion; None where there is none to try."""
    jobs = list_shape_corrections(problem, candidate, scales, policy)
    corrected = [fit for fit in problem.refit_all([job for _, job in jobs]) if fit is not None]
    return min(corrected, key=lambda fit: fit.criterion, default=None)


def list_shape_corrections(
    problem: DiscoveryProblem, candidate: CandidateFit, scales: Scales, policy: DiscoveryPolicy
) -> list[tuple[str, RefitJob]]:
    """Every correction of the shape of one effect: the effect's name, and the refit."""
    return [*_second_branches(candidate, scales, policy), *_curves(problem, candidate, policy)]


def _second_branches(
    candidate: CandidateFit, scales: Scales, policy: DiscoveryPolicy
) -> Iterator[tuple[str, RefitJob]]:
    """A second branch of every effect that has memory and a shape: a spectrum of times in the place of one."""
    for effect in candidate.model.effects:
        if effect.states and effect.balances and effect.terms and effect.grid:
            # As it came from the catalogue: a fitted one would start on top of the first.
            branch = replace(effect, name=f"{effect.name}{SECOND_BRANCH}", parents=())
            model = candidate.model + branch
            starts = generate_starting_points(
                model, branch, candidate, candidate.model, scales, policy.budget.amplitude_grid
            )
            yield effect.name, RefitJob(model, tuple(starts), 1, policy.budget.correction_iterations)


def has_memory(effect: Effect) -> bool:
    """Whether an effect is no function of what is there at the moment: it has states, delays a signal or moves it between samples."""
    return bool(effect.states or effect.delay or effect.hold)


def prepare_curve(rest: CandidateFit, signal: EffectSignal, policy: DiscoveryPolicy) -> RefitJob:
    """The refit of ``rest`` with a curve that stands for the whole ``signal`` of an effect that it does not have."""
    return _prepare_curve(rest, signal, signal.value, policy)


def prepare_power(
    selected: CandidateFit, rest: CandidateFit, signal: EffectSignal, policy: SurrogatePolicy
) -> RefitJob:
    """The refit of ``rest`` with a power of the variable of ``signal`` that stands for the whole signal of an effect of ``selected``."""
    power, values = make_power_effect(_site_of(rest, signal), signal.dependence, signal.variable, signal.value, policy)
    model = rest.model + power
    names = next(b.model_names for b in model.bound_effects if b.effect.name == CURVE)
    begin = {names[n]: v for n, v in values.items()}
    kept = {n: v for n, v in selected.model.values.items() if n in rest.model.values}
    starts = ({**rest.model.values, **begin}, {**rest.model.values, **kept, **begin})
    return RefitJob(model, starts, 2, policy.refit_iterations)


def _curves(
    problem: DiscoveryProblem, candidate: CandidateFit, policy: DiscoveryPolicy
) -> Iterator[tuple[str, RefitJob]]:
    """A curve at the site of every effect, over the variable that its signal depends on most."""
    for signal in estimate_effect_signals(problem, candidate, policy.localisation):
        corrected: Effect | None = next((e for e in candidate.model.effects if e.name == signal.effect), None)
        if corrected is not None and not (corrected.states or corrected.hold):  # these are no function of a variable
            yield corrected.name, _prepare_curve(candidate, signal, signal.value - signal.modelled, policy)


def _prepare_curve(
    candidate: CandidateFit, signal: EffectSignal, values: np.ndarray, policy: DiscoveryPolicy
) -> RefitJob:
    """``candidate`` with a curve at the site of ``signal`` over its variable, which begins as the regression of ``values`` (K,)."""
    curve, heights = make_curve_effect(
        _site_of(candidate, signal),
        signal.dependence,
        signal.variable,
        values,
        signal.std,
        policy.surrogate,
        policy.budget.correction_heights,
    )
    model = candidate.model + curve
    names = next(b.model_names for b in model.bound_effects if b.effect.name == CURVE)
    starts = ({**candidate.model.values, **{names[n]: v for n, v in heights.items()}}, candidate.model.values)
    return RefitJob(model, starts, 1, policy.budget.correction_iterations)


def _site_of(candidate: CandidateFit, signal: EffectSignal) -> DisturbanceSite:
    sites = list_disturbance_sites(candidate.model, [o.name for o in candidate.model.outputs])
    return next(s for s in sites if s.label == signal.site)
