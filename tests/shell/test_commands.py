"""The command as a person or a program meets it: exit codes, messages, files and JSON."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from greybox import Experiment, FitOptions, fit, load_fit, read_csv
from greybox.data.findings import RecordCode
from greybox.data.signals import multisine
from greybox.shell import fit as fit_command
from greybox.shell.commands import app
from greybox.simulation.simulate import simulate, write_csv
from models.micro_actuator import micro_actuator

Run = Callable[..., Result]
NOISE = {"x": 2e-7, "i": 5e-3}
KNOWN = ["--fix", "M=0.01", "--fix", "Ra=8"]
PACE = ["--duration", "1", "--sampling-time", "0.01"]
PRECISE = ["--noise", "x=2e-7", "--noise", "i=5e-3"]


def record(rows: int, seed: int) -> Experiment:
    time = 2.5e-4 * np.arange(rows)
    generator = np.random.default_rng(seed)
    u = multisine(time, 5, 800, 2.0, generator)
    return simulate(micro_actuator, {"time": time, "u": u}).record(NOISE, generator)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    write_csv(record(1500, 1), micro_actuator, folder / "train.csv")
    write_csv(record(600, 2), micro_actuator, folder / "test.csv")
    return folder


def everything(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def drawn(*names: str) -> list[str]:
    """Every figure is there three times."""
    return [f"{name}.{kind}" for name in names for kind in ("png", "svg", "pdf")]


@pytest.mark.rest
def test_a_fit_prints_saves_and_draws(run: Run, data: Path, tmp_path: Path) -> None:
    start = ["--start", "K=5000", "--start", "Kv=1"]
    judge = ["--validate", data / "test.csv", "--skip", 50]
    result = run(
        "fit", "micro_actuator", data / "train.csv", *KNOWN, *start, *PRECISE, *judge, "--at-rest", "--figures"
    )
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    lines = result.stdout.splitlines()
    assert lines[0].startswith("micro_actuator explains its records: the error in ")
    assert len(lines) <= 25 and max(map(len, lines)) <= 80
    for text in (
        "Kf ",
        "[",
        "V*s/m",
        "1 validation record",
        "next: greybox export results/micro_actuator-fit/fit.json",
    ):
        assert text in result.stdout
    assert "M dv/dt = Kf i" not in result.stdout
    folder = tmp_path / "results" / "micro_actuator-fit"
    figures = ["fit-train", "residual-i", "residual-x", "validation-test"]
    assert everything(folder) == sorted(["constants.tex", "fit.json", "report.html", *drawn(*figures)])
    files = {
        Path(file).name
        for file in result.stdout.partition("files in results/micro_actuator-fit: ")[2].replace(",", "").split()
    }
    assert files == {name for name in everything(folder) if not name.endswith((".svg", ".pdf"))}
    saved = json.loads((folder / "fit.json").read_text())
    assert saved["model"] == "micro_actuator"
    assert saved["status"] == "converged"
    assert saved["success"] is True
    assert saved["options"]["at_rest"] is True
    assert set(saved["parameters"]) == set(micro_actuator.values)
    for name, estimate in saved["parameters"].items():
        assert set(estimate) == {"value", "std", "interval", "unit", "fixed", "at_bound"}
        assert estimate["fixed"] is (name in ("M", "Ra"))
        if not estimate["fixed"]:
            low, high = estimate["interval"]
            assert low < estimate["value"] < high
            assert abs(estimate["value"] - micro_actuator.values[name]) < 4 * estimate["std"]
    for part in ("misfit", "validation"):
        assert set(saved[part]) == {"x", "i"}
        for output, misfit in saved[part].items():
            assert {"rmse", "unit", "best_fit_percent", "noise_ratio"} <= set(misfit)
            assert misfit["noise_ratio"] == pytest.approx(1, abs=0.15)
            assert misfit["rmse"] == pytest.approx(NOISE[output], rel=0.15)
    assert saved["validation"]["x"]["samples"] == 550


def test_the_command_does_what_the_library_does(run: Run, data: Path, tmp_path: Path) -> None:
    result = run("fit", "micro_actuator", data / "train.csv", *KNOWN, *PRECISE, "--json", "--output", "out")
    assert result.exit_code == 0
    printed = json.loads(result.stdout)
    model = micro_actuator.fix(M=0.01, Ra=8)
    expected = fit(model, read_csv(data / "train.csv", model), noise=NOISE, options=FitOptions())
    saved = load_fit(tmp_path / "out" / "fit.json", model)
    for name, estimate in expected.parameters.items():
        assert printed["parameters"][name]["value"] == pytest.approx(estimate.value, rel=1e-6)
        assert saved.parameters[name].value == printed["parameters"][name]["value"]


def test_quiet_means_silent(run: Run, data: Path, tmp_path: Path) -> None:
    result = run("fit", "micro_actuator", data / "train.csv", *KNOWN, "-q", "--no-report", "--output", "out")
    assert (result.exit_code, result.output) == (0, "")
    assert everything(tmp_path) == ["out", "out/fit.json"]


def test_notes_of_the_records_go_to_stderr_once(run: Run, data: Path, tmp_path: Path) -> None:
    _, *rows = (data / "train.csv").read_text().splitlines()
    for name, used in (("a.csv", rows), ("b.csv", rows[:-1])):
        (tmp_path / name).write_text("\n".join(["time,u,x,temp", *(row.rpartition(",")[0] + ",20" for row in used)]))
    arguments = ["fit", "micro_actuator", "a.csv", "--validate", "b.csv", *KNOWN, "--fix", "Kf", "--noise", "x=2e-7"]
    result = run(*arguments, "--json")
    assert result.exit_code == 0, result.output
    assert result.stderr.splitlines() == [
        "note: a.csv, b.csv: not measured: output 'i'",
        "note: a.csv, b.csv: the header gives no unit for time, u, x: s, V, m assumed",
        "note: a.csv, b.csv: columns ignored: 'temp'",
        "note: b.csv: rows 1 to 1499 are the readings of rows 1 to 1499 of a.csv, which is fitted: it cannot validate the model;"
        " use a record that is not",
    ]
    assert run(*arguments, "-q").output == ""


def test_several_validation_records_are_judged_one_by_one(run: Run, data: Path, tmp_path: Path) -> None:
    off = read_csv(data / "test.csv", micro_actuator)
    write_csv(off.with_outputs({**off.outputs, "x": off.outputs["x"] + 2e-6}), micro_actuator, tmp_path / "off.csv")
    judges = ["--validate", data / "test.csv", "--validate", "off.csv", "--skip", 50]
    result = run(
        "fit",
        "micro_actuator",
        data / "train.csv",
        *KNOWN,
        *PRECISE,
        *judges,
        "--at-rest",
        "--output",
        "out",
        "--details",
    )
    assert result.exit_code == 0, result.output
    table = result.stdout.partition("validation record  ")[2].partition("next:")[0]
    ratios = {tuple(line.split()[:2]): float(line.split()[8]) for line in table.splitlines()[1:] if line.strip()}
    assert set(ratios) == {(name, output) for name in ("test", "off") for output in ("x", "i")}
    assert ratios["test", "x"] == pytest.approx(1, abs=0.15)
    assert ratios["off", "x"] == pytest.approx(np.hypot(10, 1), rel=0.05)
    model = micro_actuator.fix(M=0.01, Ra=8)
    saved = load_fit(tmp_path / "out" / "fit.json", model)
    pooled = np.sqrt(np.mean([ratios["test", "x"] ** 2, ratios["off", "x"] ** 2]))
    assert saved.validation.misfit["x"].noise_ratio == pytest.approx(pooled, rel=5e-3)  # three digits are printed


@pytest.mark.slow
def test_an_output_that_only_a_validation_record_has_is_drawn(run: Run, data: Path, tmp_path: Path) -> None:
    rows = [line.rpartition(",")[0] for line in (data / "train.csv").read_text().splitlines()]
    (tmp_path / "x.csv").write_text("\n".join(rows))
    judge = ["--validate", data / "test.csv"]
    result = run("fit", "micro_actuator", "x.csv", *KNOWN, "--fix", "Kf", *judge, "--figures", "--output", "out")
    assert result.exit_code == 0, result.output
    figures = drawn("fit-x", "residual-x", "validation-test")
    assert everything(tmp_path / "out") == sorted(["constants.tex", "fit.json", "report.html", *figures])


def test_a_free_decay_is_fitted_when_it_is_said_to_be_one(run: Run, tmp_path: Path) -> None:
    time = 2.5e-4 * np.arange(1200)
    decay = simulate(micro_actuator, {"time": time, "u": 0 * time}, initial={"x": 1e-4})
    write_csv(decay.record(NOISE, np.random.default_rng(3)), micro_actuator, tmp_path / "decay.csv")
    arguments = ["fit", "micro_actuator", "decay.csv", *KNOWN, "--fix", "Kf", "--fix", "Kv", "--fix", "La", *PRECISE]
    refused = run(*arguments)
    assert refused.exit_code == 2
    assert "(shell: --free-decay)" in refused.stderr
    result = run(*arguments, "--free-decay", "--output", "out")
    assert result.exit_code == 0, result.output
    saved = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert RecordCode.INPUT_CONSTANT in {finding["code"] for finding in saved["findings"]}
    estimate = saved["parameters"]["K"]
    assert abs(estimate["value"] - micro_actuator.values["K"]) < 4 * estimate["std"]


def test_substeps_that_may_have_no_effect_are_noted(run: Run, data: Path) -> None:
    result = run("fit", "micro_actuator", data / "train.csv", *KNOWN, *PRECISE, "--substeps", 4, "--output", "out")
    assert result.exit_code == 0
    assert "note: --substeps 4 has no effect on a linear model" in result.stderr


def test_an_effect_brings_its_parameters(run: Run, data: Path, tmp_path: Path) -> None:
    options = ["--effect", "cubic_stiffness", "--method", "rk4", "--substeps", 8, "--at-rest", "--output", "out"]
    name = next(q.name for q in _with_effect("cubic_stiffness").all_parameters if q.name not in micro_actuator.values)
    result = run("fit", "micro_actuator", data / "train.csv", *KNOWN, *PRECISE, *options, "--start", f"{name}=1000")
    assert result.exit_code == 0, result.output
    saved = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert saved["effects"] == ["cubic_stiffness"]
    estimate = saved["parameters"][name]
    assert abs(estimate["value"]) < 4 * estimate["std"]
    assert "8 substeps" in saved["discretisation"]


def _with_effect(name: str):
    from greybox import effect

    return micro_actuator + effect(name)


def test_columns_and_units_are_mapped(run: Run, data: Path, tmp_path: Path) -> None:
    header, *rows = (data / "train.csv").read_text().splitlines()
    assert header == "time [s],u [V],x [m],i [A]"
    (tmp_path / "other.csv").write_text("\n".join(["time [s],Spannung [V],Weg [m],i [A]", *rows]) + "\n")
    columns = ["--column", "u=Spannung", "--column", "x=Weg [m]"]
    result = run("fit", "micro_actuator", "other.csv", *KNOWN, *columns, "-q")
    assert result.exit_code == 0, result.output


BAD_FITS = [
    (["micro_actuatr", "DATA"], "no model 'micro_actuatr'; did you mean 'micro_actuator'"),
    (["micro_actuator", "trian.csv"], "trian.csv: file not found"),
    (["micro_actuator", "DATA", "--fix", "Mm=1"], "no parameter 'Mm'; did you mean 'M'"),
    (["micro_actuator", "DATA", "--fix", "M=ten"], "--fix M=ten: 'ten' is not a number"),
    (["micro_actuator", "DATA", "--fix", "M=nan"], "must be finite"),
    (["micro_actuator", "DATA", "--fix", "M=5"], "'M': 5 kg lies outside its bounds [0.0001, 1] kg"),
    (["micro_actuator", "DATA", "--start", "M"], "--start M: it has no '='; write --start NAME=VALUE"),
    (["micro_actuator", "DATA", "--fix", "M=1", "--fix", "M=0.5"], "--fix M: given twice"),
    (["micro_actuator", "DATA", "--fix", "M=0.1", "--start", "M=0.2"], "M: --fix and --start contradict each other"),
    (["micro_actuator", "DATA", "--fix", "M", "--free", "M"], "M: --fix and --free contradict each other"),
    (["micro_actuator", "DATA", "--effect", "coulomb"], "no effect 'coulomb'; did you mean 'coulomb_friction'"),
    (["micro_actuator", "DATA", "--noise", "y=1"], "noise of 'y': the model has no such output"),
    (["micro_actuator", "DATA", "--noise", "x=0"], "not a positive standard deviation"),
    (["micro_actuator", "DATA", "--column", "x=Laser"], "'Laser', which the file does not have"),
    (["micro_actuator", "DATA", "--validate", "DATA", "--skip", "1500"], "shortest validation record has 1500"),
    (["micro_actuator", "DATA", "--validate", "DATA", "--skip", "1491"], "at least 10 must be left; leave out fewer"),
    (["micro_actuator", "DATA", "--skip", "100"], "--skip 100 has no effect: it leaves out rows of validation records"),
    (
        ["micro_actuator", "DATA", "--method", "exact", "--substeps", "4"],
        "--substeps: no effect with --method exact, which has no substeps",
    ),
    (["micro_actuator", "DATA", "--validate", "none.csv"], "none.csv: file not found"),
    (["micro_actuator", "DATA", "--output", "DATA"], "it is a file; give a folder"),
    (["micro_actuator", "DATA", "--output", "/proc/none"], "cannot be written to"),
    (["micro_actuator", "DATA", "--method", "exact", "--effect", "cubic_stiffness"], "linear"),
    (["emps", "DATA"], "no column for any output of model 'emps'"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_FITS, ids=[message for _, message in BAD_FITS])
def test_bad_input_is_told_in_one_message_and_nothing_is_written(
    run: Run, data: Path, tmp_path: Path, arguments: list[str], message: str
) -> None:
    result = run("fit", *(data / "train.csv" if a == "DATA" else a for a in arguments))
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("error:") == 1
    assert "Traceback" not in result.output
    assert result.stdout == ""
    assert everything(tmp_path) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["ft"], "did you mean 'fit'"),
        (["fit", "m", "d.csv", "--fxi", "M=1"], "--fix"),
        (["fit", "m", "d.csv", "--hold", "second"], "known: auto, zero, first"),
        (["fit", "m"], "DATA is missing"),
        (["fit", "m", "d.csv", "--skip", "-1"], "--skip"),
    ],
)
def test_misspelled_options_get_a_suggestion(run: Run, arguments: list[str], message: str) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert message in result.stderr


def test_a_broken_model_file_is_told_with_its_line(run: Run, data: Path, tmp_path: Path) -> None:
    (tmp_path / "rig.py").write_text("import greybox\n\nx = greybox.Modle\n")
    result = run("fit", "rig.py", data / "train.csv")
    assert result.exit_code == 2
    assert "rig.py, line 3: AttributeError" in result.stderr


def test_no_success_is_exit_code_1_and_still_saved(run: Run, tmp_path: Path) -> None:
    (tmp_path / "runaway.py").write_text(RUNAWAY)
    time = 0.01 * np.arange(400)
    rows = [f"{t:.2f},{np.sin(5 * t):.6f},{0.1 * np.sin(5 * t + 1):.6f}" for t in time]
    (tmp_path / "d.csv").write_text("\n".join(["time,u,x", *rows]) + "\n")
    result = run("fit", "runaway.py", "d.csv", "--at-rest", "--output", "out")
    assert result.exit_code == 1
    assert "cannot be simulated from the start values" in result.stderr
    saved = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert saved["success"] is False
    assert saved["status"] == "no_start"


RUNAWAY = """
from greybox import Balance, Input, Model, Output, Parameter, State

