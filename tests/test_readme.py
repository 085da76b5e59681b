"""What the README shows works as it stands."""

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def test_the_python_example_runs_and_finds_the_inertia(tmp_path, monkeypatch):
    (code,) = blocks("python")
    monkeypatch.chdir(tmp_path)
    scope: dict = {}
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(code, "README.md", "exec"), scope)
    estimate = scope["found"].parameters["J"]
    assert estimate.interval[0] < 2e-4 < estimate.interval[1]
    assert "J dw/dt = Kt i - B w" in " ".join(said.getvalue().split())
    assert (tmp_path / "rotor.json").exists()


def shell_lines():
    block = next(b for b in blocks("") if "greybox models " in b)
    return [line.split(" #")[0].strip() for line in block.splitlines() if line.startswith("greybox")]


def test_the_shell_example_runs_in_an_empty_directory(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    for line in shell_lines():
        command = [sys.executable, "-m", "greybox.cli", *shlex.split(line)[1:]]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
    assert (tmp_path / "results" / "fit.json").exists()
    assert (tmp_path / "my_rig" / "models" / "micro_actuator.py").exists()


@pytest.mark.parametrize("command", ["make demo", "make test"])
def test_the_readmes_commands_are_those_of_the_makefile(command):
    assert command in README
    assert f"\n{command.split()[1]}:" in (ROOT / "Makefile").read_text(encoding="utf-8")
