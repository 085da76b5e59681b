"""`greybox export`: what it prints, writes and refuses."""

import json
import subprocess
import sys

import casadi as ca
import numpy as np
import pytest

import greybox as gb
from greybox.base.values import Finding
from greybox.estimation.linear.exported_model import ExportFinding
from greybox.shell.commands import app
from greybox.simulation.simulate import simulate_twin
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder
from models.silverbox import silverbox
from tests.support.command import CliRunner

FORMATS = {"control": "_ss.py", "mat": ".mat", "json": ".json", "numpy": ".npz", "modelica": ".mo", "python": ".py"}


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fit")
    t = np.arange(600) * 2.5e-4
    model = (micro_actuator + gb.effect("coulomb_friction")).fix("M", "Ra", "La", "Kv", "Kf").start(Fc=0.01)
    record = gb.simulate(model, {"time": t, "u": np.sign(np.sin(300 * t))}).record(
        {"x": 1e-7, "i": 1e-3}, np.random.default_rng(0)
    )
    return gb.fit(model, record).save(folder / "fit.json")


def export(*arguments):
    return CliRunner().invoke(app, ["export", *map(str, arguments)])


@pytest.mark.parametrize("to", FORMATS)
def test_each_format_is_written(saved, tmp_path, monkeypatch, to):
    monkeypatch.chdir(tmp_path)
    done = export(saved, "--to", to)
    assert done.exit_code == 0, done.output
    assert (tmp_path / "results" / "micro_actuator-export" / f"micro_actuator{FORMATS[to]}").is_file()
    assert "files: results" in done.output


@pytest.mark.rest
@pytest.mark.parametrize(("to", "files"), [("c", [".c", ".h"]), ("fmu", [".fmu"])])
def test_code_is_stepped_as_the_records_were(saved, tmp_path, to, files):
    done = export(saved, "--to", to, "--output", tmp_path / "plant")
    assert done.exit_code == 0, done.output
    assert "0.00025 s" in done.output
    assert all((tmp_path / f"plant{suffix}").is_file() for suffix in files)


@pytest.fixture(scope="module")
def saved_oscillator(tmp_path_factory):
    """A fit of two states: the observer of the drive takes the C compiler twenty seconds."""
    t = np.arange(300) * 2e-3
    record = gb.simulate(silverbox, {"time": t, "u": 0.1 * np.sign(np.sin(80 * t))}).record(
        {"y": 1e-4}, np.random.default_rng(0)
    )
    return gb.fit(silverbox, record).save(tmp_path_factory.mktemp("oscillator") / "fit.json")


@pytest.mark.parametrize(("to", "files"), [("c", [".c", ".h"]), ("fmu", [".fmu"]), ("python", [".py"])])
def test_an_observer_is_written(saved_oscillator, tmp_path, to, files):
    done = export(
        saved_oscillator, "--to", to, "--observer", "--process-noise", "v=0.5", "--output", tmp_path / "plant"
    )
    assert done.exit_code == 0, done.output
    assert "Kalman filter, step 0.002 s" in " ".join(done.output.split())
    assert all((tmp_path / f"plant{suffix}").is_file() for suffix in files)


def test_an_observer_of_a_model_that_lacks_nothing_says_what_to_give(saved, tmp_path):
    done = export(saved, "--to", "c", "--observer", "--output", tmp_path / "plant")
    assert done.exit_code == 2
    assert "--process-noise" in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.rest
def test_a_casadi_function_is_read_back(saved, tmp_path):
    done = export(saved, "--to", "casadi", "--dt", "2.5e-4", "--output", tmp_path / "plant")
    assert done.exit_code == 0, done.output
    function = ca.Function.deserialize((tmp_path / "plant.casadi").read_text())
    assert (function.name_out(), function.size1_in(0)) == (["x_next", "y"], 3)


def test_poles_zeros_gain_and_bandwidth_are_printed(saved, tmp_path):
    done = export(
        saved,
        "--to",
        "json",
        "--at",
        "u=1",
        "--dt",
        "2.5e-4",
        "--samples",
        "5",
        "--output",
        tmp_path / "p.json",
        "--details",
    )
    assert done.exit_code == 0, done.output
    for text in ("poles (z)", "u -> x: gain 29.", "bandwidth (-3 dB)", "5 models drawn from the covariance", "x = 2.9"):
        assert text in done.output
    read = json.loads((tmp_path / "p.json").read_text())
    assert ExportFinding.FRICTION_LEFT_OUT in [f["code"] for f in read["findings"]]
    assert len(read["family"]["A"]) == 5 and read["u0"] == [1.0]


