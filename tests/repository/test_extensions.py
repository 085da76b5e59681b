"""Packages of strangers, installed beside greybox: what one adds is used; broken ones hurt nothing."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.command import unwrap

pytestmark = pytest.mark.rest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "extensions.md").read_text(encoding="utf-8")
WRONG_PROJECT = """
[project]
name = "greybox-wrong"
version = "3.0"
[project.entry-points."greybox.readers"]
wrong = "wrong:read"
[project.entry-points."greybox.exports"]
wrong = "wrong:read"
[project.entry-points."greybox.plants"]
wrong = "wrong:read"
[project.entry-points."greybox.commands"]
wrong = "wrong:read"
fit = "wrong:HELLO"
[project.entry-points."greybox.effects"]
wrong = "wrong:read"
taken = "wrong:FRICTION"
"""
WRONG = """
from greybox import Effect
from greybox.extensions import Command


def read(path, policy): ...


HELLO = Command(read, "Hello.")
FRICTION = Effect("coulomb_friction", "force", [], terms=lambda x, u, p: 0)
"""
USE = """
import sys
import numpy as np
import greybox as gb

sys.path.insert(0, {root!r})
from models.silverbox import silverbox

record = gb.read_csv("run.acme", silverbox)
print(record.source, len(record.time))
extended = silverbox + gb.effect("acme_seal_drag")
print(extended.title)
fit = gb.fit(silverbox, record, noise={{"y": 1e-3}}, options=gb.FitOptions(at_rest=True))
fit.save("fit.json")
"""


def code(title: str) -> str:
    found = re.search(rf'```\w+ title="{title}"\n(.*?)```', PAGE, re.DOTALL)
    assert found, title
    return found[1]


@pytest.fixture(scope="module")
def beside(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package of the page as a wheel, and a folder with it installed; a second package that cannot be imported."""
    wheel = pytest.importorskip("hatchling.builders.wheel", reason="hatchling comes with the extra 'test'")
    folder, wheels = tmp_path_factory.mktemp("beside"), []
    for name, project, module in (
        ("acme", code("pyproject.toml"), code("acme.py")),
        (
            "broken",
            '[project]\nname = "greybox-broken"\nversion = "2.0"\n'
            '[project.entry-points."greybox.readers"]\nbroken = "broken:READER"\n',
            "import a_package_that_nobody_has\n",
        ),
        ("wrong", WRONG_PROJECT, WRONG),
    ):
        source = tmp_path_factory.mktemp(name)
        build = (
            '\n[build-system]\nrequires = ["hatchling"]\nbuild-backend = "hatchling.build"\n'
            f'[tool.hatch.build.targets.wheel]\ninclude = ["{name}.py"]\n'
        )
        (source / "pyproject.toml").write_text(project + build, encoding="utf-8")
        (source / f"{name}.py").write_text(module, encoding="utf-8")
        (built,) = wheel.WheelBuilder(str(source)).build(directory=str(source / "dist"), versions=["standard"])
        wheels.append(built)
    options = ["--quiet", "--no-deps", "--no-index", "--no-compile", "--target", str(folder)]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, *wheels], check=True, timeout=120)
    return folder


def run(beside: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(beside), str(ROOT)])
    environment = {**os.environ, "PYTHONPATH": path, "COLUMNS": "200"}
    return subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=150)


