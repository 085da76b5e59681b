"""Effects at the inputs and outputs of an FMU: its local model, the search for them, and the fit with the FMU itself."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import lsim

import greybox as gb
from greybox.base.errors import ModelError
from greybox.data.experiment import Experiment
from greybox.discovery.decision import Verdict
from greybox.extensions.fmu.effects import FmuWithEffects, discover_fmu, fit_fmu_effects, prepare_fmu
from greybox.extensions.fmu.plant import read_fmu
from greybox.shell.commands import app
from greybox.simulation.kernel.c_compiler import GreyboxWarning
from tests.support.reference_fmus import MASS, VAN_DER_POL, build_reference_fmu
from tests.support.result_schema import strict_offences

pytest.importorskip("fmpy", reason="fmpy comes with the extra 'fmu'")
pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="there is no C compiler on the path"
)
NOISE = {"x": 2e-4, "v": 2e-3}
K, ZONE = 33.0, 0.3


def mass_record(seed, rows=300, zone=ZONE):
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
def prepared(plants):
    records = mass_record(0), mass_record(1)
    fit = gb.fit(plants["CoSimulation"].with_values(["K"]), records[0], noise=NOISE, validation=records[1])
    return prepare_fmu(fit, *records)


def test_the_response_to_the_input_has_the_poles_of_the_plant(prepared):
    response, k = prepared.local.response, prepared.fit.parameters["K"].value
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(response.A)), np.sort_complex(np.roots([1, 1.5, k])), rtol=1e-6
    )
    assert min(response.explained.values()) > 1 - 1e-9 and prepared.runs < 10


def test_it_is_linearised_along_a_record_and_exported_like_a_model(prepared, tmp_path):
    fit, k = prepared.fit, prepared.fit.parameters["K"].value
    linear, sampled = gb.linearise(fit), gb.linearise(fit, dt=0.05)
    np.testing.assert_allclose(np.sort_complex(linear.poles), np.sort_complex(np.roots([1, 1.5, k])), rtol=1e-6)
    gain = linear.frequency_response([0.0])[0, 0, 0]
    assert gain.real == pytest.approx(1 / k, rel=1e-6) and sampled.dt == 0.05
    np.testing.assert_allclose(sampled.poles, np.exp(0.05 * linear.poles), rtol=1e-9)
    with pytest.warns(GreyboxWarning, match="answer to small changes of the inputs along r0"):
        written = gb.export.to_json(fit, tmp_path / "mass.json")
    np.testing.assert_allclose(json.loads(written.read_text())["A"], linear.A)
    alone = gb.linearise(fit.model.plant, along=prepared.records[0])
    assert alone.A.shape == linear.A.shape
    with pytest.raises(ModelError, match="give along="):
        gb.linearise(fit.model.plant)
    with pytest.raises(ModelError, match="give along=, not at="):
        gb.linearise(fit, {"F": 1.0})


def test_the_local_model_is_the_fmu_where_it_was_run(prepared):
    run = gb.simulate(prepared.local.model, prepared.estimation[0])
    for name, values in prepared.fit.traces[0].simulated.items():
        np.testing.assert_allclose(run.outputs[name], values, atol=1e-9)


def test_effects_at_every_input_and_output_are_candidates(prepared):
    names = {e.name for e in prepared.local.candidates}
    assert {"input_dead_zone", "drive_lag", "transport_delay", "sensor_lag", "sensor_lag_at_v", "backlash"} <= names
    assert not any("response" in name or "fmu" in name for name in names)


@pytest.mark.parametrize("kind", ["CoSimulation", pytest.param("ModelExchange", marks=pytest.mark.slow)])
def test_an_effect_is_fitted_with_the_fmu_itself(plants, kind):
    records = mass_record(0), mass_record(1)
    fit = gb.fit(plants[kind].with_values(["K"]), records[0], noise=NOISE, validation=records[1])
    about = prepare_fmu(fit, *records)
    zone = next(e for e in about.local.candidates if e.name == "input_dead_zone")
    result = fit_fmu_effects(about, [zone], start={"d": 0.2}, noise=NOISE)
    assert result.agrees and set(result.parameters) == {"K", "d"}
    for name, true in (("K", K), ("d", ZONE)):
        estimate = result.parameters[name]
        assert abs(estimate.value - true) < 3 * estimate.std and estimate.std < 0.01 * true
    for name in NOISE:
        assert result.misfits[name].noise_ratio == pytest.approx(1, abs=0.1)
        assert result.validation[name].noise_ratio == pytest.approx(1, abs=0.1)
    assert fit.solver.statistics["simulation_equivalents"] + about.runs + result.runs < 50
    assert strict_offences(json.loads(json.dumps(result.as_dict())), FmuWithEffects) == []


@pytest.mark.slow
def test_an_effect_with_memory_is_fitted_within_its_intervals(plants):
    """A lag of the drive, which changes the input between samples, too."""
    lag, records = 0.12, []
    for seed in (0, 1):
        rng = np.random.default_rng(seed)
        time = 0.05 * np.arange(300)
        u = rng.standard_normal(51).repeat(6)[:300]
        system = [[0, 1, 0], [-K, -1.5, 1], [0, 0, -1 / lag]], [[0], [0], [1 / lag]], np.eye(3)[:2], np.zeros((2, 1))
        y = lsim(system, u, time, interp=False)[1]
        noisy = {name: y[:, j] + NOISE[name] * rng.standard_normal(300) for j, name in enumerate(NOISE)}
        records.append(Experiment(f"r{seed}", time, {"F": u}, noisy))
    fit = gb.fit(plants["ModelExchange"].with_values(["K"]), records[0], noise=NOISE, validation=records[1])
    about = prepare_fmu(fit, *records)
    candidate = next(e for e in about.local.candidates if e.name == "drive_lag")
    result = fit_fmu_effects(about, [candidate], start={"tau_u": 0.05}, noise=NOISE)
    assert result.agrees
    for name, true in (("K", K), ("tau_u", lag)):
        assert abs(result.parameters[name].value - true) < 3 * result.parameters[name].std


@pytest.mark.slow
def test_a_discovery_names_the_effect(prepared):
    candidates = [
        e for e in prepared.local.candidates if e.name in ("input_dead_zone", "input_offset", "sensor_lag", "drive_lag")
    ]
    found = discover_fmu(prepared, noise=NOISE, effects=candidates, workers=1)
    assert found.discovery.verdict is Verdict.NAMED
    assert found.with_effects.effects == ("input_dead_zone",) and found.with_effects.agrees
    assert found.with_effects.parameters["d"].value == pytest.approx(ZONE, rel=0.01)
    text = str(found)
    assert "linear response" in text and "runs of the FMU in all" in text


def test_without_inputs_effects_at_outputs_remain(tmp_path):
    plant = read_fmu(build_reference_fmu(VAN_DER_POL, tmp_path, "2.0", "CoSimulation"))
    time = 0.05 * np.arange(150)
    record = Experiment("r", time, {}, {"x0": 2 * np.cos(time)})
    about = prepare_fmu(gb.fit(plant, record), record)
    assert about.local.response is None
    assert {"sensor_lag", "sensor_drift"} <= {e.name for e in about.local.candidates}


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
    fitted = invoke(app, ["fit", plant, run, *common, "--effect", "input_dead_zone", "--output", str(out)])
    assert fitted.exit_code == 0, fitted.output
    assert json.loads((out / "fmu_fit.json").read_text())["effects"] == ["input_dead_zone"]
    checked = invoke(app, ["check", plant, run, *common, "--output", str(out)])
    assert checked.exit_code == 0 and (out / "check.json").is_file(), checked.output
    compared = invoke(app, ["compare", plant, run, "--validate", other, *common, "--output", str(out)])
    assert compared.exit_code == 0 and "arx" in compared.stdout, compared.output
    few = ["--effects", "input_dead_zone,input_offset", "--workers", "1"]
    found = invoke(app, ["discover", plant, run, "--validate", other, *common, *few, "--output", str(out)])
    assert found.exit_code == 0, found.output
    assert json.loads((out / "discovery.json").read_text())["verdict"] == "named"
    refused = invoke(app, ["discover", plant, run, "--output", str(out)])
    assert refused.exit_code == 2 and "no validation record" in refused.stderr


def test_an_effect_inside_the_fmu_is_refused(prepared):
    with pytest.raises(ModelError, match="does not have"):
        fit_fmu_effects(prepared, [gb.effect("coulomb_friction")], noise=NOISE)
