"""Where nothing special is true: random constants near the nominal ones, and records with a rich input."""

from __future__ import annotations

import math

import numpy as np

from greybox.errors import DataError, ModelError
from greybox.experiment import Experiment
from greybox.model import Model
from greybox.model.rules import check_constants
from greybox.simulation import declared_initial_state, simulate

LEAST_ROWS, MOST_ROWS = 1000, 12000
TIME_CONSTANTS = 10.0  # of the slowest decay
PER_TIME_CONSTANT = 2.0  # samples in the fastest one
SHARE = 0.01  # noise of each output, over its movement
SEED = 1
SPREAD = math.log(2.0)  # of a constant about its nominal value
TRIES = 20
NEAR = 1e-6  # of a bound, as a share of how far the state moves


def simulate_generic_record(model: Model) -> tuple[Experiment, str]:
    """A simulated record of ``model`` at its start values, and what was assumed, in words.

    The input takes a new random level, between -1 and 1 in its unit, every few samples (between 0 and 1 where a state
    would reach its bound otherwise). Raises DataError where the model cannot be simulated that way.
    """
    step, rows = choose_sampling(model)
    time = step * np.arange(rows)
    for low in lowest_input_levels(model):
        generator = np.random.default_rng(SEED)
        inputs = {i.name: draw_levels(generator, rows, low) for i in model.inputs}
        run = simulate(model, {"time": time, **inputs})
        if run.overflow is None and not touches_bounds(model, np.column_stack(list(run.states.values()))):
            break
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


def choose_sampling(model: Model) -> tuple[float, int]:
    """Sampling time in seconds and number of rows that show the model's fastest and slowest motion."""
    fastest, slowest = fastest_and_slowest_rate(model)
    if not fastest:
        return 0.01, LEAST_ROWS
    step = 1 / (PER_TIME_CONSTANT * fastest)
    rows = math.ceil(TIME_CONSTANTS / slowest / step)
    if rows > MOST_ROWS:  # the slow end counts: what is faster is integrated between the samples
        return TIME_CONSTANTS / slowest / MOST_ROWS, MOST_ROWS
    return step, max(rows, LEAST_ROWS)


def fastest_and_slowest_rate(model: Model) -> tuple[float, float]:
    """The fastest pole and the slowest decay at the start values, in 1/s; zeros for a model without either."""
    p = np.array(list(model.values.values()))
    jacobian = model.system.jacobian(declared_initial_state(model), np.zeros(len(model.inputs)), p).full()
    if not np.isfinite(jacobian).all():
        return 0.0, 0.0
    eigenvalues = np.linalg.eigvals(jacobian)
    size = np.abs(eigenvalues)
    moving = size > 1e-9 * max(size.max(initial=0.0), 1e-12)
    if not moving.any():
        return 0.0, 0.0
    decays = -eigenvalues.real[moving & (eigenvalues.real < -1e-9 * size.max())]
    return float(size[moving].max()), float(decays.min() if len(decays) else size[moving].min())


def lowest_input_levels(model: Model) -> tuple[float, ...]:
    """Least levels of a generic input to try: where a state has a lower bound, an input below zero may take it there."""
    return (-1.0, 0.0) if any(math.isfinite(s.bounds[0]) for s in model.all_states) else (-1.0,)


def touches_bounds(model: Model, x: np.ndarray) -> bool:
    """Whether a state, of (N, nx), comes to its bounds."""
    low, high = np.array([s.bounds for s in model.all_states]).T
    near = NEAR * np.ptp(x, axis=0)
    return bool((x <= low + near).any() or (x >= high - near).any())


def draw_levels(generator: np.random.Generator, rows: int, low: float) -> np.ndarray:
    """Random levels (rows,), each kept for a random number of samples, short and long ones alike."""
    lengths = np.ceil(np.exp(generator.uniform(0, np.log(rows / 20), rows))).astype(int)
    return np.repeat(generator.uniform(low, 1, rows), lengths)[:rows]


def draw_constants(model: Model, generator: np.random.Generator, spread: float = SPREAD) -> np.ndarray:
    """All parameters (np,): free ones at random within ``e^spread`` times their values, fixed ones as they are.

    Inside bounds and rules; where these leave no room the spread shrinks, down to the values themselves.
    """
    parameters = model.all_parameters
    for _ in range(TRIES):
        draw = generator.uniform(-1.0, 1.0, len(parameters))
        p = [
            q.value if q.fixed else _drawn(q.value, q.bounds, spread * r) for q, r in zip(parameters, draw, strict=True)
        ]
        try:
            check_constants(model.title, model.rules, model.parameters_at(p))
        except ModelError:
            spread /= 2
            continue
        return np.array(p)
    return np.array([q.value for q in parameters])


def _drawn(value: float, bounds: tuple[float, float], exponent: float) -> float:
    low, high = bounds
    if value == 0.0:  # off: a little of it, on the side where it may be
        span = high - low if math.isfinite(high - low) else 1.0
        drawn = 0.01 * span * (abs(exponent) if low == 0.0 else exponent)
    else:
        drawn = value * math.exp(exponent)
    return min(max(drawn, low), high)
