"""Cases with a hidden effect on four plants beside the two rigs: a circuit, a drive, a motor with tacho, two tanks.

Records are simulated by greybox itself, with effects of its catalogue; how strong an effect is comes from how far it moves the output,
as in `fits.hidden_cases`. They ask for something else than those: whether the evidence for an effect means the same on another plant,
where the effect is among the candidates and where it was taken away.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

import greybox as gb
from fits.hidden_cases import STRONGEST, WEAKEST
from greybox.effects import Scales, measure_scales, tailor_to_record
from models.cascaded_tanks import cascaded_tanks
from models.emps import emps
from models.silverbox import silverbox

ROUNDS = 6  # simulations spent on finding a strength
RESOLUTION = 1000  # noise over the movement of the output, its inverse
COLOUR = 0.9


def _tacho_balances(x, u, p):
    return [gb.Balance("force", "V/s", 1, "y", motor=p.b * u.u, damping=-p.a * x.y)]


tacho = gb.Model(
    "tacho",
    states=[gb.State("y", "V", role="velocity", description="speed, as the tacho's voltage")],
    inputs=[gb.Input("u", "V", role="drive")],
    outputs=[gb.Output("y", "V")],
    parameters=[
        gb.Parameter("b", "1/s", 8.0, bounds=(1e-2, 1e4), source="a study"),
        gb.Parameter("a", "1/s", 10.0, bounds=(1e-2, 1e4), role="damping", source="a study"),
    ],
    balances=_tacho_balances,
    description="DC motor with tacho",
)


@dataclass(frozen=True)
class Plant:
    """A model, its sampling time in s, the mean and amplitude of its input, and effects that may be hidden in it."""

    model: gb.Model
    period: float
    mean: float
    amplitude: float
    effects: tuple[str, ...]


PLANTS = {
    "silverbox": Plant(
        silverbox,
        1.6384e-3,
        0.0,
        0.1,
        (
            "cubic_stiffness",
            "quadratic_stiffness",
            "quadratic_damping",
            "input_offset",
            "coulomb_friction",
            "input_saturation",
        ),
    ),
    "emps": Plant(
        emps,
        5e-3,
        0.0,
        3.0,
        ("coulomb_friction", "directional_damping", "constant_load", "input_dead_zone", "quadratic_damping"),
    ),
    "tacho": Plant(
        tacho,
        0.02,
        1.0,
        3.0,
        ("input_dead_zone", "input_saturation", "coulomb_friction", "transport_delay", "input_offset", "sensor_lag"),
    ),
    "cascaded_tanks": Plant(
        cascaded_tanks,
        4.0,
        3.0,
        1.5,
        ("input_offset", "input_dead_zone", "sensor_lag", "transport_delay", "lower_overflow"),
    ),
}


@dataclass(frozen=True)
class PlantCase:
    """What a user has, and the effect that is true (none: the model is complete)."""

    name: str
    plant: str
    model: gb.Model
    estimation: gb.Experiment
    validation: gb.Experiment
    noise: Mapping[str, float] | None
    effect: str


def make_plant_case(seed: int, rows: int) -> PlantCase | None:
    """One case; None where no strength of the effect that was drawn suits the plant."""
    rng = np.random.default_rng([seed, 77])
    name = str(rng.choice(list(PLANTS)))
    plant = PLANTS[name]
    truth = plant.model.start(**{q.name: float(q.value * rng.uniform(0.8, 1.25)) for q in plant.model.free_parameters})
    inputs = [_draw_input(plant, rows, rng) for _ in range(2)]
    output = plant.model.outputs[0].name
    calm = gb.simulate(truth, inputs[0]).outputs[output]
    if not np.isfinite(calm).all():
        return None
    noise = float(np.std(calm)) / RESOLUTION * float(np.exp(rng.uniform(-1, 1)))
    effect = str(rng.choice([*plant.effects, ""], p=[*([0.92 / len(plant.effects)] * len(plant.effects)), 0.08]))
    if effect:
        scales = _measure_scales(truth, inputs[0])
        extended = _size_effect(truth, effect, scales, inputs[0], calm, noise, rng)
        if extended is None:
            return None
        truth = extended
    colour = COLOUR if rng.random() < 0.25 else 0.0
    records = []
    for k, given in enumerate(inputs):
        y = gb.simulate(truth, given).outputs[output]
        if not np.isfinite(y).all():
            return None
        noisy = y + noise * _draw_noise(len(y), colour, rng)
        records.append(gb.Experiment(f"record {k + 1}", given.time, given.inputs, {output: noisy}))
    start = {q.name: float(f"{truth.values[q.name] * rng.uniform(0.7, 1.4):.3g}") for q in plant.model.free_parameters}
    known = {output: noise} if rng.random() < 0.5 else None
    return PlantCase(f"{name}-{seed}", name, plant.model.start(**start), records[0], records[1], known, effect)


def _draw_input(plant: Plant, rows: int, rng: np.random.Generator) -> gb.Experiment:
    """Coloured noise with steps about the mean."""
    time = np.arange(rows) * plant.period
    f = np.fft.rfftfreq(rows, plant.period)
    corner = rng.uniform(0.01, 0.1) / plant.period
    weight = np.where((f > 0) & (f < 0.3 / plant.period), 1 / np.sqrt(1 + (f / corner) ** 2), 0.0)
    u = np.fft.irfft(weight * np.exp(2j * np.pi * rng.random(len(f))), rows)
    held = np.repeat(rng.uniform(-1, 1, rows // 60 + 1), 60)[:rows]
    u = u / np.abs(u).max() + (rng.random() < 0.5) * held
    return gb.Experiment("input", time, {"u": plant.mean + plant.amplitude * u / np.abs(u).max()}, {})


def _measure_scales(model: gb.Model, given: gb.Experiment) -> Scales:
    run = gb.simulate(model, given)
    states = np.column_stack([run.states[s.name] for s in model.all_states])
    return measure_scales(model, states, given.inputs["u"][:, None], float(np.median(given.intervals)))


def _size_effect(
    model: gb.Model,
    name: str,
    scales: Scales,
    given: gb.Experiment,
    calm: np.ndarray,
    noise: float,
    rng: np.random.Generator,
) -> gb.Model | None:
    """``model`` with the effect at a strength that moves the output by a number of noises drawn as for the rigs; None without one."""
    entry = tailor_to_record(gb.effect(name), scales)
    extended = model + entry
    names = next(b.model_names for b in extended.bound_effects if b.effect.name == name)
    grid = entry.grid(scales) if entry.grid else {}
    shape = {names[n]: float(rng.choice(list(values))) for n, values in grid.items()}
    probe = {names[n]: value for n, value in (entry.probe(scales) if entry.probe else {}).items()}
    wanted = float(np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST)))) * noise
    factor = 1.0
    for _ in range(ROUNDS if probe else 1):
        values = _within_bounds(extended, shape | {n: factor * v for n, v in probe.items()})
        moved = gb.simulate(extended.start(**values), given).outputs[model.outputs[0].name]
        if not np.isfinite(moved).all():
            factor *= 0.1
            continue
        size = float(np.sqrt(np.mean((moved - calm) ** 2)))
        if abs(np.log(max(size, 1e-12) / wanted)) < 0.3:
            break
        factor *= float(np.clip(wanted / max(size, 1e-12), 0.1, 10.0))
    final = extended.start(**_within_bounds(extended, shape | {n: factor * v for n, v in probe.items()}))
    moved = gb.simulate(final, given).outputs[model.outputs[0].name]
    return final if np.isfinite(moved).all() and np.std(moved - calm) > WEAKEST * noise / 2 else None


def _within_bounds(model: gb.Model, values: Mapping[str, float]) -> dict[str, float]:
    bounds = {n: model.parameter(n).bounds for n in values}
    return {n: float(np.clip(v, *bounds[n])) for n, v in values.items()}


def _draw_noise(rows: int, colour: float, rng: np.random.Generator) -> np.ndarray:
    e = rng.normal(size=rows)
    for k in range(1, rows if colour else 0):
        e[k] = colour * e[k - 1] + np.sqrt(1 - colour**2) * e[k]
    return e
