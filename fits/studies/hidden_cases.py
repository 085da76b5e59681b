"""Cases with a hidden effect: a rig drawn at random, its records from the twin, and what a user would say about it.

A case is the plain rig plus nothing, one or two effects of the catalogue, a relative of one whose form differs, something that no
entry of the catalogue comes near, or an effect of the catalogue beside such a stranger. How strong an effect is comes from how far it
moves the outputs: between a few and two hundred times the noise, before any constant has adapted. What is left of that after the plain
model has been refitted is another matter (a spring swallows nearly all of a slow creep), so some effects cannot be seen; a study has to
say which.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fits.studies.rig_twins import Effects, simulate
from greybox.data.experiment import Experiment

PERIOD = {"micro_actuator": 2.5e-4, "pneumatic_cylinder": 0.01}
ROWS, FINE, QUIET_ROWS = 6000, 20, 1600
# Root-mean-square deviation that an effect causes, over the noise, of the output it moves most.
WEAKEST, STRONGEST = 3.0, 200.0
# Simulations spent on finding that strength, over a part of the record.
SECANTS, SHARE = 4, 0.34
COLOUR = 0.9  # correlation from sample to sample of coloured noise

SINGLES = {
    "micro_actuator": (
        "coulomb_friction",
        "stribeck_friction",
        "lugre_friction",
        "quadratic_damping",
        "cubic_stiffness",
        "quadratic_stiffness",
        "viscoelastic_creep",
        "bouc_wen_hysteresis",
        "second_mode",
        "force_constant_droop",
        "winding_heating",
        "eddy_current",
        "constant_load",
        "input_saturation",
        "input_dead_zone",
        "transport_delay",
        "input_offset",
        "sensor_drift",
        "sensor_lag",
        "cogging",
        "end_stop",
        "gain_by_sign",
    ),
    "pneumatic_cylinder": (
        "coulomb_friction",
        "stribeck_friction",
        "lugre_friction",
        "quadratic_damping",
        "constant_load",
        "return_spring",
        "chamber_leakage",
        "choked_flow",
        "supply_droop",
        "position_dependent_volume",
        "valve_dead_zone",
        "input_saturation",
        "valve_lag",
        "transport_delay",
        "input_offset",
        "backlash",
        "sensor_lag",
        "cogging",
        "end_stop",
        "gain_by_sign",
        "spool_play",
    ),
}
PAIRS = {
    "micro_actuator": (
        ("coulomb_friction", "cubic_stiffness"),
        ("viscoelastic_creep", "input_dead_zone"),
        ("quadratic_damping", "input_offset"),
        ("cubic_stiffness", "winding_heating"),
        ("input_saturation", "coulomb_friction"),
        ("transport_delay", "quadratic_stiffness"),
        ("second_mode", "coulomb_friction"),
        ("force_constant_droop", "sensor_drift"),
    ),
    "pneumatic_cylinder": (
        ("coulomb_friction", "valve_dead_zone"),
        ("valve_lag", "constant_load"),
        ("chamber_leakage", "coulomb_friction"),
        ("supply_droop", "input_offset"),
        ("position_dependent_volume", "valve_lag"),
        ("choked_flow", "valve_dead_zone"),
        ("backlash", "input_offset"),
        ("return_spring", "transport_delay"),
    ),
}
# Effects that no entry of the catalogue comes near; see `fits.studies.rig_twins`.
_FOREIGN = (
    "power_damping",
    "resting_friction",
    "random_disturbance",
    "magnet",
    "ishlinskii_spring",
    "thermal_drive",
    "second_clock",
    "sensor_on_change",
    "coarse_drive",
    "gain_ripple",
    "mains_hum",
)
FOREIGN = {"micro_actuator": _FOREIGN, "pneumatic_cylinder": _FOREIGN}
# A relative, and the names that are right for it.
FAMILY: Mapping[str, tuple[str, ...]] = {
    "creep_spectrum": ("viscoelastic_creep", "creep_three_branches"),
    "asymmetric_friction": ("coulomb_friction", "stribeck_friction", "asymmetric_friction"),
    "creeping_friction": ("coulomb_friction", "stribeck_friction", "lugre_friction"),
    "quintic_stiffness": ("cubic_stiffness",),
    "cubic_damping": ("quadratic_damping", "cubic_damping"),
    "soft_saturation": ("soft_saturation", "input_saturation"),
    "soft_dead_zone": ("input_dead_zone", "valve_dead_zone"),
    # The same under the names that the catalogue gives them.
    "end_stop": ("end_stops",),
    "spool_play": ("valve_hysteresis",),
    "input_play": ("input_hysteresis", "valve_hysteresis"),
    "radiation": ("radiation_loss",),
    "convection": ("natural_convection",),
    "second_body": ("heat_storage",),
}
RELATIVES = {
    "micro_actuator": ("creep_spectrum", "quintic_stiffness", "cubic_damping", "soft_saturation", "creeping_friction"),
    "pneumatic_cylinder": (
        "asymmetric_friction",
        "cubic_damping",
        "soft_saturation",
        "soft_dead_zone",
        "creeping_friction",
    ),
}
KINDS = ("single", "pair", "complete", "relative", "foreign", "mixed")


@dataclass(frozen=True)
class Case:
    """What a user has (``model`` by name, ``known`` and ``start`` constants, records, ``noise`` or None) and what is true."""

    name: str
    kind: str
    model: str
    known: Mapping[str, float]
    start: Mapping[str, float]
    estimation: Experiment
    validation: Experiment
    quiet: Experiment | None
    noise: Mapping[str, float] | None
    base: Mapping[str, float]
    effects: Effects
    sigma: Mapping[str, float]
    colour: float

    @property
    def right(self) -> tuple[tuple[str, ...], ...]:
        """For each true effect the names that are right."""
        return tuple(FAMILY.get(name, (name,)) for name in self.effects)


def make(seed: int, kind: str, rows: int = ROWS, effects: Sequence[str] = (), rig: str = "") -> Case:
    """One case; the same ``seed`` and ``kind`` (and ``effects``, drawn at random where empty) give the same one again."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    rig = rig or str(rng.choice(list(PERIOD)))
    base, free = _rig(rig, rng)
    names = tuple(effects) or _drawn(rig, kind, rng)
    sigma, period = _sigma(rig, names, rng), PERIOD[rig]
    inputs = [_input(rig, rows, rng), _input(rig, rows, rng)]
    truth: dict[str, Mapping[str, float]] = {}
    for name in names:
        truth[name] = _sized(rig, base, name, inputs[0][: max(round(SHARE * rows), 50)], sigma, rng)
    colour = COLOUR if rng.random() < 0.25 else 0.0
    records = [_record(f"record {k}", rig, base, truth, u, sigma, colour, rng) for k, u in enumerate(inputs, 1)]
    silence = np.zeros(QUIET_ROWS)
    noisy = {name: std * _noise(QUIET_ROWS, colour, rng) for name, std in sigma.items()}
    knowledge = rng.choice(["noise", "quiet", "nothing"], p=[0.5, 0.3, 0.2])
    quiet = Experiment(
        "quiet", np.arange(QUIET_ROWS) * period, {"u": silence}, {n: y + _rest(n, base) for n, y in noisy.items()}
    )
    return Case(
        f"{kind}-{seed:03d}",
        kind,
        rig,
        {n: v for n, v in base.items() if n not in free},
        {n: float(f"{base[n] * rng.uniform(0.7, 1.4):.3g}") for n in free},
        records[0],
        records[1],
        quiet if knowledge == "quiet" else None,
        dict(sigma) if knowledge == "noise" else None,
        base,
        truth,
        sigma,
        colour,
    )


