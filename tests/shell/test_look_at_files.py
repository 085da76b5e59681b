"""`greybox check FILE`: a file without a model."""

from __future__ import annotations

import json

import numpy as np
from click.testing import CliRunner

from greybox.shell.commands import app


def run(*words):
    return CliRunner().invoke(app, list(map(str, words)))


def write(path):
    time = 0.01 * np.arange(300)
    rows = "\n".join(
        f"{t!r},{u!r},{x!r}" for t, u, x in np.column_stack([time, np.sin(time), np.cos(9 * time)]).tolist()
    )
    path.write_text(f"time [s],drive [V],laser 1 [um]\n{rows}\n")
    return path


def test_a_file_is_looked_at_and_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run("check", write(tmp_path / "run.csv"))
    assert result.exit_code == 0
    assert 'gb.Input("drive", "V")' in result.stdout and "laser 1" in result.stdout
    assert [p.name for p in tmp_path.iterdir()] == ["run.csv"]


def test_a_header_with_accents_keeps_its_letters(tmp_path):
    file = tmp_path / "tank.csv"
    file.write_text("t [s],Füllstand [cm]\n" + "".join(f"{k},{np.sin(k):.6f}\n" for k in range(50)), encoding="utf-8")
    assert 'gb.Output("Fullstand", "cm")' in run("check", str(file)).stdout


def test_several_files_as_json(tmp_path):
    file = write(tmp_path / "run.csv")
    one = json.loads(run("check", file, "--json").stdout)
    assert {s["header"]: s["use"] for s in one["signals"]} == {
        "time [s]": "time",
        "drive [V]": "input",
        "laser 1 [um]": "output",
    }
    assert one["columns"]["drive"] == "drive [V]"
    assert len(json.loads(run("check", file, file, "--json").stdout)) == 2


def test_a_damaged_file_ends_with_exit_code_2(tmp_path):
    (tmp_path / "run.mf4").write_bytes(b"MDF     4.10    " + bytes(100))
    result = run("check", tmp_path / "run.mf4")
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1 and result.stderr.startswith("error: run.mf4: ")


def test_columns_are_named_where_a_file_is_looked_at(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    rows = "\n".join(f"01.02.2024 08:00:{k:02d};{k % 7},5;2{k % 5},1" for k in range(30))
    (tmp_path / "odd.csv").write_text(f"Zeit;Ventil;Temp\n{rows}\n")
    proposed = run("check", "odd.csv")
    assert "\ncolumns for it: --column time=Zeit\n" in proposed.stdout
    # What it proposes it takes, and what is stated stands in the next proposal.
    assert run("check", "odd.csv", "--column", "time=Zeit").stdout == proposed.stdout
    named = run("check", "odd.csv", "--column", "v [percent]=Ventil", "--column", "T [degC]=3")
    assert 'gb.Output("T", "K")' in named.stdout
    words = " ".join(named.stdout.split())
    assert "--column time=Zeit --column 'v [percent]'=Ventil --column 'T [degC]'=Temp" in words
    unknown = run("check", "odd.csv", "--column", "x=Tmp")
    assert unknown.exit_code == 2 and "odd.csv: no column 'Tmp' for x; did you mean 'Temp'?" in unknown.stderr
