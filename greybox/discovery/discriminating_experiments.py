"""Which experiment would tell rivals apart: the one where the refitted rival stays farthest behind (T-optimality).

For a chosen model A and a rival B, ``T = min over B's parameters of sum ((y_A - y_B) / noise)^2`` on a simulated experiment
(Atkinson, Fedorov 1975): the cost by which B would lose. The minimum is taken by one Gauss-Newton step from B's fitted
parameters. Below about ten the experiment shows nothing.

`greybox.experiment_design` measures by T as well, but stands above this package: it begins with a discovery, adds the information
of earlier records and needs its gradient along the input. Here the inputs are few, the rival keeps its bounds, and a proposal costs a
few runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from greybox.discovery.policy import ProposalPolicy
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.experiment import Experiment
from greybox.model.signals import Input
from greybox.model.sites import DRIVE, VALVE
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


NEW_COURSES = (
    InputKind.FULL_SWEEP,
    InputKind.SMALL_SWEEP,
    InputKind.MULTISINE,
    InputKind.STEPS,
    InputKind.SLOW_TRIANGLE,
)


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
    for kind, inputs in candidate_inputs(problem.experiments[0], problem.model.inputs, policy).items():
        run = simulate(selected.model, inputs)
        if run.overflow is not None:
            continue
        for measured in sensors:
            cost = _cost_of_rival(problem, rival, run.record(), measured, policy)
            if np.isfinite(cost):
                experiments.append(DiscriminatingExperiment(kind, measured, rival.effects, cost))
    return sorted(experiments, key=lambda e: -e.cost)


def candidate_inputs(
    record: Experiment, inputs: Sequence[Input], policy: ProposalPolicy
) -> dict[InputKind, Experiment]:
    """Inputs that could be applied instead: a sweep, a multisine, steps, a slow ramp, the record's own at other amplitudes.

    Each input moves within the range that it has in the record, and each in a course of its own. What nobody sets (an input with a
    role other than that of a drive or valve, such as an ambient temperature) stays as it was, and so does a constant input.
    """
    rows = min(record.rows, policy.most_samples)
    same = record.window(0, rows)
    period = float(np.median(record.intervals))
    time = np.arange(rows) * period
    set_by_user = {i.name for i in inputs if i.role in ("", DRIVE, VALVE)}
    ranges = {name: _InputRange.of(values) for name, values in record.inputs.items()}
    driven = [name for name in record.inputs if name in set_by_user and ranges[name].peak > 0]
    courses = {name: _courses(time, period, number, policy) for number, name in enumerate(driven)}
    shares = {InputKind.SMALL_SWEEP: 1 / 5, InputKind.MULTISINE: 1 / 3}
    experiments = {}
    for kind in NEW_COURSES:
        share = shares.get(kind, 1.0)
        moved = {name: ranges[name].middle + share * ranges[name].peak * courses[name][kind] for name in driven}
        experiments[kind] = Experiment(kind, time, {**same.inputs, **moved}, {})
    for kind, factor in {
        InputKind.SAME_INPUT: 1.0,
        InputKind.SAME_INPUT_SMALL: 1 / 3,
        InputKind.SAME_INPUT_DOUBLED: 2.0,
    }.items():
        rest = {name: ranges[name].rest for name in driven}
        scaled = {name: rest[name] + factor * (same.inputs[name] - rest[name]) for name in driven}
        experiments[kind] = Experiment(kind, same.time, {**same.inputs, **scaled}, {}, same.hold)
    return experiments


@dataclass(frozen=True)
class _InputRange:
    """Where an input moves in a record: about zero if it takes both signs, else about the middle of its range.

    ``rest`` is zero, or the end of the range that is nearest to it.
    """

    middle: float
    peak: float
    rest: float

    @classmethod
    def of(cls, values: np.ndarray) -> _InputRange:
        low, high = float(values.min()), float(values.max())
        if low < 0 < high:
            return cls(0.0, max(-low, high), 0.0)
        return cls((low + high) / 2, (high - low) / 2, low if low >= 0 else high)


def _courses(time: np.ndarray, period: float, number: int, policy: ProposalPolicy) -> dict[InputKind, np.ndarray]:
    """Courses between -1 and 1 for input ``number`` of those that are driven."""
    low, high = 2 / time[-1], 0.1 / period
    generator = np.random.default_rng(policy.seed + number)
    sweep = chirp(time, low, high, 1.0)
    steps, ramps = 5 + 2 * number, 2 + number
    return {
        InputKind.FULL_SWEEP: sweep if number % 2 == 0 else sweep[::-1],
        InputKind.SMALL_SWEEP: sweep if number % 2 == 0 else sweep[::-1],
        InputKind.MULTISINE: multisine(time, low, high, 1.0, generator),
        InputKind.STEPS: np.sign(np.sin(2 * np.pi * steps / time[-1] * time)),
        InputKind.SLOW_TRIANGLE: (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * ramps / time[-1] * time)),
    }


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
