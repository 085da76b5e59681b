"""FMUs as plants: the published reference models of FMI 2 and 3, and our own exports, fitted to records."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import zipfile

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import greybox as gb
from greybox.base.errors import DataError, ModelError, OutputError
from greybox.base.json_file import read_json
from greybox.data.experiment import Experiment
from greybox.estimation.findings import EstimationCode
from greybox.extensions.fmu.plant import read_fmu
from greybox.extensions.fmu.simulator import FmuRunError, FmuSimulator
from greybox.shell.answers import FitAnswer
from greybox.shell.commands import app
from models.micro_actuator import micro_actuator
from tests.support.command import CliRunner
from tests.support.reference_fmus import BOUNCING_BALL, DAHLQUIST, MASS, VAN_DER_POL, build_reference_fmu
from tests.support.result_schema import strict_offences

pytest.importorskip("fmpy", reason="fmpy comes with the extra 'fmu'")
pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="there is no C compiler on the path"
)
KINDS = [(version, kind) for version in ("2.0", "3.0") for kind in ("CoSimulation", "ModelExchange")]
# Each version and each kind once: what is looked at has to do with either, not with both together.
CROSSED = [("2.0", "ModelExchange"), ("3.0", "CoSimulation")]
TIME = 0.05 * np.arange(200)


def van_der_pol(mu):
    def rates(t, x):
        return [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]

    return solve_ivp(rates, (0, TIME[-1]), [2.0, 0.0], t_eval=TIME, rtol=1e-10, atol=1e-12).y


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    made = {}

    def get(model, version, kind):
        if (model.name, version, kind) not in made:
            folder = tmp_path_factory.mktemp(f"{model.name}{version[0]}{kind}")
            made[model.name, version, kind] = build_reference_fmu(model, folder, version, kind)
        return made[model.name, version, kind]

    return get


@pytest.mark.parametrize(("version", "kind"), KINDS)
def test_an_fmu_runs_as_its_equations(build, version, kind):
    plant = read_fmu(build(VAN_DER_POL, version, kind))
    assert (plant.fmu.fmi_version, plant.fmu.kind, plant.inputs) == (version, kind, ())
    assert [o.name for o in plant.outputs] == ["x0", "x1"]
    record = Experiment("r", TIME, {}, {"x0": np.cos(TIME)})
    with FmuSimulator(plant.fmu) as simulator:
        for mu in (1.0, 2.0, 1.0):
            run = simulator.run(record, {"mu": mu})
            np.testing.assert_allclose(run["x0"], van_der_pol(mu)[0], atol=2e-6)


@pytest.mark.crossed(3)
@pytest.mark.parametrize("is_even", [True, False], ids=["even", "uneven"])
@pytest.mark.parametrize(("version", "kind"), KINDS)
def test_inputs_run_straight_or_are_held_as_the_record_says(build, version, kind, is_even):
    plant = read_fmu(build(MASS, version, kind))
    rows = 80
    shares = np.ones(rows) if is_even else np.random.default_rng(5).uniform(0.4, 1.8, rows)
    time = 0.05 * np.append(0.0, np.cumsum(shares)[:-1])
    u = np.sin(1.7 * time) + 0.5 * np.sign(np.sin(0.9 * time))
    A, B = np.array([[0.0, 1.0], [-30.0, -1.5]]), np.array([0.0, 1.0])
    with FmuSimulator(plant.fmu) as simulator:
        for hold in ("first", "zero", "first"):
            record = Experiment("r", time, {"F": u}, {"x": 0 * time}, hold)
            x = np.zeros((len(time), 2))
            for k, h in enumerate(np.diff(time)):
                slope = (u[k + 1] - u[k]) / h * (hold == "first")
                # x' = A x + B (u + slope s) as one exponential.
                whole = np.zeros((4, 4))
                whole[:2, :2], whole[:2, 2], whole[2, 3] = A, B, 1.0
                x[k + 1] = (expm(whole * h) @ [*x[k], u[k], slope])[:2]
            run = simulator.run(record, {"K": 30.0})
            # A staircase through the middles of ten steps leaves a hundredth of what a held input would.
            allowed = 2e-5 if (kind, hold) == ("CoSimulation", "first") else 1e-6
            np.testing.assert_allclose(run["x"], x[:, 0], atol=allowed)


def test_units_of_modelica_bounds_of_a_type_and_inputs_of_other_types_are_read(build, tmp_path):
    def change(text):
        kinds = '<SimpleType name="J"><Real unit="kg.m2" min="1" max="99"/></SimpleType>'
        switch = '<ScalarVariable name="on" valueReference="9" causality="input" variability="discrete"><Boolean start="false"/>'
        text = text.replace("<ModelVariables>", f"<TypeDefinitions>{kinds}</TypeDefinitions><ModelVariables>")
        text = text.replace("</ModelVariables>", f"{switch}</ScalarVariable></ModelVariables>")
        text = text.replace('<Real start="30.0" min="0"/>', '<Real start="30.0" declaredType="J"/>')
        return text.replace('<Real start="0"/>', '<Real start="0" unit="N.m"/>').replace(
            'start="0.0"', 'start="0.0" unit="m/s2"'
        )

    with (
        zipfile.ZipFile(build(MASS, "2.0", "CoSimulation")) as source,
        zipfile.ZipFile(tmp_path / "a.fmu", "w") as target,
    ):
        for name in source.namelist():
            data = source.read(name)
            target.writestr(name, change(data.decode()) if name == "modelDescription.xml" else data)
    plant = read_fmu(tmp_path / "a.fmu")
    (constant,) = plant.parameters
    units = [signal.unit for signal in (*plant.inputs, *plant.outputs, constant)]
    assert units == ["N*m", "m/s^2", "m/s^2", "kg*m^2"] and constant.bounds == (1.0, 99.0)
    assert plant.description.endswith("stay at their start: on")
    table = {"time [s]": TIME, "F [mN*m]": 1000 * np.sin(TIME), "x [mm/s2]": 1000 * np.cos(TIME)}
    record = gb.read_csv(table, plant.model)
    np.testing.assert_allclose([record.inputs["F"][1], record.outputs["x"][0]], [np.sin(TIME[1]), 1.0])


@pytest.mark.parametrize(("version", "kind"), CROSSED)
def test_a_perturbed_constant_returns_within_its_interval(build, version, kind):
    plant = read_fmu(build(VAN_DER_POL, version, kind))
    rng = np.random.default_rng(2)
    record = Experiment("r", TIME, {}, {"x0": van_der_pol(1.4)[0] + 0.02 * rng.standard_normal(len(TIME))})
    result = gb.fit(plant.model.start(mu=0.8), record)
    low, high = result.parameters["mu"].interval
    assert result.success and low < 1.4 < high and high - low < 0.05
    assert result.solver.statistics["simulation_equivalents"] <= 8 + 4 * (kind == "ModelExchange")
    assert result.misfit["x0"].rmse == pytest.approx(0.02, rel=0.15)
    assert "mu" in str(result) and result.solver.statistics["runs"] <= 15


def test_dahlquist_has_the_interval_of_least_squares(build):
    plant = read_fmu(build(DAHLQUIST, "3.0", "ModelExchange"))
    time = TIME[:80]
    rng = np.random.default_rng(0)
    exact = np.exp(-0.7 * time)
    result = gb.fit(plant, Experiment("r", time, {}, {"x": exact + 0.01 * rng.standard_normal(80)}), noise={"x": 0.01})
    slope = -time * exact
    assert result.parameters["k"].std == pytest.approx(0.01 / np.linalg.norm(slope), rel=0.2)
    assert abs(result.parameters["k"].value - 0.7) < 4 * result.parameters["k"].std


def bouncing(e, time):
    """Heights by the closed form between the bounces."""
    g, h0 = 9.81, 1.0
    speed, began, heights = np.sqrt(2 * g * h0), np.sqrt(2 * h0 / g), h0 - g * time**2 / 2
    while began < time[-1] and speed > 1e-3:
        speed *= e
        since = time - began
        heights = np.where(since >= 0, speed * since - g * since**2 / 2, heights)
        began += 2 * speed / g
    return heights


@pytest.mark.parametrize(("version", "kind"), CROSSED)
def test_the_bounce_of_a_ball_is_found_through_its_events(build, version, kind):
    plant, time = read_fmu(build(BOUNCING_BALL, version, kind)), 0.02 * np.arange(90)
    rng = np.random.default_rng(4)
    record = Experiment("r", time, {}, {"h": bouncing(0.8, time) + 0.01 * rng.standard_normal(len(time))})
    result = gb.fit(plant.with_values(["e"], {"e": 0.75}), record)
    # Two standard deviations: beside the slow residual of late bounces an interval has few degrees of freedom, and is wider.
    bounce = result.parameters["e"]
    low, high = bounce.value - 2 * bounce.std, bounce.value + 2 * bounce.std
    assert result.success and result.solver.statistics["simulation_equivalents"] <= 14
    # A co-simulation sees a bounce at the end of its step only.
    slack = 0.0 if kind == "ModelExchange" else 0.02
    assert low - slack < 0.8 < high + slack and high - low < 0.02


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    path = tmp_path_factory.mktemp("fmu") / "plant.fmu"
    return gb.export.to_fmu(micro_actuator, path, dt=2.5e-4, substeps=16)


def actuator_record(seed=0, rows=600):
    rng = np.random.default_rng(seed)
    time = 2.5e-4 * np.arange(rows)
    u = gb.signals.multisine(time, 5, 300, 1.0, rng)
    return gb.simulate(micro_actuator, {"time": time, "u": u}).record({"x": 1e-7, "i": 1e-3}, rng)


@pytest.mark.rest
@pytest.mark.parametrize(
    "factors", [(2, 0.8, 1.2), *(pytest.param(f, marks=pytest.mark.slow) for f in ((0.5, 1.2, 0.8), (3, 0.6, 1.4)))]
)
def test_our_own_export_gives_its_constants_back_in_fifty_simulations(exported, factors):
    plant, true = read_fmu(exported), micro_actuator.values
    start = {name: factor * true[name] for name, factor in zip("BKM", factors, strict=True)}
    result = gb.fit(plant.with_values(list(start), start), actuator_record(), validation=actuator_record(1))
    cost = result.solver.statistics
    # Some four of them tell whether the multisine, smooth and exact, was held or straight between rows.
    assert result.success and cost["simulation_equivalents"] <= 27 and cost["failed_runs"] == 0
    for name in start:
        estimate = result.parameters[name]
        assert abs(estimate.value - true[name]) < 3 * estimate.std
        assert estimate.std < 1e-3 * true[name]
    assert result.validation.misfit["x"].rmse == pytest.approx(1e-7, rel=0.1)
    own = gb.fit(micro_actuator.fix("Ra", "La", "Kf", "Kv"), actuator_record(), options=gb.FitOptions(at_rest=True))
    assert result.parameters["K"].std == pytest.approx(own.parameters["K"].std, rel=0.2)


def test_an_initial_state_is_a_parameter(exported):
    plant = read_fmu(exported)
    assert "state_x" not in [q.name for q in plant.model.free_parameters]
    time = 2.5e-4 * np.arange(120)
    run = gb.simulate(micro_actuator, {"time": time, "u": 0 * time}, initial={"x": 1e-5})
    record = run.record({"x": 1e-8, "i": 1e-4}, np.random.default_rng(0))
    result = gb.fit(plant.with_values(["state.x"], {"state.x": 5e-6}), record)
    assert result.parameters["state_x"].value == pytest.approx(1e-5, rel=1e-3)


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_a_run_that_fails_does_not_end_the_fit(build, kind):
    plant = read_fmu(build(VAN_DER_POL, "2.0", kind))
    record = Experiment("r", TIME, {}, {"x0": van_der_pol(0.3)[0]})
    # From far off the first steps overshoot into what the FMU refuses.
    result = gb.fit(plant.model.start(mu=40.0), record)
    assert result.success and result.parameters["mu"].value == pytest.approx(0.3, abs=1e-5)
    with FmuSimulator(plant.fmu) as simulator:
        with pytest.raises(FmuRunError, match="the run failed"):
            simulator.run(record, {"mu": 60.0})
        assert np.isfinite(simulator.run(record, {"mu": 1.0})["x0"]).all()
        assert (simulator.runs, simulator.failures) == (2, 1)


@pytest.mark.rest
def test_a_start_that_does_not_run_is_said(build):
    plant = read_fmu(build(VAN_DER_POL, "2.0", "CoSimulation"))
    record = Experiment("r", TIME[:80], {}, {"x0": van_der_pol(1.0)[0][:80]})
    result = gb.fit(plant.model.start(mu=60.0), record, options=gb.FitOptions(other_starts=0))
    assert not result.success and result.solver.details[0].code == EstimationCode.PLANT_RUN_FAILED
    assert "does not run" in result.solver.status_message
    # Other starts are tried as for any model, and what ran is told.
    assert gb.fit(plant.model.start(mu=60.0), record).parameters["mu"].value == pytest.approx(1.0, abs=1e-4)


def test_a_slope_is_taken_on_the_side_that_runs(build):
    plant = read_fmu(build(VAN_DER_POL, "2.0", "CoSimulation"))
    record = Experiment("r", TIME, {}, {"x0": van_der_pol(45.0)[0] + 1e-3 * np.sin(TIME)})
    result = gb.fit(plant.model.start(mu=49.999), record)
    assert result.solver.statistics["failed_runs"] > 0 and abs(result.parameters["mu"].value - 45) < 2


def test_names_and_files_that_are_wrong_are_refused(exported, tmp_path):
    plant = read_fmu(exported)
    with pytest.raises(ModelError, match="no parameter 'k'"):
        plant.with_values(["k"])
    with pytest.raises(ModelError, match="no real variable 'z'"):
        read_fmu(exported, outputs=["z"])
    (tmp_path / "bad.fmu").write_bytes(exported.read_bytes()[:300])
    with pytest.raises(DataError, match="not a readable FMU"):
        read_fmu(tmp_path / "bad.fmu")


@pytest.mark.rest
def test_the_command_fits_an_fmu(exported, tmp_path):
    record = actuator_record(rows=300)
    rows = np.column_stack([record.time, record.inputs["u"], record.outputs["x"]])
    text = "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    (tmp_path / "run.csv").write_text(f"time [s],u [V],x [m]\n{text}\n")
    words = ["fit", str(exported), str(tmp_path / "run.csv"), "--free", "K", "--free", "B", "--start", "K=5000"]
    # Everything that a fit of a model has: a profile, a prior, starts, the residual tests, a page.
    more = ["--profile", "K", "--prior", "B=0.5+-5", "--starts", "2", "--output", str(tmp_path / "out")]
    done = CliRunner().invoke(app, [*words, *more])
    assert done.exit_code == 0, done.output
    assert "explains its records" in done.stdout and (tmp_path / "out" / "report.html").is_file()
    data = read_json(tmp_path / "out" / "fit.json", gb.Fit)
    assert strict_offences(data, FitAnswer) == [] and set(data["free"]) == {"K", "B"}
    assert [p["name"] for p in data["profiles"]] == ["K"] and data["tests"] and len(data["ends"]) == 2
    idle = CliRunner().invoke(app, [*words, "--method", "rk4"])
    assert idle.exit_code == 2 and "on an FMU, whose equations are closed" in idle.stderr
    refused = CliRunner().invoke(app, [*words, "--effect", "coulomb_friction"])
    assert refused.exit_code == 2 and "coulomb_friction" in refused.stderr


def test_an_fmu_that_cannot_be_unpacked_is_said_and_leaves_no_folder(exported, tmp_path, monkeypatch) -> None:
    plant = read_fmu(exported)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(zipfile.ZipFile, "extractall", fail_on_a_full_disk)
    with pytest.raises(OutputError, match="No space"), FmuSimulator(plant.fmu):
        pass
    assert not list(tmp_path.iterdir())


def fail_on_a_full_disk(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
