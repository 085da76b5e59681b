"""Experiment: what it refuses, what it keeps, when time counts as uniform."""

import copy
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from greybox.base.errors import DataError
from greybox.comparison.blackbox import arx
from greybox.data.experiment import Experiment, collect_record_findings, number_unnamed_records
from greybox.data.findings import RecordCode, is_sensor_fault
from greybox.data.sampling import estimate_time_resolution, find_sampling_time
from greybox.data.sensor_faults import find_change_band

N = 40
TIME = 0.5 * np.arange(N)
DRIVE = np.sin(TIME)
ANSWER = np.cos(TIME)


def make(**changes):
    given = {"time": TIME, "inputs": {"u": DRIVE}, "outputs": {"y": ANSWER}, "name": "run"} | changes
    return Experiment.from_arrays(given.pop("time"), given.pop("inputs"), given.pop("outputs"), **given)


def codes(experiment):
    return [finding.code for finding in experiment.findings]


def test_keeps_the_arrays_as_protected_copies():
    drive = DRIVE.copy()
    experiment = make(inputs={"u": drive})
    drive[0] = 99.0
    assert experiment.inputs["u"][0] == DRIVE[0]
    assert all(a.dtype == np.float64 for a in (experiment.time, experiment.inputs["u"], experiment.outputs["y"]))
    with pytest.raises(ValueError, match="read-only"):
        experiment.outputs["y"][0] = 1.0
    with pytest.raises(TypeError):
        experiment.inputs["w"] = drive
    with pytest.raises(AttributeError):
        experiment.name = "other"


def test_counts_rows_seconds_and_intervals():
    experiment = make()
    assert (experiment.rows, experiment.duration, experiment.sampling_time) == (N, 19.5, 0.5)
    assert experiment.regular
    np.testing.assert_array_equal(experiment.intervals, np.full(N - 1, 0.5))


def test_irregular_time_keeps_every_interval_and_says_so():
    time = np.cumsum(1.0 + 0.5 * np.sin(np.arange(N)))
    experiment = make(time=time)
    assert experiment.sampling_time is None
    assert not experiment.regular
    np.testing.assert_array_equal(experiment.intervals, np.diff(time))
    assert codes(experiment) == [RecordCode.TIME_IRREGULAR]


@pytest.mark.parametrize(("rows", "told"), [(2, True), (9, True), (10, False)])
def test_a_short_record_is_read_and_says_that_it_carries_little(rows, told):
    short = Experiment.from_arrays(TIME[:rows], {"u": DRIVE[:rows]}, {"y": np.arange(float(rows))})
    assert short.rows == rows
    assert [f.values["rows"] for f in short.findings if f.code == RecordCode.FEW_ROWS] == [rows] * told


