"""Simulation against other integrators, test signals, and records that survive a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from greybox import Balance, Experiment, Input, Model, Output, Parameter, State, effect, read_csv
from greybox.base.errors import DataError, ModelError
from greybox.data.signals import multisine
from greybox.simulation.free_run import SimulationPolicy
from greybox.simulation.integrators.discretisation import DiscretisationPolicy
from greybox.simulation.simulate import read_inputs, simulate, simulate_twin, write_csv
from models.cascaded_tanks import cascaded_tanks
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder


def reference(model: Model, time: np.ndarray, u: np.ndarray, hold: str) -> np.ndarray:
    """States (N, nx) by scipy, interval by interval, from equations written out by CasADi."""
    p = np.array(list(model.values.values()))
    x = np.asarray(model.system.start_function(p)[0]).ravel()
    rows = [x]
    for k in range(len(time) - 1):
        end = u[k + 1] if hold == "first" else u[k]

        def rate(t: float, x: np.ndarray, k: int = k, end: float = end) -> np.ndarray:
            value = u[k] + (end - u[k]) * (t - time[k]) / (time[k + 1] - time[k])
            return model.system.rhs_function(x, value, p).full().ravel()

        run = solve_ivp(rate, time[k : k + 2], x, method="LSODA", rtol=1e-9, atol=1e-12)
        x = run.y[:, -1]
        rows.append(x)
    return np.array(rows)


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize(
    ("model", "step", "low"),
    [(micro_actuator, 2.5e-4, -1.0), (cascaded_tanks, 4.0, 1.0), (pneumatic_cylinder, 0.01, -1.0)],
)
def test_states_agree_with_another_integrator(model: Model, step: float, low: float, hold: str) -> None:
    time = step * np.arange(60)
    u = np.random.default_rng(3).uniform(low, 3.0, 60)
    run = simulate(model, Experiment("test", time, {"u": u}, {}, hold))
    expected = reference(model, time, u, hold)
    for k, name in enumerate(model.system.state_names):
        movement = np.ptp(expected[:, k])
        assert np.abs(run.states[name] - expected[:, k]).max() < 2e-6 * movement, name


def test_the_twin_agrees_with_the_exact_hold() -> None:
    time = 2.5e-4 * np.arange(400)
    u = multisine(time, 10, 800, 2.0, np.random.default_rng(0))
    record = simulate_twin(micro_actuator, {"u": u}, 2.5e-4)
    run = simulate(micro_actuator, record)
    for name, values in run.outputs.items():
        assert np.abs(record.outputs[name] - values).max() < 1e-7 * np.ptp(values)


def test_the_twin_refuses_what_it_cannot_follow() -> None:
    with pytest.raises(ModelError, match="dry friction"):
        simulate_twin(micro_actuator + effect("coulomb_friction"), {"u": np.ones(20)}, 1e-3)
    with pytest.raises(ModelError, match="no input 'u'"):
        simulate_twin(micro_actuator, {"U": np.ones(20)}, 1e-3)


def test_a_step_ends_at_the_static_gain_and_rk4_says_the_same() -> None:
    time = 2.5e-4 * np.arange(2000)
    inputs = {"time": time, "u": np.ones(2000)}
    run = simulate(micro_actuator, inputs)
    p = micro_actuator.values
    assert run.outputs["x"][-1] == pytest.approx(p["Kf"] / (p["K"] * p["Ra"]), rel=1e-4)
    other = simulate(micro_actuator, inputs, method="rk4")
    assert "RK4" in other.discretisation
    assert np.abs(other.outputs["x"] - run.outputs["x"]).max() < 1e-6 * np.ptp(run.outputs["x"])


def test_initial_states_are_taken_by_name() -> None:
    inputs = {"time": np.arange(5) * 1e-4, "u": np.zeros(5)}
    run = simulate(micro_actuator, inputs, initial={"x": 1e-3})
    assert run.states["x"][0] == 1e-3
    assert run.states["v"][0] == 0
    assert run.states["v"][-1] < 0
    with pytest.raises(ModelError, match="no state 'X'"):
        simulate(micro_actuator, inputs, initial={"X": 1.0})


def test_inputs_that_are_missing_are_named() -> None:
    with pytest.raises(DataError, match="no column for input 'u'"):
        simulate(micro_actuator, {"time": np.arange(5.0), "U": np.zeros(5)})
    with pytest.raises(DataError, match="no column for time"):
        simulate(micro_actuator, {"u": np.zeros(5)})


def explosive() -> Model:
    return Model(
        "explosive",
        states=[State("x", "m", 1.0)],
        inputs=[Input("u", "m/s")],
        outputs=[Output("x", "m")],
        parameters=[Parameter("a", "1/(m*s)", 1.0)],
        balances=lambda x, u, p: [Balance("growth", "m/s", 1, "x", square=p.a * x.x**2, input=u.u)],
    )


def test_an_overflow_is_a_result_that_says_when() -> None:
    time = 0.01 * np.arange(300)  # x = 1 / (1 - t)
    run = simulate(explosive(), {"time": time, "u": np.zeros(300)})
    assert run.overflow == pytest.approx(1.0, abs=0.03)
    assert simulate(explosive(), {"time": time[:50], "u": np.zeros(50)}).overflow is None


def test_an_overflow_begins_in_the_row_in_which_the_exponential_does() -> None:
    """x' = a x from one is exp(a t), which double precision holds up to its largest number: t = ln(1.8e308) / a."""
    growth = Model(
        "growth",
        states=[State("x", "m", 1.0)],
        inputs=[Input("u", "m/s")],
        outputs=[Output("x", "m")],
        parameters=[Parameter("a", "1/s", 70.0)],
        balances=lambda x, u, p: [Balance("growth", "m/s", 1, "x", own=p.a * x.x, input=u.u)],
    )
    time = 0.1 * np.arange(120)
    first = time[time > np.log(np.finfo(float).max) / 70.0][0]  # 10.2 s
    assert simulate(growth, {"time": time, "u": np.zeros(120)}).overflow == first
    # The last row alone is enough.
    assert simulate(growth, {"time": time[time <= first], "u": np.zeros(103)}).overflow == first


