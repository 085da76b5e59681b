"""`greybox design`: what it writes, and what it refuses."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.extensions.design.command import read_data
from greybox.extensions.design.problem import DESIGN_POLICY
from greybox.shell.commands import COMMANDS, app
from greybox.shell.study import Study
from greybox.simulation.simulate import read_inputs, write_csv
from models.silverbox import silverbox
from tests.support.command import CliRunner
from tests.support.result_schema import strict_offences

BASE = ["--limit", "u=-0.1:0.1", "--duration", "0.3", "--sampling-time", "1.5e-3"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments: str):
    return CliRunner().invoke(app, ["design", *arguments])


@pytest.mark.slow
def test_a_model_a_fit_and_a_simulation_of_the_input(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Refines the best two inputs, not six: a third of the time.
    monkeypatch.setitem(gb.design.__kwdefaults__, "policy", replace(DESIGN_POLICY, starts=2))
    done = run("silverbox", "--noise", "y=1e-3", *BASE, "--limit", "y=-0.1:0.1", "--at-rest", "--output", "first")
    assert done.exit_code == 0, done.output
    assert sorted(p.name for p in Path("first").iterdir()) == ["design.json", "input.csv", "report.html"]
    data = json.loads(Path("first/design.json").read_text())
    assert strict_offences(data, "design") == [] and data["goal"] == "precision"
    played = ["simulate", "silverbox", "first/input.csv", "--noise", "y=1e-3", "--output", "record.csv", "--no-report"]
    assert CliRunner().invoke(app, played).exit_code == 0
    record = gb.read_csv("record.csv", silverbox)
    assert np.abs(record.outputs["y"]).max() < 0.1 + 4e-3
    fitted = CliRunner().invoke(
        app, ["fit", "silverbox", "record.csv", "--noise", "y=1e-3", "--at-rest", "--output", "fit", "--no-report"]
    )
    assert fitted.exit_code == 0, fitted.output
    again = run(
        "fit/fit.json", "--limit", "u=-0.1:0.1", "--duration", "0.3", "--output", "second", "--no-report", "--json"
    )
    assert again.exit_code == 0, again.output
    constants = json.loads(again.stdout)["predicted"]
    assert all(c["std_after"] < c["std_before"] for c in constants.values() if c["std_before"])
    assert read_inputs("second/input.csv", silverbox).rows == 200
    # The fit began at rest, and so does what is designed for it: its first states are no unknowns of the next record.
    rested = run("fit/fit.json", "--at-rest", "--limit", "u=-0.1:0.1", "--duration", "0.3", "--no-report", "--json")
    assert json.loads(rested.stdout)["predicted"] == constants


BAD = [
    (["nothing.json"], "nothing.json"),
    (["silverbox", *BASE], "the noise of no output is known"),
    (["silverbox", "--noise", "y=1e-3", "--limit", "u=3"], "--limit u=3: write it as LOW:HIGH"),
    (["silverbox", "--noise", "y=1e-3", "--limit", "u=2:1"], "the low end must not lie above"),
    (["silverbox", "--noise", "y=1e-3", "--limit", "u=-1:1"], "a design needs a duration"),
    (
        ["silverbox", "--noise", "y=1e-3", *BASE, "--goal", "discrimination", "--rival", "input_offset"],
        "give records or a fit",
    ),
    (["silverbox", "--noise", "y=1e-3", *BASE, "--rate", "u=-1"], "a rate of -1"),
    (
        ["silverbox", "--noise", "y=1e-3", *BASE, "--effect", "cubic_stiffness"],
        "--effect: no effect with --goal precision",
    ),
    (["silverbx", "--noise", "y=1e-3", *BASE], "silverbox"),
    (["silverbox", "--model", "silverbox", *BASE], "leave out one of the two"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD, ids=[message[:30] for _, message in BAD])
def test_bad_input_is_one_sentence_and_exit_code_two(folder: Path, arguments: list[str], message: str) -> None:
    done = run(*arguments)
    assert done.exit_code == 2, done.output
    assert message in done.stderr and done.stderr.count("\n") == 1
    assert not list(folder.iterdir())


def test_a_discovery_needs_its_records(folder: Path) -> None:
    write_csv(gb.simulate(silverbox, {"time": 1e-3 * np.arange(20), "u": np.ones(20)}).record(), silverbox, "a.csv")
    Path("discovery.json").write_text('{"verdict": "named"}')
    done = run("discovery.json", *BASE)
    assert done.exit_code == 2 and "discovery.json" in done.stderr


@pytest.mark.parametrize("command", ["design", "changed"])
def test_records_of_a_design_are_split_as_those_of_its_fit(folder: Path, command: str) -> None:
    k = np.r_[0:200, 260:400]
    rows = "\n".join(f"{1e-3 * i},{np.sin(i / 9)},{np.cos(i / 7)}" for i in k)
    Path("a.csv").write_text(f"time [s],u [V],y [V]\n{rows}\n")
    study = COMMANDS[command].study(split_holes=True)
    pieces = read_data([Path("a.csv")], silverbox, study)
    assert [piece.rows for piece in pieces] == [200, 140]
    assert Study.split_holes in COMMANDS[command].options
    with pytest.raises(gb.GreyboxError, match="60 rows are missing"):
        read_data([Path("a.csv")], silverbox, study.but(split_holes=False))
