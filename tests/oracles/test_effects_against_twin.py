"""Every effect at known constants against the independent simulator of `fits.studies.rig_twins`, and against simulated cases."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import greybox.model.effects
from fits.studies import rig_twins
from greybox.data.experiment import Experiment
from greybox.data.read import read_csv
from greybox.model.effects.catalogue import CATALOGUE, effect
from greybox.simulation.integrators.discretisation import discretise
from greybox.simulation.kernel.interface import KernelPoint
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.records import to_record
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder

MODELS = {m.name: m for m in (micro_actuator, pneumatic_cylinder)}
PERIOD = {"micro_actuator": 2.5e-4, "pneumatic_cylinder": 0.01}
# What the sensors of both rigs see: metre and ampere, metre and pascal.
NOISE = {"micro_actuator": (2e-7, 5e-3), "pneumatic_cylinder": (2e-4, 500.0, 500.0)}
ROWS = 120

FRICTION = {
    "coulomb_friction": {"Fc": 0.02},
    "stribeck_friction": {"Fc": 0.01, "Fs": 0.025, "vs": 2e-3},
    "lugre_friction": {"Fc": 0.01, "Fs": 0.02, "vs": 3e-3, "s0": 2e3, "s1": 0.2},
    "quadratic_damping": {"B2": 1.5},
}
ACTUATOR = FRICTION | {
    "cubic_stiffness": {"K3": 4e10},
    "quadratic_stiffness": {"K2": 3e6},
    "viscoelastic_creep": {"K1": 300.0, "tau1": 0.01},
    "bouc_wen_hysteresis": {"alpha": 800.0, "beta": 4e4, "gamma": 1.5e4},
    "second_mode": {"m2": 4e-4, "k2": 1200.0, "c2": 0.03},
    "force_constant_droop": {"a": 3e7},
    "winding_heating": {"Rth": 3.0, "tau_th": 0.02},
    "eddy_current": {"Re": 4.0},
    "constant_load": {"F0": 0.01},
    "input_saturation": {"u_max": 0.7},
    "soft_saturation": {"u_max": 1.2},
    "input_dead_zone": {"d": 0.1},
    "transport_delay": {"delay": 1.35 * 2.5e-4},
    "input_offset": {"u0": -0.07},
    "sensor_drift": {"rate": 1e-3},
    "sensor_lag": {"tau_s": 4e-4},
}
CYLINDER = {
    "coulomb_friction": {"Fc": 15.0},
    "stribeck_friction": {"Fc": 8.0, "Fs": 16.0, "vs": 0.02},
    "lugre_friction": {"Fc": 8.0, "Fs": 14.0, "vs": 0.02, "s0": 2e4, "s1": 60.0},
    "quadratic_damping": {"B2": 500.0},
    "constant_load": {"F0": 4.0},
    "return_spring": {"Ks": 2000.0},
    "chamber_leakage": {"kl": 5.0},
    "choked_flow": {"b": 0.32, "ce": 1.5},
    "supply_droop": {"r": 0.05, "tau_d": 0.3},
    "position_dependent_volume": {"scale": 0.9},
    "valve_dead_zone": {"d": 0.4},
    "input_saturation": {"u_max": 2.0},
    "soft_saturation": {"u_max": 6.0},
    "valve_lag": {"tau_v": 0.015},
    "transport_delay": {"delay": 0.0235},
    "input_offset": {"u0": 0.1},
    "backlash": {"gap": 8e-4},
    "sensor_lag": {"tau_s": 0.04},
}
# Pairs that act on the same balance, parameter or signal: {rig: [names]}
PAIRS = {
    "micro_actuator": [
        ("winding_heating", "force_constant_droop"),
        ("winding_heating", "eddy_current"),
        ("viscoelastic_creep", "input_dead_zone"),
        ("coulomb_friction", "cubic_stiffness"),
        ("input_saturation", "transport_delay"),
        ("second_mode", "sensor_lag"),
    ],
    "pneumatic_cylinder": [
        ("choked_flow", "position_dependent_volume"),
        ("supply_droop", "choked_flow"),
        ("valve_lag", "choked_flow"),
        ("chamber_leakage", "position_dependent_volume"),
        ("coulomb_friction", "valve_dead_zone"),
        ("valve_dead_zone", "valve_lag"),
        ("backlash", "input_offset"),
    ],
}
# Effects of the benchmark rigs have no twin: tests/studies/test_real_data.py has their formulas. The others are compared with small
# steps in tests/model/effects.
BY_HAND = {
    "input_gain",
    "reversed_input",
    "reversed_reading",
    "late_row",
    "early_row",
    "sensor_gain",
    "sensor_offset",
    "rate_limit",
    "warming_friction",
    "clock_skew",
    "heat_loss",
    "heat_gain",
    "viscous_damping",
    "radiation_loss",
    "natural_convection",
    "heat_storage",
    "gravity_torque",
    "torque_ripple",
    "overflow",
    "linear_leak",
    "saturating_inductance",
    "brush_drop",
    "drive_lag",
    "load_dependent_friction",
    "asymmetric_friction",
    "end_stop",
    "end_stops",
    "cogging",
    "gain_by_sign",
    "input_hysteresis",
    "valve_hysteresis",
    "rectified_reading",
    "root_leak",
    "pump_back_pressure",
    "displacement_damping",
    "cubic_damping",
    "directional_damping",
    "upper_overflow",
    "lower_overflow",
    "reading_curve",
    "sensor_saturation",
    "linear_input",
    "band_limited_input",
}
TRUTHS = {"micro_actuator": ACTUATOR, "pneumatic_cylinder": CYLINDER}
CASES = [
    *((rig, (name,)) for rig, entries in TRUTHS.items() for name in entries),
    *((rig, pair) for rig, pairs in PAIRS.items() for pair in pairs),
]
# Steps of the twin in a sampling interval: the bristles are stiff, play moves once a step.
FINE = {"lugre_friction": 200, "backlash": 200}
# Substeps of greybox: these equations are compared here, its own choice of step below.
SUBSTEPS = {"lugre_friction": 64, "bouc_wen_hysteresis": 40, "stribeck_friction": 60, "backlash": 40}


def held(rig, rows=ROWS):
    """Levels held for some samples, of both signs, with a rest in between."""
    rng = np.random.default_rng(3)
    peak, each = {"micro_actuator": (1.2, 8), "pneumatic_cylinder": (3.0, 12)}[rig]
    u = np.repeat(rng.uniform(-peak, peak, rows // each), each)
    u[rows // 2 : rows // 2 + 2 * each] = 0.0
    return u


def with_effects(model, truth):
    """``model`` with effects at their true values: {name: {parameter: value}}."""
    for name, values in truth.items():
        model = model + effect(name)
        own = model.bound_effects[-1].model_names
        if name == "transport_delay":
            model = model.bound(delay=(0.0, 16 * PERIOD[model.name]))
        model = model.start(**{own[k]: v for k, v in values.items()})
    return model


def outputs(model, experiment, substeps=0):
    """Outputs (N, ny) of greybox from rest, its step, and the measured values (N, ny)."""
    record = to_record(model, experiment)
    p = np.array(list(model.values.values()))
    x0 = np.asarray(model.system.start_function(p)[0]).ravel()
    step = discretise(model.system, p, x0[None, :], record.lengths, substeps=substeps)
    q, _ = step.coefficients(p, record.lengths, np.empty(0, int))
    y, _ = make_kernel(step).simulate(record.read_by(step), q, p, x0)
    return y, step, record.y


@cache
def plain_twin(rig):
    """Outputs (N, ny) of the twin without an effect."""
    return np.array(rig_twins.simulate(rig, MODELS[rig].values, {}, held(rig), PERIOD[rig], 20))


def deviation(rig, names, substeps):
    """Largest difference between greybox and the twin, in units of the noise, and how far the effects move the outputs."""
    truth = {name: TRUTHS[rig][name] for name in names}
    model = with_effects(MODELS[rig], truth)
    u = held(rig)
    experiment = Experiment("held", np.arange(ROWS) * PERIOD[rig], {"u": u}, {}, before={"u": 0.0})
    fine = max(FINE.get(name, 20) for name in names)
    twin = np.array(rig_twins.simulate(rig, model.values, truth, u, PERIOD[rig], fine))
    ours, _, _ = outputs(model, experiment, substeps)
    return np.abs(ours - twin).max(axis=0) / NOISE[rig], np.abs(twin - plain_twin(rig)).max(axis=0) / NOISE[rig]


def test_every_effect_of_the_catalogue_is_compared_here_or_by_hand():
    assert {entry.name for entry in CATALOGUE} == set(ACTUATOR) | set(CYLINDER) | BY_HAND


def test_every_effect_of_both_rigs_is_compared():
    for rig, model in MODELS.items():
        assert set(TRUTHS[rig]) == {
            e.name
            for e in greybox.model.effects.catalogue.applicable_effects(model)
            if e.name.partition("_at_")[0] not in BY_HAND
        }
        for name, values in TRUTHS[rig].items():
            assert set(values) == {q.name for q in effect(name).parameters}


@pytest.mark.crossed(3)
@pytest.mark.parametrize(("rig", "names"), CASES, ids=lambda v: v if isinstance(v, str) else "+".join(v))
def test_the_equations_are_those_of_the_independent_simulator(rig, names):
    substeps = max(SUBSTEPS.get(name, 20) for name in names)
    off, moved = deviation(rig, names, substeps)
    assert off.max() < 1e-3
    assert moved.max() > 1.0  # the effect is in the record, not lost in rounding


SINGLES = [case for case in CASES if len(case[1]) == 1]


@pytest.mark.crossed(3)
@pytest.mark.parametrize(("rig", "names"), SINGLES, ids=lambda v: v if isinstance(v, str) else v[0])
def test_slopes_along_the_parameters_are_those_of_differences(rig, names):
    (name,) = names
    truth = TRUTHS[rig][name]
    model = with_effects(MODELS[rig], {name: truth})
    record = to_record(
        model, Experiment("held", np.arange(ROWS) * PERIOD[rig], {"u": held(rig)}, {}, before={"u": 0.0})
    )
    record = replace(record, y=np.zeros((ROWS, len(model.outputs))))
    p = np.array(list(model.values.values()))
    x0, dx0 = (np.asarray(value) for value in model.system.start_function(p))
    step = discretise(model.system, p, x0.T, record.lengths, substeps=10)
    kernel, seen, weight = make_kernel(step), record.read_by(step), 1 / np.array(NOISE[rig])
    which = np.array([model.system.parameter_names.index(model.bound_effects[0].model_names[k]) for k in truth])
    q, dq = step.coefficients(p, record.lengths, which)
    _, slopes = kernel.residuals(
        seen, KernelPoint(q, dq, p, np.eye(len(p))[:, which], x0.ravel(), dx0[:, which]), weight
    )
    for k, number in enumerate(which):
        ends = []
        for share in (1 + 1e-6, 1 - 1e-6):
            moved = p.copy()
            moved[number] *= share
            q, _ = step.coefficients(moved, record.lengths, np.empty(0, int))
            ends.append(-kernel.simulate(seen, q, moved, x0.ravel())[0] * weight)
        difference = (ends[0] - ends[1]) / (2e-6 * p[number])
        assert np.linalg.norm(slopes[:, :, k] - difference) < 1e-4 * np.linalg.norm(difference)


@pytest.mark.parametrize("rig", MODELS)
def test_absent_effects_leave_the_outputs_and_probes_move_them_a_little(rig):
    model, rows = MODELS[rig], 240
    experiment = Experiment("held", np.arange(rows) * PERIOD[rig], {"u": held(rig, rows)}, {}, before={"u": 0.0})
    plain, step, _ = outputs(model, experiment)
    record, p = to_record(model, experiment), np.array(list(model.values.values()))
    start = np.asarray(model.system.start_function(p)[0]).ravel()
    _, x = make_kernel(step).simulate(record, step.coefficients(p, record.lengths, np.empty(0, int))[0], p, start)
    scales = greybox.model.effects.scales.measure_scales(model, x, record.u, PERIOD[rig])
    peak = np.abs(plain - plain[0]).max(axis=0)
    for entry in greybox.model.effects.catalogue.applicable_effects(model, scales):
        if entry.name.startswith("reversed") or entry.late:
            continue  # a wire is reversed or not: there is no little of it
        absent = model + entry
        own = absent.bound_effects[0].model_names
        if entry.amplitudes:
            away = np.abs(outputs(absent, experiment, substeps=20)[0] - plain).max(axis=0) / NOISE[rig]
            assert away.max() < 0.01, entry.name
        grid = {name: values[0] for name, values in entry.grid(scales).items()} if entry.grid else {}
        probe = entry.probe(scales) if entry.probe else {}
        present = absent.start(**{own[name]: value for name, value in {**grid, **probe}.items()})
        moved = np.abs(outputs(present, experiment, substeps=20)[0] - plain).max(axis=0) / peak
        # choked flow replaces a law: it is never small
        assert 5e-4 < moved.max() < (0.5 if entry.amplitudes else 20.0), (entry.name, moved)


# The names of constants in the answers of the simulated cases, where they differ.
CONSTANTS = {"Mp": "M_piston", "fv": "f_v", "A": "A_piston", "Vt": "V_total", "Ps": "P_S"}
# Residual over noise at the true constants: 6000 samples scatter by 0.01, autoregressive noise by 0.03.
WHITE, COLOURED = 0.03, 0.09
# In this case the simulator lets a stuck piston creep by about 0.5 mm/s (friction as a steep tanh).
CREEPING = {"case-006": 0.08}
# The share of the noise by which the step that the program chooses itself may be off.
STEP_ERROR = 0.15


@cache
def true_model(folder):
    """The model of a simulated case with its effects and true constants, and the noise of each output; None if uncatalogued."""
    answer, case = (json.loads((folder / name).read_text()) for name in ("answer.json", "case.json"))
    if not set(answer["effects"]) <= {entry.name for entry in CATALOGUE}:
        return None
    base = {CONSTANTS.get(name, name): value for name, value in answer["base"].items() if name != "G"}
    model = with_effects(MODELS[case["model"]].fix(**(base | case["known"])), answer["effects"])
    noise = [answer["sigma"][output.name[0]] for output in model.outputs]
    return model, np.array(noise), COLOURED if answer["noise_colour"] else WHITE


def at_truth(folder):
    """Rows (record, output, misfit over noise, step error over noise) of one case, its model, discretisation and allowance."""
    model, noise, allowance = true_model(folder)
    rows = []
    for name in ("estimation", "validation"):
        record = read_csv(folder / f"{name}.csv", model, before={"u": 0.0})
        y, step, measured = outputs(model, record)
        finer, *_ = (y,) if step.per_interval else outputs(model, record, 4 * step.substeps)
        for k, output in enumerate(model.outputs):
            seen = np.isfinite(measured[:, k])
            if seen.any():
                misfit, off = (np.sqrt(np.mean(d[seen, k] ** 2)) / noise[k] for d in (y - measured, y - finer))
                rows.append((name, output.name, misfit, off))
    return rows, model, step, CREEPING.get(folder.name, allowance)


@pytest.mark.rest
@pytest.mark.parametrize("every", [3, pytest.param(1, marks=pytest.mark.slow)])
def test_simulated_cases_are_explained_to_the_noise_at_their_true_constants(shared_blind, every):
    wrong = []
    folders = [folder for folder in sorted(shared_blind.glob("case-*")) if true_model(folder)]
    assert len(folders) > 30
    for folder in folders[::every]:
        rows, model, step, allowance = at_truth(folder)
        print(
            folder.name,
            model.title,
            step.label,
            *(f"{r[0][:3]} {r[1]} {r[2]:.3f} ({r[3]:.4f})" for r in rows),
            sep="  ",
        )
        wrong += [
            (folder.name, model.title, *row) for row in rows if abs(row[2] - 1) > allowance or row[3] > STEP_ERROR
        ]
    assert not wrong