def test_noise_is_repeatable_and_as_large_as_asked() -> None:
    run = simulate(micro_actuator, {"time": 1e-3 * np.arange(4000), "u": np.ones(4000)})
    one, same, other = (run.record({"i": 0.01}, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(one.outputs["i"], same.outputs["i"])
    assert not np.array_equal(one.outputs["i"], other.outputs["i"])
    assert np.std(one.outputs["i"] - run.outputs["i"]) == pytest.approx(0.01, rel=0.05)
    assert np.array_equal(one.outputs["x"], run.outputs["x"])
    for noise, generator, message in (
        ({"y": 1.0}, np.random.default_rng(0), "no such output"),
        ({"x": -1.0}, np.random.default_rng(0), "not a standard deviation"),
        ({"x": 1.0}, None, "needs a generator"),
    ):
        with pytest.raises(ModelError, match=message):
            run.record(noise, generator)


def test_a_record_survives_its_file(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    x = generator.standard_normal(50) * 1e-6
    x[7] = np.nan
    time = np.cumsum(generator.uniform(0.9, 1.1, 50))
    record = Experiment("r", time, {"u": generator.standard_normal(50)}, {"x": x, "i": np.pi * x})
    file = write_csv(record, micro_actuator, tmp_path / "new" / "r.csv")
    assert file.read_text().splitlines()[0] == "time [s],u [V],x [m],i [A]"
    assert read_csv(file, micro_actuator).fingerprint == record.fingerprint


def test_inputs_are_read_without_outputs(tmp_path: Path) -> None:
    file = tmp_path / "input.csv"
    file.write_text("t [ms],drive [mV],other\n0,1000,3\n1,2000,4\n2,500,5\n")
    record = read_inputs(file, micro_actuator, columns={"u": "drive"}, hold="first")
    assert np.allclose(record.time, [0, 0.001, 0.002])
    assert np.allclose(record.inputs["u"], [1, 2, 0.5])
    assert record.hold == "first"
    assert not record.outputs
    with pytest.raises(
        DataError, match=r"no column for input 'u' \[V\]; did you mean 'drive \[mV\]'\? unused headers: drive"
    ):
        read_inputs(file, micro_actuator)
    with pytest.raises(DataError, match="file not found"):
        read_inputs(tmp_path / "none.csv", micro_actuator)


def test_the_policy_chooses_the_step():
    inputs = {"time": 2e-3 * np.arange(100), "u": np.full(100, 2.0)}
    steps = {}
    for name, share in (("usual", 0.5), ("finer", 0.05)):
        rules = DiscretisationPolicy(eigenvalue_step=share)
        policy = SimulationPolicy(max_halvings=0, discretisation=rules)
        steps[name] = simulate(pneumatic_cylinder, inputs, method="rk4", policy=policy).discretisation
    assert steps["usual"] != steps["finer"]
