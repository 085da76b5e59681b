"""`greybox robot`: the answer in the first line, on one screen, with the next command; bad input ends with exit code 2."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from greybox.shell.commands import app
from greybox.shell.project import find_model
from tests.support.command import CliRunner
from tests.support.robots import DOUBLE_PENDULUM, double_pendulum_torques, joint_log, write, write_log


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "arm.urdf", DOUBLE_PENDULUM)
    write_log(joint_log(viscous=(0.8, 0.0), dry=(0.0, 0.5), payload=0.4), tmp_path / "log.csv")
    return tmp_path


def run(*arguments: str):
    return CliRunner().invoke(app, ["robot", *arguments])


def test_it_answers_on_one_screen_and_writes_a_page(folder: Path) -> None:
    done = run("arm.urdf", "log.csv", "--output", "out")
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    # More would not stand on a screen.
    assert len(lines) <= 25
    assert lines[0].startswith("double_pendulum: viscous friction at shoulder and dry friction at elbow;")
    answer = " ".join(lines[:3])
    assert "a payload of 0.4 kg" in answer and "on lower; 6 of 6 base parameters are carried." in answer
    assert "next: greybox robot arm.urdf log.csv ANOTHER_MOTION.csv" in done.stdout
    page = (folder / "out" / "report.html").read_text(encoding="utf-8")
    assert "with all effects" in page
    assert "Iyy1 + 0.25" in page
    data = json.loads((folder / "out" / "robot.json").read_text(encoding="utf-8"))
    assert data["payload"]["link"] == "lower" and [e["joint"] for e in data["effects"]] == ["shoulder", "elbow"]
    # Torques by the model that was written are those of the log's own equations: here of two joints that move alone.
    torques, motion = (find_model(str(folder / "out" / f"{name}.py")) for name in ("torques", "motion"))
    friction = {e["joint"]: e["value"] for e in data["effects"]}
    assert torques.values["B1"] == pytest.approx(friction["shoulder"]) == motion.values["B1"]
    assert torques.values["Fc"] == pytest.approx(friction["elbow"]) == motion.values["Fc"]
    at_rest = torques.system.output_function([], [0.4, 0.2, 0, 0, 0, 0], list(torques.values.values())).full().ravel()
    described = double_pendulum_torques(np.array([[0.4, 0.2]]), np.zeros((1, 2)), np.zeros((1, 2)))[0]
    heavier = 0.4 * 9.81 * data["payload"]["centre"][2]
    assert at_rest[1] == pytest.approx(described[1] - heavier * np.sin(0.6), rel=0.02)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["none.urdf", "log.csv"], "none.urdf: the robot description cannot be read"),
        (["log.csv", "log.csv"], "log.csv: this is no XML"),
        (["arm.urdf", "none.csv"], "none.csv"),
        (["arm.urdf", "wrong.csv"], "wrong.csv"),
        (["arm.urdf"], "RECORDS"),
    ],
)
def test_bad_input_ends_with_one_message(folder: Path, arguments: list[str], reason: str) -> None:
    write(folder / "wrong.csv", "time [s],x [m]\n" + "\n".join(f"{k},1" for k in range(100)))
    done = run(*arguments)
    assert done.exit_code == 2 and reason in done.stderr and done.stdout == ""
    assert not (folder / "results").exists()


@pytest.mark.rest
def test_it_designs_the_motion_to_record_next(folder: Path) -> None:
    done = run("arm.urdf", "log.csv", "--design", "--output", "out", "--no-report")
    assert done.exit_code == 0, done.output
    first = " ".join(done.stdout.split())
    assert first.startswith("10 s of this motion make the intervals of 6 base parameters")
    assert "times narrower than the logs alone (median; " in first
    rows = np.loadtxt(folder / "out" / "next_motion.csv", delimiter=",", skiprows=1)
    # Inside what the description states of the shoulder.
    assert np.abs(rows[:, 1]).max() <= 3 and np.abs(rows[:, 3]).max() <= 8


def test_its_page_says_what_is_missing_where(folder: Path) -> None:
    details = run("arm.urdf", "log.csv", "--details", "--no-report").stdout
    for words in ("Iyy1 + 0.25 m2", "established", "viscous friction"):
        assert words in details