runaway = Model(
    "runaway",
    states=[State("x", "m", 1.0)],
    inputs=[Input("u", "m/s")],
    outputs=[Output("x", "m")],
    parameters=[Parameter("a", "1/(m**2*s)", 5.0, (0.1, 50.0))],
    balances=lambda x, u, p: [Balance("growth", "m/s", 1, "x", cubic=p.a * x.x**3, input=u.u)],
)
"""


GAIN = """
from greybox import Balance, Input, Model, Output, Parameter, State

gain = Model(
    "gain",
    states=[State("x", "V", 1.0)],
    inputs=[Input("u", "V")],
    outputs=[Output("x", "V")],
    parameters=[Parameter("k", "1/s", 1.0, (0.5, 5.0)), Parameter("a", "1/s", 1.0)],
    balances=lambda x, u, p: [Balance("rate", "V/s", 1, "x", drive=p.k * u.u, decay=-p.a * x.x)],
).fix(a=1.0)
"""


def test_a_fit_worse_than_a_constant_is_exit_code_1(run: Run, tmp_path: Path) -> None:
    """The drive of the rig has the other sign, which the bounds of its gain leave out: the optimum describes nothing."""
    time = np.arange(0, 5, 0.05)
    readings = -2 * (1 - np.exp(-time)) + 0.01 * np.random.default_rng(3).standard_normal(time.size)
    (tmp_path / "gain.py").write_text(GAIN)
    rows = [f"{t:.3f},1,{x:.5f}" for t, x in zip(time, readings, strict=True)]
    (tmp_path / "step.csv").write_text("\n".join(["time [s],u [V],x [V]", *rows]) + "\n")
    result = run("fit", "gain.py", "step.csv", "--at-rest", "--noise", "x=0.01", "--output", "out")
    assert result.exit_code == 1
    assert "their own mean follows x better than the model" in " ".join(result.stdout.split())
    assert "worse than a constant in x" in result.stderr
    assert json.loads((tmp_path / "out" / "fit.json").read_text())["success"] is True


def test_ctrl_c_saves_the_best_point(run: Run, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def impatient(*_: object) -> Iterator[Callable[[object], None]]:
        yield lambda _: signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(fit_command, "show_fit_progress", impatient)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.html").write_text("of an earlier fit")
    result = run("fit", "micro_actuator", data / "train.csv", *KNOWN, "--start", "K=4000", "--output", "out")
    assert result.exit_code == 130
    assert (
        f"the best point so far is in {Path('out') / 'fit.json'} (no figures, no report, those there" in result.stderr
    )
    saved = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert saved["status"] == "interrupted"
    assert saved["success"] is False


def test_models_are_listed_and_printed(run: Run) -> None:
    listed = run("models")
    assert listed.exit_code == 0
    assert listed.stdout.splitlines()[0].endswith("models can be named here.")
    assert re.search("micro_actuator +u -> x, i +compliant four-bar", listed.stdout)
    one = run("models", "micro_actuator", "--effect", "coulomb_friction")
    assert one.exit_code == 0
    assert "coulomb_friction" in one.stdout
    assert "0.0001, 1]" in one.stdout
    assert run("models", "nonsense").exit_code == 2


@pytest.mark.rest
def test_effects_are_listed_with_their_places(run: Run) -> None:
    catalogue, whole = run("effects"), run("effects", "--details")
    assert "coulomb_friction" in catalogue.stdout and "Fc [{force}]" not in catalogue.stdout
    assert "Fc [{force}]" in whole.stdout
    of_model = json.loads(run("effects", "micro_actuator", "--effect", "input_offset", "--json").stdout)
    by_name = {p["name"]: p for p in of_model}
    assert by_name["coulomb_friction"]["site"] == "force" and by_name["coulomb_friction"]["parameters"] == {"Fc": "N"}
    assert by_name["sensor_lag_at_i"]["parameters"] == {"tau_s": "s"}
    assert by_name["input_offset"]["reason"] and by_name["valve_lag"]["reason"]


def test_a_delay_may_be_as_long_as_the_record_shows(run: Run, tmp_path: Path) -> None:
    plant = tmp_path / "slow.py"
    plant.write_text(
        "from greybox import Balance, Input, Model, Output, Parameter, State\n"
        "slow = Model('slow', [State('T', 'K')], [Input('P', 'W')], [Output('T', 'K')],\n"
        "    [Parameter('C', 'J/K', 10.0, (1, 100)), Parameter('h', 'W/K', 2.0, (0.1, 20))],\n"
        "    lambda x, u, p: [Balance('heat', 'W', p.C, 'T', heater=u.P, loss=-p.h * x.T)])\n"
    )
    generator = np.random.default_rng(1)
    heater = np.repeat(generator.uniform(0, 50, 40), 10)
    late = np.concatenate([np.zeros(3), heater[:-3]])
    decay = np.exp(-0.1)
    T = np.zeros(400)
    for k in range(399):
        T[k + 1] = decay * T[k] + (1 - decay) / 2.0 * late[k]
    rows = "\n".join(
        f"{0.5 * k},{u},{y}" for k, (u, y) in enumerate(zip(heater, T + 0.01 * generator.normal(size=400), strict=True))
    )
    (tmp_path / "r.csv").write_text("time [s],P [W],T [K]\n" + rows + "\n")
    done = run(
        "fit",
        str(plant),
        str(tmp_path / "r.csv"),
        "--effect",
        "transport_delay",
        "--noise",
        "T=0.01",
        "--json",
        "--no-report",
    )
    assert json.loads(done.stdout)["parameters"]["delay"]["value"] == pytest.approx(1.5, rel=0.02)


def test_simulate_writes_what_fit_reads(run: Run, tmp_path: Path) -> None:
    signals = ["--multisine", 2, "--band", "5:800", "--duration", 0.25, "--sampling-time", 2.5e-4, "--seed", 3]
    noise = ["--noise", "x=2e-7", "--noise", "i=5e-3"]
    for name in ("a.csv", "b.csv"):
        result = run("simulate", "micro_actuator", *signals, *noise, "--fix", "K=5500", "--output", name)
        assert result.exit_code == 0, result.output
        assert "1000 rows" in result.stdout
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert (tmp_path / "a.csv").read_text().startswith("time [s],u [V],x [m],i [A]\n")
    assert run("fit", "micro_actuator", "a.csv", *KNOWN, "-q", "--output", "out").exit_code == 0
    estimate = json.loads((tmp_path / "out" / "fit.json").read_text())["parameters"]["K"]
    assert abs(estimate["value"] - 5500) < 4 * estimate["std"]


def test_simulate_takes_inputs_from_a_file(run: Run, tmp_path: Path) -> None:
    (tmp_path / "u.csv").write_text("t [ms],u [mV]\n" + "".join(f"{k},{1000 * (k % 7)}\n" for k in range(30)))
    result = run("simulate", "micro_actuator", "u.csv", "--initial", "x=1e-4")
    assert result.exit_code == 0, result.output
    written = read_csv(tmp_path / "results" / "micro_actuator-simulated.csv", micro_actuator)
    assert np.allclose(written.inputs["u"], [k % 7 for k in range(30)])
    assert written.outputs["x"][0] == 1e-4


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["micro_actuator"], 2, "give either a file with inputs or one of --step"),
        (["micro_actuator", "--step", "1", "--chirp", "1"], 2, "give either"),
        (["micro_actuator", "--step", "1"], 2, "needs --duration and --sampling-time"),
        (["micro_actuator", "--step", "1", "--duration", "1", "--sampling-time", "1e-9"], 2, "gives 1000000000 rows"),
        (["micro_actuator", "--chirp", "1", *PACE], 2, "--band (not given)"),
        (["micro_actuator", "--chirp", "1", "--band", "9:3", *PACE], 2, "--band 9:3"),
        (["micro_actuator", "--step", "1", "--initial", "q=1", *PACE], 2, "no state"),
        (["micro_actuator", "none.csv"], 2, "none.csv: file not found"),
        (["micro_actuator", "--step", "1", *PACE, "--output", "."], 2, "folder"),
        (["runaway.py", "--step", "1", *PACE], 1, "overflows"),
        (["micro_actuator", "--step", "1", "--band", "5:8", *PACE], 2, "--band: no effect beside this test signal"),
        (["micro_actuator", "--step", "1", "--column", "u=V", *PACE], 2, "--column: no effect beside this test signal"),
        (
            ["micro_actuator", "u.csv", "--band", "5:8", *PACE],
            2,
            "--band, --duration: no effect beside",
        ),
    ],
)
def test_simulate_refuses(run: Run, tmp_path: Path, arguments: list[str], code: int, message: str) -> None:
    (tmp_path / "runaway.py").write_text(RUNAWAY)
    result = run("simulate", *arguments)
    assert result.exit_code == code
    assert message in result.stderr
    assert not list(tmp_path.rglob("*.csv"))


def test_simulate_never_overwrites_its_own_input(run: Run, tmp_path: Path) -> None:
    text = "time [s],u [V]\n" + "".join(f"{k * 1e-3:g},{k % 7}\n" for k in range(30))
    (tmp_path / "u.csv").write_text(text)
    refused = run("simulate", "micro_actuator", "u.csv", "--output", tmp_path / "u.csv")
    assert refused.exit_code == 2
    assert "it is the input file, which would be overwritten; give another file" in refused.stderr
    assert (tmp_path / "u.csv").read_text() == text


def test_a_file_with_other_content_is_not_replaced_without_a_word(run: Run, tmp_path: Path) -> None:
    drive = (
        "simulate",
        "micro_actuator",
        "--duration",
        0.1,
        "--sampling-time",
        1e-3,
        "--output",
        "y.csv",
        "--no-report",
    )
    assert run(*drive, "--step", 1).stderr == ""
    assert run(*drive, "--step", 1).stderr == ""  # the same once more
    assert run(*drive, "--step", 2).stderr == "note: y.csv held something else and was overwritten\n"
    # What the same command wrote is replaced silently, also where its results are others; what somebody put there is not.
    (tmp_path / "y.csv").write_text("mine")
    assert run(*drive, "--step", 2).stderr == "note: y.csv held something else and was overwritten\n"


def test_a_constant_in_no_equation_is_noted(run: Run, tmp_path: Path) -> None:
    text = RUNAWAY.replace("parameters=[", 'parameters=[Parameter("spare", "N", 1.0), ')
    assert text != RUNAWAY
    (tmp_path / "rig.py").write_text(text)
    result = run("models", "rig.py")
    assert result.exit_code == 0, result.output
    assert "note: parameter 'spare' is in no equation" in result.stderr
    assert run("models", "micro_actuator").stderr == ""


@pytest.mark.rest
def test_check_names_what_the_record_leaves_open(run: Run, data: Path) -> None:
    result, whole = (run("check", "micro_actuator", data / "train.csv", *more) for more in ((), ("--details",)))
    assert result.exit_code == 0, result.output
    first = " ".join(result.stdout.splitlines()[:2])
    assert (
        first.startswith("These records determine 3 of the 7 free parameters of micro_actuator") and "M, B, K" in first
    )
    for text in ("exact hold", "linear", "1500 rows every 0.00025 s", "noise", "not determined: M, B, K, Kf"):
        assert text in whole.stdout
    closed = run("check", "micro_actuator", data / "train.csv", "--fix", "M")
    assert closed.stdout.startswith("These records determine every free parameter of micro_actuator")


@pytest.mark.rest
def test_init_and_a_fit_inside(run: Run, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run("init", "mine").exit_code == 0
    again = run("init", "mine")
    assert again.exit_code == 2
    assert "already holds" in again.stderr
    assert run("init", "mine", "--force").exit_code == 0
    monkeypatch.chdir(tmp_path / "mine")
    assert not any("shipped" in m["where"] for m in json.loads(run("models", "--json").stdout)["models"])
    result = run("fit", "micro_actuator", data / "train.csv", *KNOWN, "-q")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "mine" / "results" / "micro_actuator-fit" / "fit.json").is_file()


@pytest.mark.parametrize("command", sorted(app.commands))
def test_help_ends_with_an_example_and_speaks_no_python(run: Run, command: str) -> None:
    result = run(command, "--help")
    assert result.exit_code == 0
    assert f"  greybox {command}" in result.stdout.partition("Examples:")[2]
    assert "<class" not in result.stdout
    assert "list[" not in result.stdout


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGINT to send")
def test_ctrl_c_while_the_command_is_being_loaded_is_told_in_one_line() -> None:
    # What is imported first stands still until the signal comes.
    code = (
        "import sys, time, greybox.shell\n"
        "class Slow:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'click':\n"
        "            print('loading', flush=True)\n"
        "            time.sleep(170)\n"
        "sys.meta_path.insert(0, Slow())\n"
        "greybox.shell.main()\n"
    )
    command = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert command.stdout.readline() == "loading\n"
    command.send_signal(signal.SIGINT)
    _, errors = command.communicate(timeout=150)
    assert (command.returncode, errors) == (130, "error: interrupted\n")


def test_help_and_version_load_nothing_heavy() -> None:
    heavy = {"casadi", "numpy", "pandas", "scipy", "matplotlib", "control", "pint"}
    code = f"import sys, greybox.shell.commands; print(sorted({heavy} & set(sys.modules)))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == "[]"
    shown = subprocess.run([sys.executable, "-m", "greybox", "--version"], capture_output=True, text=True, check=False)
    assert shown.returncode == 0
    assert shown.stdout.startswith("greybox ")


def test_a_quiet_record_tells_the_noise(run: Run, data: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    rows = "\n".join(f"{k * 2.5e-4:.6g},0,{2e-7 * rng.normal():.6e},{5e-3 * rng.normal():.6e}" for k in range(800))
    (tmp_path / "quiet.csv").write_text(f"time [s],u [V],x [m],i [A]\n{rows}\n")
    done = run(
        "fit",
        "micro_actuator",
        str(data / "train.csv"),
        "--quiet",
        str(tmp_path / "quiet.csv"),
        "--fix",
        "M",
        "--fix",
        "Ra",
        "--at-rest",
        "--json",
    )
    saved = json.loads(done.stdout)
    assert saved["noise_sources"] == {"x": "quiet_record", "i": "quiet_record"}, done.stderr
    assert saved["noise"]["x"] == pytest.approx(2e-7, rel=0.1)


OWN_PLANT = """
import numpy as np

