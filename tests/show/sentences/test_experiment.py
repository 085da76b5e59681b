"""One golden text for each template of a record."""

import numpy as np
import pytest

from greybox.base.values import Finding
from greybox.data.experiment import Experiment
from greybox.data.findings import RecordCode
from greybox.data.survey import FileSurvey, SignalSurvey
from greybox.show import text
from greybox.show.sentences import sentence

GAP = {"gaps": 2, "start": 10.0, "stop": 40.5, "usual_step": 0.5}
GOLDEN = {
    RecordCode.NO_TIME: (
        "",
        {},
        "no column is called time or t: name it (--column time=HEADER), or give the step (--sampling-time SECONDS)",
    ),
    RecordCode.CODE_FOR_MISSING: (
        "x",
        {"kind": "output", "value": -999.0, "rows": 5, "start": 2.5},
        "output 'x' is exactly -999 in 5 rows (first at 2.5 s), far from all its other values: if this stands for a missing reading,"
        " leave these fields empty",
    ),
    RecordCode.ROWS_TWICE: (
        "",
        {"rows": 2, "first": "line 7"},
        "2 rows written twice, time and values alike, counted once (first line 7)",
    ),
    RecordCode.POINTS_OPEN: (
        "Druck [mbar]",
        {"text": "1.250"},
        "Druck [mbar]: the points of 1.250 may stand between thousands, which a fit asks",
    ),
    RecordCode.COLUMN_WITH_TEXT: (
        "x [m]",
        {"count": 299, "rows": 300, "reason": "column 'x [m]', row 9: '--' is not a number; leave it empty"},
        "x [m]: 299 of 300 fields are numbers and the others are refused: column 'x [m]', row 9: '--' is not a number; leave it empty",
    ),
    RecordCode.TIME_UNUSABLE: ("u [V]", {"reason": "time is repeated"}, "u [V]: time is repeated"),
    RecordCode.BROUGHT_TO_ONE_TIME: (
        "",
        {
            "base": "u",
            "step": 1e-3,
            "rows": 3500,
            "start": 0.2,
            "stop": 3.7,
            "signals": [["u", "input", 1e-3, "zero"], ["v", "input", 20.0, "first"], ["y", "output", 0.01, "measured"]],
        },
        "signals have stamps of their own; brought to the stamps of 'u' (1000 Hz, 3500 rows from 0.2 to 3.7 s): 'v' (every 20 s)"
        " straight, 'y' (100 Hz) at the nearest rows",
    ),
    RecordCode.CLOCK_OFFSET: (
        "Laser",
        {
            "reference": "DAQ",
            "signal": "sync",
            "offset": 0.2373,
            "std": 1.2e-6,
            "drift": 2e-5,
            "middle": 2.0,
            "correlation": 1.0,
        },
        "clock 'Laser' is 0.2373 s behind clock 'DAQ' (standard deviation 1.2e-06 s, and loses 20 us every second), as 'sync' on"
        " both shows; its stamps are corrected",
    ),
    RecordCode.CLOCK_OFFSET_BY_RECORDER: (
        "stamps of /laser",
        {"reference": "stamps of /daq", "offset": 0.2378},
        "clocks 'stamps of /daq' and 'stamps of /laser' differ by 0.238 s, by when their messages reached the recorder; the stamps of"
        " the second are corrected, to a few milliseconds",
    ),
    RecordCode.CLOCK_START: (
        "B",
        {"start": 0.25},
        "clock 'B' was started 0.25 s after the first, as the file says; its stamps are shifted by that",
    ),
    RecordCode.DATES_READ: (
        "Zeit",
        {"kind": "clock", "start": "01:30:00"},
        "Zeit: times of day, counted in seconds from 01:30:00",
    ),
    RecordCode.MIDNIGHT_PASSED: (
        "time",
        {"nights": 2},
        "time: the time of day starts anew 2 times, each of which is read as midnight; write the date too where days are left out",
    ),
    RecordCode.SUMMER_TIME: (
        "time",
        {"hours": 1, "at": "2024-10-27 02:00:00"},
        "time: the clock was put back by an hour before 2024-10-27 02:00:00, as at a change of summer time; the hour is taken out (a"
        " time zone in the stamps would leave no doubt)",
    ),
    RecordCode.ORIGINS_APART: (
        "",
        {"start": "2024-10-27 02:00:00 UTC", "own": ""},
        "its time counts from its own zero, other records of this call from 2024-10-27 02:00:00 UTC, with which it cannot be compared:"
        " how they lie to each other in time is not known",
    ),
    RecordCode.SHEET_NOT_READ: (
        "Levels",
        {"read": "Drive"},
        "sheet 'Levels' is not read, as sheet 'Drive' is: which column is its time cannot be told; call it time [s], or keep one column"
        " of dates or times of day",
    ),
    RecordCode.ROWS_BELOW_TABLE: (
        "Daten",
        {"row": 51, "rows": 12},
        "sheet 'Daten': the table ends at the empty row 51, and 12 rows below it are not read; remove the empty rows, or move what is"
        " below to a sheet of its own",
    ),
    RecordCode.CLOCKS_NOT_COMPARED: (
        "B",
        {"reference": "A"},
        "clocks 'A' and 'B' have no signal in common: an offset between them cannot be told from a delay of the plant; record one"
        " signal on both, or fit a delay (shell: --effect transport_delay)",
    ),
    RecordCode.INPUT_CONSTANT: ("u", {"value": 1.0}, "input 'u' is constant at 1"),
    RecordCode.OUTPUT_CONSTANT: (
        "x",
        {"value": 3e-6},
        "output 'x' is constant at 3e-06: a constant signal carries no information; leave it out",
    ),
    RecordCode.OUTPUT_GAPS: ("x", {"gaps": 1, "rows": 40}, "output 'x' has 1 gap in 40 rows"),
    RecordCode.OUTPUT_UNWRAPPED: (
        "a",
        {"period": 6.28318531, "unit": "rad", "jumps": 12},
        "output 'a' starts anew every 6.28319 rad: 12 jumps taken out",
    ),
    RecordCode.TURNS_UNCERTAIN: (
        "a",
        {"period": 360.0, "unit": "deg", "times": 2, "start": 1.25, "stop": 1.75},
        "output 'a' starts anew every 360 deg and may have gone on by more than half of that unseen, 2 times, first between 1.25 and 1.75"
        " s: the number of turns is a guess there; sample it faster, or split the record there (--split-holes)",
    ),
    RecordCode.SENSOR_FROZEN: (
        "x",
        {"value": 0.731, "rows": 40, "start": 0.6, "stop": 0.99},
        "output 'x' stays at exactly 0.731 for 40 rows, from 0.6 to 0.99 s, while the input moves, with a jump before or after:"
        " if the sensor or the logger failed, leave these fields empty",
    ),
    RecordCode.INPUT_FOLLOWS_OUTPUT: (
        "u",
        {"output": "w", "share": 0.612},
        "input 'u' follows output 'w': past readings tell 61 % of what its own past leaves open, as in a closed loop; a disturbance that"
        " nobody measured then acts on the input too, and what is said of the input may be the disturbance's",
    ),
    RecordCode.READING_COARSE: (
        "q",
        {"step": 0.0174533},
        "output 'q' reads in steps of 0.01745, which alone make an error of 0.29 steps (rms)",
    ),
    RecordCode.SENT_ON_CHANGE: (
        "T",
        {"band": 0.5, "held": False},
        "output 'T' is sent when it has changed by 0.5: then a reading lies half a step from what the sensor feels",
    ),
    RecordCode.TIME_JITTER: (
        "",
        {"jitter": 1.02e-3, "usual_step": 0.016},
        "time stamps jitter by 0.001 s (standard deviation; usual step 0.016 s), and the readings do not: they were taken regularly and"
        " stamped late or early. Leave the time out and give the step (shell: '-' in its place in --columns, and --sampling-time SECONDS),"
        " or each error of a stamp counts as motion",
    ),
    RecordCode.SENSOR_DEAD: (
        "x",
        {"value": 0.2, "start": 1.49, "rows": 51},
        "output 'x' stays at exactly 0.2 from 1.49 s to the end (51 rows) while the input keeps moving: if the sensor or the logger"
        " failed, leave these fields empty",
    ),
    RecordCode.SENSOR_SPIKES: (
        "x",
        {"count": 3, "times": [0.4, 1.41]},
        "output 'x' jumps away and back within one row, 3 times (at 0.4 s, 1.41 s and 1 more): if this is a fault of the sensor"
        " and not the motion of the plant, leave these fields empty, or fit with a robust loss,"
        " FitOptions(loss='huber') (shell: --loss huber)",
    ),
    RecordCode.SPIKES_LEFT_OUT: (
        "x",
        {"count": 3},
        "3 readings of output 'x' that jump away and back within one row left out, as a robust loss was asked for",
    ),
    RecordCode.SENSOR_SATURATED: (
        "x",
        {"end": "largest", "value": 0.9, "rows": 60, "stays": 4},
        "output 'x' reads exactly its largest value, 0.9, in 60 rows and stays there 4 times: if the sensor or the converter saturates,"
        " leave these fields empty (an end stop of the plant looks the same)",
    ),
    RecordCode.ROWS_ON_CHANGE: (
        "w",
        {"band": 15.02},
        "there is a row only when output 'w' has changed by 15.02: when an input changed between two rows is not recorded, and constants of"
        " fast motions take this up; log every change of the inputs too, or at a fixed rate",
    ),
    RecordCode.INPUT_COURSE_SHARED: (
        "u",
        {"course": "first"},
        "input u is taken as straight between its rows, in all of these records alike, as most of their rows show; if it is not so tell"
        " it (shell: --interpolate u=zero or =first)",
    ),
    RecordCode.INPUT_COURSES_DIFFER: (
        "u",
        {"courses": ["first", "zero"]},
        "input u is straight between its rows and held between its rows from record to record; one signal moves in one way: tell it"
        " where they are read (hold=...)",
    ),
    RecordCode.ROWS_OF_PAST: (
        "",
        {"rows": 12, "seconds": 0.6},
        "the record begins in motion, and what its inputs were before is not told: its first 12 rows (0.6 s) only tell what reaches the"
        " rest late; with --before INPUT=VALUE (before=) they count",
    ),
    RecordCode.INPUT_TAKEN_STRAIGHT: (
        "T_air",
        {},
        "input T_air is smooth and carries the noise of a sensor, as what is measured does and a computer's output does not: it is taken as"
        " straight between its rows; if it is held read the record with hold='zero' (shell: --interpolate"
        " T_air=zero)",
    ),
    RecordCode.TIME_ROUNDED: (
        "",
        {"shortest": 2e-4, "longest": 3e-4, "sampling_time": 2.5e-4},
        "time is rounded: steps from 0.0002 to 0.0003 s differ by at most one unit of the last digit; a uniform step of 0.00025 s"
        " is assumed",
    ),
    RecordCode.TIME_GAP: (
        "",
        GAP,
        "time has 2 gaps, the longest from 10 to 40.5 s (usual step 0.5 s): the input is assumed to continue through it; with its 60"
        " missing rows it is refused where the input moves by much in such a time, and by a nonlinear model, which is integrated in"
        " steps; split the record there with split_at_time_gaps() (shell: --split-holes)",
    ),
    RecordCode.INPUT_HELD_THROUGH_GAP: (
        "",
        {**GAP, "gaps": 1},
        "time has a gap from 10 to 40.5 s (usual step 0.5 s): the input is assumed to continue through it",
    ),
    RecordCode.TIME_ROWS_MISSING: (
        "",
        {"rows": 39, "places": 38, "usual_step": 0.01},
        "39 rows are missing in 38 places (usual step 0.01 s): the input is assumed to continue through each, which is wrong if"
        " it moved there",
    ),
    RecordCode.TIME_IRREGULAR: (
        "",
        {"shortest": 0.5, "longest": 1.5},
        "time is irregular: steps from 0.5 to 1.5 s; each interval is used as it is",
    ),
    RecordCode.PIECES_LEFT_OUT: (
        "",
        {"pieces": [[0.3, 0.30075, 4]]},
        "excluded, too few rows between two gaps in time: 0.3 to 0.30075 s (4 rows)",
    ),
    RecordCode.OUTPUT_NOT_MEASURED: (
        "",
        {"outputs": ["x", "w"], "columns": {"w": "speed [1/min]"}},
        "not measured: output 'x' and 'w'; is 'speed [1/min]' w, whose unit it has? (shell: --column 'w=speed [1/min]')",
    ),
    RecordCode.MAY_BE_PER_CENT: (
        "u",
        {"header": "u", "largest": 80.0},
        "u is a plain number in the model, its header states no unit, and it reaches 80: taken as it stands; if it is per cent, say so"
        " (shell: --column 'u [%]=u')",
    ),
    RecordCode.UNITS_ASSUMED: (
        "",
        {"units": {"time": "s", "x": "m"}},
        "the header gives no unit for time, x: s, m assumed",
    ),
    RecordCode.UNITS_READ: (
        "",
        {
            "columns": [
                ["w [1/min]", "1/min", "turns"],
                ["enc [inc]", "count", "counts"],
                ["t in ms", "ms", "name"],
                ["x [m]", "mm", "told"],
                ["stamp", "us", "size"],
                ["T [C]", "degC", "notation"],
            ]
        },
        "units: 'w [1/min]' counts turns (1/min; a turn is 2 pi rad); 'enc [inc]' is taken as a plain number; 't in ms' is in ms, as its"
        " name says; 'x [m]' is read in mm, as told; 'stamp' is in us since 1970, by the size of its numbers; 'T [C]' is in degC",
    ),
    RecordCode.COLUMNS_IGNORED: ("", {"columns": ["a", "b"]}, "columns ignored: 'a', 'b'"),
    RecordCode.CONDITION_READ: (
        "P_S",
        {"value": 801e3, "unit": "Pa", "source": "comment"},
        "condition P_S: 801000 Pa, from a comment of the file",
    ),
    RecordCode.FEW_ROWS: (
        "",
        {"rows": 7},
        "only 7 rows: the intervals hold if the model is right, and so few values hardly show whether it is",
    ),
    RecordCode.ONE_OF_RUNS: ("", {"runs": 2}, "one of 2 runs in its file: time restarts with each run"),
    RecordCode.RESAMPLED: (
        "",
        {"sampling_time": 0.5, "rows": 100},
        "resampled to every 0.5 s from 100 rows",
    ),
    RecordCode.ROWS_OF_PAST: (
        "",
        {"rows": 12, "seconds": 0.3},
        "the record begins in motion, and what its inputs were before is not told: its first 12 rows (0.3 s) only tell what reaches the"
        " rest late; with --before INPUT=VALUE (before=) they count",
    ),
    RecordCode.ALSO_FITTED: (
        "",
        {"record": "low.csv", "place": "rows 1 to 90 are the readings of rows 31 to 120 of low.csv"},
        "rows 1 to 90 are the readings of rows 31 to 120 of low.csv, which is fitted: it cannot validate the model;"
        " use a record that is not",
    ),
}


