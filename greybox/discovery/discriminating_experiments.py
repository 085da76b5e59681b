"""Which experiment would tell rivals apart: the one where the refitted rival stays farthest behind (T-optimality).

For a chosen model A and a rival B, ``T = min over B's constants of sum ((y_A - y_B) / noise)^2`` on a simulated experiment
(Atkinson, Fedorov 1975): the cost by which B would lose. The minimum is taken by one Gauss-Newton step from B's fitted
constants. Below about ten the experiment tells nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from greybox.discovery.problem import CandidateFit, DiscoveryProblem, predict_decrease
from greybox.experiment import Experiment
from greybox.signals import chirp, multisine
from greybox.simulation import simulate

# Experiments are compared on this many samples at most: enough to rank them.
MOST_SAMPLES = 4000
# Noise of a sensor that is not there yet, as a share of what it would show at most.
NEW_SENSOR = 0.01
SEED = 1


@dataclass(frozen=True)
class DiscriminatingExperiment:
    """An experiment, which outputs it needs, and the cost by which the rival would lose there."""

    experiment: str
    measured: tuple[str, ...]
    rival: tuple[str, ...]
    cost: float

    def __str__(self) -> str:
        return (
            f"{self.experiment}, with {', '.join(self.measured)} measured, would tell {' + '.join(self.rival)} apart"
            f" (expected chi-square {self.cost:.3g})"
        )


def rank_discriminating_experiments(
    bench: DiscoveryProblem, chosen: CandidateFit, rival: CandidateFit
) -> list[DiscriminatingExperiment]:
    """Every experiment of the menu with the sensors at hand, and with one more, best first."""
    at_hand = tuple(bench.noise_std)
    every = tuple(o.name for o in bench.plain.outputs)
    sensors = [at_hand] + [(*at_hand, name) for name in every if name not in at_hand]
    found = []
    for label, inputs in candidate_inputs(bench.experiments[0]).items():
        run = simulate(chosen.model, inputs)
        if run.overflow is not None:
            continue
        for measured in sensors:
            cost = _lost(bench, rival, run.record(), measured)
            if np.isfinite(cost):
                found.append(DiscriminatingExperiment(label, measured, rival.effects, cost))
    return sorted(found, key=lambda s: -s.cost)


def candidate_inputs(record: Experiment) -> dict[str, Experiment]:
    """Inputs that could be applied instead: the record's own at other amplitudes, a sweep, a multisine, steps, a slow ramp."""
    rows = min(record.rows, MOST_SAMPLES)
    period = float(np.median(record.intervals))
    time = np.arange(rows) * period
    peak = max(float(np.abs(u).max()) for u in record.inputs.values())
    low, high = 2 / time[-1], 0.1 / period
    generator = np.random.default_rng(SEED)
    shapes: Mapping[str, np.ndarray] = {
        "a sweep at full amplitude": chirp(time, low, high, peak),
        "a sweep at a fifth of the amplitude": chirp(time, low, high, peak / 5),
        "a multisine": multisine(time, low, high, peak / 3, generator),
        "steps up and down": peak * np.sign(np.sin(2 * np.pi * 5 / time[-1] * time)),
        "a slow triangle": peak * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * 2 / time[-1] * time)),
    }
    names = list(record.inputs)
    menu = {label: Experiment(label, time, dict.fromkeys(names, u), {}) for label, u in shapes.items()}
    own = record.window(0, rows)
    for label, factor in (
        ("the same input", 1.0),
        ("the same input at a third", 1 / 3),
        ("the same input doubled", 2.0),
    ):
        menu[label] = Experiment(label, own.time, {n: factor * u for n, u in own.inputs.items()}, {}, own.hold)
    return menu


def _lost(bench: DiscoveryProblem, rival: CandidateFit, record: Experiment, measured: tuple[str, ...]) -> float:
    """Cost of the rival on a record of the chosen model, after its constants have adapted."""
    seen = Experiment(record.name, record.time, record.inputs, {n: record.outputs[n] for n in measured}, record.hold)
    problem = bench.problem(rival.model, (seen,))
    std = problem.noise.std.copy()
    for j, output in enumerate(rival.model.outputs):
        if (
            output.name in measured and output.name not in bench.noise_std
        ):  # nobody has said how good that sensor would be
            std[j] = NEW_SENSOR * max(float(np.abs(record.outputs[output.name]).max()), 1e-300)
    problem = problem.with_noise(replace(problem.noise, std=std))
    e = problem.shooting(problem.variables).evaluate(np.zeros(problem.variables.size))
    return e.cost - predict_decrease(e, *problem.variables.bounds()) if np.isfinite(e.cost) else np.inf
