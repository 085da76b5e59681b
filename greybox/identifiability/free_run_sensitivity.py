"""Sensitivities of any other model: free runs over records with a rich random input, differentiated by the kernel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from greybox.errors import DataError
from greybox.experiment import Experiment
from greybox.identifiability.generic_experiment import (
    draw_constants,
    draw_levels,
    fastest_and_slowest_rate,
    lowest_input_levels,
    touches_bounds,
)
from greybox.identifiability.policy import RANDOM_EXPERIMENT_POLICY, RandomExperimentPolicy
from greybox.identifiability.sensitivity import Sensitivity
from greybox.integrators import discretise
from greybox.kernel import make_kernel
from greybox.kernel.interpreted import InterpretedKernel
from greybox.model import Model
from greybox.model.signals import Parameter
from greybox.numerics import COLUMN_CUTOFF
from greybox.transcription import DecisionVector, InitialStates, SingleShooting, to_record


def compute_free_run_sensitivities(
    model: Model, at_rest: bool, seed: int, count: int, policy: RandomExperimentPolicy = RANDOM_EXPERIMENT_POLICY
) -> list[tuple[Sensitivity, np.ndarray]]:
    """Sensitivities at ``count`` random points, or a few more, and all parameters (np,) there.

    Constants that are zero, which switches an effect off, are given a value that shows. Raises DataError where the model
    cannot be run at any point. Points where a state touches its bound are taken only if there are no others: the
    equations are cut off there.
    """
    model = switch_on(model, np.random.default_rng((seed, 0)), policy)
    points: list[tuple[Sensitivity, np.ndarray]] = []
    touching: list[tuple[Sensitivity, np.ndarray]] = []
    draws = count * policy.tries_per_point
    plan = [*(policy.amplitudes * draws)[:draws], *policy.large_amplitudes]
    for k, amplitude in enumerate(plan):
        enough = len(points) >= count
        if enough and (amplitude not in policy.large_amplitudes or _have_influence(points).all()):
            continue
        generator = np.random.default_rng((seed, k))
        # Where runs overflow or touch bounds, points nearer to the nominal one are tried.
        p = draw_constants(model, generator, policy.constant_spread / 4 ** (k // count), policy.tries)
        point = _compute_point(set_parameters(model, p), at_rest, amplitude, generator, policy)
        if point is not None:
            (touching if point.doubtful > policy.integration_doubt else points).append((point, p))
    points = points or touching[:count]
    if not points:
        raise DataError(
            f"{model.title} overflows at every random point near its values: it cannot be checked;"
            " give other values with model.start(...), or with --start"
        )
    return points


def switch_on(
    model: Model, generator: np.random.Generator, policy: RandomExperimentPolicy = RANDOM_EXPERIMENT_POLICY
) -> Model:
    """``model`` with its free constants of zero at values that move the outputs by about a tenth.

    Some show only after others have been switched on, and too large a value may be cut off by the equations: hence
    several rounds.
    """
    off = [q for q in model.free_parameters if q.value == 0.0]
    names = [q.name for q in model.free_parameters]
    for _ in range(policy.switching_rounds if off else 0):
        slope = _measure_influence(model, generator, policy)
        values = {
            q.name: _choose_next_value(q, model.values[q.name], slope[names.index(q.name)], policy.switched_on_share)
            for q in off
        }
        if all(values[q.name] == model.values[q.name] for q in off):
            break
        model = model.start(**values)
    return model


def _choose_next_value(q: Parameter, value: float, slope: float, share: float) -> float:
    """The next value to try, given the present one and what a step of one in it (or of itself) does."""
    if value != 0.0:
        return value if slope > 0 else value / 10
    if slope == 0:
        return 0.0
    up, down = np.clip([share / slope, -share / slope], *q.bounds)
    return float(up or down)


def _measure_influence(model: Model, generator: np.random.Generator, policy: RandomExperimentPolicy) -> np.ndarray:
    """Movement of the outputs, as a share of their own, that a unit of each free constant makes (nf,)."""
    records = [_make_record(model, step, 1.0, generator, policy) for step in choose_sampling_times(model, policy)]
    start = np.asarray(model.system.start_function(np.array(list(model.values.values())))[0]).ravel()
    sensitivity = _compute_sensitivity(model, records, np.tile(start, (len(records), 1)), True, 1, policy)
    if sensitivity is None:
        return np.zeros(len(model.free_parameters))
    return sensitivity.lengths(list(sensitivity.blocks)) / np.sqrt(policy.run_rows * len(records))


def _have_influence(points: list[tuple[Sensitivity, np.ndarray]]) -> np.ndarray:
    """Which constants move an output at one of the points at least (nf,)."""
    return np.any([s.lengths(list(s.blocks)) > 0 for s, _ in points], axis=0)


def _compute_point(
    model: Model, at_rest: bool, amplitude: float, generator: np.random.Generator, policy: RandomExperimentPolicy
) -> Sensitivity | None:
    """One point, None where a run overflows. A second, finer run tells small singular values from integration error."""
    records = [_make_record(model, step, amplitude, generator, policy) for step in choose_sampling_times(model, policy)]
    start = np.asarray(model.system.start_function(np.array(list(model.values.values())))[0]).ravel()
    nudges = 1 + policy.state_offset * generator.uniform(-1, 1, (len(records), len(start))) * (not at_rest)
    factor = policy.substep_factor

    def compute(finer: int) -> Sensitivity | None:
        return _compute_sensitivity(model, records, start * nudges, at_rest, finer, policy)

    runs = ((finer, compute(finer)) for finer in (1, factor))
    finer, coarse = next(((finer, s) for finer, s in runs if s is not None), (1, None))
    if coarse is None:
        return None
    names = list(coarse.blocks)
    before = _singular_values(coarse, names)
    small = (before > COLUMN_CUTOFF) & (before < policy.recheck_below)
    if not small.any():
        return coarse
    fine = compute(factor * finer)
    if fine is None:
        return coarse
    shrunk = before[small & (_singular_values(fine, names) < before / factor)]
    return replace(coarse, doubtful=max(coarse.doubtful, 2 * float(shrunk.max(initial=0.0))))


def _singular_values(point: Sensitivity, names: list[str]) -> np.ndarray:
    return point.decompose(names).values


def set_parameters(model: Model, p: np.ndarray) -> Model:
    """``model`` with these values of all its parameters (np,)."""
    return model.start(**{name: float(v) for name, v in zip(model.values, p, strict=True)})


def choose_sampling_times(model: Model, policy: RandomExperimentPolicy = RANDOM_EXPERIMENT_POLICY) -> list[float]:
    """Sampling times (s) that show the fastest motion, and the slowest where one record cannot show both."""
    fastest, slowest = fastest_and_slowest_rate(model)
    if not fastest:
        return [0.01]
    short = 1 / (policy.run_samples_per_time_constant * fastest)
    long = min(policy.run_slow_time_constants / (slowest * policy.run_rows), policy.longest_step / fastest)
    return [short] if long < 2 * short else [short, long]


def _make_record(
    model: Model, step: float, amplitude: float, generator: np.random.Generator, policy: RandomExperimentPolicy
) -> Experiment:
    rows = policy.run_rows
    time = step * np.arange(rows)
    low = generator.choice(lowest_input_levels(model))
    inputs = {i.name: amplitude * draw_levels(generator, rows, low) for i in model.inputs}
    return Experiment("random", time, inputs, {o.name: np.zeros(rows) for o in model.outputs})


def _compute_sensitivity(
    model: Model,
    experiments: list[Experiment],
    starts: np.ndarray,
    at_rest: bool,
    finer: int,
    policy: RandomExperimentPolicy,
) -> Sensitivity | None:
    """Slopes of the outputs over the records with ``finer`` times the usual substeps; None where a run overflows."""
    records = tuple(to_record(model, e) for e in experiments)
    nx, ny = starts.shape[1], len(model.outputs)
    scale = np.where(starts[0] != 0, np.abs(starts[0]), 1.0)
    free = np.full(nx, not at_rest)
    p = np.array(list(model.values.values()))
    jacobians, touched = [], False
    for e, record in enumerate(records):
        variables = DecisionVector.of(model, InitialStates(starts[e : e + 1], free, scale))
        step = discretise(model.system, p, starts[e : e + 1], record.lengths)
        if finer > 1:
            step = discretise(model.system, p, starts[e : e + 1], record.lengths, substeps=finer * step.substeps)
        kernel = (
            InterpretedKernel(step)
            if variables.size * step.substeps <= policy.interpreted_operations
            else make_kernel(step)
        )
        shooting = SingleShooting(variables, step, kernel, (record,), np.ones(ny))
        ((residual, jacobian),) = shooting.residuals(variables.here)
        if not np.isfinite(jacobian).all():
            return None
        jacobians.append((np.std(residual, axis=0), jacobian))
        touched |= touches_bounds(model, shooting.simulate(variables.here)[0][1], policy)
    n, states_each = len(variables.which), int(free.sum())
    blocks = {}
    for j, output in enumerate(model.outputs):
        size = max(float(movement[j]) for movement, _ in jacobians) or 1.0
        parts = [jacobian[:, j, :] / size for _, jacobian in jacobians]
        states = np.zeros((sum(len(part) for part in parts), states_each * len(parts)))
        row = 0
        for e, part in enumerate(parts):
            states[row : row + len(part), states_each * e : states_each * (e + 1)] = part[:, n:]
            row += len(part)
        blocks[output.name] = states, np.vstack([part[:, :n] for part in parts])
    return Sensitivity(blocks, policy.bound_doubt if touched else policy.integration_doubt).compress()
