"""The missing signal of a named effect, from the data and from the model: the picture that convinces, or not.

With the extended model's parameters and without the effect, the residual holds the effect whole, nothing of it swallowed by other
parameters. The smoother that estimates an unknown signal from it also passes over the extended model's own run: where the effect is
right the two agree, whatever way the effect enters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from greybox.discovery.dependence import Dependence, rank_dependences
from greybox.discovery.disturbance_sites import (
    DisturbanceSite,
    LinearisedRun,
    linearise_run,
    list_disturbance_sites,
    unwhitened_shooting,
)
from greybox.discovery.failures import SearchStage
from greybox.discovery.localisation import find_worst_stretch, signal_units
from greybox.discovery.policy import EvidencePolicy, LocalisationPolicy
from greybox.discovery.problem import CandidateFit, DiscoveryProblem, with_start_values
from greybox.discovery.signal_smoother import SignalSmoother, SmoothedSignal, absorbed_basis, whiten_columns
from greybox.model import Model
from greybox.numerics import TINY
from greybox.values import ReadOnly


@dataclass(frozen=True, eq=False)
class EffectSignal(ReadOnly):
    """The signal that ``effect`` stands for at ``site`` of ``record``, in ``unit``.

    Parameters
    ----------
    time
        Seconds (K,).
    value, std
        Signal from the data and its standard deviation (K,).
    modelled
        The same signal from the extended model (K,).
    variable, variable_name, variable_unit
        Values (K,), name and unit of the variable that the signal depends on most.
    dependence
        The data's signal as a function of it.
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
    dependence: Dependence

    @property
    def explained(self) -> float:
        """One minus the variance of the difference over that of the signal."""
        return 1 - float(np.var(self.value - self.modelled) / max(np.var(self.value), TINY))


def estimate_effect_signals(
    problem: DiscoveryProblem, candidate: CandidateFit, policy: LocalisationPolicy
) -> tuple[EffectSignal, ...]:
    """One for each effect of an extended model, where its signal can be estimated."""
    signals = [
        problem.failures.attempt(
            SearchStage.EVIDENCE,
            (b.effect.name,),
            partial(_estimate, problem, candidate, b.effect.name, b.site, policy),
            None,
        )
        for b in candidate.model.bound_effects
    ]
    return tuple(signal for signal in signals if signal is not None)


def _estimate(
    problem: DiscoveryProblem, candidate: CandidateFit, effect: str, site_name: str, policy: LocalisationPolicy
) -> EffectSignal | None:
    without = _without_effect(problem, candidate, effect)
    shooting, zero = unwhitened_shooting(without), without.variables.here
    residuals = [r for r, _ in shooting.residuals(zero)]
    measured = [np.isfinite(record.samples(record.y)) for record in shooting.records]
    if not all(np.isfinite(r[present]).all() for r, present in zip(residuals, measured, strict=True)):
        return None  # without the effect the model overflows: nothing to compare with
    record, first, rows = find_worst_stretch(residuals, policy.most_rows)
    line = linearise_run(without, record, first, rows)
    sites = list_disturbance_sites(without.model, [o.name for o in without.model.outputs])
    site = next((s for s in sites if s.name == site_name), None)
    if site is None:
        return None
    shooting, zero = unwhitened_shooting(candidate), candidate.variables.here
    stretch = slice(first, first + rows)
    residual = residuals[record][stretch]
    of_effect = residual - shooting.residuals(zero)[record][0][stretch]
    from_data, modelled = _smooth_both(line, site, without, residual, of_effect, policy)
    names = [*without.model.system.state_names, *(i.name for i in without.model.inputs)]
    states = shooting.simulate(zero)[record][1]
    along_run = _states_and_inputs(candidate, without, states[stretch], line)[from_data.rows]
    units = signal_units(without.model)
    variables = {name: (values, units[name]) for name, values in zip(names, along_run.T, strict=True)}
    time = line.time[from_data.rows]
    ranked = [d for d in rank_dependences(time, from_data.value, variables, policy) if d.tone is None]
    if not ranked:
        return None
    best = ranked[0]
    return EffectSignal(
        effect,
        site.label,
        site.unit,
        candidate.problem.experiments[record].name,
        time,
        from_data.value,
        from_data.std,
        modelled,
        best.variable,
        best.unit,
        variables[best.variable][0],
        best,
    )


