"""Gaps in the time of a record: where the input is unknown a record is two records, and a fit says so."""

import re

import numpy as np
import pytest

from greybox import Experiment, FitOptions, fit
from greybox.base.errors import DataError
from greybox.data.experiment import refuse_unknown_input
from greybox.data.findings import RecordCode, is_sensor_fault
from greybox.data.read import read_experiments
from greybox.simulation.simulate import write_csv
from models.micro_actuator import micro_actuator
from tests.oracles.independent import linear_record

PERIOD = 2.5e-4
PLANT = micro_actuator.fix("M", "Ra")


def driven(rows=2000, seed=0):
    """Four kilohertz, a held random level every millisecond, discretised by scipy, no noise."""
    levels = np.random.default_rng(seed).choice([-2.0, 2.0], rows // 4)
    return linear_record(micro_actuator, np.repeat(levels, 4), PERIOD)


def without(record, *gone):
    """``record`` without the rows of the slices ``gone``, as a logger would have left it."""
    kept = np.setdiff1d(np.arange(record.rows), np.r_[gone])
    signals = [{name: values[kept] for name, values in group.items()} for group in (record.inputs, record.outputs)]
    return Experiment.from_arrays(record.time[kept], *signals, name="run", source="run.csv")


def test_a_record_is_cut_at_its_gaps_and_short_pieces_are_named():
    whole = driven()
    torn = without(whole, slice(800, 1200), slice(1204, 1210))
    first, second = torn.split_at_time_gaps()
    assert (first.rows, second.rows) == (800, 790)
    np.testing.assert_array_equal(second.outputs["x"], whole.outputs["x"][1210:])
    np.testing.assert_array_equal(second.time, whole.time[1210:])
    assert first.sampling_time == second.sampling_time == pytest.approx(PERIOD, rel=1e-12)
    assert first.findings == second.findings
    (finding,) = first.findings
    assert finding.code == RecordCode.PIECES_LEFT_OUT
    assert finding.values["pieces"] == [[whole.time[1200], whole.time[1203], 4]]
    assert [part.rows for part in torn.split_at_time_gaps(min_rows=4)] == [800, 4, 790]
    with pytest.raises(
        DataError, match=re.escape("leave 3 pieces: the longest has 800 rows, and a record needs at least 900")
    ):
        torn.split_at_time_gaps(min_rows=900)
    assert whole.split_at_time_gaps() == (whole,)


def test_a_long_gap_of_a_moving_input_is_refused_and_its_pieces_give_the_constants():
    torn = without(driven(), slice(800, 1200))
    with pytest.raises(DataError) as error:
        fit(PLANT, torn)
    for part in ("'run'", "a gap from 0.19975 to 0.3 s", "400 rows are missing", "input 'u'", "--split-holes"):
        assert part in str(error.value)
    result = fit(PLANT, torn.split_at_time_gaps(), noise={"x": 1e-9, "i": 1e-6})
    assert result.success
    for name in PLANT.free_parameters:
        assert result.parameters[name.name].value == pytest.approx(micro_actuator.values[name.name], rel=1e-8)


def test_a_short_gap_a_resting_drive_and_a_slow_input_are_only_noted():
    short = without(driven(), slice(800, 815))
    time = PERIOD * np.arange(2000)
    pause = np.where((time > 0.19) & (time < 0.31), 0.0, driven().inputs["u"])
    slow = np.sin(2 * np.pi * time / 2)
    still, steady = (without(linear_record(micro_actuator, u, PERIOD), slice(800, 1200)) for u in (pause, slow))
    for record in (short, still, steady):
        refuse_unknown_input([record])
        (finding,) = record.findings
        assert finding.code == RecordCode.TIME_GAP
        assert finding.values["start"] == pytest.approx(0.19975)


def test_of_two_inputs_the_one_that_moves_in_the_gap_is_named():
    time = PERIOD * np.arange(2000)
    inputs = {"slow": np.sin(2 * np.pi * time / 2), "fast": driven().inputs["u"]}
    torn = without(Experiment.from_arrays(time, inputs, {"x": np.sin(time)}, name="run"), slice(800, 1200))
    with pytest.raises(DataError, match="input 'fast'"):
        refuse_unknown_input([torn])


def test_a_torn_record_for_validation_is_refused_before_the_fit():
    reports = []
    with pytest.raises(DataError, match="400 rows are missing"):
        fit(PLANT, driven(400), validation=without(driven(), slice(800, 1200)), report=reports.append)
    assert not reports


def test_a_step_that_falls_into_a_gap_is_refused():
    stepped = np.where(np.arange(2000) < 1000, 0.0, 1.0)
    with pytest.raises(DataError, match=r"a gap from 0.22475 to 0.275 s: 200 rows are missing.* changes by 2 times"):
        fit(PLANT, without(linear_record(micro_actuator, stepped, PERIOD), slice(900, 1100)))


def test_a_long_gap_is_refused_of_every_model_that_is_integrated_in_steps():
    pause = np.where(np.arange(2000) // 500 == 1, 0.0, driven().inputs["u"])
    record = without(linear_record(micro_actuator, pause, PERIOD), slice(600, 900))
    assert fit(PLANT, record, noise={"x": 1e-9, "i": 1e-6}).success  # the exact hold goes through the pause
    with pytest.raises(
        DataError, match=re.escape("a gap from 0.14975 to 0.225 s: 300 rows are missing, and a model that is")
    ):
        fit(PLANT, record, options=FitOptions(method="rk4"))


def test_a_sensor_in_doubt_is_the_first_thing_that_a_fit_says():
    record = driven(400)
    frozen = {name: values.copy() for name, values in record.outputs.items()}
    frozen["x"][300:] = frozen["x"][299]
    doubted = Experiment.from_arrays(record.time, record.inputs, frozen, name="run")
    (fault,) = filter(is_sensor_fault, doubted.findings)
    assert (fault.code, fault.subject) == (RecordCode.SENSOR_DEAD, "x")
    result = fit(PLANT, doubted, noise={"x": 2e-7, "i": 5e-3})
    assert result.notes[0] == f"run: {fault}"
    assert len(result.notes) > 1


@pytest.fixture
def torn(tmp_path):
    path = tmp_path / "run.csv"
    write_csv(without(driven(600), slice(200, 330)), micro_actuator, path)
    return path


@pytest.mark.parametrize("command", ["fit", "check", "discover", "compare"])
def test_every_command_refuses_the_guess_and_writes_nothing(run, torn, tmp_path, command):
    judges = ["--validate", torn] if command == "discover" else []
    result = run(command, "micro_actuator", torn, *judges, "--fix", "Ra=8")
    assert result.exit_code == 2
    assert "a gap from 0.04975 to 0.0825 s: 130 rows are missing" in result.stderr
    assert not (tmp_path / "results").exists()


def test_a_check_says_of_a_hole_what_a_fit_will_say(run, tmp_path):
    """A linear model with a slow input runs through it; a fit of another one, or of a livelier record, will not."""
    slow = linear_record(micro_actuator, np.sin(np.pi * PERIOD * np.arange(2000)), PERIOD)
    for rows, is_long in ((130, True), (10, False)):
        write_csv(without(slow, slice(800, 800 + rows)), micro_actuator, tmp_path / "run.csv")
        for words in (["run.csv"], ["micro_actuator", "run.csv", "--fix", "Ra=8", "--no-report"]):
            text = re.sub(r"\s+", " ", run("check", *words).stdout)
            assert "time has a gap from 0.19975" in text and "--split-holes" in text
            assert ("with its 130 missing rows it is refused" in text) == is_long


def test_the_option_splits_and_says_so(run, torn):
    result = run(
        "check", "micro_actuator", torn, "--fix", "Ra=8", "--split-holes", "--at-rest", "--no-report", "--details"
    )
    assert result.exit_code == 0
    assert "run[0:200]: 200 rows every 0.00025 s" in result.stdout and "run[200:470]: 270 rows" in result.stdout
    assert "2 records" in result.stderr and "--at-rest" in result.stderr


def test_runs_in_one_file_are_read_apart_where_time_starts_anew(run, tmp_path):
    first, second = driven(200), driven(300, seed=1)
    for record, name in ((first, "a.csv"), (second, "b.csv")):
        write_csv(record, micro_actuator, tmp_path / name)
    rows = (tmp_path / "a.csv").read_text() + (tmp_path / "b.csv").read_text().partition("\n")[2]
    (tmp_path / "both.csv").write_text(rows)
    with pytest.raises(DataError, match=r"time goes back at line 202 .* split there \(shell: --split-holes\)"):
        read_experiments(tmp_path / "both.csv", micro_actuator)
    one, two = read_experiments(tmp_path / "both.csv", micro_actuator, split=True)
    assert (one.name, two.name) == ("both[0:200]", "both[200:500]")
    assert (one.fingerprint, two.fingerprint) == tuple(
        read_experiments(tmp_path / name, micro_actuator)[0].fingerprint for name in ("a.csv", "b.csv")
    )
    assert one.findings == two.findings
    assert [(f.code, dict(f.values)) for f in one.findings] == [(RecordCode.ONE_OF_RUNS, {"runs": 2})]
    (tmp_path / "both.csv").write_text(rows.replace("\n0.01,", "\nten,"))
    with pytest.raises(DataError, match=r"lines 42, 242: 'ten', 'ten' are not numbers"):
        read_experiments(tmp_path / "both.csv", micro_actuator, split=True)
    (tmp_path / "both.csv").write_text(rows.replace("\n0.0125,", "\n0.01225,"))
    with pytest.raises(DataError, match=r"(?s)time is repeated at line 52.*time is repeated at line 252"):
        read_experiments(tmp_path / "both.csv", micro_actuator, split=True)
    (tmp_path / "both.csv").write_text(rows)
    checked = run("check", "micro_actuator", "both.csv", "--fix", "Ra=8", "--split-holes", "--no-report", "--details")
    assert checked.exit_code == 0 and "both[200:500]: 300 rows" in checked.stdout and "no effect" not in checked.stderr


def test_without_a_gap_the_option_is_idle_and_a_simulation_goes_on_through_one(run, torn, tmp_path):
    write_csv(driven(100), micro_actuator, tmp_path / "whole.csv")
    checked = run("check", "micro_actuator", "whole.csv", "--fix", "Ra=8", "--split-holes", "--no-report")
    assert "--split-holes has no effect: time has no gap" in checked.stderr
    simulated = run("simulate", "micro_actuator", torn, "--output", "again.csv", "--no-report")
    assert simulated.exit_code == 0
    assert "run.csv: time has a gap from 0.04975 to 0.0825 s" in simulated.stderr
