"""Where nothing special is true: random constants near the nominal ones, and records with a rich input."""

from __future__ import annotations

import math

import numpy as np

from greybox.errors import DataError, ModelError
from greybox.experiment import Experiment
from greybox.findings import Finding
from greybox.identifiability.findings import IdentifiabilityCode
from greybox.identifiability.policy import RANDOM_EXPERIMENT_POLICY, RandomExperimentPolicy
from greybox.model import Model
from greybox.model.rules import check_constants
from greybox.numerics import INTEGRATING_POLE, TINY
from greybox.simulation import declared_initial_state, simulate


def simulate_generic_record(
    model: Model, policy: RandomExperimentPolicy = RANDOM_EXPERIMENT_POLICY
) -> tuple[Experiment, Finding]:
    """A simulated record of ``model`` at its start values, and a finding that says what was assumed.

    The input takes a new random level, between -1 and 1 in its unit, every few samples (between 0 and 1 where a state
    would reach its bound otherwise). Raises DataError where the model cannot be simulated that way.
    """
    step, rows = choose_sampling(model, policy)
    time = step * np.arange(rows)
    for low in lowest_input_levels(model):
        generator = np.random.default_rng(policy.seed)
        inputs = {i.name: draw_levels(generator, rows, low) for i in model.inputs}
        run = simulate(model, {"time": time, **inputs})
        if run.overflow is None and not touches_bounds(model, np.column_stack(list(run.states.values())), policy):
            break
    if run.overflow is not None:
        raise DataError(
            f"{model.title} cannot be simulated at its start values: it overflows after {run.overflow:.3g} s;"
            " give other values with --start, or a record to check it with"
        )
    outputs = {name: values for name, values in run.outputs.items() if np.ptp(values) > 0}
    if not outputs:
        raise DataError(f"{model.title}: no output moves when every input does; check the equations of the outputs")
    noise = {name: policy.noise_share * float(np.std(values)) for name, values in outputs.items()}
    record = Experiment("generic", time, inputs, run.record(noise, generator).outputs)
    figures = {
        "rows": rows,
        "step": step,
        "inputs": {i.name: {"low": low, "high": 1.0, "unit": i.unit} for i in model.inputs},
        "noise_share": policy.noise_share,
    }
    return record, Finding(IdentifiabilityCode.SIMULATED_RECORD, values=figures)


def choose_sampling(model: Model, policy: RandomExperimentPolicy = RANDOM_EXPERIMENT_POLICY) -> tuple[float, int]:
    """Sampling time in seconds and number of rows that show the model's fastest and slowest motion."""
    fastest, slowest = fastest_and_slowest_rate(model)
    if not fastest:
        return 0.01, policy.min_rows
    step = 1 / (policy.samples_per_time_constant * fastest)
    rows = math.ceil(policy.slow_time_constants / slowest / step)
    if rows > policy.max_rows:  # the slow end counts: what is faster is integrated between the samples
        return policy.slow_time_constants / slowest / policy.max_rows, policy.max_rows
    return step, max(rows, policy.min_rows)


def fastest_and_slowest_rate(model: Model) -> tuple[float, float]:
    """The fastest pole and the slowest decay at the start values, in 1/s; zeros for a model without either."""
    p = np.array(list(model.values.values()))
    jacobian = model.system.jacobian(declared_initial_state(model), np.zeros(len(model.inputs)), p).full()
    if not np.isfinite(jacobian).all():
        return 0.0, 0.0
    eigenvalues = np.linalg.eigvals(jacobian)
    size = np.abs(eigenvalues)
    moving = size > INTEGRATING_POLE * max(size.max(initial=0.0), TINY)
    if not moving.any():
        return 0.0, 0.0
    decays = -eigenvalues.real[moving & (eigenvalues.real < -INTEGRATING_POLE * size.max())]
    return float(size[moving].max()), float(decays.min() if len(decays) else size[moving].min())


def lowest_input_levels(model: Model) -> tuple[float, ...]:
    """Least levels of a generic input to try: where a state has a lower bound, an input below zero may take it there."""
    return (-1.0, 0.0) if any(math.isfinite(s.bounds[0]) for s in model.all_states) else (-1.0,)


def touches_bounds(model: Model, x: np.ndarray, policy: RandomExperimentPolicy = RANDOM_EXPERIMENT_POLICY) -> bool:
    """Whether a state, of (N, nx), comes to its bounds."""
    low, high = np.array([s.bounds for s in model.all_states]).T
    near = policy.bound_margin * np.ptp(x, axis=0)
    return bool((x <= low + near).any() or (x >= high - near).any())


def draw_levels(generator: np.random.Generator, rows: int, low: float) -> np.ndarray:
    """Random levels (rows,), each kept for a random number of samples, short and long ones alike."""
    lengths = np.ceil(np.exp(generator.uniform(0, np.log(rows / 20), rows))).astype(int)
    return np.repeat(generator.uniform(low, 1, rows), lengths)[:rows]


def draw_constants(
    model: Model,
    generator: np.random.Generator,
    spread: float = RANDOM_EXPERIMENT_POLICY.constant_spread,
    tries: int = RANDOM_EXPERIMENT_POLICY.tries,
) -> np.ndarray:
    """All parameters (np,): free ones at random within ``e^spread`` times their values, fixed ones as they are.

    Inside bounds and rules; where these leave no room the spread shrinks, down to the values themselves.
    """
    parameters = model.all_parameters
    for _ in range(tries):
        draw = generator.uniform(-1.0, 1.0, len(parameters))
        p = [
            q.value if q.fixed else _draw_value(q.value, q.bounds, spread * r)
            for q, r in zip(parameters, draw, strict=True)
        ]
        try:
            check_constants(model.title, model.rules, model.parameters_at(p))
        except ModelError:
            spread /= 2
            continue
        return np.array(p)
    return np.array([q.value for q in parameters])


def _draw_value(value: float, bounds: tuple[float, float], exponent: float) -> float:
    low, high = bounds
    if value == 0.0:  # off: a little of it, on the side where it may be
        span = high - low if math.isfinite(high - low) else 1.0
        drawn = 0.01 * span * (abs(exponent) if low == 0.0 else exponent)
    else:
        drawn = value * math.exp(exponent)
    return min(max(drawn, low), high)
