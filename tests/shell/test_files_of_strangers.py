"""A result, a study or a key in the shell runs no program that the user did not name."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import greybox as gb
from greybox.shell.commands import app
from tests.base.parallel.test_jobs import lag
from tests.oracles.independent import linear_record
from tests.shell.project.test_outline import TRAP

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


@pytest.mark.parametrize(
    "line", ["greybox fit ", "greybox fit rig --fix ", "greybox fit models/rig.py --fix k", "greybox models "]
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
