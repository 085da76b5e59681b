"""A result, a study or a key in the shell runs no program that the user did not name."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.shell.commands import app
from greybox.shell.plants import PlantKind
from tests.base.parallel.test_jobs import lag
from tests.oracles.independent import linear_record
from tests.shell.project.test_outline import TRAP
from tests.support.command import CliRunner

ROOT = Path(__file__).resolve().parents[2]


def run(*words: str):
    return CliRunner().invoke(app, list(words), prog_name="greybox")


@pytest.fixture
def trap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A model file that leaves a file beside itself when it runs."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = {n: m for n, m in sys.modules.items() if is_a_model_module(n)}
    file = tmp_path / "trap.py"
    file.write_text(TRAP)
    yield file
    for name in filter(is_a_model_module, list(sys.modules)):
        del sys.modules[name]
    sys.modules.update(before)


@pytest.fixture(scope="module")
def saved_fit(tmp_path_factory) -> Path:
    """A fit as the program writes it."""
    model = lag()
    record = linear_record(model, np.random.default_rng(1).normal(size=100), 0.01, noise={"x": 1e-3})
    return gb.fit(model, record).save(tmp_path_factory.mktemp("fit") / "fit.json")


def is_a_model_module(name: str) -> bool:
    return name.split(".")[0] == "models" or name.startswith("_greybox_file_")


FORMS = ["trap.py", "./trap.py", "{}/trap.py", "trap.py:rig", "//server/share/trap.py", "..\\trap.py", "a/b"]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("command", ["export fit.json --to json", "changed fit.json r.csv", "design fit.json"])
def test_a_fit_names_its_model_without_a_path(trap: Path, saved_fit: Path, form: str, command: str):
    data = json.loads(saved_fit.read_text()) | {"model": form.format(trap.parent)}
    Path("fit.json").write_text(json.dumps(data))
    Path("r.csv").write_text("time,u,x\n")
    limits = ["--limit", "u=-1:1", "--duration", "1"] if command.startswith("design") else []
    done = run(*command.split(), *limits)
    assert done.exit_code == 2
    assert "--model" in done.stderr and "Traceback" not in done.stderr
    assert not (trap.parent / "ran").exists()
    assert not Path("results").exists()


@pytest.mark.parametrize("form", FORMS)
def test_a_discovery_names_its_model_without_a_path(trap: Path, form: str):
    data = {
        "format": 1,
        "verdict": "named",
        "model": form.format(trap.parent),
        "effects": [],
        "parameters": {},
        "gap": {},
    }
    Path("discovery.json").write_text(json.dumps(data | {"alternatives": [], "ranking": [], "noise": {}}))
    Path("r.csv").write_text("time,u,x\n")
    done = run("design", "discovery.json", "r.csv", "--limit", "u=-1:1", "--duration", "1")
    assert done.exit_code == 2
    assert "--model" in done.stderr and "Traceback" not in done.stderr
    assert not (trap.parent / "ran").exists()
    assert not Path("results").exists()


@pytest.mark.parametrize("command", ["fit", "check", "discover", "compare"])
@pytest.mark.parametrize("model", ["trap.py", "trap.py:rig", "../{}/trap.py"])
def test_a_study_alone_runs_no_model_file(trap: Path, command: str, model: str):
    text = f'model = "{model.format(trap.parent.name)}"\n[records]\nestimation = ["a.csv"]\nvalidation = ["a.csv"]\n'
    if command in ("fit", "check"):
        text = text.replace("validation", "# validation")
    Path("study.toml").write_text(text)
    done = run(command, "study.toml")
    assert done.exit_code == 2
    assert "--model" in done.stderr
    assert not (trap.parent / "ran").exists()


@pytest.mark.parametrize("command", ["fit", "check", "compare"])
@pytest.mark.parametrize("plant", ["plant.fmu", "PLANT.FMU", "sub/plant.fmu"])
def test_a_study_alone_runs_no_plant_that_brings_code(trap: Path, command: str, plant: str):
    text = f'model = "{plant}"\n[records]\nestimation = ["a.csv"]\n'
    Path("study.toml").write_text(text + 'validation = ["a.csv"]\n' * (command == "compare"))
    done = run(command, "study.toml")
    assert done.exit_code == 2
    assert "a study alone runs none" in done.stderr and f"--model {plant}" in done.stderr


@pytest.mark.parametrize("plant", ["plant.fmu", "plant.Fmu"])
def test_a_result_names_no_plant_that_brings_code(trap: Path, saved_fit: Path, plant: str):
    Path("fit.json").write_text(json.dumps(json.loads(saved_fit.read_text()) | {"model": plant}))
    done = run("export", "fit.json", "--to", "json")
    assert done.exit_code == 2 and "give --model MODEL" in done.stderr


def test_a_kind_of_plant_that_does_not_say_so_is_taken_to_bring_code():
    assert PlantKind((".x",), "", (), str, lambda model, study: model).runs_code


# Written as headers of a record: escapes, C1 controls, a line that looks like a message, and marks that turn the direction of writing.
HEADERS = ["y\x1b]0;owned\x07 [K]", "y [\x9b2J]", '"y\nerror: no [K]"', "y\u202e [K]", "\x1b[2J"]


@pytest.mark.parametrize("header", HEADERS)
def test_a_look_at_a_file_prints_no_header_raw(tmp_path: Path, header: str):
    file = tmp_path / "r.csv"
    rows = "".join(f"{k},{k % 7},{k % 5}.5\n" for k in range(50))
    file.write_text(f"time [s],u,{header}\n{rows}", encoding="utf-8")
    done = run("check", str(file))
    shown = done.stdout + done.stderr
    assert all(line.isprintable() for line in shown.split("\n"))
    assert not any(line.startswith("error: no") for line in shown.splitlines())


def test_a_key_of_a_study_reaches_no_terminal_raw(tmp_path: Path):
    (tmp_path / "study.toml").write_text('model = "lag"\n"\\u001b[2J\\nnote: fine" = 1\n')
    done = run("fit", str(tmp_path / "study.toml"))
    assert done.exit_code == 2 and "\x1b" not in done.stderr
    assert not any(line.startswith("note") for line in done.stderr.splitlines())


def test_a_proposed_column_is_quoted_for_the_shell(tmp_path: Path):
    file = tmp_path / "r.csv"
    rows = "".join(f"{k},{k % 7},{k % 5}.5\n" for k in range(50))
    file.write_text(f"time [s],u,y`id`; $(touch ran)'\"\"' [K]\n{rows}", encoding="utf-8")
    line = next(line for line in run("check", str(file)).stdout.splitlines() if "--column" in line)
    words = shlex.split(line.partition(": ")[2])
    assert words[::2] == ["--column"] * (len(words) // 2) and any("$(touch ran)" in word for word in words)


def test_a_study_runs_the_model_file_that_the_user_names(trap: Path):
    Path("study.toml").write_text('model = "trap.py"\n')
    done = run("check", "study.toml", "--model", "trap.py:rig")
    assert (trap.parent / "ran").exists()
    assert "names the model file" not in done.stderr


def test_a_model_is_named_once(trap: Path):
    done = run("check", "micro_actuator", "--model", "trap.py")
    assert done.exit_code == 2
    assert not (trap.parent / "ran").exists()


def test_a_study_of_another_project_runs_nothing_of_it(trap: Path):
    project = trap.parent / "project"
    (project / "models").mkdir(parents=True)
    (project / "models" / "rig.py").write_text(TRAP)
    (project / "study.toml").write_text('model = "rig"\n')
    done = run("check", str(project / "study.toml"))
    assert done.exit_code == 2
    assert str(project) in done.stderr
    assert not list(project.rglob("ran"))
    os.chdir(project)
    run("check", "study.toml")
    assert list(project.rglob("ran"))


@pytest.mark.rest
@pytest.mark.parametrize(
    "line",
    [
        *(pytest.param(line, marks=pytest.mark.slow) for line in ("greybox fit ", "greybox models ")),
        "greybox fit rig --fix ",
        "greybox fit models/rig.py --fix k",
    ],
)
def test_the_shell_runs_nothing_to_offer_words(trap: Path, line: str):
    (trap.parent / "models").mkdir()
    trap.rename(trap.parent / "models" / "rig.py")
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "_GREYBOX_COMPLETE": "bash_complete",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split(" ")) - 1),
    }
    command = [sys.executable, "-m", "greybox"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.stderr == ""
    assert {"rig", "k="} & set(done.stdout.replace(",", "\n").split())
    assert not list(trap.parent.rglob("ran"))
