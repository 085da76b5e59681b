"""The model in CasADi, do-mpc, acados and python-control runs as the library runs it."""

from __future__ import annotations

import warnings

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import greybox as gb
from greybox.base.errors import ModelError
from models.cascaded_tanks import cascaded_tanks
from models.micro_actuator import micro_actuator

DT = 2.5e-4
TIME = DT * np.arange(60)
DRIVE = 2 * np.sin(2 * np.pi * TIME / 0.01) + np.repeat([0.5, -0.3, 0.8, 0.1, -0.9, 0.2], 10)
STICKING = (micro_actuator + gb.effect("stribeck_friction")).start(Fc=0.05, Fs=0.08, vs=0.01)


def library_run(model, **options):
    run = gb.simulate(model, {"time": TIME, "u": DRIVE}, **options)
    return np.column_stack([run.outputs[o.name] for o in model.outputs])


def agree(found, expected, tolerance=1e-6):
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(found / scale, expected / scale, atol=tolerance)


def test_the_continuous_function_integrates_to_the_library_run():
    function = gb.export.to_casadi(micro_actuator)
    assert (function.name_in(), function.name_out()) == (["x", "u", "p"], ["dx", "y"])
    x, rows = np.zeros(3), []
    for u in DRIVE:
        rows.append(np.asarray(function(x, u, [])[1]).ravel())

        def rate(t, z, u=u):
            return np.asarray(function(z, u, [])[0]).ravel()

        x = solve_ivp(rate, (0, DT), x, method="LSODA", rtol=1e-9, atol=1e-13).y[:, -1]
    agree(np.array(rows), library_run(micro_actuator))


@pytest.mark.parametrize(
    "model",
    [micro_actuator, STICKING, micro_actuator + gb.effect("transport_delay")],
    ids=["linear", "friction", "delay"],
)
def test_the_sampled_function_is_the_library_step(model):
    model = model.start(delay=4e-4) if "delay" in model.values else model
    function = gb.export.to_casadi(model, DT, substeps=0 if model is micro_actuator else 8)
    x, rows = np.zeros(function.size1_in(0)), []
    # Earlier inputs belong to the state; before the drive began they were what it begins with.
    x[len(model.all_states) :] = DRIVE[0]
    for u in DRIVE:
        x, y = (np.asarray(v).ravel() for v in function(x, u, []))
        rows.append(y)
    agree(np.array(rows), library_run(model, substeps=0 if model is micro_actuator else 8), 1e-10)


def test_free_parameters_stay_arguments():
    function = gb.export.to_casadi(micro_actuator, free=["K", "M"])
    stiff = gb.export.to_casadi(micro_actuator.start(K=9e3, M=0.02))
    state = [1e-5, 0.1, 0.2]
    np.testing.assert_allclose(function(state, 1, [9e3, 0.02])[0], stiff(state, 1, [])[0])
    jacobian = ca.Function("j", [p := ca.SX.sym("p", 2)], [ca.jacobian(function(state, 1, p)[0], p)])
    assert np.count_nonzero(np.asarray(jacobian([9e3, 0.02]))) == 2
    with pytest.raises(ModelError, match="no parameter 'm'"):
        gb.export.to_casadi(micro_actuator, free=["m"])
    with pytest.raises(ModelError, match="it cannot be free"):
        gb.export.to_casadi((micro_actuator + gb.effect("transport_delay")).start(delay=4e-4), DT, free=["delay"])


def test_continuous_equations_of_sticking_friction_are_refused():
    with pytest.raises(ModelError, match="give dt for a sampled system"):
        gb.export.to_casadi(STICKING)


def do_mpc_run(model, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        do_mpc = pytest.importorskip("do_mpc", reason="do-mpc comes with the extra 'do-mpc'")
        plant = gb.export.to_do_mpc(model, **options)
        simulator = do_mpc.simulator.Simulator(plant)
        settings = {} if options else {"integration_tool": "cvodes", "abstol": 1e-13, "reltol": 1e-11}
        simulator.set_param(t_step=DT, **settings)
        simulator.setup()
        simulator.x0 = np.zeros((plant.n_x, 1))
        names = [o.name for o in model.outputs]
        rows = []
        for u in DRIVE:
            simulator.make_step(np.array([[u]]))
            rows.append([float(simulator.data["_aux", f"y_{name}"][-1, 0]) for name in names])
    return np.array(rows)


def test_do_mpc_runs_the_continuous_model():
    agree(do_mpc_run(micro_actuator), library_run(micro_actuator))


def test_do_mpc_runs_the_sampled_model_with_friction_in_it():
    agree(do_mpc_run(STICKING, dt=DT, substeps=8), library_run(STICKING, substeps=8))


def test_python_control_runs_the_sampled_model_with_friction_in_it():
    control = pytest.importorskip("control")
    system = gb.export.to_nonlinear_system(STICKING, DT, substeps=8)
    response = control.input_output_response(system, TIME, DRIVE[None, :], np.zeros(system.nstates))
    agree(response.outputs.T, library_run(STICKING, substeps=8))


def test_acados_takes_the_model():
    pytest.importorskip("acados_template", reason="acados is installed by its own instructions")
    model = gb.export.to_acados(cascaded_tanks)
    assert model.x.numel() == len(cascaded_tanks.states)


def test_what_is_missing_is_named_with_how_it_is_installed(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "acados_template", None)
    monkeypatch.setitem(sys.modules, "do_mpc.model", None)
    with pytest.raises(gb.errors.GreyboxError, match="package acados_template is missing"):
        gb.export.to_acados(micro_actuator)
    with pytest.raises(gb.errors.GreyboxError, match=r"pip install 'greybox-sysid\[do-mpc\]'"):
        gb.export.to_do_mpc(micro_actuator)


@pytest.mark.parametrize(
    "export", [gb.export.to_casadi, gb.export.to_acados, gb.export.to_do_mpc, gb.export.to_control]
)
def test_what_is_no_sampling_time_is_refused_by_its_name(export):
    with pytest.raises(ModelError, match=r"dt='plant\.casadi' is no sampling time; give a number of seconds"):
        export(micro_actuator, dt="plant.casadi")
