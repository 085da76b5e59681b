"""The missing effect is named, and nothing is named that is not missing. The rigs are simulated without greybox."""

import json

import numpy as np
import pytest

from fits.rig_twins import simulate
from greybox.discovery import discover
from greybox.effects import effect
from greybox.errors import DataError
from greybox.estimation import FitOptions
from greybox.experiment import Experiment
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


def found(rig, effects, noise, told=True, colour=0.0, rows=0, among=()):
    train, test = records(rig, effects, noise, colour, rows)
    given = dict(zip((o.name for o in rig.outputs), noise, strict=False)) if told else None
    chosen = [effect(name) for name in among] or None
    return discover(off(rig), train, validation=test, noise=given, options=OPTIONS, effects=chosen)


WELL, POOR = (2e-7, 5e-3), (2e-7,)
AIR, POSITION = (2e-4, 500.0, 500.0), (2e-4,)
# What was hidden, and which other effects it is offered with: the ones that look most like it.
SHORT = [
    (micro_actuator, {"coulomb_friction": {"Fc": 0.05}}, WELL, ("quadratic_damping", "bouc_wen_hysteresis")),
    (micro_actuator, {"stribeck_friction": {"Fc": 0.04, "Fs": 0.08, "vs": 0.01}}, WELL, ("coulomb_friction", "quadratic_damping")),
    (micro_actuator, {"quadratic_damping": {"B2": 5.0}}, WELL, ("coulomb_friction", "cubic_stiffness")),
    (micro_actuator, {"cubic_stiffness": {"K3": 1e10}}, POOR, ("force_constant_droop", "input_saturation")),
    (micro_actuator, {"quadratic_stiffness": {"K2": 4e5}}, WELL, ("cubic_stiffness", "constant_load")),
    (micro_actuator, {"viscoelastic_creep": {"K1": 400.0, "tau1": 0.03}}, WELL, ("bouc_wen_hysteresis", "winding_heating")),
    (micro_actuator, {"second_mode": {"m2": 4e-4, "k2": 400.0, "c2": 0.02}}, WELL, ("transport_delay", "sensor_lag")),
    (micro_actuator, {"force_constant_droop": {"a": 2e5}}, WELL, ("cubic_stiffness", "input_saturation")),
    (micro_actuator, {"winding_heating": {"Rth": 1.0, "tau_th": 0.1}}, WELL, ("viscoelastic_creep", "input_saturation")),
    (micro_actuator, {"eddy_current": {"Re": 30.0}}, WELL, ("transport_delay", "sensor_lag")),
    (micro_actuator, {"constant_load": {"F0": 0.05}}, WELL, ("input_offset", "sensor_drift")),
    (micro_actuator, {"input_saturation": {"u_max": 2.2}}, WELL, ("cubic_stiffness", "force_constant_droop")),
    (micro_actuator, {"input_dead_zone": {"d": 0.15}}, WELL, ("coulomb_friction", "quadratic_damping")),
    (micro_actuator, {"transport_delay": {"delay": 3.75e-4}}, WELL, ("sensor_lag", "eddy_current")),
    (micro_actuator, {"input_offset": {"u0": 0.05}}, WELL, ("constant_load", "sensor_drift")),
    (micro_actuator, {"sensor_drift": {"rate": 1e-4}}, WELL, ("constant_load", "viscoelastic_creep")),
    (pneumatic_cylinder, {"coulomb_friction": {"Fc": 20.0}}, POSITION, ("quadratic_damping", "valve_dead_zone")),
    (pneumatic_cylinder, {"chamber_leakage": {"kl": 5.0}}, AIR, ("return_spring", "input_offset")),
    (pneumatic_cylinder, {"supply_droop": {"r": 0.06, "tau_d": 0.3}}, AIR, ("input_saturation", "valve_lag")),
    (pneumatic_cylinder, {"valve_dead_zone": {"d": 0.2}}, AIR, ("coulomb_friction", "input_saturation")),
    (pneumatic_cylinder, {"valve_lag": {"tau_v": 0.08}}, AIR, ("transport_delay", "sensor_lag")),
    (pneumatic_cylinder, {"backlash": {"gap": 2e-3}}, AIR, ("coulomb_friction", "sensor_lag")),
    # Refits from afar are lost without damped steps, a weak effect beside a strong one unless it is looked for nearly absent.
    (micro_actuator, {"bouc_wen_hysteresis": {"alpha": 60.0, "beta": 8e3, "gamma": -3e3}}, WELL, ("viscoelastic_creep", "second_mode")),
    (micro_actuator, {"lugre_friction": {"Fc": 0.04, "Fs": 0.07, "vs": 0.01, "s0": 9000.0, "s1": 2.0}}, WELL, ("bouc_wen_hysteresis",)),
    (micro_actuator, {"soft_saturation": {"u_max": 5.0}}, WELL, ("input_saturation", "winding_heating")),
    (micro_actuator, {"cubic_stiffness": {"K3": 2e10}, "coulomb_friction": {"Fc": 1e-3}}, WELL, ("input_offset", "sensor_lag")),
    (micro_actuator, {}, WELL, ("cubic_stiffness", "coulomb_friction")),
]  # fmt: skip