REFUSED = [
    ({"hold": "cubic"}, "hold 'cubic' is unknown; known: auto, zero, first, band-limited, mean: 'zero' (held)"),
    ({"time": TIME[:1], "inputs": {"u": DRIVE[:1]}, "outputs": {"y": ANSWER[:1]}}, "1 rows; a record needs at least 2"),
    ({"inputs": {"u": DRIVE[1:]}}, "input 'u' has 39 rows, time has 40; each signal needs one value for each time"),
    ({"outputs": {"y": ANSWER[:, None]}}, "output 'y' has shape (40, 1); give one number for each row"),
    ({"outputs": {"y": ANSWER * 1j}}, "output 'y' does not hold real numbers: its type is complex128"),
    ({"outputs": {"y": ["high"] * N}}, "output 'y' does not hold real numbers: its type is <U4"),
    ({"time": TIME[::-1]}, "time goes back at rows 2, 3, 4, 5, 6 and 34 more (19 s after 19.5 s)"),
    ({"time": np.where(np.arange(N) == 7, 3.0, TIME)}, "time is repeated at row 8 (3 s after 3 s); time must increase"),
    ({"time": np.where(np.arange(N) == 7, np.nan, TIME)}, "time is empty or NaN at row 8; every row needs its time"),
    ({"time": np.where(np.arange(N) == N - 1, np.inf, TIME)}, "time is infinite at row 40"),
    (
        {"inputs": {"u": np.where(TIME == 2, np.nan, DRIVE)}},
        "input 'u' is empty or NaN at row 5; an input must be known",
    ),
    ({"inputs": {"u": np.where(TIME == 2, -np.inf, DRIVE)}}, "input 'u' is infinite at row 5; write a finite number"),
    (
        {"outputs": {"y": np.where(TIME == 2, np.inf, ANSWER)}},
        "output 'y' is infinite at row 5; write a finite number, or leave",
    ),
    ({"outputs": {"y": np.full(N, np.nan)}}, "output 'y' holds no value at all; remove it"),
    ({"outputs": {}}, "no output; a record needs at least one measured output"),
    ({"outputs": {"u": ANSWER}}, "'u' is both an input and an output"),
    ({"inputs": {"u": np.zeros(N)}}, "constant input: 'u' is 0 in every row, so the record does not excite the plant"),
    ({"inputs": {"u": np.zeros(N), "w": np.zeros(N)}}, "'u' and 'w' are 0 in every row"),
    ({"inputs": {"u": np.ones(N)}, "outputs": {"y": np.ones(N)}}, "nothing moves: 'u', 'y' are constant"),
    ({"inputs": {}, "outputs": {"y": np.ones(N)}}, "nothing moves: 'y' is constant"),
    ({"outputs": {"y": np.ones(N), "z": np.ones(N)}}, "no output moves: 'y', 'z' are constant over the whole record"),
    ({"conditions": {"T": np.nan}}, "condition 'T' is nan; give a finite number"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSED, ids=[message[:40] for _, message in REFUSED])
def test_refuses_with_one_clear_message(changes, message):
    with pytest.raises(DataError, match=re.escape(message)) as error:
        make(**changes)
    assert str(error.value).startswith("experiment 'run': ")


def test_all_problems_come_in_one_message():
    with pytest.raises(DataError) as error:
        make(
            inputs={"u": np.where(TIME == 2, np.nan, DRIVE)},
            outputs={"y": np.where(TIME == 3, np.inf, ANSWER)},
            time=np.where(np.arange(N) == 9, 0, TIME),
        )
    text = str(error.value)
    assert "3 problems" in text
    for part in ("time goes back at row 10", "input 'u' is empty or NaN at row 5", "output 'y' is infinite at row 7"):
        assert part in text


def test_a_step_from_rest_and_an_allowed_free_decay_are_records_with_a_note():
    for record, name, value in (
        (make(inputs={"u": np.ones(N)}), "u", 1.0),
        (make(inputs={"u": np.zeros(N)}, allow_constant_input=True), "u", 0.0),
        (make(inputs={"u": DRIVE, "w": np.zeros(N)}), "w", 0.0),
    ):
        (finding,) = record.findings
        assert (finding.code, finding.subject, finding.values["value"]) == (RecordCode.INPUT_CONSTANT, name, value)
    assert make(inputs={}).rows == N


def test_nothing_moves_is_refused_even_when_a_constant_input_is_allowed():
    with pytest.raises(DataError, match="nothing moves"):
        make(inputs={"u": np.zeros(N)}, outputs={"y": np.zeros(N)}, allow_constant_input=True)


def test_gaps_of_outputs_stay_and_are_counted():
    answer = ANSWER.copy()
    answer[[3, 17]] = np.nan
    experiment = make(outputs={"y": answer})
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(experiment.outputs["y"])), [3, 17])
    (finding,) = experiment.findings
    assert (finding.code, finding.subject) == (RecordCode.OUTPUT_GAPS, "y")
    assert finding.values == {"gaps": 2, "rows": 40}


@pytest.mark.parametrize("reading", [0.0, 0.731])
def test_a_sensor_that_stands_still_while_the_input_moves_is_named(reading):
    time = 0.01 * np.arange(200)
    answer = np.cos(7 * time) + 1e-3 * np.sin(900 * time)
    answer[60:100] = reading
    drive = {"u": np.sin(5 * time)}
    (finding,) = make(time=time, inputs=drive, outputs={"y": answer}).findings
    assert (finding.code, finding.subject) == (RecordCode.SENSOR_FROZEN, "y")
    assert finding.values == {"value": reading, "rows": 40, "start": time[60], "stop": time[99]}
    assert is_sensor_fault(finding)


