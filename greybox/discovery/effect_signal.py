"""The missing signal of a named effect, from the data and from the model: the picture that convinces, or not.

With the extended model's constants and without the effect, the residual holds the effect whole, nothing of it swallowed by other
constants. The smoother that estimates an unknown signal from it also passes over the extended model's own run: where the effect is
right the two agree, by whatever way the effect enters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from greybox.discovery.dependence import Dependence, rank_dependences
from greybox.discovery.disturbance_sites import (
    DisturbanceSite,
    LinearisedRun,
    linearise_run,
    list_disturbance_sites,
    unwhitened_shooting,
)
from greybox.discovery.localisation import find_worst_stretch, signal_units
from greybox.discovery.problem import CandidateFit, DiscoveryProblem, with_start_values
from greybox.discovery.signal_smoother import SignalSmoother, absorbed_basis, whiten_columns
from greybox.values import ReadOnly


@dataclass(frozen=True, eq=False)
class EffectSignal(ReadOnly):
    """The signal that ``effect`` stands for at ``site`` of ``record``, in ``unit``.

    ``value`` and ``std`` (K,) are from the data, ``modelled`` (K,) from the extended model. ``variable`` (K,): the values of the
    variable that it depends on most (``variable_name``, in ``variable_unit``); ``region``: the data's signal as a function of it; ``time``
    (K,) in seconds. ``explained``: share of the signal's variance that the effect explains.
    """

    effect: str
    site: str
    unit: str
    record: str
    time: np.ndarray
    value: np.ndarray
    std: np.ndarray
    modelled: np.ndarray
    variable_name: str
    variable_unit: str
    variable: np.ndarray
    region: Dependence

    @property
    def explained(self) -> float:
        """One minus the variance of the difference over that of the signal."""
        return 1 - float(np.var(self.value - self.modelled) / max(np.var(self.value), 1e-300))


def estimate_effect_signals(bench: DiscoveryProblem, trial: CandidateFit) -> tuple[EffectSignal, ...]:
    """One for each effect of an extended model, where its signal is to be seen."""
    found = (_missing(bench, trial, b.effect.name, b.site) for b in trial.model.bound_effects)
    return tuple(m for m in found if m is not None)


def _missing(bench: DiscoveryProblem, trial: CandidateFit, name: str, site: str) -> EffectSignal | None:
    without = _without(bench, trial, name)
    shooting, zero = unwhitened_shooting(without), np.zeros(without.variables.size)
    residuals = [r for r, _ in shooting.residuals(zero)]
    if not all(
        np.isfinite(r[np.isfinite(s.samples(s.y))]).all() for r, s in zip(residuals, shooting.records, strict=True)
    ):
        return None  # without it the model overflows: nothing to compare with
    record, first, rows = find_worst_stretch(residuals)
    line = linearise_run(without, record, first, rows)
    place = next(
        (p for p in list_disturbance_sites(without.model, [o.name for o in without.model.outputs]) if p.name == site),
        None,
    )
    if place is None:
        return None
    own = unwhitened_shooting(trial).residuals(np.zeros(trial.variables.size))[record][0]
    stretch = slice(first, first + rows)
    seen = residuals[record][stretch]
    data, model = _both(line, place, without, seen, seen - own[stretch])
    names = [*without.model.system.state_names, *(i.name for i in without.model.inputs)]
    states = unwhitened_shooting(trial).simulate(np.zeros(trial.variables.size))[record][1]
    along = _along(trial, without, states, stretch, line)[data[0]]
    units = signal_units(without.model)
    variables = {n: (v, units[n]) for n, v in zip(names, along.T, strict=True)}
    ranked = [r for r in rank_dependences(line.time[data[0]], data[1], variables) if r.tone is None]
    if not ranked:
        return None
    best = ranked[0]
    return EffectSignal(
        name, str(place), place.unit, trial.problem.experiments[record].name, line.time[data[0]], data[1], data[2], model,
        best.variable, best.unit, variables[best.variable][0], best,
    )  # fmt: skip


def _without(bench: DiscoveryProblem, trial: CandidateFit, name: str) -> CandidateFit:
    """The extended model at its own constants, one effect taken out and nothing refitted."""
    model = trial.model.without(name)
    problem = bench.problem(model)
    names, kept = trial.model.system.state_names, model.system.state_names
    guess = trial.variables.initial.guess[:, [names.index(n) for n in kept]]
    variables = with_start_values(problem.variables, {n: v for n, v in trial.model.values.items() if n in model.values})
    variables = replace(variables, initial=replace(variables.initial, guess=guess))
    return CandidateFit(model, np.nan, trial.count, variables.size, problem, variables, trial.evaluation)


def _both(
    line: LinearisedRun, place: DisturbanceSite, trial: CandidateFit, seen: np.ndarray, modelled: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """Knots, signal and standard deviation from the data, and the signal from the model's run, by one smoother."""
    noise, present = trial.problem.noise, np.isfinite(seen)
    initial = absorbed_basis(line, 1 / noise.std, noise.colour, np.zeros((*seen.shape, 0)), present)
    smoother = SignalSmoother.of(line, place, 1 / noise.std, noise.colour, initial, present)
    data, model = (whiten_columns(r[:, :, None], noise.colour, present)[present][:, 0] for r in (seen, modelled))
    found = smoother.smooth(data)
    return (found.rows, found.value, found.std), smoother.smooth(model, found.intensity).value


def _along(
    trial: CandidateFit, without: CandidateFit, states: np.ndarray, stretch: slice, line: LinearisedRun
) -> np.ndarray:
    """States of the extended run that the model has without the effect too, and the inputs (R, nx + nu)."""
    names = trial.model.system.state_names
    kept = [names.index(n) for n in without.model.system.state_names]
    return np.column_stack([states[stretch][:, kept], line.u])