def test_a_minimal_model_says_what_was_taken_out_and_so_is_its_family(tmp_path):
    t = 0.01 * np.arange(300)
    noise = {"s": 2e-4, "p_a": 500.0, "p_b": 500.0}
    record = gb.simulate(pneumatic_cylinder, {"time": t, "u": np.sin(6 * t)}).record(noise, np.random.default_rng(0))
    fit = gb.fit(pneumatic_cylinder, record, noise=noise).save(tmp_path / "fit.json")
    done = export(fit, "--to", "json", "--minimal", "--samples", "3", "--dt", "0.01", "--output", tmp_path / "p.json")
    assert done.exit_code == 0, done.output
    read = json.loads((tmp_path / "p.json").read_text())
    (finding,) = (f for f in read["findings"] if f["code"] == ExportFinding.STATES_REMOVED)
    assert finding["values"]["unreached"] == ["p_b"]
    assert np.shape(read["A"]) == (3, 3) and np.shape(read["family"]["A"]) == (3, 3, 3)
    assert all(channel["integrators"] == (name == "u -> s") for name, channel in read["channels"].items())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--to", "c", "--at", "u=1"], "--at: no effect with --to c; leave it out"),
        (["--to", "python", "--dt", "1e-3"], "--dt: no effect with --to python"),
        (["--to", "mat", "--at", "uu=1"], "no state or input 'uu'; did you mean 'u'"),
        (["--to", "mat", "--at", "u=one"], "'one' is not a number"),
        (
            ["--to", "mat", "--method", "tustin"],
            "--method tustin has no effect: it samples the model; give --dt SECONDS too",
        ),
        (["--to", "mat", "--output", "p.py"], "--to mat writes .mat; give a file with that suffix"),
        (["--to", "mat", "--seed", "3"], "--seed 3 has no effect: no models are drawn; give --samples N too"),
        (["--to", "mat", "--dt", "-1"], "sampling time -1.0 s: give a time above 0 s"),
        (
            ["--to", "mat", "--at", "x=1e-3", "--at", "u=0"],
            "has no equilibrium with x = 0.001 m, u = 0 V, out of balance: force",
        ),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_is_written(saved, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    done = export(saved, *arguments)
    assert done.exit_code == 2
    assert message in done.output and "Traceback" not in done.output
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_no_fit_is_refused(tmp_path):
    (tmp_path / "list.json").write_text("[1, 2]")
    (tmp_path / "text.json").write_text("hello")
    for name, message in (
        ("list.json", "not a fit of this program"),
        ("text.json", "not JSON"),
        ("gone.json", "No such file"),
    ):
        done = export(tmp_path / name, "--to", "mat")
        assert done.exit_code == 2 and message in done.output


def test_a_fit_of_an_unknown_model_asks_for_its_file(saved, tmp_path):
    data = json.loads(saved.read_text())
    other = tmp_path / "fit.json"
    other.write_text(json.dumps(data | {"model": "micro_actuatr"}))
    done = export(other, "--to", "mat")
    assert done.exit_code == 2
    assert "did you mean 'micro_actuator'" in done.output and "--model my/rig.py" in done.output


def test_a_fit_that_failed_is_warned_about(saved, tmp_path):
    data = json.loads(saved.read_text())
    other = tmp_path / "fit.json"
    other.write_text(json.dumps(data | {"success": False, "status": "interrupted"}))
    done = export(other, "--to", "mat", "--output", tmp_path / "p.mat")
    assert done.exit_code == 0
    assert f"warning: {Finding(ExportFinding.FIT_FAILED, values={'status': 'interrupted'})}\n" in done.output


@pytest.mark.rest
def test_the_exported_python_model_can_be_fitted_again(saved, tmp_path):
    assert export(saved, "--to", "python", "--output", tmp_path / "rig.py").exit_code == 0
    done = subprocess.run(
        [sys.executable, "-m", "greybox", "models", str(tmp_path / "rig.py")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "micro_actuator + coulomb_friction" in done.stdout


PLAIN = """
from greybox import Balance, Input, Model, Output, Parameter, State
mass = Model(
    "mass", [State("x", "m"), State("v", "m/s")], [Input("F", "N")], [Output("x", "m")],
    [Parameter("M", "kg", 1.0, (0.01, 10.0)), Parameter("K", "N/m", 200.0, (1.0, 1e5))],
    lambda x, u, p: [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        Balance("force", "N", p.M, "v", drive=u.F, spring=-p.K * x.x),
    ],
)
"""
OWN = """
import greybox as gb
from plain import mass
brake = gb.Effect(
    "brake", "force", [gb.Parameter("ce", "{force}/{velocity}", 0.5, (0.0, 100.0))],
    terms=lambda x, u, p: -p.ce * x.velocity, equation="-ce v",
)
rig = mass + brake
"""


def test_a_result_with_an_effect_of_ones_own_is_exported_with_a_file_that_adds_it(tmp_path, monkeypatch):
    (tmp_path / "plain.py").write_text(PLAIN)
    (tmp_path / "own.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    import own

    drive = np.repeat(np.random.default_rng(3).standard_normal(10), 20)
    record = simulate_twin(own.rig, {"F": drive}, 0.02, {"x": 1e-5}, 1)
    gb.fit(own.rig, record, noise={"x": 1e-5}).save("f.json")
    words = ("f.json", "--to", "json", "--no-report", "--output", "out.json", "--model")
    refused = export(*words, "plain.py")
    text = " ".join(refused.stderr.split())
    assert refused.exit_code == 2 and "--model takes a file that adds it, such as rig = mass + brake" in text
    done = export(*words, "own.py")
    assert done.exit_code == 0, done.stderr
