"""Plants to start from: each project of `write_project(plant=...)` runs as its README says, and its twin does more than its model."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

import pytest

from greybox import GreyboxError
from greybox.shell.commands import app
from greybox.shell.template import plant_names, write_project
from tests.support.command import CliRunner

HIDDEN = {
    "chamber": "transport_delay",
    "circuit": "input_saturation",
    "cylinder": "valve_dead_zone",
    "rotary-drive": "coulomb_friction",
    "stage": "cubic_stiffness",
    "tank-chain": "linear_leak_at_tank_3",
    "tanks": "input_dead_zone",
    "thermal": "input_saturation",
    "two-mass": "coulomb_friction",
}


# What `greybox init --plant` writes is the same for all: by day one of each kind of physics.
BY_DAY = ("chamber", "rotary-drive", "thermal")


@pytest.fixture(params=[pytest.param(name, marks=[pytest.mark.slow] * (name not in BY_DAY)) for name in sorted(HIDDEN)])
def plant(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of a plant; the working folder is its project."""
    write_project(tmp_path / "rig", plant=request.param)
    monkeypatch.chdir(tmp_path / "rig")
    monkeypatch.syspath_prepend(tmp_path / "rig")
    return request.param


def shorten_records(rows: int) -> None:
    """Let the twin write records of so many rows."""
    text, count = re.subn(
        r"(SAMPLING_TIME, ROWS = \S+), \d+", rf"\1, {rows}", Path("twin.py").read_text(encoding="utf-8")
    )
    assert count == 1
    Path("twin.py").write_text(text, encoding="utf-8")


def run(*words: str) -> str:
    done = CliRunner().invoke(app, [*words, "--output", "out"], prog_name="greybox")
    assert done.exit_code == 0, done.output
    return done.output


@pytest.mark.crossed(3)
@pytest.mark.rest
def test_the_twin_hides_an_effect_from_the_model(plant: str) -> None:
    shorten_records(500)
    runpy.run_path("twin.py")
    run("fit", "study.toml", "--no-report")
    result = json.loads(Path("out/fit.json").read_text())
    assert result["success"]
    assert max(signal["noise_ratio"] for signal in result["misfit"].values()) > 5


@pytest.mark.slow
def test_discovery_names_what_the_twin_hides(plant: str) -> None:
    runpy.run_path("twin.py")
    run("discover", "study.toml", "--no-report")
    answer = json.loads(Path("out/discovery.json").read_text())
    assert [effect["name"] for effect in answer["effects"]] == [HIDDEN[plant]]


def test_every_plant_is_tried() -> None:
    assert plant_names() == sorted(HIDDEN)


def test_an_unknown_plant_gets_the_nearest_name(tmp_path: Path) -> None:
    with pytest.raises(GreyboxError, match="two-mass"):
        write_project(tmp_path / "rig", plant="two-masses")
    assert not (tmp_path / "rig").exists()