def test_a_sensor_that_dies_without_a_jump_is_named_while_the_input_goes_on():
    time = 0.01 * np.arange(200)
    drive, answer = np.sin(5 * time), np.cos(7 * time) + 1e-3 * np.sin(900 * time)
    answer[150:] = answer[149]
    (finding,) = make(time=time, inputs={"u": drive}, outputs={"y": answer}).findings
    assert finding.code == RecordCode.SENSOR_DEAD
    assert finding.values == {"value": answer[149], "start": time[149], "rows": 51}
    silent = np.where(time > 1.4, drive[140], drive)
    assert not make(time=time, inputs={"u": silent}, outputs={"y": answer}).findings
    stopped = np.minimum(np.cos(time / 2 + np.pi), -0.8)  # comes smoothly to the end of its range
    assert np.all(np.diff(stopped[-40:]) == 0)
    assert not make(time=time, inputs={"u": drive}, outputs={"y": stopped}).findings


def test_a_coarse_sensor_an_end_stop_and_a_plant_at_rest_are_no_dead_sensors():
    time = 0.01 * np.arange(200)
    smooth, drive = np.cos(2 * time), np.sin(5 * time)
    resting, silent = smooth.copy(), drive.copy()
    resting[:60], silent[:60] = smooth[60], 0.0
    coarse, stopped = np.round(smooth, 1), np.minimum(smooth, 0.8)
    assert np.diff(np.flatnonzero(np.diff(coarse))).max() >= 10  # it does repeat itself for long
    assert codes(make(time=time, inputs={"u": drive}, outputs={"y": coarse})) == [RecordCode.READING_COARSE]
    assert not make(time=time, inputs={"u": drive}, outputs={"y": stopped}).findings
    assert not make(time=time, inputs={"u": silent}, outputs={"y": resting}).findings


def shaken(rows=400, seed=0):
    """Time, a smooth input, and a smooth answer with white noise: what a sound sensor reads."""
    time = 0.01 * np.arange(rows)
    drive = np.sin(5 * time) + 0.5 * np.sin(31 * time)
    return time, drive, np.cos(5 * time) + 1e-3 * np.random.default_rng(seed).normal(size=rows)


def findings_of(time, drive, answer):
    return make(time=time, inputs={"u": drive}, outputs={"y": answer}).findings


def test_spikes_of_one_row_are_counted_and_placed():
    time, drive, answer = shaken()
    answer[[40, 41 + 100, 300]] += [0.3, -0.2, 0.15]
    (finding,) = findings_of(time, drive, answer)
    assert finding.code == RecordCode.SENSOR_SPIKES
    assert finding.values == {"count": 3, "times": [time[40], time[141], time[300]]}
    spiky = make(time=time, inputs={"u": drive}, outputs={"y": answer})
    assert [f.code for f in collect_record_findings([spiky])] == [RecordCode.SENSOR_SPIKES]
    assert not collect_record_findings([spiky], is_robust=True)


def test_what_the_plant_does_itself_is_no_spike():
    time, drive, answer = shaken()
    assert not findings_of(time, drive, answer)
    stepped = answer + 3.0 * (time > 1.2)  # a level that stays
    assert not findings_of(time, drive, stepped)
    hammer = drive.copy()
    hammer[[60, 200]] += 5.0
    followed = answer.copy()
    followed[[61, 201]] += 0.4  # one row after the input's own pulse
    assert not findings_of(time, hammer, followed)
    assert not findings_of(time, np.where(time < 2, 1.0, -1.0), np.random.default_rng(1).normal(size=len(time)))
    often = answer.copy()
    often[::10] += 0.3  # one row in ten: the noise is such
    assert not findings_of(time, drive, often)
    rings = answer + 0.3 * np.sin(2.6 * np.arange(400)) * (
        np.arange(400) % 200 < 20
    )  # in stretches, by three samples a period
    assert not findings_of(time, drive, rings)


@pytest.mark.parametrize("share", [0.002, 0.01, 0.02, 0.03, 0.05, 0.07])
@pytest.mark.parametrize("steps", [0.0, 2e-3])
def test_wild_readings_are_noticed_up_to_one_in_fifteen(share, steps):
    time, drive, answer = shaken(rows=2000)
    rng = np.random.default_rng(round(1e3 * share))
    wild = rng.choice(2000, round(2000 * share), replace=False)
    answer[wild] += rng.uniform(0.2, 3.0, len(wild)) * rng.choice([-1, 1], len(wild))
    answer = np.round(answer / steps) * steps if steps else answer
    spikes = [f for f in findings_of(time, drive, answer) if f.code == RecordCode.SENSOR_SPIKES]
    assert [f.code for f in spikes] == [RecordCode.SENSOR_SPIKES]
    assert spikes[0].values["count"] == pytest.approx(len(wild), rel=0.35, abs=1)


