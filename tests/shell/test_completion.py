"""Tab in the shell: commands, models, effects, constants and outputs; nothing, and no error, where what was typed leads nowhere."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from greybox.model.effects.catalogue import CATALOGUE
from greybox.shell.commands import app
from models.micro_actuator import micro_actuator
from tests.support.command import CliRunner

ROOT = Path(__file__).resolve().parents[2]


def offered(line: str) -> list[str]:
    """What bash is offered after ``line``, in a process of its own, as the shell asks for it."""
    words = line.split(" ")
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "_GREYBOX_COMPLETE": "bash_complete",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
    }
    command = [sys.executable, "-m", "greybox"]
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.stderr == ""
    return [offer.partition(",")[2] for offer in done.stdout.split("\n") if offer]


def inside(line: str) -> list[str]:
    """The same without a process: through the entry of the command line."""
    environment = {
        "_GREYBOX_COMPLETE": "bash_complete",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split(" ")) - 1),
    }
    done = CliRunner().invoke(app, [], prog_name="greybox", env=environment)
    assert done.stderr == ""
    return [offer.partition(",")[2] for offer in done.stdout.split("\n") if offer]


@pytest.mark.rest
def test_the_command_itself_answers_the_shell() -> None:
    assert offered("greybox fit micro_act") == ["micro_actuator", "micro_actuator_no_inductance"]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("greybox mod", {"models"}),
        ("greybox fit micro_actuator --effect coulomb", {"coulomb_friction"}),
        (
            "greybox discover micro_actuator a.csv --effects coulomb_friction,cubic_s",
            {"coulomb_friction,cubic_stiffness"},
        ),
        ("greybox fit micro_actuator --fix K", {"K=", "Kf=", "Kv="}),
        ("greybox fit micro_actuator --effect cubic_stiffness --start K", {"K=", "Kf=", "Kv=", "K3="}),
        ("greybox fit micro_actuator --free R", {"Ra"}),
        ("greybox check micro_actuator --noise ", {"x=", "i="}),
        ("greybox simulate micro_actuator --initial ", {"x=", "v=", "i="}),
        ("greybox fit nothing_of_this_name --fix ", set()),
        ("greybox fit --fix ", set()),
    ],
)
def test_what_fits_is_offered(line: str, expected: set[str]) -> None:
    assert set(inside(line)) == expected


def test_everything_of_a_kind_is_offered_where_nothing_is_typed() -> None:
    assert set(inside("greybox fit micro_actuator --effect ")) == {e.name for e in CATALOGUE}
    assert set(inside("greybox fit micro_actuator --fix ")) == {f"{name}=" for name in micro_actuator.values}


def test_a_model_file_is_offered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_rig.py").write_text("")
    (tmp_path / "my_record.csv").write_text("")
    monkeypatch.chdir(tmp_path)
    assert inside("greybox check my_") == ["my_rig.py"]


def test_the_script_for_the_shell_is_shown() -> None:
    done = CliRunner().invoke(app, ["--help"], prog_name="greybox")
    assert "--install-completion" in done.stdout and "--show-completion" in done.stdout