@pytest.mark.parametrize(
    ("rig", "effects", "noise", "others"), SHORT,
    ids=[f"{rig.name}-{'-'.join(effects) or 'nothing'}" for rig, effects, _, _ in SHORT],
)  # fmt: skip
def test_the_hidden_effect_is_told_from_its_look_alikes(rig, effects, noise, others):
    rows = 600 if rig is micro_actuator else 500
    train, test = records(rig, effects, noise, rows=rows)
    given = dict(zip((o.name for o in rig.outputs), noise, strict=False))
    among = [effect(name) for name in (*effects, *others)]
    d = discover(off(rig), train, validation=test, noise=given, options=OPTIONS, effects=among)
    assert d.verdict == ("named" if effects else "complete"), str(d)
    assert [e["name"] for e in d.effects] == list(effects)
    for e in d.effects:
        for name, truth in effects[e["name"]].items():
            estimate = e["parameters"][name]
            assert abs(estimate["value"] - truth) < max(5 * estimate["std"], 0.02 * abs(truth))


WHOLE = [
    (micro_actuator, "coulomb_friction", {"Fc": 0.05}, WELL),
    (micro_actuator, "cubic_stiffness", {"K3": 1e10}, WELL),
    (micro_actuator, "input_dead_zone", {"d": 0.15}, WELL),
    (micro_actuator, "eddy_current", {"Re": 30.0}, WELL),
    (pneumatic_cylinder, "chamber_leakage", {"kl": 5.0}, AIR),
    (pneumatic_cylinder, "coulomb_friction", {"Fc": 20.0}, POSITION),
    (pneumatic_cylinder, "valve_lag", {"tau_v": 0.08}, AIR),
]


# One of each rig in the ordinary run.
ORDINARY = ((micro_actuator, "coulomb_friction"), (pneumatic_cylinder, "valve_lag"))


@pytest.mark.parametrize(
    ("rig", "name", "constants", "noise"),
    [pytest.param(*case, marks=() if case[:2] in ORDINARY else pytest.mark.slow) for case in WHOLE],
    ids=lambda v: getattr(v, "name", v if isinstance(v, str) else ""),
)
def test_a_single_effect_is_named_out_of_the_whole_catalogue(rig, name, constants, noise):
    d = found(rig, {name: constants}, noise)
    assert d.verdict == "named", str(d)
    (named,) = d.effects
    assert named["name"] == name
    for parameter, truth in constants.items():
        estimate = named["parameters"][parameter]
        assert abs(estimate["value"] - truth) < max(5 * estimate["std"], 0.02 * abs(truth))
    worst = max(d.gap.values(), key=lambda g: g.before / g.floor)
    assert worst.explained_fraction > 0.9


def left_alone(told, colour, rows, among=()):
    d = found(micro_actuator, {}, WELL, told, colour, rows, among)
    assert d.verdict == "complete", str(d)
    assert d.effects == []
    return d


def test_a_complete_model_says_what_could_still_hide():
    d = left_alone(True, 0.0, 700, ("cubic_stiffness", "coulomb_friction"))
    assert any(n.startswith("cubic_stiffness could still hide below K3") for n in d.notes)


@pytest.mark.slow
@pytest.mark.parametrize(("told", "colour"), [(False, 0.0), (True, 0.9), (False, 0.9)])
def test_a_complete_model_is_left_alone_whatever_the_noise(told, colour):
    left_alone(told, colour, 0)


def test_an_offset_and_a_load_without_the_current_are_called_a_tie():
    d = found(
        micro_actuator,
        {"input_offset": {"u0": 0.02}},
        POOR,
        rows=700,
        among=("input_offset", "constant_load", "sensor_lag"),
    )
    assert d.verdict == "ambiguous", str(d)
    assert {d.effects[0]["name"], *(n for a in d.alternatives for n in a)} == {"input_offset", "constant_load"}
    assert any("x, i measured, would tell" in n for n in d.notes), d.notes


def test_the_answer_is_saved_as_the_schema_says(tmp_path):
    train, test = records(micro_actuator, {"quadratic_damping": {"B2": 5.0}}, WELL, rows=600)
    among = [effect(name) for name in ("quadratic_damping", "cubic_stiffness")]
    d = discover(
        off(micro_actuator), train, validation=test, noise={"x": 2e-7, "i": 5e-3}, options=OPTIONS, effects=among
    )
    data = json.loads(d.save(tmp_path / "discovery.json").read_text())
    assert data["effects"][0]["name"] == "quadratic_damping"
    assert set(data["effects"][0]["parameters"]["B2"]) >= {"value", "std", "unit"}
    assert set(data["gap"]["x"]) == {"before", "after", "floor", "unit"}
    assert {"verdict", "effects", "alternatives", "sites", "parameters", "gap"} <= set(data)


def test_nothing_to_judge_by_is_refused():
    train, _ = records(micro_actuator, {}, WELL, rows=100)
    with pytest.raises(DataError, match="no validation record"):
        discover(off(micro_actuator), train, validation=[])