def acts_as_constant(candidate: CandidateFit, name: str, policy: EvidencePolicy) -> bool:
    """Whether an effect adds the same to every equation at every sample of the estimation records although elsewhere it would not.

    There a constant does as well: an input that never changes its sign shows an offset of a dead zone, not the zone.
    """
    model, without = candidate.model, candidate.model.without(name)
    if model.system.state_names != without.system.state_names or len(model.system.delays) != len(without.system.delays):
        return False  # it has a memory
    runs = unwhitened_shooting(candidate).simulate(candidate.variables.here)
    states, inputs = np.vstack([x for _, x in runs]), np.vstack([record.u for record in candidate.problem.records])

    def spread(states: np.ndarray, inputs: np.ndarray) -> float:
        """Standard deviation over rms of what the effect adds, all equations relative to their largest."""
        with_it, plain = (_evaluate_equations(m, states, inputs) for m in (model, without))
        added = (with_it - plain) / np.maximum(np.abs(with_it).max(axis=0), TINY)
        return float(np.sqrt(added.var(axis=0).sum() / max(float((added**2).mean(axis=0).sum()), TINY)))

    if not spread(states, inputs) <= policy.same_signal:
        return False
    generator = np.random.default_rng(policy.seed)
    elsewhere = [generator.uniform(-1, 1, v.shape) * np.abs(v).max(axis=0) for v in (states, inputs)]
    return spread(*elsewhere) > policy.constant_spread


def _evaluate_equations(model: Model, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Rates of the states and outputs (N, nx + ny) at N samples."""
    system = model.system
    p = [model.values[n] for n in system.parameter_names]
    functions = (system.rhs_function, system.output_function)
    return np.hstack([function(states.T, inputs.T, p).full().T for function in functions])


def _without_effect(problem: DiscoveryProblem, candidate: CandidateFit, name: str) -> CandidateFit:
    """The extended model at its own parameters, one effect taken out and nothing refitted."""
    model = candidate.model.without(name)
    estimation = problem.prepare(model)
    names, kept = candidate.model.system.state_names, model.system.state_names
    guess = candidate.variables.initial.guess[:, [names.index(n) for n in kept]]
    values = {n: v for n, v in candidate.model.values.items() if n in model.values}
    variables = with_start_values(estimation.variables, values)
    variables = replace(variables, initial=replace(variables.initial, guess=guess))
    return CandidateFit(model, np.nan, candidate.count, variables.size, estimation, variables, candidate.evaluation)


def _smooth_both(
    line: LinearisedRun,
    site: DisturbanceSite,
    candidate: CandidateFit,
    residual: np.ndarray,
    modelled: np.ndarray,
    policy: LocalisationPolicy,
) -> tuple[SmoothedSignal, np.ndarray]:
    """The signal from the data, and from the model's run, by one smoother."""
    noise, present = candidate.problem.noise, np.isfinite(residual)
    initial = absorbed_basis(line, 1 / noise.std, noise.colour, np.zeros((*residual.shape, 0)), present)
    smoother = SignalSmoother.at_site(line, site, 1 / noise.std, noise.colour, initial, present, policy)
    data, model = (whiten_columns(r[:, :, None], noise.colour, present)[present][:, 0] for r in (residual, modelled))
    from_data = smoother.smooth(data)
    return from_data, smoother.smooth(model, from_data.intensity).value


def _states_and_inputs(
    candidate: CandidateFit, without: CandidateFit, states: np.ndarray, line: LinearisedRun
) -> np.ndarray:
    """States of the extended run that the model has without the effect too, and the inputs (R, nx + nu)."""
    names = candidate.model.system.state_names
    kept = [names.index(n) for n in without.model.system.state_names]
    return np.column_stack([states[:, kept], line.u])