def _rig(rig: str, rng: np.random.Generator) -> tuple[dict[str, float], tuple[str, ...]]:
    """Constants of one specimen, and those that a user has to fit."""
    if rig == "micro_actuator":
        kf = rng.uniform(1.1, 1.7)
        base = {
            "M": rng.uniform(0.008, 0.013),
            "B": rng.uniform(0.2, 0.36),
            "K": rng.uniform(4500, 7500),
            "Kf": kf,
            "Kv": kf,
            "Ra": rng.uniform(6, 10),
            "La": rng.uniform(0.9e-3, 1.3e-3),
        }
        return base, ("B", "K", "Kf", "Kv", "La")
    base = {
        "M_piston": rng.uniform(1.6, 2.5),
        "f_v": rng.uniform(12, 30),
        "A_piston": 1.2566e-3,
        "V_total": 6.283e-4,
        "P_S": 7e5,
        "P_a": 101300.0,
        "K2": rng.uniform(4.8e-10, 6.6e-10),
        "rho_a": 1.185,
    }
    return base, ("K2", "f_v")


def _drawn(rig: str, kind: str, rng: np.random.Generator) -> tuple[str, ...]:
    if kind == "complete":
        return ()
    if kind == "pair":
        return tuple(PAIRS[rig][rng.integers(len(PAIRS[rig]))])
    if kind == "mixed":
        return (*_drawn(rig, "single", rng), *_drawn(rig, "foreign", rng))
    among = {"single": SINGLES, "relative": RELATIVES, "foreign": FOREIGN}[kind][rig]
    return (among[rng.integers(len(among))],)