def test_a_sensor_that_ends_before_the_motion_does_is_named_at_either_end():
    time, drive, answer = shaken()
    clipped = np.clip(answer, -0.8, 0.9)
    upper, lower = findings_of(time, drive, clipped)
    assert upper.code == lower.code == RecordCode.SENSOR_SATURATED
    assert (upper.values["end"], upper.values["value"]) == ("largest", 0.9)
    assert (lower.values["end"], lower.values["value"]) == ("smallest", -0.8)
    (coarse,) = findings_of(time, drive, np.round(clipped, 1))  # a coarse sensor repeats itself anyway
    assert coarse.code == RecordCode.READING_COARSE and coarse.values["step"] == pytest.approx(0.1)


def test_split_covers_every_row_once_and_keeps_the_times():
    experiment = make(conditions={"T": 293.0}, hold="first", source="run.csv")
    first, second = experiment.split(0.7)
    assert (first.rows, second.rows) == (28, 12)
    assert (first.name, second.name) == ("run[0:28]", "run[28:40]")
    np.testing.assert_array_equal(np.concatenate([first.time, second.time]), TIME)
    np.testing.assert_array_equal(np.concatenate([first.outputs["y"], second.outputs["y"]]), ANSWER)
    assert second.time[0] == 14.0
    for part in (first, second):
        assert (part.hold, part.source, dict(part.conditions)) == ("first", "run.csv", {"T": 293.0})
    assert len({experiment.fingerprint, first.fingerprint, second.fingerprint}) == 3


@pytest.mark.parametrize("fraction", [0.0, 1.0, -0.5, 2.0])
def test_split_refuses_a_fraction_that_is_none(fraction):
    with pytest.raises(DataError, match="give a number between 0 and 1"):
        make().split(fraction)


def test_split_and_window_refuse_parts_without_an_interval():
    with pytest.raises(DataError, match=r"splits 40 rows into 1 and 39; each part needs at least 2"):
        make().split(0.02)
    for rows in ((0, 1), (5, 5), (-3, 8), (30, 41), (9, 4)):
        with pytest.raises(DataError, match="does not fit 40 rows"):
            make().window(*rows)


def test_a_window_may_be_short_quiet_or_without_a_measured_output():
    answer = ANSWER.copy()
    answer[:5] = np.nan
    part = make(outputs={"y": answer}, inputs={"u": np.maximum(TIME - 10, 0)}).window(0, 4)
    assert part.rows == 4
    assert np.isnan(part.outputs["y"]).all()


def test_a_part_of_a_regular_record_has_the_step_of_the_whole():
    time = np.round(np.arange(1000) * 0.0016384, 5)
    experiment = make(time=time, inputs={"u": np.sin(time)}, outputs={"y": np.cos(time)})
    assert experiment.regular
    assert experiment.window(3, 8).sampling_time == experiment.sampling_time
    assert find_sampling_time(time[3:8]) != experiment.sampling_time  # the part alone would find another
    assert experiment.with_hold("first").sampling_time == experiment.sampling_time


def test_a_regular_part_of_an_irregular_record_is_regular():
    time = np.append(TIME, [30.0, 30.5])
    experiment = make(time=time, inputs={"u": np.sin(time)}, outputs={"y": np.cos(time)})
    assert not experiment.regular
    assert experiment.window(0, N).sampling_time == 0.5


def test_with_hold_changes_the_hold_alone():
    experiment = make()
    linear = experiment.with_hold("first")
    assert (experiment.hold, linear.hold) == ("zero", "first")
    assert linear.fingerprint == experiment.fingerprint
    with pytest.raises(DataError, match="hold 'second' is unknown"):
        experiment.with_hold("second")


