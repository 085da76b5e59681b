"""`--json`: what a script reads from standard output, and nothing else beside it."""

from __future__ import annotations

import inspect
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from greybox.cli.app import app

TALKING = {"models", "init", "export"}  # these compute nothing that is not in the file they write


def test_every_command_that_computes_has_it() -> None:
    commands = {c.callback.__name__: c.callback for c in app.registered_commands}
    assert set(commands) > TALKING
    assert {n for n, c in commands.items() if "json" not in inspect.signature(c).parameters} == TALKING


def test_a_simulation_says_what_it_has_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    options = ["--step", "1", "--duration", "0.05", "--sampling-time", "2.5e-4", "--output", "out/a.csv"]
    done = CliRunner().invoke(app, ["simulate", "micro_actuator", *options, "--json"])
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert (said["file"], said["rows"], said["outputs"]) == (str(Path("out/a.csv")), 200, ["x", "i"])
    assert Path(said["file"]).exists() and Path(said["report"]).exists()