@pytest.mark.parametrize("code", RecordCode)
def test_each_code_of_a_record_has_its_sentence(code):
    subject, values, text = GOLDEN[code]
    assert sentence(Finding(code, subject=subject, values=values)) == text


def test_the_records_of_a_finding_stand_before_its_sentence():
    finding = Finding(RecordCode.INPUT_CONSTANT, subject="u", values={"value": 1.0, "records": ["a.csv", "b"]})
    assert sentence(finding) == "a.csv, b: input 'u' is constant at 1"


def test_a_record_shows_its_signals_conditions_and_findings():
    time = 0.5 * np.arange(40)
    outputs = {"y": np.where(time == 2, np.nan, np.cos(time))}
    record = Experiment.from_arrays(time, {"u": np.ones(40)}, outputs, name="run", conditions={"T": 293.0})
    assert str(record).splitlines() == [
        f"run: 40 rows every 0.5 s, 19.5 s, input held between samples, data {record.fingerprint}",
        "  input     u: 1 to 1, 0 gaps",
        "  output    y: -0.997172 to 1, 1 gap",
        "  condition T: 293",
        "  note      input 'u' is constant at 1",
        "  note      output 'y' has 1 gap in 40 rows",
    ]


def test_an_irregular_record_and_an_output_without_values_are_shown_as_such():
    time = np.cumsum(1.0 + 0.5 * np.sin(np.arange(40)))
    record = Experiment("run", time, {"u": np.sin(time)}, {"y": np.full(40, np.nan)}, hold="first")
    lines = str(record).splitlines()
    assert lines[0].startswith("run: 40 rows at irregular times, ") and "input linear between samples" in lines[0]
    assert lines[2] == "  output    y: no value"