from greybox import Output, Parameter
from greybox.simulation.plant import as_model


class Decay:
    name = "own_decay"
    inputs = ()
    outputs = (Output("y", "V"),)
    parameters = (Parameter("rate", "1/s", 1.0, (0.01, 100.0)),)

    def simulate(self, record, values):
        return {"y": np.exp(-values["rate"] * record.time)}


own_decay = as_model(Decay())
"""


def test_a_plant_in_a_model_file_is_fitted_and_checked(run: Run, tmp_path: Path) -> None:
    (tmp_path / "own_decay.py").write_text(OWN_PLANT)
    time = 0.01 * np.arange(200)
    y = np.exp(-2 * time) + 1e-3 * np.random.default_rng(0).standard_normal(200)
    np.savetxt(tmp_path / "run.csv", np.column_stack([time, y]), delimiter=",", header="time,y", comments="")
    given = [tmp_path / "own_decay.py", tmp_path / "run.csv", "--no-report", "--output", tmp_path / "out"]
    result = run("fit", *given, "--json")
    assert result.exit_code == 0, result.stderr
    rate = json.loads(result.stdout)["parameters"]["rate"]
    assert rate["value"] == pytest.approx(2.0, abs=4 * rate["std"])
    checked = run("check", *given, "--details")
    assert checked.exit_code == 0 and "no equations: it is run from outside" in checked.stdout, checked.output
    assert "These records determine every free parameter" in checked.stdout


def test_one_effect_is_shown_by_its_name(run: Run) -> None:
    shown = json.loads(run("effects", "coulomb_friction", "--json").stdout)
    assert [e["name"] for e in shown] == ["coulomb_friction"]
    text = run("effects", "coulomb_friction").stdout
    assert "Fc" in text and "stribeck" not in text