def test_fingerprint_follows_the_data_and_nothing_else():
    inputs, shuffled = {"u": DRIVE, "w": 2 * DRIVE}, {"w": 2 * DRIVE, "u": DRIVE}
    base = make(inputs=inputs)
    assert re.fullmatch("[0-9a-f]{16}", base.fingerprint)
    assert make(inputs=shuffled, name="other", hold="first").fingerprint == base.fingerprint
    assert make(inputs={"w": DRIVE, "u": 2 * DRIVE}).fingerprint != base.fingerprint
    answer = ANSWER.copy()
    answer[3] = np.nextafter(answer[3], 2)
    assert make(inputs=inputs, outputs={"y": answer}).fingerprint != base.fingerprint
    negative_zero, other_nan = ANSWER.copy(), ANSWER.copy()
    negative_zero[3], other_nan[3] = -0.0, -np.nan
    zero, nan = ANSWER.copy(), ANSWER.copy()
    zero[3], nan[3] = 0.0, np.nan
    assert make(outputs={"y": negative_zero}).fingerprint == make(outputs={"y": zero}).fingerprint
    assert make(outputs={"y": other_nan}).fingerprint == make(outputs={"y": nan}).fingerprint


@pytest.mark.parametrize("again", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))], ids=["copy", "pickle"])
def test_survives_copying_and_pickling(again):
    part = make(conditions={"T": 293.0}, hold="first", source="run.csv").window(3, 20)
    other = again(part)
    assert (other.fingerprint, other.sampling_time, str(other)) == (part.fingerprint, part.sampling_time, str(part))
    assert not other.inputs["u"].flags.writeable
    assert dict(other.conditions) == {"T": 293.0}


# --- when time is uniform


def test_time_printed_with_nine_digits_is_uniform():
    time = np.array([float(f"{t:.9g}") for t in np.arange(65_062) * 0.0016384])
    assert find_sampling_time(time) == pytest.approx(0.0016384, rel=1e-8)
    time = np.array([0, 0.00100000802, 0.00200001604, 0.00300000201, 0.00400001])
    assert find_sampling_time(time) == pytest.approx(0.001, rel=1e-4)


def test_time_rounded_to_a_printed_place_below_a_tenth_of_the_step_is_uniform():
    time = np.round(np.arange(500) * 0.0123, 3)  # steps of 0.012 and 0.013 s
    assert np.ptp(np.diff(time)) > 0.07 * 0.0123
    assert find_sampling_time(time) == pytest.approx(0.0123, rel=1e-3)


@pytest.mark.parametrize(("seconds", "step"), [(60.0, 0.02), (3600.0, 10.0)], ids=["minutes", "hours"])
def test_time_printed_in_minutes_or_hours_is_uniform(seconds, step):
    time = seconds * np.array([float(f"{t:.6g}") for t in np.arange(3000) * step / seconds])
    assert np.abs(np.diff(time) / step - 1).max() > 0.001
    assert find_sampling_time(time) == pytest.approx(step, rel=1e-4)


def test_the_same_deviation_without_the_excuse_of_printing_is_irregular():
    grid = np.arange(500) * 0.0123
    time = grid + np.random.default_rng(1).uniform(-5e-4, 5e-4, 500)
    assert np.abs(time - grid).max() < 0.1 * 0.0123
    assert find_sampling_time(time) is None


def test_time_in_single_precision_is_uniform():
    time = np.float32(np.arange(100_000) * 1e-3).astype(float)
    assert np.abs(np.diff(time) / 1e-3 - 1).max() > 1e-3
    assert find_sampling_time(time) == pytest.approx(1e-3, rel=1e-6)


def test_time_printed_to_nearly_half_a_step_is_uniform_and_noted():
    time = np.array([float(f"{t:.4f}") for t in np.arange(2000) * 2.5e-4])  # 4 kHz: steps of 0.2 and 0.3 ms
    assert find_sampling_time(time) == pytest.approx(2.5e-4, rel=1e-5)
    experiment = make(time=time, inputs={"u": np.sin(time)}, outputs={"y": np.cos(time)})
    assert experiment.regular
    (finding,) = experiment.findings
    assert finding.code == RecordCode.TIME_ROUNDED
    assert finding.values["shortest"] == pytest.approx(2e-4) and finding.values["longest"] == pytest.approx(3e-4)
    for row in (1, 7, 1000, 1998):
        assert find_sampling_time(np.delete(time, row)) is None