def test_a_survey_is_a_table_with_the_columns_to_name():
    def signal(header, unit, rows, step, use, name, **more):
        values = {
            "missing": 0,
            "regular": True,
            "start": 0.0,
            "stop": 2.0,
            "lowest": -1.0,
            "highest": 1.0,
            "gaps": 0,
            "held": False,
        }
        return SignalSurvey(header, unit, "", rows, step=step, use=use, name=name, **{**values, **more})

    signals = (
        signal("/cmd.value [V]", "V", 2000, 0.001, "input", "value", held=True, model_unit="V"),
        signal("x [mm]", "mm", 200, 0.01, "output", "x", gaps=2, missing=3, regular=False, model_unit="mm"),
    )
    survey = FileSurvey("run.mcap", "MCAP", signals, (Finding(RecordCode.NO_TIME),))
    lines = text(survey, 200).splitlines()
    assert (
        lines[0] == "run.mcap: MCAP, 2 signals, 2000 rows; value may be an input; x may be an output; 1 thing to know."
    )
    assert lines[3].split() == [
        "/cmd.value",
        "V",
        "2000",
        "1000",
        "Hz",
        "0",
        "-",
        "2",
        "s",
        "-1",
        "to",
        "1",
        "-",
        "input,",
        "held",
    ]
    assert lines[4].endswith("200      100 Hz, irregular  0 - 2 s    -1 to 1  2 gaps, 3 empty  output")
    assert '  gb.Input("value", "V")' in lines and '  gb.Output("x", "mm")' in lines
    assert lines[-1] == "columns for it: --column value='/cmd.value [V]'"


def test_an_input_is_not_to_be_left_empty():
    values = {"kind": "input", "value": -999.0, "rows": 5, "start": 2.5}
    written = sentence(Finding(RecordCode.CODE_FOR_MISSING, subject="u", values=values))
    assert written.endswith("write what acted there: an input needs a value in every row")
