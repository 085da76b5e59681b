"""A record that stands in for a measured one: the model itself, excited by a multilevel random input."""

from __future__ import annotations

import math

import numpy as np

from greybox.errors import DataError
from greybox.experiment import Experiment
from greybox.model import Model
from greybox.simulation import initial_state, simulate

LEAST_ROWS, MOST_ROWS = 1000, 12000
TIME_CONSTANTS = 10.0  # of the slowest decay
PER_TIME_CONSTANT = 2.0  # samples in the fastest one
SHARE = 0.01  # noise of each output, over its movement
SEED = 1


def generic_record(model: Model) -> tuple[Experiment, str]:
    """A simulated record of ``model`` at its start values, and what was assumed, in words.

    The input takes a new random level, between -1 and 1 in its unit, every few samples (between 0 and 1 where a state
    has a lower bound). Raises DataError where the model cannot be simulated that way.
    """
    step, rows = pace(model)
    generator = np.random.default_rng(SEED)
    low = 0.0 if any(math.isfinite(s.bounds[0]) for s in model.all_states) else -1.0
    time = step * np.arange(rows)
    inputs = {i.name: _levels(generator, rows, low) for i in model.inputs}
    run = simulate(model, {"time": time, **inputs})
    if run.overflow is not None:
        raise DataError(
            f"{model.title} cannot be simulated at its start values: it overflows after {run.overflow:.3g} s;"
            " give other values with --start, or a record to check it with"
        )
    outputs = {name: values for name, values in run.outputs.items() if np.ptp(values) > 0}
    if not outputs:
        raise DataError(f"{model.title}: no output moves when every input does; check the equations of the outputs")
    noise = {name: SHARE * float(np.std(values)) for name, values in outputs.items()}
    record = Experiment("generic", time, inputs, run.record(noise, generator).outputs)
    drive = ", ".join(f"{i.name} random between {low:g} and 1 {i.unit}".rstrip() for i in model.inputs) or "no input"
    return record, f"{rows} rows every {step:.3g} s, {drive}, noise {100 * SHARE:g} % of each output's movement"


def pace(model: Model) -> tuple[float, int]:
    """Sampling time in seconds and number of rows that show the model's fastest and slowest motion."""
    p = np.array(list(model.values.values()))
    jacobian = model.system.jacobian(initial_state(model), np.zeros(len(model.inputs)), p).full()
    if not np.isfinite(jacobian).all():
        return 0.01, LEAST_ROWS
    eigenvalues = np.linalg.eigvals(jacobian)
    size = np.abs(eigenvalues)
    moving = size > 1e-9 * max(size.max(initial=0.0), 1e-12)
    if not moving.any():
        return 0.01, LEAST_ROWS
    decays = -eigenvalues.real[moving & (eigenvalues.real < -1e-9 * size.max())]
    slowest = decays.min() if len(decays) else size[moving].min()
    step = 1 / (PER_TIME_CONSTANT * size[moving].max())
    rows = math.ceil(TIME_CONSTANTS / slowest / step)
    if rows > MOST_ROWS:  # the slow end counts: what is faster is integrated between the samples
        return TIME_CONSTANTS / slowest / MOST_ROWS, MOST_ROWS
    return step, max(rows, LEAST_ROWS)


def _levels(generator: np.random.Generator, rows: int, low: float) -> np.ndarray:
    """Random levels, each kept for a random number of samples, short and long ones alike."""
    lengths = np.ceil(np.exp(generator.uniform(0, np.log(rows / 20), rows))).astype(int)
    return np.repeat(generator.uniform(low, 1, rows), lengths)[:rows]