def greybox(beside: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return run(beside, folder, sys.executable, "-m", "greybox", *words)


@pytest.fixture(scope="module")
def listed(beside: Path) -> list[dict]:
    """Every extension as the command lists it."""
    return json.loads(greybox(beside, beside, "extensions", "--json").stdout)["extensions"]


@pytest.mark.slow
def test_what_a_stranger_adds_is_used(beside: Path, tmp_path: Path) -> None:
    rows = [f"{k * 1e-3!r}|{(-1) ** (k // 7) * 0.1!r}|{0.01 * ((k % 14) - 6.5)!r}" for k in range(200)]
    (tmp_path / "run.acme").write_text("\n".join(["time|u|y", *rows]), encoding="utf-8")
    done = run(beside, tmp_path, sys.executable, "-c", USE.format(root=str(ROOT)))
    assert done.returncode == 0, done.stderr
    assert "run.acme 200" in done.stdout and "acme_seal_drag" in done.stdout
    done = greybox(
        beside,
        tmp_path,
        "export",
        "fit.json",
        "--to",
        "listing",
        "--model",
        str(ROOT / "models" / "silverbox.py"),
        "--no-report",
    )
    assert done.returncode == 0, done.stderr
    written = next(tmp_path.rglob("*.lst")).read_text(encoding="utf-8")
    assert all(re.fullmatch(r"\w+ = \S+", line) for line in written.splitlines())
    assert greybox(beside, tmp_path, "acme-info", "stage").stdout == "acme stage\n"


@pytest.mark.slow
def test_a_plant_of_strangers_is_fitted_by_its_name(beside: Path, tmp_path: Path) -> None:
    area, hole, level, rows = 0.8, 0.004, 1.0, []
    for k in range(120):
        flow = 0.02 if k % 40 < 20 else 0.0
        rows.append(f"{k},{flow},{level!r}")
        for _ in range(200):
            level += 0.005 * (flow - hole * (2 * 9.81 * level) ** 0.5) / area
    (tmp_path / "tank.csv").write_text("\n".join(["time [s],q [m**3/s],h [m]", *rows]), encoding="utf-8")
    done = greybox(beside, tmp_path, "fit", "acme_tank", "tank.csv", "--noise", "h=0.001", "--json", "--no-report")
    assert done.returncode == 0, done.stderr
    parameters = json.loads(done.stdout)["parameters"]
    assert parameters["area"]["value"] == pytest.approx(area, rel=0.01)
    assert parameters["hole"]["value"] == pytest.approx(hole, rel=0.01)
    done = greybox(beside, tmp_path, "fit", "acme_tanc", "tank.csv")
    assert done.returncode == 2 and "acme_tank" in done.stderr


def test_what_the_page_types_prints_what_it_shows(beside: Path, tmp_path: Path) -> None:
    (tmp_path / "run.acme").write_text(code("run.acme"), encoding="utf-8")
    console = re.search(r"```console\n(.*?)```", PAGE, re.DOTALL)
    assert console
    for typed, shown in re.findall(r"^\$ greybox (.*?) *(?:#.*)?\n((?:(?!\$).*\n)*)", console[1], re.MULTILINE):
        done = greybox(beside, tmp_path, *typed.split())
        assert done.returncode == 0, done.stderr
        assert shown in done.stdout


def test_each_extension_is_listed_with_its_origin_and_a_broken_one_with_its_reason(
    beside: Path, tmp_path: Path, listed: list[dict]
) -> None:
    named = {(e["kind"], e["name"]): e for e in listed}
    assert named["readers", "acme"]["distribution"] == "greybox-acme"
    assert named["readers", "mat"]["distribution"] == "greybox-sysid"
    assert "a_package_that_nobody_has" in named["readers", "broken"]["failure"]
    (tmp_path / "run.strange").write_bytes(b"\x01\x02\x03" * 100)  # no text, which would be read
    done = greybox(beside, tmp_path, "fit", "silverbox", "run.strange")
    assert done.returncode == 2
    assert "broken of greybox-broken" in unwrap(done.stderr) and ".acme" in done.stderr


def test_values_of_another_class_and_names_that_are_taken_are_left_out_with_their_reason(
    beside: Path, tmp_path: Path, listed: list[dict]
) -> None:
    failures = {(e["kind"], e["name"]): e["failure"] for e in listed if e["distribution"] == "greybox-wrong"}
    needed = {"readers": "FileFormat", "exports": "ExportTarget", "plants": "PlantKind"}
    for kind, value in {**needed, "commands": "Command", "effects": "Effect"}.items():
        assert f"class {value}" in failures[kind, "wrong"] and "function" in failures[kind, "wrong"]
    assert "'fit'" in failures["commands", "fit"] and "'coulomb_friction'" in failures["effects", "taken"]
    shown = greybox(beside, tmp_path, "--help").stdout
    assert "Fit a model's parameters to records." in shown and "Hello." not in shown
    assert greybox(beside, tmp_path, "effects").returncode == 0