@pytest.mark.crossed(3)
@pytest.mark.parametrize("step", [2.23, 2.5, 3.7, 7.3])
@pytest.mark.parametrize("rows", [10, 11, 40])
def test_a_missing_row_never_hides_behind_rounding(step, rows):
    for offset in np.linspace(0, 1, 12):
        time = np.round((np.arange(rows) + offset) * step)
        assert all(find_sampling_time(np.delete(time, k)) is None for k in range(1, rows - 1))


def test_rounding_as_coarse_as_the_step_is_irregular():
    assert find_sampling_time(np.round(np.arange(100) * 0.12, 1)) is None


def test_a_gap_in_time_is_found_with_its_place():
    time = np.where(np.arange(N) > 20, TIME + 30, TIME)
    (finding,) = make(time=time).findings
    assert finding.code == RecordCode.TIME_GAP
    assert finding.values == {"gaps": 1, "start": 10.0, "stop": 40.5, "usual_step": 0.5}
    late = 0.5 * np.arange(100) + 30 * (np.arange(100) > 20) + 5 * (np.arange(100) > 60)
    (finding,) = make(time=late, inputs={"u": np.sin(late)}, outputs={"y": np.cos(late)}).findings
    assert finding.values == {"gaps": 2, "start": 10.0, "stop": 40.5, "usual_step": 0.5}


def room(seed=0):
    """Seconds of a day, and a temperature that is felt with little noise."""
    time = np.arange(0.0, 86400.0, 20.0)
    swing = 4 * np.sin(2 * np.pi * time / 86400) + 1.5 * np.sin(2 * np.pi * time / 20000)
    return time, 20 + swing + 0.02 * np.random.default_rng(seed).normal(size=len(time))


def send(felt, step, band):
    """Rows at which a reading in steps is sent because it has changed by ``band``, and these readings."""
    rows, read = [0], [np.round(felt[0] / step) * step]
    for k, value in enumerate(np.round(felt / step) * step):
        if abs(value - read[-1]) > 0.999 * band:
            rows.append(k)
            read.append(value)
    return np.array(rows), np.array(read)


@pytest.mark.parametrize(
    ("step", "band", "held"), [(0.5, 0.5, False), (0.25, 0.25, False), (0.01, 0.2, True), (1e-9, 0.4, True)]
)
def test_readings_that_are_sent_on_change_are_off_by_about_half_a_step(step, band, held):
    time, felt = room()
    rows, read = send(felt, step, band)
    true = felt[rows]
    stamps = time[rows]
    if held:
        read, true, stamps = read[np.searchsorted(rows, np.arange(len(time)), side="right") - 1], felt, time
    sent = find_change_band(stamps, read)
    assert sent is not None and sent.is_held == held and sent.band == pytest.approx(band, rel=0.06)
    assert sent.std == pytest.approx(np.sqrt(np.mean((read - true) ** 2)), rel=0.25)
    record = make(time=stamps, inputs={"u": np.sin(stamps / 1e3)}, outputs={"y": read})
    (finding,) = [f for f in record.findings if f.code == RecordCode.SENT_ON_CHANGE]
    assert finding.values["held"] == held


def test_other_coarse_readings_are_not_sent_on_change():
    rng = np.random.default_rng(2)
    time, felt = room()
    late = np.sort(rng.choice(time, 1500, replace=False))
    encoder = np.round(np.abs(((np.arange(2000) * 0.37) % 400) - 200))
    for stamps, read in (
        (time, np.round(felt, 1)),
        (late, np.round(np.interp(late, time, felt), 1)),
        (time, np.where(rng.random(len(time)) > 0.5, 1.0, 0.0)),
        (time, 1e-3 * time),
        (0.01 * np.arange(2000), encoder),
        (0.01 * np.arange(2000) + rng.uniform(0, 0.009, 2000), encoder),
    ):
        assert find_change_band(stamps, read) is None


def test_a_gap_is_told_where_an_input_moved_in_it_and_splitting_where_pieces_would_hold_something():
    time = np.array([0, 1, 2, 2.5, 3, 4, 7]) * 3600
    table = {"x": np.exp(-time / 7200)}
    few = [f for f in make(time=time, inputs={}, outputs=table).findings if f.code != RecordCode.FEW_ROWS]
    assert [f.code for f in few] == [RecordCode.TIME_IRREGULAR]
    (_, _, resting) = make(time=time, inputs={"u": np.ones(7)}, outputs=table).findings
    assert resting.code == RecordCode.TIME_IRREGULAR
    (_, driven) = make(time=time, inputs={"u": np.sin(time)}, outputs=table).findings
    assert driven.code == RecordCode.INPUT_HELD_THROUGH_GAP


