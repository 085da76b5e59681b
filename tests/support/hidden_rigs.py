"""Rigs with a hidden effect, simulated without greybox: records to learn from and to judge by, and the plain model as a user states it."""

import numpy as np

from fits.studies.rig_twins import simulate
from greybox.data.experiment import Experiment
from greybox.estimation.options import FitOptions
from models.micro_actuator import micro_actuator

ACTUATOR = {"M": 0.010, "B": 0.27, "K": 5900.0, "Kf": 1.39, "Kv": 1.39, "Ra": 8.0, "La": 1e-3}
CYLINDER = {
    "M_piston": 2.0,
    "f_v": 25.0,
    "A_piston": 1.2566e-3,
    "V_total": 6.283e-4,
    "P_S": 7e5,
    "P_a": 101300.0,
    "K2": 6e-10,
    "rho_a": 1.185,
}
AT_REST = FitOptions(at_rest=True)


def _multisine(seed, rows, period, high, amplitude):
    """Sines up to ``high`` Hz with random phases, beginning at zero."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) * period
    f = np.geomspace(2 / t[-1], high, 30) * rng.uniform(0.9, 1.1, 30)
    u = np.sin(2 * np.pi * f[:, None] * t + rng.uniform(0, 2 * np.pi, (30, 1))).sum(axis=0)
    return amplitude * u / np.abs(u).max() * np.minimum(1.0, t / (20 * period))


def simulate_records(rig, effects, noise, colour=0.0, rows=0):
    """An estimation and a validation record of the rig with hidden effects, and sensor noise of the given colour."""
    usual, period, high, amplitude, fine = (
        (2000, 2.5e-4, 400.0, 4.0, 20) if rig is micro_actuator else (1500, 0.01, 5.0, 4.0, 20)
    )
    rows = rows or usual
    base = ACTUATOR if rig is micro_actuator else CYLINDER
    result = []
    for seed in (1, 2):
        u = _multisine(seed, rows, period, high, amplitude)
        y = np.array(simulate(rig.name, base, effects, u, period, fine))[:, : len(noise)]
        rng = np.random.default_rng(10 + seed)
        e = rng.normal(size=y.shape)
        for k in range(1, rows if colour else 0):
            e[k] = colour * e[k - 1] + np.sqrt(1 - colour**2) * e[k]
        names = [o.name for o in rig.outputs][: len(noise)]
        outputs = {n: y[:, j] + noise[j] * e[:, j] for j, n in enumerate(names)}
        result.append(Experiment(f"record {seed}", np.arange(rows) * period, {"u": u}, outputs))
    return result


def plain_model(rig):
    """The plain model as a user states it: some constants known, the others up to 40 % off."""
    if rig is micro_actuator:
        known = {n: ACTUATOR[n] for n in ("M", "Ra")}
        return rig.fix(**known).start(B=0.35, K=4300.0, Kf=1.1, Kv=1.8, La=8e-4)
    known = {n: v for n, v in CYLINDER.items() if n not in ("K2", "f_v")}
    return rig.fix(**known).start(K2=4.5e-10, f_v=33.0)
