"""The missing signal of a named effect, from the data and from the model: the picture that convinces, or not.

With the extended model's parameters and without the effect, the residual holds the effect whole, nothing of it swallowed by other
parameters. The smoother that estimates an unknown signal from it also passes over the extended model's own run: where the effect is
right the two agree, whatever way the effect enters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from greybox.base.json_shape import to_values
from greybox.base.numerics import TINY
from greybox.base.values import ReadOnly
from greybox.discovery import localisation
from greybox.discovery.curve_shape import Dependence, rank_dependences
from greybox.discovery.disturbance_sites import (
    DisturbanceSite,
    LinearisedRun,
    SignalSmoother,
    SiteKind,
    SmoothedSignal,
    absorbed_basis,
    linearise_run,
    list_disturbance_sites,
    site_label,
    unwhitened_shooting,
    whiten_columns,
)
from greybox.discovery.execution import SearchStage
from greybox.discovery.holdout import HoldoutError
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate, share_values
from greybox.estimation.result import Fit
from greybox.model.model import Model

# What a model leaves on the validation records: how much, where it comes from and what it depends on.


@dataclass(frozen=True)
class RemainingError:
    """The error that a model leaves in one output.

    Parameters
    ----------
    output, rmse, unit
        Rms error on the validation records, in ``unit``.
    noise_ratio
        The same over the noise; None where nobody knows the noise.
    sites
        Labels of the likeliest sites that it comes from; empty where none explains it.
    dependence
        The missing signal there as a function of the variable that it depends on most; None where it depends on none.
    grows_with_amplitude
        Whether it is larger where the output moves more.
    """

    output: str
    rmse: float
    unit: str
    noise_ratio: float | None
    sites: tuple[str, ...]
    dependence: Dependence | None
    grows_with_amplitude: bool

    KEYS: ClassVar[str] = "rmse unit where as=seen_as noise_ratio grows_with_amplitude"

    @property
    def where(self) -> str | None:
        """Its sites; None where none explains it."""
        return " or ".join(self.sites) or None

    @property
    def seen_as(self) -> str | None:
        """As a function of what it is seen; None where of nothing."""
        if self.dependence is None:
            return "amplitude" if self.grows_with_amplitude else None
        return str(self.dependence)

    def to_values(self) -> dict[str, Any]:
        """What it says, ready for a finding."""
        return {
            "rmse": self.rmse,
            "unit": self.unit,
            "noise_ratio": self.noise_ratio,
            "sites": list(self.sites),
            "dependence": to_values(self.dependence),
            "grows_with_amplitude": self.grows_with_amplitude,
        }


def measure_remaining_error(
    fit: Fit,
    holdout: Mapping[str, HoldoutError],
    location: localisation.ResidualLocalisation,
    uncounted: int,
) -> Mapping[str, RemainingError]:
    """By output what a model leaves.

    Parameters
    ----------
    fit, holdout
        The validated fit, and its errors on the validation records.
    location
        That of its residual on the estimation records.
    uncounted
        Rows at the start of each validation record that do not count.
    """
    relevant = next((d for d in location.dependences if d.is_relevant), None)
    leading = set(location.likeliest[:1])
    sensors = {site_label(SiteKind.SENSOR, name): name for name in fit.misfit}

    def sites(output: str) -> tuple[str, ...]:
        # What a sensor adds stands in its own output and in no other; what acts in the plant may show in all of them.
        return tuple(label for label in location.likeliest if sensors.get(label, output) == output)

    return {
        name: RemainingError(
            name,
            error.after,
            error.unit,
            error.after / error.floor if error.is_floor_known else None,
            sites(name),
            # The dependence is that of the signal at the leading site: of an output that this does not reach it says nothing.
            relevant if leading & set(sites(name)) else None,
            _grows_with_amplitude(fit, name, uncounted),
        )
        for name, error in holdout.items()
    }


# Blocks in which the validation records are divided: errors of neighbouring samples are not independent.
EVIDENCE_BLOCKS = 24
# Blocks from which it is looked at whether the error grows with the amplitude...
LEAST_BLOCKS = 6
# ...if the largest amplitude of a block is so many times the smallest...
AMPLITUDE_RANGE = 1.5
# ...and it does so from this rank correlation of error and amplitude on.
AMPLITUDE_CORRELATION = 0.6


def _grows_with_amplitude(fit: Fit, output: str, uncounted: int) -> bool:
    """Whether the error of blocks of the validation records rises with the movement of the output there."""
    errors, movements = [], []
    for trace in (t for t in fit.validation.traces if output in t.measured):
        residual, measured = trace.residual(output)[uncounted:], trace.measured[output][uncounted:]
        pieces = max(EVIDENCE_BLOCKS // max(len(fit.validation.traces), 1), 2)
        for part, signal in zip(np.array_split(residual, pieces), np.array_split(measured, pieces), strict=True):
            present = np.isfinite(part)
            if present.sum() > 1:
                errors.append(float(np.sqrt(np.mean(part[present] ** 2))))
                movements.append(float(np.std(signal[present])))
    if len(errors) < LEAST_BLOCKS or max(movements) < AMPLITUDE_RANGE * max(min(movements), TINY):
        return False
    ranks = np.array([np.argsort(np.argsort(values)) for values in (errors, movements)], float)
    return bool(np.corrcoef(ranks)[0, 1] > AMPLITUDE_CORRELATION)


@dataclass(frozen=True, eq=False)
class EffectSignal(ReadOnly):
    """The signal that an effect stands for, as the data have it.

    Parameters
    ----------
    effect, site, record
        The effect, where it acts, and the record that it is seen in.
    unit
        Unit of the signal.
    time
        Seconds (K,).
    value, std
        Signal from the data and its standard deviation (K,).
    modelled
        The same signal from the extended model (K,).
    variable, variable_name, variable_unit
        Values (K,), name and unit of the variable of which the effect adds a function; where there is none, of that on which the signal
        depends most.
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

    @property
    def rms(self) -> float:
        """Root mean square of the signal from the data, in ``unit``."""
        return float(np.sqrt(np.mean(self.value**2)))

    KEYS: ClassVar[str] = "effect site unit rms explained dependence=said"

    @property
    def said(self) -> Mapping[str, Any]:
        """What its dependence says, without the averages in bins."""
        values: dict[str, Any] = to_values(self.dependence)
        return values