def test_lost_rows_are_counted_where_the_others_keep_the_pace():
    time, drive, answer = shaken()
    kept = np.setdiff1d(np.arange(400), np.arange(7, 390, 10))
    (finding,) = findings_of(time[kept], drive[kept], answer[kept])
    assert finding.code == RecordCode.TIME_ROWS_MISSING
    assert (finding.values["rows"], finding.values["places"]) == (39, 39)


def test_a_finding_of_several_records_names_them_all_once():
    first, second = make(inputs={"u": np.ones(N)}, name="a"), make(inputs={"u": np.ones(N)}, source="b.csv")
    other = make(name="c", outputs={"y": np.where(TIME == 2, np.nan, ANSWER)})
    constant, gaps = collect_record_findings([first, second, other])
    assert constant.values["records"] == ["a", "b.csv"]
    assert (gaps.code, gaps.values["records"]) == (RecordCode.OUTPUT_GAPS, ["c"])


def test_a_drifting_clock_is_irregular():
    steps = 1e-3 * (1 + 5e-4 * np.sin(np.arange(20_000) / 3000))  # every step within 0.1 %, the sum is not
    time = np.append(0, np.cumsum(steps))
    assert np.abs(steps / steps.mean() - 1).max() < 1e-3
    assert find_sampling_time(time) is None


@settings(max_examples=60, deadline=None)
@given(
    st.integers(10, 5000),
    st.floats(1e-6, 1e3),
    st.floats(-1e3, 1e3),
    st.floats(0.01, 0.99),
    st.booleans(),
    st.integers(1, 5),
)
def test_uniform_whatever_the_step_and_start_but_never_with_a_missing_row(rows, step, start, place, shift, missing):
    time = start * step + step * np.arange(rows + missing)
    assert find_sampling_time(time) == pytest.approx(step, rel=1e-6)
    gap = 1 + int(place * (rows - 2))
    assert find_sampling_time(np.delete(time, np.arange(gap, gap + missing))) is None


def test_resolution_is_the_printed_place_of_the_decade():
    time = np.array([0.5, 0.501, 0.25, 1.25, 2.5, 100.0, 250.0])
    np.testing.assert_allclose(estimate_time_resolution(time), [1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1.0, 1.0])
    assert estimate_time_resolution(np.array([0.1 + 1e-15, np.pi / 10])).max() < 1e-12


def test_a_record_made_of_another_shares_its_arrays():
    record = Experiment("run", np.arange(20.0), {"u": np.sin(np.arange(20.0))}, {"y": np.cos(np.arange(20.0))})
    again = replace(record, name="again")
    assert again.time is record.time and again.inputs["u"] is record.inputs["u"]
    measured = np.arange(20.0)
    own = Experiment("run", measured, {}, {"y": measured})
    measured[3] = 100.0
    assert own.time[3] == 3.0


def test_records_that_nobody_named_are_numbered_in_their_order():
    columns = TIME, {"u": DRIVE}, {"y": ANSWER}
    first, last = Experiment.from_arrays(*columns), Experiment.from_arrays(*columns)
    steps = Experiment.from_arrays(*columns, name="steps")
    numbered = number_unnamed_records([first, steps, last])
    assert [record.name for record in numbered] == ["record 1", "steps", "record 3"]
    assert numbered[0].time is first.time and numbered[0].fingerprint == first.fingerprint
    assert numbered[0].findings == first.findings and numbered[1] is steps


def smooth(time):
    return np.sin(3 * time) + 0.4 * np.cos(11 * time)


def jittered(seed=0):
    """Regular times (400,) and the same with an error of 1 ms each."""
    time = 0.01 * np.arange(400)
    return time, time + np.clip(1e-3 * np.random.default_rng(seed).normal(size=400), -0.004, 0.004)


def told_by(time, values):
    return {f.code: f for f in findings_of(time, np.cos(time), values)}


