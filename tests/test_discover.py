"""The missing effect is named, and nothing is named that is not missing. The rigs are simulated without greybox."""

import json

import numpy as np
import pytest

from fits.rig_twins import simulate
from greybox import DataError
from greybox.discovery import discover
from greybox.experiment import Experiment
from greybox.fitting import FitOptions
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder

ACTUATOR = {"M": 0.010, "B": 0.27, "K": 5900.0, "Kf": 1.39, "Kv": 1.39, "Ra": 8.0, "La": 1e-3}
CYLINDER = {
    "M_piston": 2.0, "f_v": 25.0, "A_piston": 1.2566e-3, "V_total": 6.283e-4, "P_S": 7e5, "P_a": 101300.0, "K2": 6e-10,
    "rho_a": 1.185,
}  # fmt: skip
OPTIONS = FitOptions(at_rest=True)


def multisine(seed, rows, period, high, amplitude):
    """Sines up to ``high`` Hz with random phases, beginning at zero."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) * period
    f = np.geomspace(2 / t[-1], high, 30) * rng.uniform(0.9, 1.1, 30)
    u = np.sin(2 * np.pi * f[:, None] * t + rng.uniform(0, 2 * np.pi, (30, 1))).sum(axis=0)
    return amplitude * u / np.abs(u).max() * np.minimum(1.0, t / (20 * period))


def records(rig, effects, noise, colour=0.0, rows=0):
    """An estimation and a validation record of the rig with hidden effects, and sensor noise of the given colour."""
    usual, period, high, amplitude, fine = (
        (2000, 2.5e-4, 400.0, 4.0, 20) if rig is micro_actuator else (1500, 0.01, 5.0, 4.0, 20)
    )
    rows = rows or usual
    base = ACTUATOR if rig is micro_actuator else CYLINDER
    result = []
    for seed in (1, 2):
        u = multisine(seed, rows, period, high, amplitude)
        y = np.array(simulate(rig.name, base, effects, u, period, fine))[:, : len(noise)]
        rng = np.random.default_rng(10 + seed)
        e = rng.normal(size=y.shape)
        for k in range(1, rows if colour else 0):
            e[k] = colour * e[k - 1] + np.sqrt(1 - colour**2) * e[k]
        names = [o.name for o in rig.outputs][: len(noise)]
        outputs = {n: y[:, j] + noise[j] * e[:, j] for j, n in enumerate(names)}
        result.append(Experiment(f"record {seed}", np.arange(rows) * period, {"u": u}, outputs))
    return result


def off(rig):
    """The plain model as a user states it: some constants known, the others up to 40 % off."""
    if rig is micro_actuator:
        known = {n: ACTUATOR[n] for n in ("M", "Ra")}
        return rig.fix(**known).start(B=0.35, K=4300.0, Kf=1.1, Kv=1.8, La=8e-4)
    known = {n: v for n, v in CYLINDER.items() if n not in ("K2", "f_v")}
    return rig.fix(**known).start(K2=4.5e-10, f_v=33.0)


def found(rig, effects, noise, told=True, colour=0.0):
    train, test = records(rig, effects, noise, colour)
    given = dict(zip((o.name for o in rig.outputs), noise, strict=False)) if told else None
    return discover(off(rig), train, validation=test, noise=given, options=OPTIONS)


ONE = [
    (micro_actuator, "coulomb_friction", {"Fc": 0.05}, (2e-7, 5e-3)),
    (micro_actuator, "cubic_stiffness", {"K3": 1e10}, (2e-7, 5e-3)),
    (micro_actuator, "input_dead_zone", {"d": 0.15}, (2e-7, 5e-3)),
    (micro_actuator, "eddy_current", {"Re": 30.0}, (2e-7, 5e-3)),
    (pneumatic_cylinder, "chamber_leakage", {"kl": 5.0}, (2e-4, 500.0, 500.0)),
    (pneumatic_cylinder, "coulomb_friction", {"Fc": 20.0}, (2e-4,)),
    (pneumatic_cylinder, "valve_lag", {"tau_v": 0.08}, (2e-4, 500.0, 500.0)),
]


@pytest.mark.parametrize(
    ("rig", "name", "constants", "noise"), ONE, ids=lambda v: getattr(v, "name", v if isinstance(v, str) else "")
)
def test_a_single_effect_is_named_with_its_constants(rig, name, constants, noise):
    d = found(rig, {name: constants}, noise)
    assert d.verdict == "named", str(d)
    (effect,) = d.effects
    assert effect["name"] == name
    for parameter, truth in constants.items():
        estimate = effect["parameters"][parameter]
        assert abs(estimate["value"] - truth) < max(5 * estimate["std"], 0.02 * abs(truth))
    worst = max(d.gap.values(), key=lambda g: g.before / g.floor)
    assert worst.closed > 0.9


@pytest.mark.parametrize(("told", "colour"), [(True, 0.0), (False, 0.0), (True, 0.9), (False, 0.9)])
def test_a_complete_model_is_left_alone(told, colour):
    d = found(micro_actuator, {}, (2e-7, 5e-3), told, colour)
    assert d.verdict == "complete", str(d)
    assert d.effects == []
    if told and not colour:
        assert any(n.startswith("cubic_stiffness could still hide below K3") for n in d.notes)


def test_an_offset_and_a_load_without_the_current_are_called_a_tie():
    d = found(micro_actuator, {"input_offset": {"u0": 0.02}}, (2e-7,))
    assert d.verdict == "ambiguous", str(d)
    assert {d.effects[0]["name"], *(n for a in d.alternatives for n in a)} == {"input_offset", "constant_load"}
    assert any("x, i measured, would tell" in n for n in d.notes), d.notes


def test_the_answer_is_saved_as_the_schema_says(tmp_path):
    train, test = records(micro_actuator, {"quadratic_damping": {"B2": 3.0}}, (2e-7, 5e-3))
    d = discover(off(micro_actuator), train, validation=test, noise={"x": 2e-7, "i": 5e-3}, options=OPTIONS)
    data = json.loads(d.save(tmp_path / "discovery.json").read_text())
    assert data["effects"][0]["name"] == "quadratic_damping"
    assert set(data["effects"][0]["parameters"]["B2"]) >= {"value", "std", "unit"}
    assert set(data["gap"]["x"]) == {"before", "after", "floor", "unit"}
    assert {"verdict", "effects", "alternatives", "sites", "parameters", "gap"} <= set(data)


def test_nothing_to_judge_by_is_refused():
    train, _ = records(micro_actuator, {}, (2e-7, 5e-3))
    with pytest.raises(DataError, match="no validation record"):
        discover(off(micro_actuator), train, validation=[])
