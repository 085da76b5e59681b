"""Which experiment would tell rivals apart: the one where the refitted rival stays farthest behind (T-optimality).

For a chosen model A and a rival B, ``T = min over B's parameters of sum ((y_A - y_B) / noise)^2`` on a simulated experiment
(Atkinson, Fedorov 1975): the cost by which B would lose. The minimum is taken by one Gauss-Newton step from B's fitted
parameters. Below about ten the experiment shows nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from greybox.discovery.policy import ProposalPolicy
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.experiment import Experiment
from greybox.numerics import TINY
from greybox.signals import chirp, multisine
from greybox.simulation import simulate


class InputKind(StrEnum):
    """Inputs that could be applied instead of those of the record."""

    FULL_SWEEP = "full_sweep"
    SMALL_SWEEP = "small_sweep"
    MULTISINE = "multisine"
    STEPS = "steps"
    SLOW_TRIANGLE = "slow_triangle"
    SAME_INPUT = "same_input"
    SAME_INPUT_SMALL = "same_input_small"
    SAME_INPUT_DOUBLED = "same_input_doubled"


@dataclass(frozen=True)
class DiscriminatingExperiment:
    """An experiment, which outputs it needs, and the cost by which the rival would lose there."""

    experiment: InputKind
    measured: tuple[str, ...]
    rival: tuple[str, ...]
    cost: float


def rank_discriminating_experiments(
    problem: DiscoveryProblem, selected: CandidateFit, rival: CandidateFit, policy: ProposalPolicy
) -> list[DiscriminatingExperiment]:
    """Every candidate input with the present sensors, and with one more, best first."""
    installed = tuple(problem.noise_std)
    outputs = tuple(o.name for o in problem.model.outputs)
    sensors = [installed] + [(*installed, name) for name in outputs if name not in installed]
    experiments = []
    for kind, inputs in candidate_inputs(problem.experiments[0], policy).items():
        run = simulate(selected.model, inputs)
        if run.overflow is not None:
            continue
        for measured in sensors:
            cost = _cost_of_rival(problem, rival, run.record(), measured, policy)
            if np.isfinite(cost):
                experiments.append(DiscriminatingExperiment(kind, measured, rival.effects, cost))
    return sorted(experiments, key=lambda e: -e.cost)


def candidate_inputs(record: Experiment, policy: ProposalPolicy) -> dict[InputKind, Experiment]:
    """Inputs that could be applied instead: a sweep, a multisine, steps, a slow ramp, the record's own at other amplitudes."""
    rows = min(record.rows, policy.most_samples)
    period = float(np.median(record.intervals))
    time = np.arange(rows) * period
    peak = max(float(np.abs(u).max()) for u in record.inputs.values())
    low, high = 2 / time[-1], 0.1 / period
    generator = np.random.default_rng(policy.seed)
    signals = {
        InputKind.FULL_SWEEP: chirp(time, low, high, peak),
        InputKind.SMALL_SWEEP: chirp(time, low, high, peak / 5),
        InputKind.MULTISINE: multisine(time, low, high, peak / 3, generator),
        InputKind.STEPS: peak * np.sign(np.sin(2 * np.pi * 5 / time[-1] * time)),
        InputKind.SLOW_TRIANGLE: peak * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * 2 / time[-1] * time)),
    }
    names = list(record.inputs)
    experiments = {kind: Experiment(kind, time, dict.fromkeys(names, u), {}) for kind, u in signals.items()}
    same = record.window(0, rows)
    factors = {
        InputKind.SAME_INPUT: 1.0,
        InputKind.SAME_INPUT_SMALL: 1 / 3,
        InputKind.SAME_INPUT_DOUBLED: 2.0,
    }
    for kind, factor in factors.items():
        inputs = {n: factor * u for n, u in same.inputs.items()}
        experiments[kind] = Experiment(kind, same.time, inputs, {}, same.hold)
    return experiments


def _cost_of_rival(
    problem: DiscoveryProblem,
    rival: CandidateFit,
    record: Experiment,
    measured: tuple[str, ...],
    policy: ProposalPolicy,
) -> float:
    """Cost of the rival on a record of the selected model, after its parameters have adapted."""
    outputs = {n: record.outputs[n] for n in measured}
    estimation = problem.prepare(
        rival.model, (Experiment(record.name, record.time, record.inputs, outputs, record.hold),)
    )
    std = estimation.noise.std.copy()
    for j, output in enumerate(rival.model.outputs):
        is_new = output.name in measured and output.name not in problem.noise_std
        if is_new:  # how good that sensor would be is not known
            std[j] = policy.new_sensor_noise * max(float(np.abs(record.outputs[output.name]).max()), TINY)
    estimation = estimation.with_noise(replace(estimation.noise, std=std))
    e = estimation.shooting(estimation.variables).evaluate(estimation.variables.here)
    if not (np.isfinite(e.cost) and e.is_finite):
        return np.inf
    return e.cost - e.predicted_decrease(*estimation.variables.bounds())