@pytest.mark.parametrize("noise", [1e-4, 3e-3])
def test_stamps_that_jitter_are_told_from_a_sampling_that_does(noise):
    regular, stamps = jittered()
    error = noise * np.random.default_rng(1).normal(size=400)
    of_stamps = told_by(stamps, smooth(regular) + error)
    assert of_stamps[RecordCode.TIME_JITTER].values["jitter"] == pytest.approx(np.std(stamps - regular), rel=0.02)
    of_sampling = told_by(stamps, smooth(stamps) + error)
    assert RecordCode.TIME_JITTER not in of_sampling and RecordCode.TIME_IRREGULAR in of_sampling


def test_readings_that_hardly_move_say_nothing_of_the_stamps():
    _, stamps = jittered()
    assert RecordCode.TIME_IRREGULAR in told_by(
        stamps, 1e-3 * smooth(stamps) + np.random.default_rng(1).normal(size=400)
    )


def test_a_reading_in_steps_says_how_large_they_are():
    time = 0.01 * np.arange(500)
    values = 2e-3 * np.random.default_rng(2).normal(size=500) + 0.3 * np.sin(2 * time)
    rounded = told_by(time, 0.0175 * np.round(values / 0.0175) + 0.003)
    assert rounded[RecordCode.READING_COARSE].values["step"] == pytest.approx(0.0175)
    assert RecordCode.READING_COARSE not in told_by(time, values)
    # Printed with four digits, and held for five rows: that repeats, and is not coarse.
    assert RecordCode.READING_COARSE not in told_by(time, np.repeat(np.round(values[::5], 4), 5))


def test_a_data_frame_is_no_record_and_is_told_how_to_become_one() -> None:
    frame = pytest.importorskip("pandas").DataFrame({"time [s]": [0.0, 0.1], "u": [0.0, 1.0], "x": [0.0, 0.1]})
    for records in (frame, [frame]):
        with pytest.raises(DataError, match=r"gb\.read_csv\(table, model\)"):
            arx(records, na=1, nb=1, output="x")


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("step", [0.0, 0.01])
@pytest.mark.parametrize("every", [5, 20, 60])
def test_the_corner_of_a_curve_is_no_spike(every, step, noise):
    """A heater is switched off: the temperature turns within one row, and lies on the lines before and behind it."""
    time = np.arange(0.0, 3600.0, every)
    power = (time >= 600) & (time < 3000)
    warm, cool = 1 - np.exp(-(time - 600) / 3000), np.exp(-(time - 3000) / 3000) * (1 - np.exp(-0.8))
    curve = 50 * np.where(time < 600, 0.0, np.where(time < 3000, warm, cool))
    curve += np.random.default_rng(4).normal(0, noise, len(time))
    curve = np.round(curve / step) * step if step else curve
    assert RecordCode.SENSOR_SPIKES not in {f.code for f in findings_of(time, power * 1.0, curve)}
    curve[300 // every] += 3.0
    curve[2000 // every] -= 2.0
    (spikes,) = (f for f in findings_of(time, power * 1.0, curve) if f.code == RecordCode.SENSOR_SPIKES)
    assert spikes.values["count"] == 2


@pytest.mark.parametrize("code", [-999.0, 9999.0, -99.9, 65535.0, 1e30, 9.96921e36])
@pytest.mark.parametrize("where", [[40, 41, 42, 150, 151], [3, 200]])
def test_a_value_far_from_all_others_that_repeats_stands_for_no_reading(code, where):
    time, drive, answer = shaken()
    for name, signals in (("y", (drive, answer.copy())), ("u", (drive.copy(), answer))):
        signals[name == "y"][where] = code
        found = [f for f in findings_of(time, *signals) if f.code == RecordCode.CODE_FOR_MISSING]
        assert [(f.subject, f.values["value"], f.values["rows"], f.values["start"]) for f in found] == [
            (name, code, len(where), time[where[0]])
        ]


def test_pulses_and_large_motion_are_no_codes():
    time, drive, answer = shaken()
    hammer = np.where(np.isin(np.arange(len(time)), [60, 61, 200]), 500.0, 0.0)
    far = answer + 100.0 * (time > 3.0)  # half of the record somewhere else
    for signals in ((hammer, answer), (drive, far), (drive, np.maximum(answer, 0.0)), (np.sign(drive), answer)):
        assert RecordCode.CODE_FOR_MISSING not in {f.code for f in findings_of(time, *signals)}
