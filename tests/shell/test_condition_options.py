"""Operating conditions from the shell: values on the command line, a column of the file, or a comment line in it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from greybox import read_csv
from greybox.base.errors import DataError, GreyboxError
from greybox.data.findings import RecordCode
from greybox.shell.inputs import read_records
from greybox.shell.study import Study
from greybox.shell.study_values import Conditions
from greybox.simulation.simulate import write_csv
from models.pneumatic_cylinder import pneumatic_cylinder
from tests.oracles.independent import linear_record

Run = Callable[..., Result]
SUPPLIES = (7e5, 8e5)
NOISE = ["--noise", "s=1e-5", "--at-rest"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``low.csv`` and ``high.csv`` state no supply pressure; ``column.csv`` and ``comment.csv`` are the same records and do."""
    made = tmp_path_factory.mktemp("records")
    t = np.arange(150) * 0.01
    u = 1.25 * np.cos(0.4 * np.pi * t) + 2.0 * np.cos(1.6 * np.pi * t)
    for name, supply in zip(("low", "high"), SUPPLIES, strict=True):
        model = pneumatic_cylinder.start(P_S=supply)
        record = linear_record(model, u, 0.01, [0.0, 0.0, supply / 2, supply / 2])
        write_csv(record.with_outputs({"s": record.outputs["s"]}), model, made / f"{name}.csv")
    header, *rows = (made / "low.csv").read_text().splitlines()
    shown = 700 + 0.5 * np.random.default_rng(0).uniform(-1, 1, len(rows))
    shown += 700 - shown.mean()
    lines = [f"{header},P_S [kPa]", *(f"{row},{p:.9f}" for row, p in zip(rows, shown, strict=True))]
    (made / "column.csv").write_text("\n".join(lines))
    (made / "comment.csv").write_text("# bench 2\n# P_S = 800 kPa\n" + (made / "high.csv").read_text())
    (made / "moving.csv").write_text(
        "\n".join([f"{header},P_S [kPa]", *(f"{row},{600 + k}" for k, row in enumerate(rows))])
    )
    return made


@pytest.mark.rest
def test_records_at_two_supply_pressures_are_fitted_with_the_conditions_that_they_state(run: Run, folder, tmp_path):
    files = [folder / f"{name}.csv" for name in ("column", "comment")]
    result = run("fit", "pneumatic_cylinder", *files, *NOISE, "--condition", "P_S", "--no-report", "--details")
    assert result.exit_code == 0, result.output
    saved = json.loads((tmp_path / "results" / "pneumatic_cylinder-fit" / "fit.json").read_text())
    assert [t["conditions"]["P_S"] for t in saved["traces"]] == pytest.approx(SUPPLIES, rel=1e-9)
    for name in ("K2", "f_v"):
        assert saved["parameters"][name]["value"] == pytest.approx(pneumatic_cylinder.values[name], rel=1e-6)
    assert "condition P_S: 700000 Pa, mean of its column" in result.stdout
    assert "condition P_S: 800000 Pa, from a comment of the file" in result.stdout


def test_values_on_the_command_line_go_to_the_records_in_their_order(folder):
    low, high = folder / "low.csv", folder / "high.csv"
    given = Conditions().from_option("--condition", ["P_S=7e5,8e5,9e5", "M_piston=1.4,1.5"])
    study = Study(conditions=given, estimation=(low, high), validation=(low,))
    records, judges, _ = read_records(study, pneumatic_cylinder)
    assert [dict(r.conditions) for r in records] == [{"P_S": 7e5, "M_piston": 1.4}, {"P_S": 8e5, "M_piston": 1.5}]
    assert [dict(r.conditions) for r in judges] == [{"P_S": 9e5}]
    with pytest.raises(GreyboxError, match="--condition P_S: given with values and from the files; keep one"):
        Conditions().from_option("--condition", ["P_S=7e5", "P_S"])


def test_a_record_that_judges_its_own_fit_is_named(folder):
    low, high = folder / "low.csv", folder / "high.csv"
    _, (other, same), _ = read_records(Study(estimation=(low,), validation=(high, low)), pneumatic_cylinder)
    assert RecordCode.ALSO_FITTED not in [finding.code for finding in other.findings]
    assert same.findings[-1].code == RecordCode.ALSO_FITTED and same.findings[-1].values["record"] == "low.csv"


@pytest.mark.parametrize(
    ("command", "judges", "records"),
    [("check", [], "1 record"), ("discover", ["--validate", "high.csv"], "1 record and 1 for validation")],
)
def test_other_commands_know_conditions_too(run: Run, folder, monkeypatch, command, judges, records):
    monkeypatch.chdir(folder)
    result = run(command, "pneumatic_cylinder", "low.csv", *judges, *NOISE, "--condition", "P_S=7e5,8e5,9e5")
    assert result.exit_code == 2 and f"--condition P_S: 3 values for {records}; give one for each" in result.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["low", "P_S=7e5,8e5"], "--condition P_S: 2 values for 1 record; give one for each, in their order"),
        (["low", "P_S=-7e5"], "parameter 'P_S': -700000 Pa lies outside its bounds"),
        (["low", "P_s=7e5"], "condition 'P_s' is not a parameter of pneumatic_cylinder; did you mean"),
        (["low", "P_s"], "has no parameter 'P_s'; did you mean"),
        (["low", "P_S"], "low.csv: condition 'P_S' [Pa] has neither a column nor a comment line"),
        (["moving", "P_S"], "its column runs from 600000 to 749000 Pa, so it is no condition of the whole record"),
    ],
)
def test_conditions_that_cannot_be_are_refused_and_nothing_is_written(run: Run, folder, tmp_path, options, words):
    name, condition = options
    result = run("fit", "pneumatic_cylinder", folder / f"{name}.csv", *NOISE, "--condition", condition)
    assert result.exit_code == 2
    assert words in " ".join(result.stderr.split())
    assert not any(tmp_path.iterdir())


def test_a_comment_states_a_condition_in_its_own_unit_once(folder, tmp_path):
    table = (folder / "low.csv").read_text()
    for line in ("# P_S = 8.5 bar", "#P_S [bar]: 8.5", "# P_S = 850000"):
        (tmp_path / "run.csv").write_text(f"{line}\n{table}")
        record = read_csv(tmp_path / "run.csv", pneumatic_cylinder, conditions={"P_S": None, "M_piston": 1.5})
        assert dict(record.conditions) == {"P_S": pytest.approx(8.5e5), "M_piston": 1.5}
    for text, words in {
        "# P_S = 8 bar\n# P_S = 9 bar": "has several comment lines",
        "# P_S = 8 V": "comment line '# P_S = 8 V' is not understood",
        "# P_S = high": "comment line '# P_S = high' is not understood",
    }.items():
        (tmp_path / "run.csv").write_text(f"{text}\n{table}")
        with pytest.raises(DataError, match=words):
            read_csv(tmp_path / "run.csv", pneumatic_cylinder, conditions={"P_S": None})
