"""`--json`: what a script reads from standard output, and nothing else beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from greybox import FitOptions, fit, simulate
from greybox.estimation.result import load_fit
from greybox.shell.answers import FitAnswer
from greybox.shell.commands import COMMANDS, app
from greybox.shell.printed import list_printed, schema_of_command
from greybox.simulation.simulate import write_csv
from models.micro_actuator import micro_actuator
from tests.support.command import CliRunner
from tests.support.result_schema import strict_offences
from tests.support.robots import DOUBLE_PENDULUM, joint_log, write, write_log


def test_every_command_has_it_and_a_schema() -> None:
    printing = {name for name, command in COMMANDS.items() if "json" in command.table}
    assert printing == set(COMMANDS) == set(list_printed())


@pytest.mark.parametrize("command", list_printed())
def test_the_schema_of_a_command_is_whole_in_itself(command: str) -> None:
    done = run("schema", command)
    schema = json.loads(done.stdout)
    Draft202012Validator.check_schema(schema)
    references = set(re.findall(r"#/\$defs/(\w+)", done.stdout))
    assert references == set(schema["$defs"])
    assert accepts("schema", schema)


@pytest.mark.rest
def test_what_commands_that_compute_nothing_print_is_as_their_schema_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for command in (
        ["models"],
        ["models", "micro_actuator"],
        ["effects"],
        ["effects", "silverbox"],
        ["init", "rig", "--plant", "stage"],
        ["check", "silverbox", "--output", "check", "--no-report"],
    ):
        done = run(*command, "--json")
        assert done.exit_code == 0 and accepts(command[0], json.loads(done.stdout)), command


EXAMPLES = {
    "fit": "micro_actuator train.csv --fix M --fix Ra --no-report",
    "compare": "micro_actuator train.csv --fix M --fix Ra --no-report",
    "discover": "micro_actuator train.csv --validate test.csv --fix M --fix Ra --effects cubic_stiffness --workers 1 --no-report",
    "app": "micro_actuator train.csv",
    "changed": "fit.json test.csv --no-effects --no-report",
    "design": "fit.json --limit u=-1:1 --duration 0.02 --no-report",
    "fleet": "micro_actuator train.csv test.csv --fix M --fix Ra --at-rest --no-report",
    "campaign": "micro_actuator --limit u=-1:1 --duration 0.02 --sampling-time 2.5e-4 --noise x=1e-7 --no-report",
    "check": "train.csv test.csv",
    "export": "fit.json --to json --samples 2 --no-report",
    "robot": "arm.urdf log.csv --no-report",
    "simulate": "micro_actuator train.csv",
    "models": "",
    "effects": "micro_actuator",
    "init": "rig --plant tanks",
    "extensions": "",
    "demo": "--no-report",
    "schema": "design",
}
"""What a person types after each command."""
LONG = ("compare", "campaign", "demo")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two records and the fit of one, and a robot with a log."""
    folder = tmp_path_factory.mktemp("bench")
    write_log(joint_log(), write(folder / "arm.urdf", DOUBLE_PENDULUM).with_name("log.csv"))
    plain, noise = micro_actuator.fix("M", "Ra"), {"x": 2e-7, "i": 5e-3}
    for seed, name in enumerate(("test.csv", "train.csv")):
        u = np.random.default_rng(10 + seed).normal(0, 1, 200)
        record = simulate(plain, {"time": 2.5e-4 * np.arange(200), "u": u}).record(noise, np.random.default_rng(seed))
        write_csv(record, micro_actuator, folder / name)
    fit(plain, record, noise=noise, options=FitOptions(at_rest=True)).save(folder / "fit.json")
    return folder


def test_there_is_an_example_of_every_command() -> None:
    assert set(EXAMPLES) == set(list_printed())


@pytest.mark.parametrize("command", [pytest.param(c, marks=[pytest.mark.slow] * (c in LONG)) for c in EXAMPLES])
def test_what_a_command_prints_is_one_json_value_as_its_schema_says(
    bench: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.chdir(bench)

    async def announce_only(workbench: object, port: int, announce: Callable[[str], None]) -> None:
        announce("http://127.0.0.1:1/token/")

    if command == "app":
        server = pytest.importorskip("greybox.extensions.app.server", reason="the app's server is not installed")
        monkeypatch.setattr(server, "serve", announce_only)
    done = run(command, *EXAMPLES[command].split(), "--json")
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout)
    faults = [error.message for error in Draft202012Validator(schema_of_command(command)).iter_errors(printed)]
    assert faults == []


