"""`greybox check FILE`: a file without a model."""

from __future__ import annotations

import json

import numpy as np
import pytest

from greybox.data.findings import RecordCode
from greybox.data.survey import survey_file
from greybox.shell.commands import app
from greybox.shell.template import plant_names
from tests.support.command import CliRunner


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
    # No model has these signals: a plant to start one from is named as `init` takes it.
    assert "next: greybox init my_rig --plant PLANT\n" in result.stdout
    offered = " ".join(result.stdout.split()).partition("PLANT: ")[2].partition(" next:")[0].split(", ")
    assert offered == plant_names()


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


@pytest.mark.parametrize("word", ["off", "OVL", "err 12", "<0.01"])
@pytest.mark.parametrize("suffix", [".csv", ".xlsx", ".parquet"])
def test_a_column_of_numbers_with_some_text_is_said_with_its_cells_and_the_remedy(tmp_path, word, suffix):
    readings: list[object] = [round(0.1 * k, 2) for k in range(40)]
    readings[7] = readings[20] = word
    columns = {"time [s]": [0.5 * k for k in range(40)], "x [m]": readings, "remark": [word, *[""] * 39]}
    file = tmp_path / f"log{suffix}"
    if suffix == ".parquet":
        texts = {h: list(map(str, c)) if h != "time [s]" else c for h, c in columns.items()}
        pq = pytest.importorskip("pyarrow.parquet")
        pq.write_table(pytest.importorskip("pyarrow").table(texts), file)
    elif suffix == ".xlsx":
        book = pytest.importorskip("openpyxl").Workbook()
        for row in (list(columns), *zip(*columns.values(), strict=True)):
            book.active.append(row)
        book.save(file)
    else:
        rows = [",".join(map(str, row)) for row in zip(*columns.values(), strict=True)]
        file.write_text("\n".join([",".join(columns), *rows]) + "\n")
    survey = survey_file(file)
    said = [f for f in survey.findings if f.code == RecordCode.COLUMN_WITH_TEXT]
    assert [(f.subject, f.values["count"], f.values["rows"]) for f in said] == [("x [m]", 38, 40)]
    assert word in said[0].values["reason"] and "leave the field empty" in said[0].values["reason"]
    signal = next(s for s in survey.signals if s.header == "x [m]")
    assert (signal.use, signal.missing, signal.highest) == ("output", 2, 3.9)


MOTOR = """
from greybox import Balance, Input, Model, Output, Parameter, State

motor = Model(
    "motor",
    [State("i", "A"), State("w", "rad/s")],
    [Input("u", "V")],
    [Output("i", "A"), Output("w", "rad/s")],
    [Parameter("L", "H", 0.01, (1e-4, 1.0)), Parameter("R", "ohm", 1.0, (0.1, 10.0)), Parameter("K", "N*m/A", 0.1, (0.01, 1.0)),
     Parameter("J", "kg*m^2", 0.01, (1e-4, 1.0))],
    lambda x, u, p: [
        Balance("winding", "V", p.L, "i", drive=u.u, loss=-p.R * x.i, back=-p.K * x.w),
        Balance("shaft", "N*m", p.J, "w", motor=p.K * x.i),
    ],
)
"""


@pytest.mark.parametrize(
    ("others", "offered"),
    [({"speed [1/min]": 60.0}, "speed [1/min]"), ({"a [1/min]": 1.0, "b [rpm]": 2.0}, ""), ({"temp [degC]": 20.0}, "")],
)
def test_a_column_whose_unit_fits_an_output_without_one_is_offered_by_name(tmp_path, others, offered):
    (tmp_path / "motor.py").write_text(MOTOR)
    time = 0.01 * np.arange(60)
    columns = {"time [s]": time, "u [V]": np.sign(np.sin(9 * time)), "i [A]": np.sin(time)}
    columns |= {h: v * np.cos(time) for h, v in others.items()}
    table = np.column_stack(list(columns.values()))
    rows = [",".join(f"{v:.6g}" for v in row) for row in table.tolist()]
    (tmp_path / "log.csv").write_text("\n".join([",".join(columns), *rows]) + "\n")
    from greybox.data.read import read_csv
    from greybox.shell.project import find_model

    record = read_csv(tmp_path / "log.csv", find_model(str(tmp_path / "motor.py")))
    said = next(f for f in record.findings if f.code == RecordCode.OUTPUT_NOT_MEASURED)
    assert said.values.get("columns", {}) == ({"w": offered} if offered else {})
    assert ("--column 'w=speed [1/min]'" in str(said)) == bool(offered)
    if offered:
        again = read_csv(tmp_path / "log.csv", find_model(str(tmp_path / "motor.py")), columns={"w": offered})
        np.testing.assert_allclose(again.outputs["w"], 60 * 2 * np.pi / 60 * np.cos(time), rtol=1e-5)


def test_an_input_that_comes_back_to_its_ends_is_no_doubtful_sensor(tmp_path):
    time, generator = 0.01 * np.arange(1200), np.random.default_rng(1)
    # Ramped between two ends that it stays at, as a valve is driven.
    valve = np.round(np.clip(5 + 2.5 * np.sin(2 * np.pi * time / 1.5) + 0.3 * np.sin(9 * time), 3.3, 7.3), 3)
    angle = np.convolve(valve, np.exp(-np.arange(60) / 20) / 20, "full")[: len(time)] + generator.normal(0, 0.01, 1200)

    def doubts(name: str) -> dict[str, str]:
        path = tmp_path / f"{name}.csv"
        columns = np.column_stack([time, valve, angle])
        np.savetxt(path, columns, "%.6g", delimiter=",", header=f"time_s,{name},angle_deg", comments="")
        return {str(f.code): str(f) for f in survey_file(path).findings if f.subject == name}

    assert doubts("valve_V") == {}
    # Of the same numbers as what may be an output it is a doubt, and what is said holds of either.
    as_output = doubts("p_kPa")
    assert "leave these fields empty (where it is an input, write what acted" in as_output[RecordCode.SENSOR_SATURATED]
