"""Effects at the inputs and outputs of an FMU: what a search sees of it, and the verbs that take it with them as any model."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim

import greybox as gb
from greybox.base.errors import ModelError
from greybox.data.experiment import Experiment
from greybox.discovery.decision import Verdict
from greybox.discovery.plant_search import view_plant
from greybox.discovery.result import Discovery
from greybox.extensions.fmu.plant import read_fmu
from greybox.model.effects.catalogue import applicable_effects
from greybox.model.equations import equations_text
from greybox.shell.commands import app
from greybox.show import text
from greybox.simulation.kernel.c_compiler import GreyboxWarning
from tests.support.command import CliRunner
from tests.support.reference_fmus import MASS, VAN_DER_POL, build_reference_fmu
from tests.support.result_schema import strict_offences

pytest.importorskip("fmpy", reason="fmpy comes with the extra 'fmu'")
pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="there is no C compiler on the path"
)
NOISE = {"x": 2e-4, "v": 2e-3}
K, ZONE = 33.0, 0.3


def mass_record(seed, rows=200, zone=ZONE):
    """The mass with its constant changed and a dead zone at its input, by the exact motion of a linear system."""
    rng = np.random.default_rng(seed)
    time = 0.05 * np.arange(rows)
    u = rng.standard_normal(rows // 6 + 1).repeat(6)[:rows]
    system = [[0, 1], [-K, -1.5]], [[0], [1]], np.eye(2), np.zeros((2, 1))
    y = lsim(system, u - np.clip(u, -zone, zone), time, interp=False)[1]
    noisy = {name: y[:, j] + NOISE[name] * rng.standard_normal(rows) for j, name in enumerate(NOISE)}
    return Experiment(f"r{seed}", time, {"F": u}, noisy)


@pytest.fixture(scope="module")
def plants(tmp_path_factory):
    return {
        kind: read_fmu(build_reference_fmu(MASS, tmp_path_factory.mktemp(kind), version, kind))
        for version, kind in (("2.0", "CoSimulation"), ("3.0", "ModelExchange"))
    }


@pytest.fixture(scope="module")
def records():
    return mass_record(0), mass_record(1)


@pytest.fixture(scope="module")
def fitted(plants, records):
    return gb.fit(plants["CoSimulation"].with_values(["K"]), records[0], noise=NOISE, validation=records[1])


def test_the_response_to_the_input_has_the_poles_of_the_plant(fitted):
    view, k = view_plant(fitted), fitted.parameters["K"].value
    response = view.response
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(response.A)), np.sort_complex(np.roots([1, 1.5, k])), rtol=1e-6
    )
    assert min(response.explained.values()) > 1 - 1e-9 and view.runs < 10


def test_it_is_linearised_along_a_record_and_exported_like_a_model(fitted, records, tmp_path):
    fit, k = fitted, fitted.parameters["K"].value
    linear, sampled = gb.linearise(fit), gb.linearise(fit, dt=0.05)
    np.testing.assert_allclose(np.sort_complex(linear.poles), np.sort_complex(np.roots([1, 1.5, k])), rtol=1e-6)
    gain = linear.frequency_response([0.0])[0, 0, 0]
    assert gain.real == pytest.approx(1 / k, rel=1e-6) and sampled.dt == 0.05
    np.testing.assert_allclose(sampled.poles, np.exp(0.05 * linear.poles), rtol=1e-9)
    with pytest.warns(GreyboxWarning, match="answer to small changes of the inputs along r0"):
        written = gb.export.write_linear(fit, tmp_path / "mass.json", "json")
    np.testing.assert_allclose(json.loads(written.read_text())["A"], linear.A)
    alone = gb.linearise(fit.model.plant, along=records[0])
    assert alone.A.shape == linear.A.shape
    with pytest.raises(ModelError, match="give along="):
        gb.linearise(fit.model.plant)
    with pytest.raises(ModelError, match="give along=, not at="):
        gb.linearise(fit, {"F": 1.0})


def test_the_model_about_its_run_is_the_fmu_where_it_was_run(fitted):
    view = view_plant(fitted)
    run = gb.simulate(view.model, view.estimation[0])
    for name, values in fitted.traces[0].simulated.items():
        np.testing.assert_allclose(run.outputs[name], values, atol=1e-9)


def test_what_the_rig_lacks_is_known_of_the_model_about_its_run(fitted):
    told = replace(fitted, model=fitted.model.with_parts(has=["motor"], lacks=["link"]))
    view = view_plant(told)
    assert (view.model.has, view.model.lacks) == (("motor",), ("link",))


def test_effects_at_every_input_and_output_are_candidates(fitted):
    names = {e.name for e in applicable_effects(fitted.model)}
    assert {"input_dead_zone", "drive_lag", "transport_delay", "sensor_lag", "sensor_lag_at_v", "backlash"} <= names


@pytest.mark.parametrize("kind", ["CoSimulation", pytest.param("ModelExchange", marks=pytest.mark.slow)])
def test_an_effect_is_fitted_with_the_fmu_itself(plants, records, kind):
    """From where it is absent: the dead zone and the constant that had made up for it, within their intervals."""
    fit = gb.fit(plants[kind].with_values(["K"]), records[0], noise=NOISE)
    result = gb.fit(fit.model + gb.effect("input_dead_zone"), records[0], noise=NOISE, validation=records[1])
    assert result.success and set(result.parameters) == {"K", "d"}
    for name, true in (("K", K), ("d", ZONE)):
        estimate = result.parameters[name]
        assert abs(estimate.value - true) < 3 * estimate.std and estimate.std < 0.01 * true
    for name in NOISE:
        assert result.misfit[name].noise_ratio == pytest.approx(1, abs=0.1)
        assert result.validation.misfit[name].noise_ratio == pytest.approx(1, abs=0.1)
    assert result.solver.statistics["simulation_equivalents"] < 25
    assert "input_dead_zone at F" in str(equations_text(result.model))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "constant"), [("drive_lag", "tau_u"), ("sensor_lag", "tau_s")])
def test_an_effect_with_memory_is_fitted_within_its_intervals(plants, name, constant):
    """A lag of the drive, which changes the input between samples, too; and one of a sensor. The exact motion by scipy."""
    lag, rng = 0.12, np.random.default_rng(0)
    time = 0.05 * np.arange(300)
    u = rng.standard_normal(51).repeat(6)[:300]
    if name == "drive_lag":
        A, C = [[0, 1, 0], [-K, -1.5, 1], [0, 0, -1 / lag]], np.eye(3)[:2]
        B = [[0], [0], [1 / lag]]
    else:
        A, C = [[0, 1, 0], [-K, -1.5, 0], [1 / lag, 0, -1 / lag]], np.eye(3)[[2, 1]]
        B = [[0], [1], [0]]
    y = lsim((A, B, C, np.zeros((2, 1))), u, time, interp=False)[1]
    noisy = {name: y[:, j] + NOISE[name] * rng.standard_normal(300) for j, name in enumerate(NOISE)}
    record = Experiment("r", time, {"F": u}, noisy)
    for plant in plants.values():
        result = gb.fit(plant.with_values(["K"]) + gb.effect(name), record, noise=NOISE)
        for known, true in (("K", K), (constant, lag)):
            assert abs(result.parameters[known].value - true) < 3 * result.parameters[known].std


@pytest.mark.slow
def test_a_discovery_names_the_effect(fitted, records):
    """As any discovery: one value, one text, one file; its places are the ports of the FMU, its fits those of the FMU."""
    names = ("input_dead_zone", "input_offset", "sensor_lag")
    found = gb.discover(
        fitted.model,
        records[0],
        validation=records[1],
        test=mass_record(2),
        noise=NOISE,
        effects=list(map(gb.effect, names)),
        workers=1,
    )
    assert type(found) is Discovery and found.verdict is Verdict.NAMED
    assert [e["name"] for e in found.effects] == ["input_dead_zone"]
    assert found.best.model.plant is fitted.model.plant and found.best.model.effect_names == ("input_dead_zone",)
    assert abs(found.best.parameters["d"].value - ZONE) < 3 * found.best.parameters["d"].std
    assert found.base.parameters["K"].value == pytest.approx(fitted.parameters["K"].value, rel=1e-6)
    assert {s["name"] for s in found.ranked_sites} == {"F", "x", "v"} and found.sites == ("input F",)
    assert [c.name for c in found.claims if c.name] == ["input_dead_zone"]
    exact = gb.validate(found.best.model, mass_record(2), noise=NOISE).misfit
    assert {n: e.after for n, e in found.test.items()} == pytest.approx({n: m.rmse for n, m in exact.items()}, rel=1e-6)
    said = " ".join(text(found, details=True).split())
    assert "linear response" in said and "was run" in said
    assert not any(word in said for word in ("run_x", "response_1"))
    assert strict_offences(json.loads(json.dumps(found.as_dict())), Discovery) == []


def test_without_inputs_effects_at_outputs_remain(tmp_path):
    plant = read_fmu(build_reference_fmu(VAN_DER_POL, tmp_path, "2.0", "CoSimulation"))
    time = 0.05 * np.arange(150)
    fit = gb.fit(plant, Experiment("r", time, {}, {"x0": 2 * np.cos(time)}))
    assert view_plant(fit).response is None
    assert {"sensor_lag", "sensor_drift"} <= {e.name for e in applicable_effects(fit.model)}


@pytest.mark.slow
def test_the_commands_take_an_fmu(plants, tmp_path):
    for name, record in (("run", mass_record(0)), ("other", mass_record(1))):
        rows = np.column_stack([record.time, record.inputs["F"], record.outputs["x"], record.outputs["v"]])
        text = "\n".join(",".join(map(repr, row)) for row in rows.tolist())
        (tmp_path / f"{name}.csv").write_text(f"time [s],F,x,v\n{text}\n")
    plant, run, other = str(plants["CoSimulation"].fmu.path), str(tmp_path / "run.csv"), str(tmp_path / "other.csv")
    common = ["--free", "K", "--noise", "x=2e-4", "--noise", "v=2e-3", "--no-report"]
    invoke = CliRunner().invoke
    out = tmp_path / "out"
    fitted = invoke(
        app, ["fit", plant, run, *common, "--effect", "input_dead_zone", "--start", "d=0.2", "--output", str(out)]
    )
    assert fitted.exit_code == 0, fitted.output
    assert json.loads((out / "fit.json").read_text())["effects"] == ["input_dead_zone"]
    checked = invoke(app, ["check", plant, run, *common, "--output", str(out)])
    assert checked.exit_code == 0 and (out / "check.json").is_file(), checked.output
    compared = invoke(app, ["compare", plant, run, "--validate", other, *common, "--output", str(out)])
    assert compared.exit_code == 0 and "arx" in compared.stdout, compared.output
    few = ["--effects", "input_dead_zone,input_offset", "--workers", "1"]
    found = invoke(app, ["discover", plant, run, "--validate", other, *common, *few, "--output", str(out)])
    assert found.exit_code == 0, found.output
    assert json.loads((out / "discovery.json").read_text())["verdict"] == "named"
    assert (
        json.loads((out / "fit.json").read_text())["effects"] == ["input_dead_zone"] and not (out / "model.py").exists()
    )
    ran = invoke(app, ["simulate", plant, run, "--set", "K=33", "--no-report", "--output", str(out / "run.csv")])
    assert ran.exit_code == 0, ran.output
    refused = invoke(app, ["discover", plant, run, "--output", str(out)])
    assert refused.exit_code == 2 and "--validate FILE is missing" in refused.stderr


def test_an_effect_inside_the_fmu_is_refused(fitted):
    with pytest.raises(ModelError, match=r"coulomb_friction' acts inside, .* at its inputs and outputs \(F, x, v\)"):
        fitted.model + gb.effect("coulomb_friction")
    with pytest.raises(ModelError, match="says how a record holds an input"):
        fitted.model + gb.effect("linear_input")
    with pytest.raises(ModelError, match="needs equations; leave out laws"):
        gb.discover(fitted.model, mass_record(0), validation=mass_record(1), laws=True)