def _sigma(rig: str, names: Sequence[str], rng: np.random.Generator) -> dict[str, float]:
    """Noise of the sensors that are there: current and pressures are not always measured, but where only they tell."""
    if rig == "micro_actuator":
        current = "eddy_current" in names or rng.random() < 0.85
        return {"x": float(rng.choice([1e-7, 2e-7]))} | ({"i": float(rng.choice([2e-3, 5e-3]))} if current else {})
    pressures = rng.random() < 0.6
    return {"s": 2e-4} | ({"p_a": 500.0, "p_b": 500.0} if pressures else {})


def _input(rig: str, rows: int, rng: np.random.Generator) -> np.ndarray:
    """A voltage (N,): coloured noise with steps for the actuator, a few slow tones for the valve."""
    period = PERIOD[rig]
    t = np.arange(rows) * period
    if rig == "pneumatic_cylinder":
        f = rng.uniform(0.08, 1.6, 4)
        tones = np.sin(2 * np.pi * f[:, None] * t + rng.uniform(0, 2 * np.pi, (4, 1)))
        u = (tones - tones[:, :1] * np.exp(-t / 2)).sum(axis=0)
        return rng.uniform(2.5, 4.5) * u / np.abs(u).max()
    f = np.fft.rfftfreq(rows, period)
    corner, slope = rng.uniform(10, 60), rng.uniform(0.5, 1.2)
    weight = np.where((f > 0) & (f < 0.3 / period), (1 + (f / corner) ** 2) ** (-slope / 2), 0.0)
    u = np.fft.irfft(weight * np.exp(2j * np.pi * rng.random(len(f))), rows)
    if rng.random() < 0.4:  # a step and a rest at first
        u[: rows // 4] = 0.0
        u[rows // 40 : rows // 4] = 0.4 * np.abs(u).max()
    return rng.uniform(0.8, 3.0) * u / np.abs(u).max()


def _shape(rig: str, name: str, span: Mapping[str, float], rng: np.random.Generator) -> dict[str, float]:
    """The effect at the strength one, its shape drawn within what is usual; the strength multiplies what `_strong` says."""
    x, v, u = span["x"], span["v"], span["u"]
    micro = rig == "micro_actuator"
    force = span["force"]

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    vs, pitch = log(0.02, 0.3) * v, log(0.1, 0.6) * x
    level = {"Fc": force, "Fs": log(1.3, 2.5) * force, "vs": vs}
    m = span["mass"]
    m2, w = log(0.02, 0.08) * m, 2 * np.pi * log(120, 700)
    draw: dict[str, dict[str, float]] = {
        "coulomb_friction": {"Fc": force},
        "stribeck_friction": level,
        "lugre_friction": level | {"s0": force / (log(0.003, 0.05) * x), "s1": 0.3 * (force / x * m) ** 0.5},
        "quadratic_damping": {"B2": force / v**2},
        "cubic_stiffness": {"K3": rng.choice([-1.0, 1.0], p=[0.25, 0.75]) * force / x**3},
        "quadratic_stiffness": {"K2": rng.choice([-1.0, 1.0]) * force / x**2},
        "viscoelastic_creep": {"K1": force / x, "tau1": log(0.01, 0.2) if micro else log(0.5, 5)},
        "bouc_wen_hysteresis": {"alpha": force / x, "beta": log(1, 8) / x, "gamma": rng.uniform(-0.5, 0.5) / x},
        "second_mode": {"m2": m2, "k2": m2 * w**2, "c2": 2 * log(0.01, 0.04) * m2 * w},
        "force_constant_droop": {"a": 1 / x**2},
        "winding_heating": {"Rth": 3.0, "tau_th": log(0.05, 1.0)},
        "eddy_current": {"Re": 10.0},
        "constant_load": {"F0": rng.choice([-1.0, 1.0]) * force},
        "return_spring": {"Ks": force / x},
        "chamber_leakage": {"kl": 20.0},
        "choked_flow": {"b": rng.uniform(0.2, 0.45), "ce": rng.uniform(0.8, 1.6)},
        "supply_droop": {"r": 0.3 / u, "tau_d": log(0.1, 1.0)},
        "position_dependent_volume": {"scale": rng.uniform(0.4, 1.1)},
        "input_saturation": {"u_max": u},
        "input_dead_zone": {"d": 0.3 * u},
        "valve_dead_zone": {"d": 0.3 * u},
        "valve_lag": {"tau_v": 0.1},
        "transport_delay": {"delay": 6 * PERIOD[rig]},
        "input_offset": {"u0": rng.choice([-1.0, 1.0]) * 0.2 * u},
        "sensor_drift": {"rate": rng.choice([-1.0, 1.0]) * x},
        "sensor_lag": {"tau_s": 1e-3 if micro else 0.05},
        "backlash": {"gap": 0.2 * x},
        "cogging": {"F": force, "pitch": pitch},
        "end_stop": {"gap": rng.uniform(0.5, 0.8) * x, "kc": force / x},
        "mains_hum": {"F": force, "f": float(rng.choice([50.0, 60.0]))},
        "spool_play": {"h": 0.2 * u},
        "creep_spectrum": {"K1": force / x, "tau1": log(0.01, 0.1)},
        "asymmetric_friction": {"Fp": force, "Fm": rng.uniform(0.4, 0.8) * force},
        "creeping_friction": {"Fc": force, "vr": log(0.003, 0.05) * v},
        "quintic_stiffness": {"K5": force / x**5},
        "cubic_damping": {"B3": force / v**3},
        "soft_saturation": {"u_max": 3 * u},
        "soft_dead_zone": {"d": 0.3 * u},
        "power_damping": {"c": force / v**0.6},
        "resting_friction": {"Fc": 0.3 * force, "dF": 0.7 * force, "tau": log(0.05, 2.0), "slip": 0.05 * x},
        "random_disturbance": {
            "F": force,
            "f": log(2, 60) if micro else log(0.1, 2),
            "seed": float(rng.integers(10**6)),
        },
        "magnet": {"F": force, "x0": rng.uniform(-0.6, 0.6) * x, "w": rng.uniform(0.1, 0.4) * x},
        "ishlinskii_spring": {"k": force / x, "width": rng.uniform(0.2, 0.8) * x},
        "thermal_drive": {"F": force, "per_speed": 2 / v, "tau": log(0.1, 2) if micro else log(1, 20)},
        "second_clock": {"rate": 0.01},
        "sensor_on_change": {"d": 0.1 * x},
        "coarse_drive": {"q": 0.3 * u},
        "gain_by_sign": {"g": 0.5},
        "gain_ripple": {"m": 0.5, "f": log(20, 300) if micro else log(0.3, 5)},
    }
    return {key: float(value) for key, value in draw[name].items()}


# What a strength multiplies, where it is not the first constant alone; and constants that grow as an effect vanishes.
STRENGTH: Mapping[str, tuple[str, ...]] = {
    "stribeck_friction": ("Fc", "Fs"),
    "lugre_friction": ("Fc", "Fs", "s0"),
    "second_mode": ("m2", "k2", "c2"),
    "asymmetric_friction": ("Fp", "Fm"),
    "end_stop": ("kc",),
    "choked_flow": (),
    "position_dependent_volume": ("scale",),
    "resting_friction": ("Fc", "dF"),
}
INVERSE = ("eddy_current", "soft_saturation")


def _strong(name: str, shape: Mapping[str, float], strength: float) -> dict[str, float]:
    """The effect at a strength between 0 (absent) and 1."""
    if name == "input_saturation":
        return {"u_max": shape["u_max"] * (1 - 0.6 * min(strength, 1.0))}
    which = STRENGTH.get(name, tuple(shape)[:1])
    factor = 1 / strength if name in INVERSE else strength
    return {key: value * factor if key in which else value for key, value in shape.items()}


def _sized(
    rig: str, base: Mapping[str, float], name: str, u: np.ndarray, sigma: Mapping[str, float], rng: np.random.Generator
) -> Mapping[str, float]:
    """The effect at a strength that moves an output by a number of noises drawn between `WEAKEST` and `STRONGEST`."""
    wanted = float(np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST))))
    plain = np.array(simulate(rig, base, {}, u, PERIOD[rig], FINE))
    x = float(np.abs(plain[:, 0]).max())
    v = float(np.abs(np.gradient(plain[:, 0], PERIOD[rig])).max())
    force = base["K"] * x if rig == "micro_actuator" else base["A_piston"] * float(np.ptp(plain[:, 1]))
    span = {
        "x": x,
        "v": v,
        "u": float(np.abs(u).max()),
        "force": force,
        "mass": base.get("M", base.get("M_piston", 0.0)),
    }
    shape = _shape(rig, name, span, rng)
    if not STRENGTH.get(name, ("first",)):
        return shape
    strength = 0.05
    for _ in range(SECANTS):
        moved = np.array(
            simulate(rig, base, {name: _rounded(rig, name, _strong(name, shape, strength))}, u, PERIOD[rig], FINE)
        )
        rms = np.sqrt(np.mean((moved - plain)[:, : len(sigma)] ** 2, axis=0)) / np.array(list(sigma.values()))
        strength = float(np.clip(strength * np.clip(wanted / max(rms.max(), 1e-9), 0.1, 10.0), 1e-6, 1.0))
    return _rounded(rig, name, _strong(name, shape, strength))


