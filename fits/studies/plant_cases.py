"""Cases with a hidden effect on six everyday plants: drawn at random, simulated by `fits.studies.plant_twins`, told as a user would.

As `fits.studies.hidden_cases` does for the two rigs: the plant and its constants are drawn, the effect is as
strong as a number of noises that it
moves an output by, start values are up to 40 % off, and the noise is told, shown by nothing, or not told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fits.studies.hidden_cases import KINDS, STRONGEST, WEAKEST, Case
from fits.studies.plant_twins import DRY, PLANTS, Effects, simulate
from greybox.data.experiment import Experiment

ROOT = Path(__file__).resolve().parents[2] / "plants"
ROWS, FINE, FINE_DRY = 1500, 20, 100
SECANTS, SHARE = 4, 0.34
Draw = Callable[[np.random.Generator], float]


@dataclass(frozen=True)
class Setup:
    """How a plant is drawn: constants, those a user fits, sensors' noise, inputs, and the effects that may hide in it."""

    period: float
    base: Mapping[str, tuple[float, float]]
    """Lowest and highest value of each constant; equal where it is always the same."""

    free: tuple[str, ...]
    sensors: Mapping[str, float]
    inputs: tuple[str, ...]
    draw_input: Callable[[np.random.Generator, int], np.ndarray]
    """``(rng, rows) -> (rows, nu)``."""

    singles: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    foreign: tuple[str, ...]
    relatives: tuple[str, ...] = ()


def _multisine(rng: np.random.Generator, rows: int, period: float, low: float, high: float, peak: float) -> np.ndarray:
    frequency = np.fft.rfftfreq(rows, period)
    weight = np.where((frequency >= low) & (frequency <= high), 1.0, 0.0)
    u = np.fft.irfft(weight * np.exp(2j * np.pi * rng.random(len(frequency))), rows)
    return peak * u / np.abs(u).max()


