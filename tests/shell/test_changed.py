"""`greybox changed`: what it writes, and what it refuses."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.data.file_kinds import list_record_files
from greybox.shell.commands import app
from greybox.simulation.simulate import write_csv
from models.silverbox import silverbox
from tests.oracles.independent import linear_record, multisine
from tests.support.command import CliRunner
from tests.support.result_schema import strict_offences

PERIOD = 1.6384e-3
NOISE = {"y": 1e-3}


def store(path: Path, seed: int, **values: float) -> gb.Experiment:
    u = multisine(np.random.default_rng(seed), 200, PERIOD, 5, 200, 0.1)
    record = linear_record(silverbox.start(**values), u, PERIOD, noise=NOISE, seed=seed)
    write_csv(record, silverbox, path)
    return record


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    gb.fit(silverbox, store(folder / "then.csv", 1), noise=NOISE).save(folder / "fit.json")
    (folder / "days").mkdir()
    for day in range(1, 12):
        store(folder / "days" / f"day {day}.csv", 10 + day, d=43.0 if day < 9 else 46.0)
    return folder


@pytest.fixture
def folder(bench: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return bench


def run(*arguments: str):
    return CliRunner().invoke(app, ["changed", *arguments])


def test_today_in_text_as_json_and_as_a_page(folder: Path) -> None:
    done = run(str(folder / "fit.json"), str(folder / "days/day 10.csv"), "--output", "out")
    assert done.exit_code == 0, done.output
    assert re.match(r"d has risen by \S+ %, from ", done.stdout)
    assert sorted(p.name for p in Path("out").iterdir()) == ["changed.json", "index.html"]
    data = json.loads(Path("out/changed.json").read_text())
    assert strict_offences(data, "change") == [] and data["verdict"] == "changed" and data["constants"]["d"]["moved"]
    again = run(str(folder / "fit.json"), str(folder / "days/day 2.csv"), "--output", "out", "--no-report", "--json")
    assert json.loads(again.stdout)["verdict"] == "unchanged"


@pytest.mark.parametrize("at_rest", [False, True])
def test_the_folder_of_a_fit_is_the_fit_and_what_follows_begins_as_it_did(folder: Path, at_rest: bool) -> None:
    then, today = folder / "then.csv", folder / "days/day 10.csv"
    record = gb.read_csv(then, silverbox)
    gb.fit(silverbox, record, noise=NOISE, options=gb.FitOptions(at_rest=at_rest)).save(Path("was/fit.json"))
    done = run("was", str(today), "--validate", str(today), "--no-report")
    assert done.exit_code == 0, done.output
    assert ("--at-rest" in done.stdout.partition("next: greybox fit silverbox")[2]) is at_rest
    assert "cannot validate the model" in done.stderr


def test_a_folder_over_time(folder: Path) -> None:
    done = run(str(folder / "fit.json"), str(folder / "days"), "--chart", "--output", "chart", "--json")
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    assert strict_offences(data, "change") == []
    assert [(c["constant"], c["record"]) for c in data["change_points"]] == [("d", "day 9")]
    assert "course" in Path("chart/index.html").read_text()


def test_machines_of_a_kind(folder: Path) -> None:
    files = [str(folder / "days" / f"day {k}.csv") for k in (1, 2, 3, 4, 5, 10)]
    done = run(str(folder / "fit.json"), *files, "--population", "--output", "kind")
    assert done.exit_code == 0, done.output
    data = json.loads(Path("kind/changed.json").read_text())
    assert [Path(m["name"]).name for m in data["machines"] if m["outlying"]] == ["day 10.csv"]


def test_files_of_a_folder_come_in_the_order_of_their_numbers(folder: Path) -> None:
    assert [p.stem for p in list_record_files([folder / "days"])] == [f"day {k}" for k in range(1, 12)]


BAD = [
    (["nothing.json", "a.csv"], "nothing.json"),
    (["{fit}", "a.csv"], "a.csv"),
    (["{fit}", "."], "a folder without records"),
    (["{fit}", "{day}", "--population", "--chart"], "exclude each other"),
    (["{fit}", "{day}", "--population"], "a population needs 4"),
    (["{fit}", "{day}", "--chart"], "a chart needs 4"),
    (["{fit}", "{day}", "--chart", "--validate", "{day}"], "--validate: no effect here"),
    (["{fit}", "{day}", "--skip", "5"], "--skip 5 has no effect"),
    (["{fit}", "{day}", "--model", "micro_actuator"], "belongs to the model silverbox"),
    (["{fit}", "{fit}"], "fit.json"),
    (["{day}", "{fit}"], "fit.json: a fit, and no record; FIT is the first argument"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD, ids=[message[:30] for _, message in BAD])
def test_bad_input_is_one_sentence_and_exit_code_two(folder: Path, arguments: list[str], message: str) -> None:
    places = {"fit": str(folder / "fit.json"), "day": str(folder / "days/day 1.csv")}
    done = run(*[a.format(**places) for a in arguments])
    assert done.exit_code == 2, done.output
    assert message in done.stderr and done.stderr.count("\n") == 1
    assert not list(Path().iterdir())


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize("layout", [["--column", "u=1", "--column", "y=Reading"], ["--columns", "t,u,y"]])
@pytest.mark.parametrize("command", ["changed", "design", "fleet"])
def test_columns_of_other_names_are_read_as_by_a_fit(folder: Path, command: str, layout: list[str]) -> None:
    """What a fit was given of a logger's file is given to what follows it."""
    _, *rows = (folder / "days/day 2.csv").read_text().splitlines()
    if layout[0] == "--column":  # time last, and headers that say nothing to the model
        rows = [
            "Drive (V);Reading;time [s]".replace(";", ","),
            *(",".join([*r.split(",")[1:], r.split(",")[0]]) for r in rows),
        ]
    Path("today.csv").write_text("\n".join(rows) + "\n")
    given = {
        "changed": [str(folder / "fit.json"), "today.csv"],
        "design": ["silverbox", "today.csv", "--noise", "y=1e-3", "--limit", "u=-0.1:0.1", "--duration", "0.1"],
        "fleet": ["silverbox", "today.csv", "--noise", "y=1e-3"],
    }
    done = CliRunner().invoke(app, [command, *given[command], *layout, "--no-report"])
    assert done.exit_code == 0, done.output
