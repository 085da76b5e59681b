"""`--json`: what a script reads from standard output, and nothing else beside it."""

from __future__ import annotations

import inspect
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from greybox import FitOptions, fit, simulate
from greybox.cli.app import app
from models.micro_actuator import micro_actuator

TALKING = {"models", "init"}  # these compute nothing


def test_every_command_that_computes_has_it() -> None:
    commands = {c.callback.__name__: c.callback for c in app.registered_commands}
    assert set(commands) > TALKING
    assert {n for n, c in commands.items() if "json" not in inspect.signature(c).parameters} == TALKING


def test_a_simulation_says_what_it_has_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    options = ["--step", "1", "--duration", "0.05", "--sampling-time", "2.5e-4", "--output", "out/a.csv"]
    done = CliRunner().invoke(app, ["simulate", "micro_actuator", *options, "--json"])
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout)
    assert (printed["file"], printed["rows"], printed["outputs"]) == (str(Path("out/a.csv")), 200, ["x", "i"])
    assert Path(printed["file"]).exists() and Path(printed["report"]).exists()


def test_an_export_says_its_matrices_and_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    data = {"time": 2.5e-4 * np.arange(200), "u": np.random.default_rng(1).normal(0, 1, 200)}
    rest = FitOptions(at_rest=True)
    record = simulate(micro_actuator, data).record({"x": 2e-7, "i": 5e-3}, np.random.default_rng(2))
    fit(micro_actuator.fix("M", "Ra"), record, noise={"x": 2e-7, "i": 5e-3}, options=rest).save("fit.json")
    done = CliRunner().invoke(app, ["export", "fit.json", "--to", "mat", "--json"])
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout)
    assert np.shape(printed["linear"]["A"]) == (3, 3) and printed["linear"]["state_names"] == ["x", "v", "i"]
    assert [Path(file).suffix for file in printed["files"]] == [".mat"] and Path(printed["report"]).exists()
    done = CliRunner().invoke(app, ["export", "fit.json", "--to", "python", "--json", "--no-report"])
    printed = json.loads(done.stdout)
    assert printed["linear"] is None and printed["report"] is None and Path(printed["files"][0]).exists()