def _rounded(rig: str, name: str, values: dict[str, float]) -> dict[str, float]:
    """A delay is a whole number of the twin's steps."""
    if name == "transport_delay":
        step = PERIOD[rig] / FINE
        values["delay"] = max(1, round(values["delay"] / step)) * step
    return values


def _record(
    name: str,
    rig: str,
    base: Mapping[str, float],
    truth: Effects,
    u: np.ndarray,
    sigma: Mapping[str, float],
    colour: float,
    rng: np.random.Generator,
) -> Experiment:
    fine = 200 if "lugre_friction" in truth else FINE
    if "transport_delay" in truth:
        fine = FINE
    y = np.array(simulate(rig, base, truth, u, PERIOD[rig], fine))
    outputs = {n: y[:, j] + std * _noise(len(u), colour, rng) for j, (n, std) in enumerate(sigma.items())}
    return Experiment(name, np.arange(len(u)) * PERIOD[rig], {"u": u}, outputs)


def _noise(rows: int, colour: float, rng: np.random.Generator) -> np.ndarray:
    """Noise (N,) of standard deviation one, first-order coloured."""
    e = rng.normal(size=rows)
    for k in range(1, rows if colour else 0):
        e[k] = colour * e[k - 1] + np.sqrt(1 - colour**2) * e[k]
    return e


def _rest(output: str, base: Mapping[str, float]) -> float:
    """What a sensor shows at rest."""
    return base["P_S"] / 2 if output in ("p_a", "p_b") else 0.0