def estimate_effect_signals(problem: DiscoveryProblem, candidate: FittedCandidate) -> tuple[EffectSignal, ...]:
    """One for each effect of an extended model, where its signal can be estimated."""
    signals = [
        problem.failures.attempt(
            SearchStage.EVIDENCE,
            (b.effect.name,),
            partial(_estimate, problem, candidate, b.effect.name, b.site),
            None,
        )
        for b in candidate.model.bound_effects
    ]
    return tuple(signal for signal in signals if signal is not None)


def _estimate(
    problem: DiscoveryProblem, candidate: FittedCandidate, effect: str, site_name: str
) -> EffectSignal | None:
    without = _without_effect(problem, candidate, effect)
    shooting, zero = unwhitened_shooting(without), without.variables.here
    residuals = [r for r, _ in shooting.residuals(zero)]
    measured = [np.isfinite(record.samples(record.y)) for record in shooting.records]
    if not all(np.isfinite(r[present]).all() for r, present in zip(residuals, measured, strict=True)):
        return None  # without the effect the model overflows: nothing to compare with
    record, first, rows = localisation.find_worst_stretch(residuals, localisation.LOCALISATION_MOST_ROWS)
    line = linearise_run(without, record, first, rows)
    sites = list_disturbance_sites(without.model, [o.name for o in without.model.outputs])
    site = next((s for s in sites if s.name == site_name), None)
    if site is None:
        return None
    shooting, zero = unwhitened_shooting(candidate), candidate.variables.here
    stretch = slice(first, first + rows)
    residual = residuals[record][stretch]
    of_effect = residual - shooting.residuals(zero)[record][0][stretch]
    from_data, modelled = _smooth_both(line, site, without, residual, of_effect)
    names = [*without.model.system.state_names, *(i.name for i in without.model.inputs)]
    states = shooting.simulate(zero)[record][1]
    along_run = _states_and_inputs(candidate, without, states[stretch], line)[from_data.rows]
    units = localisation.signal_units(without.model)
    along = zip(names, along_run.T, strict=True)
    variables = {name: (values, units[name]) for name, values in along if name not in without.model.auxiliary}
    time = line.time[from_data.rows]
    ranked = [d for d in rank_dependences(time, from_data.value, variables) if d.tone is None]
    if not ranked:
        return None
    own_variable = find_own_variable(candidate, effect)
    best = next((d for d in ranked if d.variable == own_variable), ranked[0])
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


# How far what an effect adds may be from a function of one variable, over its standard deviation, for that to be its own variable.
# Neighbouring samples of a smooth law differ by a few percent, those of a step by a tenth.
FUNCTION_SCATTER = 0.15