def _levels(rng: np.random.Generator, rows: int, length: int, low: float, high: float) -> np.ndarray:
    return np.repeat(rng.uniform(low, high, -(-rows // length)), length)[:rows]


def _drive_input(rng: np.random.Generator, rows: int) -> np.ndarray:
    peak = rng.uniform(6, 12)
    u = _levels(rng, rows, 200, -peak, peak) + _multisine(rng, rows, 2e-3, 0.3, 25, 0.4 * peak)
    return u[:, None]


def _two_mass_input(rng: np.random.Generator, rows: int) -> np.ndarray:
    peak = rng.uniform(0.1, 0.3)
    u = _levels(rng, rows, 200, -peak, peak) + _multisine(rng, rows, 2e-3, 0.5, 40, 0.8 * peak)
    return u[:, None]


def _stage_input(rng: np.random.Generator, rows: int) -> np.ndarray:
    peak = rng.uniform(0.4, 1.2)
    u = _multisine(rng, rows, 1e-3, 0.6, 60, peak)
    if rng.random() < 0.4:
        u = u + _levels(rng, rows, 300, -0.5 * peak, 0.5 * peak)
    return u[:, None]


def _cylinder_input(rng: np.random.Generator, rows: int) -> np.ndarray:
    peak = rng.uniform(1.5, 4)
    u = _levels(rng, rows, 150, -peak, peak) + _multisine(rng, rows, 2e-3, 0.5, 30, 0.4 * peak)
    return u[:, None]


def _thermal_input(rng: np.random.Generator, rows: int) -> np.ndarray:
    power = _levels(rng, rows, int(rng.integers(40, 120)), 0, rng.uniform(40, 80))
    ambient = 20 + rng.uniform(0.5, 3) * np.sin(2 * np.pi * np.arange(rows) / rows + rng.uniform(0, 6))
    return np.stack([power, ambient], axis=1)


def _tanks_input(rng: np.random.Generator, rows: int) -> np.ndarray:
    return _levels(rng, rows, int(rng.integers(30, 90)), 0, rng.uniform(5, 8))[:, None]


_ON_INPUT = ("input_saturation", "input_dead_zone", "input_offset", "transport_delay")
_MOVING = ("coulomb_friction", "stribeck_friction", "quadratic_damping")
_STRANGE = ("coarse_drive", "sensor_on_change")
SETUPS: Mapping[str, Setup] = {
    "rotary_drive": Setup(
        2e-3,
        {"J": (1.5e-4, 3e-4), "B": (1.5e-4, 3e-4), "Kt": (0.03, 0.05), "Ra": (0.8, 1.6), "La": (1e-3, 2e-3)},
        ("J", "B", "Kt", "La"),
        {"w": 0.3, "i": 0.01},
        ("u",),
        _drive_input,
        (*_MOVING, *_ON_INPUT, "constant_load", "winding_heating", "sensor_lag", "gain_by_sign", "input_play"),
        (("coulomb_friction", "input_offset"), ("quadratic_damping", "coulomb_friction")),
        (*_STRANGE, "power_damping"),
        ("cubic_damping", "soft_saturation", "creeping_friction"),
    ),
    "two_mass": Setup(
        2e-3,
        {
            "J1": (1e-3, 2e-3),
            "J2": (2e-3, 4e-3),
            "c": (6, 14),
            "d": (3e-3, 8e-3),
            "d1": (0.015, 0.03),
            "d2": (0.015, 0.03),
        },
        ("J1", "J2", "c", "d", "d1", "d2"),
        {"a1": 1e-3, "a2": 1e-3},
        ("T",),
        _two_mass_input,
        (*_MOVING, "coulomb_friction_at_load", "quadratic_damping_at_load", *_ON_INPUT, "sensor_drift"),
        (
            ("coulomb_friction", "input_dead_zone"),
            ("quadratic_damping_at_load", "input_offset"),
            ("coulomb_friction", "coulomb_friction_at_load"),
        ),
        (*_STRANGE, "shaft_play", "cubic_shaft", "power_damping"),
        ("cubic_damping", "soft_saturation"),
    ),
    "stage": Setup(
        1e-3,
        {"M": (0.4, 0.8), "B": (4, 9), "K": (2000, 4000), "Kf": (12, 12)},
        ("M", "B", "K"),
        {"x": 2e-6},
        ("i",),
        _stage_input,
        (
            *_MOVING,
            *_ON_INPUT,
            *("cubic_stiffness", "quadratic_stiffness", "viscoelastic_creep", "bouc_wen_hysteresis", "sensor_drift"),
        ),
        (("cubic_stiffness", "coulomb_friction"), ("quadratic_damping", "input_offset")),
        (*_STRANGE, "magnet", "power_damping"),
        ("quintic_stiffness", "cubic_damping", "soft_saturation", "creeping_friction"),
    ),
    "cylinder": Setup(
        2e-3,
        {
            "M": (80, 80),
            "A": (1.2e-3, 1.2e-3),
            "B": (800, 1600),
            "V": (6e-4, 6e-4),
            "E": (6e8, 1e9),
            "Kq": (3e-5, 5e-5),
            "Cl": (2e-12, 8e-12),
        },
        ("B", "E", "Kq", "Cl"),
        {"x": 2e-5, "pL": 5e3},
        ("u",),
        _cylinder_input,
        (
            *_MOVING,
            *("input_saturation", "valve_dead_zone", "input_offset", "transport_delay", "valve_lag"),
            *("constant_load", "root_leak", "input_play", "end_stop", "gain_by_sign"),
        ),
        (("coulomb_friction", "valve_dead_zone"), ("valve_lag", "constant_load")),
        (*_STRANGE, "magnet", "power_damping"),
        ("cubic_damping", "soft_saturation"),
    ),
    "thermal": Setup(
        2.0,
        {"C": (300, 700), "h": (0.7, 1.5), "s": (6, 15)},
        ("C", "h", "s"),
        {"S": 0.02},
        ("P", "Ta"),
        _thermal_input,
        (
            *("input_saturation", "transport_delay", "input_offset", "sensor_drift"),
            *("radiation", "convection", "second_body"),
        ),
        (("input_saturation", "transport_delay"),),
        _STRANGE,
        ("soft_saturation",),
    ),
    "tanks": Setup(
        4.0,
        {
            "A1": (0.015, 0.015),
            "A2": (0.015, 0.015),
            "a1": (1.8e-5, 3e-5),
            "a2": (1.8e-5, 3e-5),
            "kp": (0.9e-5, 1.5e-5),
            "g": (9.81, 9.81),
        },
        ("a1", "a2", "kp"),
        {"h1": 5e-4, "h2": 5e-4},
        ("u",),
        _tanks_input,
        (
            *("input_dead_zone", "input_saturation", "input_offset", "transport_delay", "sensor_drift"),
            *("pump_back_pressure", "linear_leak", "overflow"),
        ),
        (("input_dead_zone", "input_saturation"),),
        _STRANGE,
        ("soft_saturation",),
    ),
}


def make(seed: int, kind: str, plant: str = "", rows: int = ROWS, effects: Sequence[str] = ()) -> Case:
    """One case; the same arguments give the same one again. `Case.model` is the path of the model's file."""
    rng = np.random.default_rng([seed, KINDS.index(kind), 7])
    plant = plant or str(rng.choice(list(SETUPS)))
    setup = SETUPS[plant]
    base = {name: float(rng.uniform(low, high)) for name, (low, high) in setup.base.items()}
    names = tuple(effects) or _draw_effects(setup, kind, rng)
    inputs = [setup.draw_input(rng, rows), setup.draw_input(rng, rows)]
    truth: dict[str, Mapping[str, float]] = {}
    for name in names:
        truth[name] = _size(plant, base, name, inputs[0][: max(round(SHARE * rows), 50)], rng)
    records = [_record(f"record {k}", plant, base, truth, u, rng) for k, u in enumerate(inputs, 1)]
    return Case(
        f"{plant}-{kind}-{seed:03d}",
        kind,
        str(ROOT / plant / f"{plant}.py"),
        {n: v for n, v in base.items() if n not in setup.free},
        {n: float(f"{base[n] * rng.uniform(0.7, 1.4):.3g}") for n in setup.free},
        records[0],
        records[1],
        None,
        dict(setup.sensors) if rng.random() < 0.6 else None,
        base,
        truth,
        setup.sensors,
        0.0,
    )


def _draw_effects(setup: Setup, kind: str, rng: np.random.Generator) -> tuple[str, ...]:
    if kind == "complete":
        return ()
    if kind == "pair":
        return setup.pairs[rng.integers(len(setup.pairs))]
    if kind == "mixed":
        return (*_draw_effects(setup, "single", rng), *_draw_effects(setup, "foreign", rng))
    among = {"single": setup.singles, "relative": setup.relatives}.get(kind, setup.foreign)
    return (among[rng.integers(len(among))],)


def _shape(
    name: str, plant: str, base: Mapping[str, float], span: Mapping[str, float], rng: np.random.Generator
) -> dict[str, float]:
    """The effect at the strength one; the strength multiplies what `_at_strength` says."""
    x, v, u, force, y = span["x"], span["v"], span["u"], span["force"], span["y"]
    period = SETUPS[plant].period

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    sign = float(rng.choice([-1.0, 1.0]))
    draw: dict[str, dict[str, float]] = {
        "coulomb_friction": {"Fc": force},
        "stribeck_friction": {"Fc": force, "Fs": log(1.3, 2.5) * force, "vs": log(0.02, 0.3) * v},
        "creeping_friction": {"Fc": force, "vr": log(0.02, 0.2) * v},
        "quadratic_damping": {"B2": force / v**2},
        "cubic_damping": {"B3": force / v**3},
        "power_damping": {"c": force / v**0.6},
        "cubic_stiffness": {"K3": force / x**3},
        "quadratic_stiffness": {"K2": sign * force / x**2},
        "quintic_stiffness": {"K5": force / x**5},
        "end_stop": {"gap": rng.uniform(0.5, 0.8) * x, "kc": force / x},
        "magnet": {"F": force, "x0": rng.uniform(-0.6, 0.6) * x, "w": rng.uniform(0.1, 0.4) * x},
        "constant_load": {"F0": sign * force},
        "viscoelastic_creep": {"K1": force / x, "tau1": log(0.02, 0.3)},
        "bouc_wen_hysteresis": {"alpha": force / x, "beta": log(1, 8) / x, "gamma": rng.uniform(-0.5, 0.5) / x},
        "input_saturation": {"u_max": u},
        "soft_saturation": {"u_max": 3 * u},
        "input_dead_zone": {"d": 0.3 * u},
        "valve_dead_zone": {"d": 0.3 * u},
        "input_play": {"h": 0.2 * u},
        "input_offset": {"u0": sign * 0.2 * u},
        "transport_delay": {"delay": 6 * period},
        "valve_lag": {"tau_v": 20 * period},
        "sensor_lag": {"tau_s": 20 * period},
        "sensor_drift": {"rate": sign * y / (ROWS * period)},
        "sensor_on_change": {"d": 0.1 * y},
        "gain_by_sign": {"g": 0.5},
        "coarse_drive": {"q": 0.3 * u},
        "winding_heating": {"Rth": 0.02, "tau_th": log(0.3, 2.0)},
        "shaft_play": {"gap": 0.1},
        "cubic_shaft": {"c3": 1e4 * base.get("c", 0.0)},
        "root_leak": {"c": 5e-8},
        "radiation": {"s": 2e-8},
        "convection": {"c": 0.5 * base.get("h", 0.0)},
        "second_body": {"g": base.get("h", 0.0), "C2": 0.5 * base.get("C", 0.0)},
        "pump_back_pressure": {"c": 2.0},
        "linear_leak": {"k": 2e-4},
        "overflow": {"k": 2e-3, "h": 0.7 * y},
    }
    return {key: float(value) for key, value in draw[name].items()}


# What a strength multiplies, where it is not the first constant alone; and constants that grow as an effect vanishes.
_STRENGTH: Mapping[str, tuple[str, ...]] = {"stribeck_friction": ("Fc", "Fs"), "end_stop": ("kc",)}
_INVERSE = ("soft_saturation",)


def _at_strength(name: str, shape: Mapping[str, float], strength: float, step: float) -> dict[str, float]:
    """The effect at a strength between 0 (absent) and 1; a delay is a whole number of the twin's steps."""
    if name == "input_saturation":
        return {"u_max": shape["u_max"] * (1 - 0.6 * min(strength, 1.0))}
    which = _STRENGTH.get(name, tuple(shape)[:1])
    factor = 1 / strength if name in _INVERSE else strength
    values = {key: value * factor if key in which else value for key, value in shape.items()}
    if name == "transport_delay":
        values["delay"] = max(1, round(values["delay"] / step)) * step
    return values


def _size(
    plant: str, base: Mapping[str, float], name: str, u: np.ndarray, rng: np.random.Generator
) -> Mapping[str, float]:
    """The effect at a strength that moves an output by a number of noises drawn between `WEAKEST` and `STRONGEST`."""
    setup, kind = SETUPS[plant], name.split("_at_")[0]
    wanted = float(np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST))))
    plain = _run(plant, base, {}, u)
    sigma = np.array(list(setup.sensors.values()))
    first = plain[:, 0] - plain[0, 0]
    # For the bodies: position and velocity of the first output, which is one of the two.
    position = first if plant != "rotary_drive" else np.cumsum(first) * setup.period
    velocity = np.gradient(first, setup.period) if plant != "rotary_drive" else first
    mass = next((base[body.mass] for body in PLANTS[plant].bodies), 1.0)
    span = {
        "x": float(np.abs(position).max()),
        "v": float(np.abs(velocity).max()),
        "u": float(np.abs(u[:, 0]).max()),
        "y": float(np.abs(first).max()),
        "force": mass * float(np.sqrt(np.mean(np.gradient(velocity, setup.period) ** 2))),
    }
    shape, step, strength = _shape(kind, plant, base, span, rng), setup.period / FINE, 0.05
    for _ in range(SECANTS):
        moved = _run(plant, base, {name: _at_strength(kind, shape, strength, step)}, u)
        rms = float((np.sqrt(np.mean((moved - plain) ** 2, axis=0)) / sigma).max())
        strength = float(np.clip(strength * np.clip(wanted / max(rms, 1e-9), 0.1, 10.0), 1e-6, 1.0))
    return _at_strength(kind, shape, strength, step)


def _run(plant: str, base: Mapping[str, float], truth: Effects, u: np.ndarray) -> np.ndarray:
    fine = FINE_DRY if any(name.split("_at_")[0] in DRY for name in truth) else FINE
    return np.array(simulate(PLANTS[plant], base, truth, u.tolist(), SETUPS[plant].period, fine))


def _record(
    name: str, plant: str, base: Mapping[str, float], truth: Effects, u: np.ndarray, rng: np.random.Generator
) -> Experiment:
    setup, y = SETUPS[plant], _run(plant, base, truth, u)
    outputs = {n: y[:, j] + std * rng.normal(size=len(u)) for j, (n, std) in enumerate(setup.sensors.items())}
    inputs = {n: u[:, j] for j, n in enumerate(setup.inputs)}
    return Experiment(name, np.arange(len(u)) * setup.period, inputs, outputs)