def test_a_schema_refuses_what_another_command_prints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    printed = json.loads(run("models", "--json").stdout)
    assert not any(accepts(command, printed) for command in list_printed() if command != "models")


def test_the_schema_of_an_unknown_command_is_refused() -> None:
    done = run("schema", "fitt")
    assert done.exit_code == 2 and "did you mean 'fit'" in done.stderr and done.stderr.count("\n") == 1


def run(*arguments: str):
    return CliRunner().invoke(app, list(arguments))


def accepts(command: str, printed: object) -> bool:
    return Draft202012Validator(schema_of_command(command)).is_valid(printed)


def test_a_simulation_says_what_it_has_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    options = ["--step", "1", "--duration", "0.05", "--sampling-time", "2.5e-4", "--output", "out/a.csv"]
    done = CliRunner().invoke(app, ["simulate", "micro_actuator", *options, "--json"])
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout)
    assert (printed["file"], printed["rows"], printed["outputs"]) == (str(Path("out/a.csv")), 200, ["x", "i"])
    assert accepts("simulate", printed) and Path(printed["file"]).exists() and Path(printed["report"]).exists()


def test_an_export_says_its_matrices_and_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    data = {"time": 2.5e-4 * np.arange(200), "u": np.random.default_rng(1).normal(0, 1, 200)}
    rest = FitOptions(at_rest=True)
    record = simulate(micro_actuator, data).record({"x": 2e-7, "i": 5e-3}, np.random.default_rng(2))
    fit(micro_actuator.fix("M", "Ra"), record, noise={"x": 2e-7, "i": 5e-3}, options=rest).save("fit.json")
    done = CliRunner().invoke(app, ["export", "fit.json", "--to", "mat", "--json"])
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout)
    assert accepts("export", printed)
    assert np.shape(printed["linear"]["A"]) == (3, 3) and printed["linear"]["state_names"] == ["x", "v", "i"]
    assert [Path(file).suffix for file in printed["files"]] == [".mat"] and Path(printed["report"]).exists()
    done = CliRunner().invoke(app, ["export", "fit.json", "--to", "python", "--json", "--no-report"])
    printed = json.loads(done.stdout)
    assert printed["linear"] is None and printed["report"] is None and Path(printed["files"][0]).exists()


def test_intervals_that_were_asked_for_are_in_the_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    data = {"time": 2.5e-4 * np.arange(200), "u": np.random.default_rng(1).normal(0, 1, 200)}
    noise = {"x": 2e-7, "i": 5e-3}
    write_csv(simulate(micro_actuator, data).record(noise, np.random.default_rng(2)), micro_actuator, "train.csv")
    words = "fit micro_actuator train.csv --at-rest --fix M --fix Ra --fix Kf --fix La --fix B"
    words += " --noise x=2e-7 --noise i=5e-3 --no-report --output out"
    plain = run(*words.split(), "--json")
    assert plain.exit_code == 0, plain.output
    assert not {"profiles", "bootstrap"} & set(json.loads(plain.stdout))
    words = words.replace("--no-report ", "")
    done = run(*words.split(), "--json", "--profile", "K", "--profile", "K:Kv", "--bootstrap", "100")
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout)
    assert accepts("fit", printed) and strict_offences(printed, FitAnswer) == []
    assert json.loads(Path("out/fit.json").read_text()) == printed
    (profile,) = printed["profiles"]
    assert (
        profile["name"] == "K" and profile["interval"][0] < printed["parameters"]["K"]["value"] < profile["interval"][1]
    )
    assert profile["shape"] == "bounded" and not profile["is_better"] and profile["partner"] == "Kv"
    (region,) = printed["regions"]
    assert (region["first"], region["second"], region["shape"]) == ("K", "Kv", "bounded")
    page = Path("out/report.html").read_text()
    assert "95 % by profile likelihood" in page and "Bounded on both sides" in page and "K and Kv together" in page
    assert np.shape(printed["bootstrap"]["samples"]) == (100, len(printed["free"]))
    assert load_fit("out/fit.json", micro_actuator).parameters["K"].value == printed["parameters"]["K"]["value"]