def find_own_variable(candidate: FittedCandidate, name: str) -> str:
    """The state or input of which an effect adds a function, sample by sample; "" for one of several, and for one with a memory.

    Of dry friction it is the velocity, even if the body never slides.
    """
    system = candidate.model.system
    dry = next((d for d in system.dry if d.effect == name), None)
    if dry is not None:
        return system.state_names[dry.state]
    added = _AddedSignal.along_run(candidate, name)
    if added is None:
        return ""
    columns = np.column_stack([added.states, added.inputs]).T
    names = [*system.state_names, *system.input_names]
    scatter = {variable: _scatter(z, added.values) for variable, z in zip(names, columns, strict=True)}
    best = min(scatter, key=lambda variable: scatter[variable])
    return best if scatter[best] <= FUNCTION_SCATTER else ""


@dataclass(frozen=True, eq=False)
class _AddedSignal:
    """What an effect without memory adds to rates and outputs at N samples of the estimation records, each relative to its largest value.

    ``states`` (N, nx), ``inputs`` (N, nu), ``values`` (N, nx + ny).
    """

    states: np.ndarray
    inputs: np.ndarray
    values: np.ndarray

    @classmethod
    def along_run(cls, candidate: FittedCandidate, name: str) -> _AddedSignal | None:
        """None for an effect with a memory."""
        system, plain = candidate.model.system, candidate.model.without(name).system
        if system.state_names != plain.state_names or len(system.delays) != len(plain.delays):
            return None
        runs = unwhitened_shooting(candidate).simulate(candidate.variables.here)
        states, inputs = (
            np.vstack(rows) for rows in ([x for _, x in runs], [record.u for record in candidate.problem.records])
        )
        return cls.at(candidate, name, states, inputs)

    @classmethod
    def at(cls, candidate: FittedCandidate, name: str, states: np.ndarray, inputs: np.ndarray) -> _AddedSignal:
        """At any samples."""
        models = (candidate.model, candidate.model.without(name))
        with_it, plain = (_evaluate_equations(model, states, inputs) for model in models)
        # Rates along a run that went astray are beyond all numbers: what differs there is no function of anything.
        with np.errstate(invalid="ignore"):
            return cls(states, inputs, (with_it - plain) / np.maximum(np.abs(with_it).max(axis=0), TINY))


def _scatter(z: np.ndarray, values: np.ndarray) -> float:
    """How far signals (N, n) are from functions of ``z`` (N,), over their own standard deviation: from sample to sample along ``z``."""
    ordered = values[np.argsort(z, kind="stable")]
    if np.ptp(z) == 0:
        return math.inf
    steps = 0.5 * (np.diff(ordered, axis=0) ** 2).mean(axis=0).sum()
    return float(np.sqrt(steps / max(float(values.var(axis=0).sum()), TINY)))


def _evaluate_equations(model: Model, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Rates of the states and outputs (N, nx + ny) at N samples."""
    system = model.system
    p = [model.values[n] for n in system.parameter_names]
    functions = (system.rhs_function, system.output_function)
    return np.hstack([function(states.T, inputs.T, p).full().T for function in functions])


def _without_effect(problem: DiscoveryProblem, candidate: FittedCandidate, name: str) -> FittedCandidate:
    """The extended model at its own parameters, one effect taken out and nothing refitted."""
    model = candidate.model.without(name)
    estimation = problem.prepare(model)
    names, kept = candidate.model.system.state_names, model.system.state_names
    guess = candidate.variables.initial.guess[:, [names.index(n) for n in kept]]
    variables = estimation.variables.start_at(share_values(candidate.model, model))
    variables = replace(variables, initial=replace(variables.initial, guess=guess))
    return FittedCandidate(model, np.nan, candidate.count, variables.size, estimation, variables, candidate.evaluation)


def _smooth_both(
    line: LinearisedRun,
    site: DisturbanceSite,
    candidate: FittedCandidate,
    residual: np.ndarray,
    modelled: np.ndarray,
) -> tuple[SmoothedSignal, np.ndarray]:
    """The signal from the data, and from the model's run, by one smoother."""
    noise, present = candidate.problem.noise, np.isfinite(residual)
    initial = absorbed_basis(line, 1 / noise.std, noise.colour, np.zeros((*residual.shape, 0)), present)
    smoother = SignalSmoother.at_site(line, site, 1 / noise.std, noise.colour, initial, present)
    data, model = (whiten_columns(r[:, :, None], noise.colour, present)[present][:, 0] for r in (residual, modelled))
    from_data = smoother.smooth(data)
    return from_data, smoother.smooth(model, from_data.intensity).value


def _states_and_inputs(
    candidate: FittedCandidate, without: FittedCandidate, states: np.ndarray, line: LinearisedRun
) -> np.ndarray:
    """States of the extended run that the model has without the effect too, and the inputs (R, nx + nu)."""
    names = candidate.model.system.state_names
    kept = [names.index(n) for n in without.model.system.state_names]
    return np.column_stack([states[:, kept], line.u])
