"""Sensitivities of any other model: free runs over records with a rich random input, differentiated by the kernel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from greybox.errors import DataError
from greybox.experiment import Experiment
from greybox.identifiability.generic_experiment import (
    SPREAD,
    draw_constants,
    draw_levels,
    fastest_and_slowest_rate,
    lowest_input_levels,
    touches_bounds,
)
from greybox.identifiability.sensitivity import ROUNDING, Sensitivity
from greybox.integrators import discretise
from greybox.kernel import make_kernel
from greybox.kernel.interpreted import InterpretedKernel
from greybox.model import Model
from greybox.model.signals import Parameter
from greybox.transcription import DecisionVector, InitialStates, SingleShooting, to_record

ROWS = 600  # of each record
FASTEST, SLOWEST = 3.0, 5.0  # samples in the fastest time constant; slowest time constants in a record
LONGEST = 20.0  # fastest time constants between two samples: a leak that takes a year is left to its beginning
# Of the input, in its unit. The later ones are for constants that show at none of the first: a dead zone, a saturation.
AMPLITUDES, LARGER = (1.0, 0.3, 3.0), (30.0, 1e3, 1e5, 1e7)
SWITCHED_ON = 0.1  # share of the outputs' movement that an effect makes which is off, such as a friction of zero
STATES = 0.05  # share of its start value by which an initial state is off
ROUNDS = 4  # of switching on
# Singular values up to the first may be integration error, or a state that touches its bound. Up to the second they are
# looked at again with finer steps: integration error shrinks.
INFORMATION, SMALL = 1e-6, 1e-5
AT_BOUND = 1e-3  # doubtful where a state touches its bound
FINER = 4  # times as many substeps
FEW = 100  # directions times substeps that CasADi's virtual machine runs in less time than it takes to compile them
TRIES = 3  # of other constants, where a run overflows


def compute_free_run_sensitivities(
    model: Model, at_rest: bool, seed: int, count: int
) -> list[tuple[Sensitivity, np.ndarray]]:
    """Sensitivities at ``count`` random points, or a few more, and all parameters (np,) there.

    Constants that are zero, which switches an effect off, are given a value that shows. Raises DataError where the model
    cannot be run at any point. Points where a state touches its bound are taken only if there are no others: the
    equations are cut off there.
    """
    model = switch_on(model, np.random.default_rng((seed, 0)))
    found: list[tuple[Sensitivity, np.ndarray]] = []
    touching: list[tuple[Sensitivity, np.ndarray]] = []
    plan = [*(AMPLITUDES * count * TRIES)[: count * TRIES], *LARGER]
    for k, amplitude in enumerate(plan):
        if len(found) >= count and (amplitude not in LARGER or _influence(found).all()):
            continue
        generator = np.random.default_rng((seed, k))
        # Where runs overflow or touch bounds, points nearer to the nominal one are tried.
        p = draw_constants(model, generator, SPREAD / 4 ** (k // count))
        point = _point(set_parameters(model, p), at_rest, amplitude, generator)
        if point is not None:
            (touching if point.doubtful > INFORMATION else found).append((point, p))
    found = found or touching[:count]
    if not found:
        raise DataError(
            f"{model.title} overflows at every random point near its values: nothing can be said about it;"
            " give other values with model.start(...), or with --start"
        )
    return found


def switch_on(model: Model, generator: np.random.Generator) -> Model:
    """``model`` with its free constants of zero at values that move the outputs by about a tenth.

    Some show only after others have been switched on, and too large a value may be cut off by the equations: hence
    several rounds.
    """
    off = [q for q in model.free_parameters if q.value == 0.0]
    names = [q.name for q in model.free_parameters]
    for _ in range(ROUNDS if off else 0):
        slope = _slopes(model, generator)
        values = {q.name: _switched(q, model.values[q.name], slope[names.index(q.name)]) for q in off}
        if all(values[q.name] == model.values[q.name] for q in off):
            break
        model = model.start(**values)
    return model


def _switched(q: Parameter, value: float, slope: float) -> float:
    """The next value to try, given the present one and what a step of one in it (or of itself) does."""
    if value != 0.0:
        return value if slope > 0 else value / 10
    if slope == 0:
        return 0.0
    up, down = np.clip([SWITCHED_ON / slope, -SWITCHED_ON / slope], *q.bounds)
    return float(up or down)


def _slopes(model: Model, generator: np.random.Generator) -> np.ndarray:
    """Movement of the outputs, as a share of their own, that a unit of each free constant makes (nf,)."""
    records = [_record(model, step, 1.0, generator) for step in choose_sampling_times(model)]
    start = np.asarray(model.system.start_function(np.array(list(model.values.values())))[0]).ravel()
    found = _sensitivity(model, records, np.tile(start, (len(records), 1)), True, 1)
    if found is None:
        return np.zeros(len(model.free_parameters))
    return found.lengths(list(found.blocks)) / np.sqrt(ROWS * len(records))


def _influence(points: list[tuple[Sensitivity, np.ndarray]]) -> np.ndarray:
    """Which constants move an output at one of the points at least (nf,)."""
    return np.any([s.lengths(list(s.blocks)) > 0 for s, _ in points], axis=0)


def _point(here: Model, at_rest: bool, amplitude: float, generator: np.random.Generator) -> Sensitivity | None:
    """One point, None where a run overflows. A second, finer run tells small singular values from integration error."""
    records = [_record(here, step, amplitude, generator) for step in choose_sampling_times(here)]
    start = np.asarray(here.system.start_function(np.array(list(here.values.values())))[0]).ravel()
    nudges = 1 + STATES * generator.uniform(-1, 1, (len(records), len(start))) * (not at_rest)
    runs = ((finer, _sensitivity(here, records, start * nudges, at_rest, finer)) for finer in (1, FINER))
    finer, coarse = next(((finer, s) for finer, s in runs if s is not None), (1, None))
    if coarse is None:
        return None
    names = list(coarse.blocks)
    before = _values(coarse, names)
    small = (before > ROUNDING) & (before < SMALL)
    if not small.any():
        return coarse
    fine = _sensitivity(here, records, start * nudges, at_rest, FINER * finer)
    if fine is None:
        return coarse
    shrunk = before[small & (_values(fine, names) < before / FINER)]
    return replace(coarse, doubtful=max(coarse.doubtful, 2 * float(shrunk.max(initial=0.0))))


def _values(point: Sensitivity, names: list[str]) -> np.ndarray:
    return np.linalg.svd(point.of(names), compute_uv=False)


def set_parameters(model: Model, p: np.ndarray) -> Model:
    """``model`` with these values of all its parameters (np,)."""
    return model.start(**{name: float(v) for name, v in zip(model.values, p, strict=True)})


def choose_sampling_times(model: Model) -> list[float]:
    """Sampling times that show the fastest motion, and the slowest where one record cannot show both."""
    fastest, slowest = fastest_and_slowest_rate(model)
    if not fastest:
        return [0.01]
    short, long = 1 / (FASTEST * fastest), min(SLOWEST / (slowest * ROWS), LONGEST / fastest)
    return [short] if long < 2 * short else [short, long]


def _record(model: Model, step: float, amplitude: float, generator: np.random.Generator) -> Experiment:
    time = step * np.arange(ROWS)
    low = generator.choice(lowest_input_levels(model))
    inputs = {i.name: amplitude * draw_levels(generator, ROWS, low) for i in model.inputs}
    return Experiment("random", time, inputs, {o.name: np.zeros(ROWS) for o in model.outputs})


def _sensitivity(
    model: Model, experiments: list[Experiment], starts: np.ndarray, at_rest: bool, finer: int
) -> Sensitivity | None:
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
        kernel = InterpretedKernel(step) if variables.size * step.substeps <= FEW else make_kernel(step)
        shooting = SingleShooting(variables, step, kernel, (record,), np.ones(ny))
        ((residual, jacobian),) = shooting.residuals(np.zeros(variables.size))
        if not np.isfinite(jacobian).all():
            return None
        jacobians.append((np.std(residual, axis=0), jacobian))
        touched |= touches_bounds(model, shooting.simulate(np.zeros(variables.size))[0][1])
    n, own = len(variables.which), int(free.sum())
    blocks = {}
    for j, output in enumerate(model.outputs):
        size = max(float(movement[j]) for movement, _ in jacobians) or 1.0
        parts = [jacobian[:, j, :] / size for _, jacobian in jacobians]
        states = np.zeros((sum(len(part) for part in parts), own * len(parts)))
        row = 0
        for e, part in enumerate(parts):
            states[row : row + len(part), own * e : own * (e + 1)] = part[:, n:]
            row += len(part)
        blocks[output.name] = states, np.vstack([part[:, :n] for part in parts])
    return Sensitivity(blocks, AT_BOUND if touched else INFORMATION).compress()
