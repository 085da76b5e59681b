"""Many records: each is fitted as if it were alone, a bad one is named, and what is done is kept."""

from __future__ import annotations

import csv
import json
import multiprocessing
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from statsmodels.stats.meta_analysis import combine_effects

import greybox as gb
from greybox.base import Finding
from greybox.base.errors import DataError
from greybox.base.json_shape import from_json_data, to_json_data
from greybox.estimation.result_parts import Estimate
from greybox.extensions.fleet import batch
from greybox.extensions.fleet.batch import PILOTS
from greybox.extensions.fleet.records import RecordCollection, RecordReference
from greybox.extensions.fleet.result import ConstantDistribution, FleetCode, RecordEstimate
from greybox.extensions.formats.parquet_file import find_record_rows, open_parquet_part
from greybox.shell.commands import app
from tests.support.command import CliRunner
from tests.support.first_order import first_order
from tests.support.result_schema import strict_offences

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")

PERIOD, ROWS, NOISE = 0.05, 200, 0.01
# A start that is off, as that of whoever has not fitted any of them.
MODEL = first_order(gain=1.3, lag=0.8)


def simulate(seed: int, gain: float = 2.0, lag: float = 0.5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, input and reading (N,) of a lag, from its own difference equation."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.normal(size=ROWS // 10), 10)
    fall = np.exp(-PERIOD / lag)
    y = lfilter([0, gain * (1 - fall)], [1, -fall], u)
    return PERIOD * np.arange(ROWS), u, y + NOISE * rng.normal(size=ROWS)


GAINS = 2.0 * np.exp(0.1 * np.random.default_rng(7).normal(size=24))


def record(k: int) -> gb.Experiment:
    time, u, y = simulate(k, GAINS[k])
    return gb.Experiment.from_arrays(time, {"u": u}, {"y": y}, name=f"unit {k}")


def write_record(path: Path, k: int) -> Path:
    np.savetxt(
        path, np.column_stack(simulate(k, GAINS[k])), delimiter=",", header="time [s],u,y", comments="", fmt="%.17g"
    )
    return path


@pytest.fixture(scope="module")
def parquet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All records in one file, a column names them; records lie across row groups."""
    path = tmp_path_factory.mktemp("bench") / "bench.parquet"
    columns = [np.concatenate(parts) for parts in zip(*(simulate(k, g) for k, g in enumerate(GAINS)), strict=True)]
    names = np.repeat([f"unit {k}" for k in range(len(GAINS))], ROWS)
    table = {"serial": names, **dict(zip(("time [s]", "u", "y"), columns, strict=True))}
    pq.write_table(pa.table(table), path, row_group_size=730)
    return path


def values(fleet: gb.fleet.FleetResult) -> list[dict[str, float]]:
    return [{name: e.value for name, e in r.parameters.items()} for r in fleet.records]


@pytest.mark.rest
def test_a_row_is_what_fit_gives_for_the_record_alone(parquet: Path) -> None:
    found = gb.fleet.find_records(parquet, record="serial")
    fleet = gb.fit_each(MODEL, found, noise={"y": NOISE}, workers=1)
    assert [r.name for r in fleet.records] == [f"unit {k}" for k in range(len(GAINS))]
    for k in (0, PILOTS, 17):
        alone = gb.fit(MODEL.start(**fleet.start) if k >= PILOTS else MODEL, record(k), noise={"y": NOISE})
        row = fleet.records[k]
        assert row.parameters == dict(alone.parameters) and row.misfit == dict(alone.misfit)
        assert row.findings == (*alone.findings,) and row.status == alone.status and row.rows == ROWS


def test_intervals_hold_the_true_constants_and_the_spread_is_that_of_the_machines() -> None:
    fleet = gb.fit_each(MODEL, [record(k) for k in range(len(GAINS))], noise={"y": NOISE}, workers=1)
    inside = [
        r.parameters["gain"].interval[0] <= gain <= r.parameters["gain"].interval[1]
        for r, gain in zip(fleet.records, GAINS, strict=True)
    ]
    assert sum(inside) >= 21  # of 24 intervals of 95 % fewer hold the truth once in a hundred times
    gain = fleet.population["gain"]
    assert gain.relative and gain.count == 24
    assert gain.spread == pytest.approx(np.std(np.log(GAINS), ddof=1), rel=0.1)
    assert gain.median == pytest.approx(np.median(GAINS), rel=0.01)
    assert fleet.population["lag"].spread < 0.2 * gain.spread  # all have the same


def test_the_population_is_that_of_another_program() -> None:
    rng = np.random.default_rng(3)
    std = rng.uniform(0.05, 0.3, 40)
    found = rng.normal(-1.0, 0.2, 40) + std * rng.normal(size=40)
    estimates = [Estimate(v, "m", s, (v - 0.1, v + 0.1)) for v, s in zip(found.tolist(), std.tolist(), strict=True)]
    open_ones = [Estimate(9.0, "m"), Estimate(5.0, "m", 1.0, (4.9, 5.1), at_bound=True)]
    population = ConstantDistribution.of([*estimates, *open_ones])
    reference = combine_effects(found, std**2, method_re="iterated", atol=1e-12)
    assert population.spread == pytest.approx(np.sqrt(reference.tau2), rel=1e-4)
    assert not population.relative
    assert (population.count, population.undetermined, population.at_bound) == (40, 1, 1)
    assert (population.low, population.median, population.high) == tuple(np.quantile(found, (0.05, 0.5, 0.95)))


def test_bad_records_are_named_with_their_reasons_and_the_others_are_done(tmp_path: Path) -> None:
    for k in range(8):
        write_record(tmp_path / f"unit {k}.csv", k)
    (tmp_path / "unit 2.csv").write_text("time [s],u,y\n0,1\n")
    (tmp_path / "unit 9.csv").write_text("time [s],u,z\n0,1,2\n1,1,2\n")
    (tmp_path / "unit 10.parquet").write_bytes(b"PAR1 no such file")
    time, u, _ = simulate(3)
    np.savetxt(
        tmp_path / "unit 11.csv", np.c_[time, u, np.full(ROWS, 3.0)], delimiter=",", header="time [s],u,y", comments=""
    )
    fleet = gb.fit_each(MODEL, tmp_path, noise={"y": NOISE}, workers=1)
    assert [r.name for r in fleet.records][-3:] == ["unit 9", "unit 10", "unit 11"]
    reasons = {r.name: r.reason for r in fleet.without_result}
    assert {"unit 2", "unit 9", "unit 10"} <= set(reasons)
    assert "unit 2.csv" in reasons["unit 2"] and "'y'" in reasons["unit 9"] and "Parquet" in reasons["unit 10"]
    good = [r for r in fleet.records if r.name not in {*reasons, "unit 11"}]
    assert len(good) == 7 and all(r.is_usable for r in good)
    said = [f for f in fleet.findings if f.code == FleetCode.RECORD_WITHOUT_RESULT]
    assert {f.subject for f in said} == set(reasons)
    # What the model does not follow is no part of the population.
    assert fleet.population["gain"].count == 7


@pytest.mark.rest
def test_an_interrupted_run_goes_on_from_its_journal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, journal = tmp_path / "bench", tmp_path / "fleet.jsonl"
    folder.mkdir()
    for k in range(12):
        write_record(folder / f"{k}.csv", k)
    whole = gb.fit_each(MODEL, folder, noise={"y": NOISE}, workers=1)
    fitted: list[str] = []
    fit = batch.fit

    def count(model, experiment, **options):
        if len(fitted) == 8:
            raise KeyboardInterrupt
        fitted.append(experiment.name)
        return fit(model, experiment, **options)

    monkeypatch.setattr(batch, "fit", count)
    part = gb.fit_each(MODEL, folder, noise={"y": NOISE}, workers=1, journal=journal)
    assert part.left == 4 and len(part.records) == 8
    assert FleetCode.RECORDS_LEFT in {f.code for f in part.findings}
    again: list[str] = []
    monkeypatch.setattr(
        batch,
        "fit",
        lambda model, experiment, **o: again.append(experiment.name) or fit(model, experiment, **o),
    )
    write_record(folder / "3.csv", 4)  # another record now
    done = gb.fit_each(MODEL, folder, noise={"y": NOISE}, workers=1, journal=journal)
    assert again == ["3", "8", "9", "10", "11"] and done.left == 0
    for k in (0, 7):
        assert values(done)[k] == values(whole)[k]
    assert [r.findings for r in done.records[:3]] == [r.findings for r in whole.records[:3]]
    # Other options, other results: nothing is taken from the journal.
    again.clear()
    gb.fit_each(MODEL, folder, noise={"y": 2 * NOISE}, workers=1, journal=journal)
    assert len(again) == 12


def test_a_record_unlike_the_others_is_fitted_from_the_start_of_the_model(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[float] = []
    fit = batch.fit

    def fail_far_off(model, experiment, **options):
        begun.append(model.values["gain"])
        if experiment.name == "unit 9" and model.values["gain"] != MODEL.values["gain"]:
            raise DataError("not from here")
        return fit(model, experiment, **options)

    monkeypatch.setattr(batch, "fit", fail_far_off)
    fleet = gb.fit_each(MODEL, [record(k) for k in range(10)], noise={"y": NOISE}, workers=1)
    assert begun[:PILOTS] == [1.3] * PILOTS and begun[-1] == 1.3
    assert begun[PILOTS:-1] == [fleet.start["gain"]] * 5
    assert fleet.start["gain"] == np.median([r.parameters["gain"].value for r in fleet.records[:PILOTS]])
    assert fleet.records[9].is_usable


class Deadly(RecordCollection):
    """One of its records ends the process that reads it, but for the one that started it all."""

    def read(self, reference: RecordReference, model: gb.Model) -> gb.Experiment:
        if reference.name == "7" and multiprocessing.parent_process() is not None:
            os._exit(3)
        return super().read(reference, model)


@pytest.mark.slow  # each death costs a pool of processes
@pytest.mark.timeout(600)
def test_a_record_that_ends_its_process_is_named_and_takes_no_other_along(tmp_path: Path) -> None:
    for k in range(40):  # several in a job
        write_record(tmp_path / f"{k}.csv", k % 24)
    found = gb.fleet.find_records(tmp_path)
    fleet = gb.fit_each(MODEL, Deadly(found.references, found.layout), noise={"y": NOISE}, workers=2)
    assert [r.name for r in fleet.without_result] == ["7"]
    assert "its worker process died" in fleet.without_result[0].reason
    alone = gb.fit_each(MODEL, found, noise={"y": NOISE}, workers=1)
    done = [k for k in range(40) if k != 7]
    assert [values(fleet)[k] for k in done] == [values(alone)[k] for k in done]  # two processes give what one gives


def test_parts_of_a_parquet_file_are_those_of_another_reader(parquet: Path) -> None:
    rows = find_record_rows(parquet, "serial")
    table = pq.read_table(parquet)
    assert list(rows) == [f"unit {k}" for k in range(len(GAINS))]
    for name in ("unit 0", "unit 3", "unit 23"):  # 730 rows a group: unit 3 lies in two
        part = open_parquet_part(parquet, rows[name], "serial")
        assert part.table.headers == ("time [s]", "u", "y")
        expected = table.filter(pa.compute.equal(table["serial"], name))
        for k, header in enumerate(part.table.headers):
            assert np.array_equal(part.values([k]).arrays[k], expected[header].to_numpy())


def test_a_parquet_file_that_names_no_records_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bench.parquet"
    for names, message in (
        (
            ["a", "b", "a"],
            "the rows of record 'a' do not stand together (rows 1 and 3); sort the file by 'serial' and time",
        ),
        (["a", None, "b"], "1 rows name no record in column 'serial'"),
    ):
        pq.write_table(pa.table({"serial": names}), path)
        with pytest.raises(DataError, match=re.escape(message)):
            find_record_rows(path, "serial")
    with pytest.raises(DataError, match=r"no column 'serail'.*'serial'"):
        find_record_rows(path, "serail")
    pq.write_table(pa.table({"serial": pa.array([7, 7, 12])}), path)
    assert find_record_rows(path, "serial") == {"7": (0, 2), "12": (2, 3)}


def test_files_of_one_name_get_their_folder_in_front(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_record(tmp_path / folder / "run.csv", 1)
    found = gb.fleet.find_records([tmp_path / "a", tmp_path / "b"])
    assert [r.name for r in found.references] == ["a/run", "b/run"]
    with pytest.raises(DataError, match="in Parquet files only"):
        gb.fleet.find_records(tmp_path / "a", record="serial")


def test_an_option_that_reading_does_not_have_is_refused_before_a_record_is_read(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=r"no option 'holds'; did you mean 'hold'\?"):
        gb.fleet.find_records(tmp_path, holds="first")


def test_the_table_holds_every_number_and_comes_back(tmp_path: Path) -> None:
    time, u, y = simulate(1)
    broken = gb.Experiment.from_arrays(time, {"u": u}, {"z": y}, name="other")
    fleet = gb.fit_each(MODEL, [record(0), broken], noise={"y": NOISE}, workers=1)
    rows = list(csv.DictReader(fleet.save_table(tmp_path / "fleet.csv").read_text().splitlines()))
    estimate = fleet.records[0].parameters["lag"]
    assert float(rows[0]["lag [s]"]) == estimate.value and float(rows[0]["lag_std [s]"]) == estimate.std
    assert (float(rows[0]["lag_low [s]"]), float(rows[0]["lag_high [s]"])) == estimate.interval
    assert float(rows[0]["y_misfit_over_noise"]) == fleet.records[0].misfit["y"].noise_ratio
    assert rows[1]["record"] == "other" and rows[1]["lag [s]"] == "" and "'z'" in rows[1]["reason"]
    table = pq.read_table(fleet.save_table(tmp_path / "fleet.parquet")).to_pydict()
    assert table == fleet.table()
    data = gb.fleet.load_fleet(fleet.save(tmp_path / "fleet.json"))
    assert strict_offences(data, gb.fleet.FleetResult) == [] and data["fitted"] == 1 and data["records"] == 2
    assert data["population"]["lag"]["median"] == estimate.value
    for r in fleet.records:
        assert vars(from_json_data(RecordEstimate, json.loads(json.dumps(to_json_data(r))))) == vars(r)


def test_the_page_and_the_text_say_the_same() -> None:
    records = [record(k) for k in range(8)]
    fleet = gb.fit_each(MODEL, records, noise={"y": NOISE}, workers=1)
    text = str(replace(fleet, left=2))
    assert text.startswith("first_order: 8 of 10 records were fitted")
    assert "2 of 10 records were not begun" in text
    assert str(fleet).startswith("first_order: all 8 records were fitted")
    from greybox.extensions.fleet.document import describe_fleet

    page = describe_fleet(fleet)
    assert page.question == "What are the constants of first_order in each of 8 records?"
    counts = [
        dict(zip(("fitted", "records", "followed"), n, strict=True))
        for n in ((1, 1, 1), (1, 1, 0), (8, 8, 8), (7, 8, 5), (8, 8, 0))
    ]
    assert [str(Finding(FleetCode.RECORDS_FITTED, values=values)) for values in counts] == [
        "the record was fitted",
        "the record was fitted, and the model does not follow it",
        "all 8 records were fitted",
        "7 of 8 records were fitted, and the model follows only 5 of them",
        "all 8 records were fitted, and the model follows none of them",
    ]
    (figure,) = (block.figure for block in page.evidence)
    assert [panel.name for panel in figure.panels] == ["gain", "lag", "misfit of y"]
    assert [panel.series[0].lengths.sum() for panel in figure.panels] == [8, 8, 8]


LAG_FILE = """
from greybox import Balance, Input, Model, Output, Parameter, State
model = Model('lag', [State('y', '1')], [Input('u', '1')], [Output('y', '1')],
    [Parameter('gain', '1', 1.3, (1e-3, 1e3)), Parameter('lag', 's', 0.8, (1e-3, 1e3))],
    lambda x, u, p: [Balance('lag', '1', p.lag, 'y', drive=p.gain * u.u, decay=-x.y)])
"""


def test_a_fleet_that_its_model_does_not_follow_is_no_success(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lag.py").write_text(LAG_FILE)
    for k in range(2):
        write_record(tmp_path / f"{k}.csv", k)
    done = CliRunner().invoke(app, ["fleet", "lag.py", "0.csv", "1.csv", "--fix", "gain=1000", "--no-report"])
    assert done.exit_code == 1
    assert "all 2 records were fitted, and the model follows none of them" in " ".join(done.output.split())


def test_the_command_writes_table_summary_and_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lag.py").write_text(LAG_FILE)
    (tmp_path / "bench").mkdir()
    for k in range(6):
        write_record(tmp_path / "bench" / f"{k}.csv", k)
    words = ["fleet", "lag.py", "bench", "--noise", "y=0.01", "--workers", "1"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    out = tmp_path / "results" / "lag-fleet"
    assert sorted(p.name for p in out.iterdir()) == ["fleet.csv", "fleet.json", "fleet.parquet", "report.html"]
    (tmp_path / "bench" / "6.csv").write_text("nothing")
    done = CliRunner().invoke(app, [*words, "--json", "--no-report", "--fix", "lag=0.5"])
    assert done.exit_code == 1
    data = json.loads(done.stdout)
    assert data["fitted"] == 6 and list(data["without_result"]) == ["6"] and set(data["population"]) == {"gain"}
    done = CliRunner().invoke(app, ["fleet", "lag.py", "bench/6.csv"])
    assert done.exit_code == 2 and "none of 1 records has a result; 6: " in done.output


class ProcessEnds(BaseException):
    """What nothing catches, as a process that is killed leaves nothing behind."""


@pytest.mark.rest
@pytest.mark.parametrize(
    "place",
    [
        pytest.param(0, marks=pytest.mark.slow, id="the first"),
        pytest.param(3, marks=pytest.mark.slow, id="among the first five"),
        pytest.param(6, id="in a small fleet"),
    ],
)
def test_a_record_that_ended_the_process_is_tried_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: int
) -> None:
    folder, journal = tmp_path / "bench", tmp_path / "fleet.jsonl"
    folder.mkdir()
    for k in range(7):
        write_record(folder / f"{k}.csv", k)
    fit, here = batch.fit, list[str]()

    def end(model, experiment, **options):
        if experiment.name == str(place):
            raise ProcessEnds
        return fit(model, experiment, **options)

    monkeypatch.setattr(batch, "fit", end)
    with pytest.raises(ProcessEnds):
        gb.fit_each(MODEL, folder, noise={"y": NOISE}, workers=1, journal=journal)
    monkeypatch.setattr(
        batch, "fit", lambda model, experiment, **o: here.append(experiment.name) or fit(model, experiment, **o)
    )
    done = gb.fit_each(MODEL, folder, noise={"y": NOISE}, workers=1, journal=journal)
    assert str(place) not in here and len(here) == 6 - place if place < 6 else not here
    assert [r.name for r in done.records] == list("0123456") and all(r.success for r in done.records)


def test_names_of_records_are_no_formulas_in_the_table(tmp_path: Path) -> None:
    names = ["=1+1", "+cmd|' /C calc'!A0", "@SUM(1)", "-2", "\t=1", "a\rb", "\uff1d1", "\u200b=1", "plain"]
    fleet = gb.fit_each(
        MODEL, [replace(record(k), name=name) for k, name in enumerate(names)], noise={"y": NOISE}, workers=1
    )
    with open(fleet.save_table(tmp_path / "fleet.csv"), newline="", encoding="utf-8") as file:
        _, *rows = csv.reader(file)
    cells = [row[0] for row in rows]
    assert len(cells) == len(names) and cells[-1] == "plain"
    assert not [cell for cell in cells if cell.strip()[:1] in tuple("=+-@\uff1d")]
    assert all(cell.isprintable() for row in rows for cell in row)


class Abrupt:
    """A decay whose compiled code ends the process for a record that begins above 5."""

    name = "abrupt"
    inputs = ()
    outputs = (gb.Output("y", "V"),)
    parameters = (gb.Parameter("rate", "1/s", 1.0, (0.01, 100.0)),)
    is_native = True

    def simulate(self, record: gb.Experiment, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        first = record.outputs["y"][0]
        if first > 5:
            os.abort()
        return {"y": first * np.exp(-values["rate"] * record.time)}


@pytest.mark.rest
@pytest.mark.skipif(sys.platform == "win32", reason="aborts differ")
@pytest.mark.parametrize("bad", [2, *(pytest.param(k, marks=pytest.mark.slow) for k in (0, 3))])
def test_a_record_that_ends_its_process_is_named_at_the_first_attempt(bad: int) -> None:
    time = np.linspace(0.0, 3.0, 31)
    rng = np.random.default_rng(bad)
    records = [
        gb.Experiment(
            f"r{k}", time, {}, {"y": (9.0 if k == bad else 1.0) * np.exp(-2 * time) + 0.001 * rng.normal(size=31)}
        )
        for k in range(4)
    ]
    fleet = gb.fit_each(Abrupt(), records, noise={"y": 0.001})
    assert [r.name for r in fleet.records if not r.is_usable] == [f"r{bad}"]
    assert all(r.parameters["rate"].value == pytest.approx(2.0, rel=0.01) for r in fleet.records if r.is_usable)


@pytest.mark.parametrize("copy", ["whole", "shifted clock", "other name and source"])
def test_one_measurement_that_is_in_a_fleet_twice_is_named(copy: str) -> None:
    rng, time = np.random.default_rng(5), 0.1 * np.arange(120)
    u = np.repeat(rng.integers(0, 2, 12), 10).astype(float)
    run = lfilter([0.0, 1 - np.exp(-0.2)], [1.0, -np.exp(-0.2)], u)
    model = first_order()
    (i,), (o,) = [s.name for s in model.inputs], [s.name for s in model.outputs]
    records = [
        gb.Experiment(f"r{k}", time, {i: u}, {o: run + 0.02 * rng.normal(size=120)}, source=f"r{k}.csv")
        for k in range(6)
    ]
    assert not [f for f in gb.fit_each(model, records).findings if f.code is FleetCode.RECORDS_ALIKE]
    twin = gb.Experiment(
        "twin", time + (50.0 if copy == "shifted clock" else 0.0), records[3].inputs, records[3].outputs
    )
    twin = replace(twin, source="day2.csv") if copy == "other name and source" else twin
    (finding,) = [f for f in gb.fit_each(model, [*records, twin]).findings if f.code is FleetCode.RECORDS_ALIKE]
    assert (finding.values["first"], finding.subject) == ("r3", "twin")
    assert "counts it twice" in str(finding)


@pytest.mark.crossed(3)
@pytest.mark.parametrize("told", [{}, {"hold": "zero"}, {"interpolation": {"u": "zero"}}])
def test_an_input_moves_in_one_way_in_all_files_of_a_fleet(tmp_path: Path, told: dict) -> None:
    """Every other record is too short and noisy for its rows to show what the others show."""
    for k in range(6):
        rng, time = np.random.default_rng(k), 0.05 * np.arange(80 if k % 2 else 400)
        u, answer = np.sin(1.1 * time), 2 * np.sin(1.1 * time - np.arctan(0.55)) / np.hypot(1, 0.55)
        columns = (time, u + (0.3 if k % 2 else 0.02) * rng.normal(size=len(time)), answer)
        np.savetxt(
            tmp_path / f"{k}.csv",
            np.column_stack(columns),
            delimiter=",",
            header="time [s],u,y",
            comments="",
            fmt="%.17g",
        )
    files = sorted(tmp_path.glob("*.csv"))
    alone = [gb.read_csv(file, MODEL) for file in files]
    assert {r.courses["u"] for r in alone} == {"first", "zero"}
    fleet = gb.fit_each(MODEL, gb.fleet.find_records(files, **told), journal=tmp_path / "journal")
    expected = [gb.fit(MODEL, r.with_hold("zero" if told else "first")) for r in alone]
    for found, each in zip(fleet.records, expected, strict=True):
        assert found.parameters["lag"].value == pytest.approx(each.parameters["lag"].value, rel=1e-3)
        assert ("input_course_shared" in {f.code for f in found.findings}) == (not told)
