"""Reading records: the same arrays whatever the file looks like, and one clear message for a file that is not right."""

import cProfile
import datetime as dt
import json
import pstats
import re
import string
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import openpyxl
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from greybox.base.errors import DataError, nearest
from greybox.data.columns import parse_header
from greybox.data.file_kinds import FileFormat, RecordFile
from greybox.data.findings import RecordCode
from greybox.data.policy import ReadingPolicy
from greybox.data.read import read_csv, read_experiments
from greybox.data.survey import survey_file
from greybox.data.text_table import read_text
from greybox.model.balance import Balance
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State

N = 30
TIME = 0.1 * np.arange(N)
DRIVE = np.sin(TIME)
ANSWER = 1e-6 * np.cos(3 * TIME)
CURRENT = np.cos(2 * TIME) - 1


def _oscillator(name, inputs, outputs, first="x", unit="m", more=()):
    """A stand-in with the signals of a rig; its equations are a mass on a spring."""

    def balances(x, u, p):
        drive = {i.name: p.g * u[i.name] for i in inputs[:1]}
        return [
            Balance("position", f"({unit})/s", 1, first, velocity=x.rate),
            Balance("force", f"({unit})/s^2", 1, "rate", spring=-p.k * x[first], **drive),
        ]

    gain = Parameter("g", f"({unit})/s^2/({inputs[0].unit})", 1.0) if inputs else None
    parameters = [Parameter("k", "1/s^2", 1.0), *([gain] if gain else []), *more]
    states = [State(first, unit), State("rate", f"({unit})/s")]
    return Model(name, states=states, inputs=inputs, outputs=outputs, parameters=parameters, balances=balances)


CURRENT_SENSOR = Output("i", "A", lambda x, u, p: u.u / p.R)
RIG = _oscillator("rig", [Input("u", "V")], [Output("x", "m"), CURRENT_SENSOR], more=[Parameter("R", "ohm", 8.0)])
FREE = _oscillator("free", [], [Output("x", "m")])
EMPS = _oscillator("emps", [Input("u", "V")], [Output("q", "m")], first="q")
BOX = _oscillator("silverbox", [Input("u", "V")], [Output("y", "V")], first="y", unit="V")


def write(path, headers, columns, separator=",", decimal=".", end="\n", encoding="utf-8", before=(), after=()):
    rows = [
        ["" if np.isnan(v) else repr(float(v)).replace(".", decimal) for v in row] for row in zip(*columns, strict=True)
    ]
    lines = [*before, separator.join(headers), *(separator.join(row) for row in rows), *after]
    path.write_bytes((end.join(lines) + end).encode(encoding))
    return path


def good(path, **how):
    return write(path, ["time [s]", "u [V]", "x [m]", "i [A]"], [TIME, DRIVE, ANSWER, CURRENT], **how)


def same(experiment, current=CURRENT):
    np.testing.assert_array_equal(experiment.time, TIME)
    np.testing.assert_array_equal(experiment.inputs["u"], DRIVE)
    np.testing.assert_array_equal(experiment.outputs["x"], ANSWER)
    np.testing.assert_array_equal(experiment.outputs["i"], current)


# --- the same arrays whatever the file looks like

LOOKS = {
    "comma": {},
    "semicolon": {"separator": ";"},
    "tab": {"separator": "\t"},
    "blank": {"separator": " "},
    "blanks": {"separator": "   "},
    "comma and blank": {"separator": ", "},
    "decimal comma": {"separator": ";", "decimal": ","},
    "decimal comma with tabs": {"separator": "\t", "decimal": ","},
    "decimal comma with blanks": {"separator": " ", "decimal": ","},
    "byte order mark": {"encoding": "utf-8-sig"},
    "utf-16": {"encoding": "utf-16"},
    "windows line ends": {"end": "\r\n"},
    "old mac line ends": {"end": "\r"},
    "comments": {"before": ["# recorded on the bench", "#u, x, i", "   # indented"], "after": ["# end"]},
    "blank lines at the end": {"after": ["", "  ", ""]},
}


@pytest.mark.parametrize("how", LOOKS.values(), ids=LOOKS)
def test_every_look_of_a_text_file_gives_the_same_arrays(tmp_path, how):
    experiment = read_csv(good(tmp_path / "run.csv", **how), RIG)
    same(experiment)
    assert (experiment.name, experiment.source, experiment.hold, experiment.findings) == ("run", "run.csv", "zero", ())


def test_signals_are_means_where_that_is_told(tmp_path):
    path = good(tmp_path / "run.csv")
    told = {name: {"hold": hold} for name, hold in (("all", "mean"), ("inputs", {"u": "mean"}))}
    told["by name"] = {"interpolation": dict.fromkeys(("u", "x", "i"), "mean")}
    records = {name: read_csv(path, RIG, **how) for name, how in told.items()}
    assert {name: (r.hold, r.outputs_are_means) for name, r in records.items()} == {
        "all": ("mean", True),
        "inputs": ({"u": "mean"}, False),
        "by name": ("mean", True),
    }
    # A part keeps it, and so does a record that is run without its outputs.
    assert records["all"].window(0, 3).with_outputs({}).outputs_are_means
    assert read_csv(path, RIG, hold={"x": "mean", "i": "mean"}).with_hold({"u": "first"}).hold == {
        **{"u": "first", "x": "mean", "i": "mean"}
    }
    for wrong, message in (({"x": "mean"}, "nothing of 'i'"), ({"x": "first"}, "'x', which is no input")):
        with pytest.raises(DataError, match=message):
            read_csv(path, RIG, hold=wrong)


@pytest.mark.parametrize("suffix", [".csv", ".CSV", ".tsv", ".txt", ".dat"])
def test_every_text_suffix_is_read(tmp_path, suffix):
    same(read_csv(good(tmp_path / f"run{suffix}", separator="\t"), RIG))


def test_binary_files_give_the_same_arrays(tmp_path):
    plain = {"time": TIME, "u": DRIVE, "x": ANSWER, "i": CURRENT}
    savemat(tmp_path / "run.mat", plain | {"fs": 10.0, "title": "bench", "count": np.arange(3)})
    named = {"time [ms]": 1e3 * TIME, "u [mV]": 1e3 * DRIVE, "x [um]": 1e6 * ANSWER, "i": CURRENT}
    np.savez(tmp_path / "run.npz", **named)
    pd.DataFrame(named).to_parquet(tmp_path / "run.parquet")
    same(read_csv(tmp_path / "run.mat", RIG))
    for name in ("run.npz", "run.parquet"):
        experiment = read_csv(tmp_path / name, RIG)
        np.testing.assert_allclose(experiment.time, TIME, rtol=1e-14)
        np.testing.assert_allclose(experiment.inputs["u"], DRIVE, rtol=1e-14)
        np.testing.assert_allclose(experiment.outputs["x"], ANSWER, rtol=1e-14)
        np.testing.assert_array_equal(experiment.outputs["i"], CURRENT)


def test_matlab_structs_are_reached_by_their_path_and_integers_are_numbers(tmp_path):
    savemat(tmp_path / "run.mat", {"log": {"t": TIME, "u": DRIVE, "x": np.arange(N, dtype=np.int16)}})
    columns = {"time": "log.t", "u": "log.u", "x": "log.x"}
    experiment = read_csv(tmp_path / "run.mat", RIG, columns=columns)
    np.testing.assert_array_equal(experiment.outputs["x"], np.arange(N))


def test_parquet_nulls_are_gaps(tmp_path):
    current = pd.array([None, *range(1, N)], dtype="Int64")
    pd.DataFrame({"time": TIME, "u": DRIVE, "x": ANSWER, "i": current}).to_parquet(tmp_path / "run.parquet")
    same(read_csv(tmp_path / "run.parquet", RIG), np.append(np.nan, np.arange(1.0, N)))


@pytest.mark.parametrize("gap", ["", "nan", "NaN", "NA", "n/a", "null", "-", "----", ' ""'])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_gaps_of_an_output_stay_gaps(tmp_path, gap, separator):
    path = good(tmp_path / "run.csv", separator=separator)
    lines = path.read_text().splitlines()
    for k in (1, 7, N):
        fields = lines[k].split(separator)
        lines[k] = separator.join([*fields[:2], gap, fields[3]])
    path.write_text("\n".join(lines))
    experiment = read_csv(path, RIG)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(experiment.outputs["x"])), [0, 6, N - 1])
    known = ~np.isnan(experiment.outputs["x"])
    np.testing.assert_array_equal(experiment.outputs["x"][known], ANSWER[known])
    (finding,) = experiment.findings
    assert (finding.code, finding.subject, finding.values["gaps"]) == (RecordCode.OUTPUT_GAPS, "x", 3)


@dataclass(frozen=True)
class Look:
    separator: str
    decimal: str
    order: tuple[int, ...]
    units: tuple[str, ...]
    brackets: str
    quoted: bool


SCALES = {
    "s": (("s", 1), ("ms", 1e-3), ("min", 60)),
    "V": (("V", 1), ("mV", 1e-3)),
    "m": (("m", 1), ("um", 1e-6), ("µm", 1e-6), ("mm", 1e-3)),
}
SCALES["A"] = (("A", 1), ("mA", 1e-3), ("kA", 1e3))
LABELS = [("time", "s"), ("u", "V"), ("x", "m"), ("i", "A")]
FACTORS = {unit: factor for scale in SCALES.values() for unit, factor in scale}


@st.composite
def looks(draw):
    separator = draw(st.sampled_from([",", ";", "\t"]))
    decimal = "." if separator == "," else draw(st.sampled_from([".", ","]))
    units = tuple(draw(st.sampled_from(SCALES[unit]))[0] for _, unit in LABELS)
    order = tuple(draw(st.permutations(range(4))))
    return Look(separator, decimal, order, units, draw(st.sampled_from(["[]", "()"])), draw(st.booleans()))


VALUES = st.floats(-1e9, 1e9, allow_subnormal=False)


@given(look=looks(), drive=st.lists(VALUES, min_size=10, max_size=15, unique=True), data=st.data())
def test_separators_orders_and_units_do_not_change_the_record(tmp_path_factory, look, drive, data):
    rows = len(drive)
    gaps = st.one_of(VALUES, st.just(float("nan")))
    answer = np.array(data.draw(st.lists(gaps, min_size=rows, max_size=rows)))
    answer[0] = 1.0
    wanted = [np.arange(rows) * 0.25, np.array(drive), answer, np.arange(rows) ** 2 / 7.0]
    written = [values / FACTORS[unit] for values, unit in zip(wanted, look.units, strict=True)]
    left, right = look.brackets
    headers = [f"{name} {left}{unit}{right}" for (name, _), unit in zip(LABELS, look.units, strict=True)]
    headers = [f'"{h}"' if look.quoted else h for h in headers]
    path = tmp_path_factory.mktemp("look") / "run.csv"
    shuffled = [headers[k] for k in look.order], [written[k] for k in look.order]
    experiment = read_csv(write(path, *shuffled, separator=look.separator, decimal=look.decimal), RIG)
    found = [experiment.time, experiment.inputs["u"], experiment.outputs["x"], experiment.outputs["i"]]
    for values, expected, unit in zip(found, wanted, look.units, strict=True):
        if FACTORS[unit] == 1:
            np.testing.assert_array_equal(values, expected)
        np.testing.assert_allclose(values, expected, rtol=4e-16 * 2)
    straight = read_csv(write(path, headers, written), RIG)
    assert straight.fingerprint == experiment.fingerprint


@given(
    name=st.text(string.ascii_letters + string.digits + "_ ", min_size=1, max_size=12).filter(str.strip),
    unit=st.sampled_from(list(FACTORS)),
    gap=st.sampled_from(["", " ", "  "]),
)
def test_headers_are_name_and_unit(name, unit, gap):
    for text in (f"{name}{gap}[{unit}]", f"{name}{gap}({unit})", f" {name} [ {unit} ] "):
        column = parse_header(text, 3)
        assert (column.name, column.unit, column.position) == (name.strip(), unit, 3)
    assert parse_header(name, 0).unit == ""


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("Laser (ch1)", "Laser (ch1)", ""),
        ("Laser (1)", "Laser (1)", ""),
        ("Laser (ch1) (um)", "Laser (ch1)", "um"),
        ("B (N*s/(m))", "B", "N*s/(m)"),
        ("T (degC)", "T", "degC"),
        ("duty [-]", "duty", "-"),
        ("q []", "q", ""),
        ("(V)", "(V)", ""),
        ("p_a (abs) [kPa]", "p_a (abs)", "kPa"),
        # What is meant as a unit, and is refused where it is used.
        ("p (psig)", "p", "psig"),
        ("P (dBm)", "P", "dBm"),
        ("Laser (DB4)", "Laser (DB4)", ""),
        # Units in one character, and wide letters.
        ("T [\u2103]", "T", "\N{DEGREE SIGN}C"),
        ("time [\u33b3]", "time", "ms"),
        ("P \u33be", "P kW", ""),
        ("\uff59\uff3b\uff4d\uff4d\uff3d", "y", "mm"),
    ],
)
def test_parentheses_are_a_unit_only_when_they_hold_one(header, name, unit):
    column = parse_header(header, 0)
    assert (column.name, column.unit) == (name, unit)


def test_a_header_without_a_unit_is_in_the_models_unit(tmp_path):
    same(read_csv(write(tmp_path / "run.csv", ["t", "u", "x", "i []"], [TIME, DRIVE, ANSWER, CURRENT]), RIG))


def test_signs_of_older_instruments_are_understood(tmp_path):
    headers = ["t", "u [V]", "x [µm]", "i [A]"]
    columns = [TIME, DRIVE, 1e6 * ANSWER, CURRENT]
    experiment = read_csv(write(tmp_path / "run.csv", headers, columns, encoding="latin-1"), RIG)
    np.testing.assert_allclose(experiment.outputs["x"], ANSWER, rtol=1e-14)


def test_a_file_of_many_chunks_is_read_whole_and_its_late_lines_are_named(tmp_path):
    def read(path):
        return read_text(path, ReadingPolicy(rows_per_chunk=7)).values(range(4))

    columns, problems, _ = read(good(tmp_path / "run.csv"))
    for values, expected in zip(columns.values(), (TIME, DRIVE, ANSWER, CURRENT), strict=True):
        np.testing.assert_array_equal(values, expected)
    assert not problems
    _, (problem,), _ = read(edited(tmp_path / "run.csv", {3: "0.1,a,0,0", 25: "2.3,b,0,0"}))
    assert "column 'u [V]', lines 3, 25: 'a', 'b'" in problem
    _, (problem,), _ = read(edited(tmp_path / "run.csv", {3: "0.1,0", 25: "2.3,0,0"}))
    assert "lines 3, 25 have another number of fields (2 in the first of them)" in problem


def test_offset_units_are_converted_as_data(tmp_path):
    oven = Model(
        "oven",
        states=[State("T", "K")],
        inputs=[Input("P", "W")],
        outputs=[Output("T", "K")],
        parameters=[Parameter("C", "J/K", 10.0)],
        balances=lambda x, u, p: [Balance("heat", "W", p.C, "T", supply=u.P)],
    )
    path = write(tmp_path / "run.csv", ["t [min]", "P [kW]", "T [degC]"], [TIME, DRIVE, 20 + CURRENT])
    experiment = read_csv(path, oven)
    np.testing.assert_allclose(experiment.outputs["T"], 293.15 + CURRENT, rtol=1e-14)
    np.testing.assert_allclose(experiment.time, 60 * TIME, rtol=1e-15)


def test_columns_maps_signals_to_other_headers(tmp_path):
    headers = ["Zeit [ms]", "AO0", "Laser ch1 [um]", "x [m]", "i [A]"]
    path = write(tmp_path / "run.csv", headers, [1e3 * TIME, DRIVE, 1e6 * ANSWER, TIME, CURRENT])
    experiment = read_csv(
        path, RIG, columns={"time": "Zeit", "u": "AO0", "x": "Laser ch1 [um]"}, name="first", hold="first"
    )
    np.testing.assert_allclose(experiment.outputs["x"], ANSWER, rtol=1e-15)
    np.testing.assert_allclose(experiment.time, TIME, rtol=1e-15)
    np.testing.assert_array_equal(experiment.inputs["u"], DRIVE)
    assert (experiment.name, experiment.hold) == ("first", "first")
    assert [(f.code, dict(f.values)) for f in experiment.findings] == [
        (RecordCode.UNITS_ASSUMED, {"units": {"u": "V"}}),
        (RecordCode.COLUMNS_IGNORED, {"columns": ["x [m]"]}),
    ]


def test_outputs_may_be_missing_and_other_columns_may_hold_anything(tmp_path):
    path = good(tmp_path / "run.csv")
    lines = [
        line.rsplit(",", 1)[0] + end
        for line, end in zip(path.read_text().splitlines(), [",state"] + [",ok"] * N, strict=True)
    ]
    path.write_text("\n".join(lines))
    experiment = read_csv(path, RIG, conditions={"T": 293.0})
    assert list(experiment.outputs) == ["x"]
    assert [(f.code, dict(f.values)) for f in experiment.findings] == [
        (RecordCode.OUTPUT_NOT_MEASURED, {"outputs": ["i"]}),
        (RecordCode.COLUMNS_IGNORED, {"columns": ["state"]}),
    ]
    assert experiment.conditions["T"] == 293.0


def test_a_model_without_inputs_reads_a_free_decay(tmp_path):
    experiment = read_csv(write(tmp_path / "run.csv", ["t", "x"], [TIME, ANSWER]), FREE)
    assert dict(experiment.inputs) == {}
    np.testing.assert_array_equal(experiment.outputs["x"], ANSWER)


def test_constant_inputs(tmp_path):
    step = write(tmp_path / "step.csv", ["t", "u", "x"], [TIME, np.ones(N), ANSWER])
    assert RecordCode.INPUT_CONSTANT in [f.code for f in read_csv(step, RIG).findings]
    decay = write(tmp_path / "decay.csv", ["t", "u", "x"], [TIME, np.zeros(N), ANSWER])
    with pytest.raises(
        DataError, match=r"^decay\.csv: constant input: 'u' is 0 in every row.*allow_constant_input=True"
    ):
        read_csv(decay, RIG)
    assert RecordCode.INPUT_CONSTANT in [f.code for f in read_csv(decay, RIG, allow_constant_input=True).findings]
    still = write(tmp_path / "still.csv", ["t", "u", "x"], [TIME, np.ones(N), np.ones(N)])
    with pytest.raises(DataError, match="nothing moves: 'u', 'x' are constant over the whole record"):
        read_csv(still, RIG, allow_constant_input=True)
    dead = write(tmp_path / "dead.csv", ["t", "u", "x"], [TIME, DRIVE, np.full(N, 3e-6)])
    with pytest.raises(DataError, match="no output moves: 'x' is constant over the whole record"):
        read_csv(dead, RIG)


# --- exports of instruments and spreadsheets

EXPORTS = {
    "separator line": {"before": ["sep=;"], "separator": ";"},
    "separator line in quotes": {"before": ['"sep=,"']},
    "separator line and decimal comma": {"before": ["sep=;"], "separator": ";", "decimal": ","},
}


@pytest.mark.parametrize("how", EXPORTS.values(), ids=EXPORTS)
def test_the_line_that_states_the_separator_is_understood(tmp_path, how):
    path = good(tmp_path / "run.csv", **how)
    same(read_csv(path, RIG))
    first, header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([first, header, rows[0], f"bad{rows[1]}", *rows[2:]]))
    with pytest.raises(DataError, match=r"column 'time \[s\]', line 4"):
        read_csv(path, RIG)


def test_quoted_headers_and_fields_between_blanks(tmp_path):
    table = np.column_stack([TIME, DRIVE, ANSWER, CURRENT]).tolist()
    rows = [f'{t!r} "{u!r}"   {x!r} {i!r}' for t, u, x, i in table]
    (tmp_path / "run.dat").write_text("\n".join(['"time [s]" "u [V]" "x [m]" i [A]', *rows]))
    same(read_csv(tmp_path / "run.dat", RIG))


TITLES = {
    "instrument": ["Oscilloscope 3000", "Serial;123", "", "time [s],u [V],x [m],i [A]"],
    "a comma in it": ["Rig 2, 3 May", "time [s],u [V],x [m],i [A]"],
    "filled up by a spreadsheet": ["Rig 2;;;", "time [s];u [V];x [m];i [A]"],
    "a date": ["Rig 2", "Start 12.03.2026 08:00:05", "time [s]\tu [V]\tx [m]\ti [A]"],
    "settings": ["Gain;2.0;;", "Limits;-1;1;", "time [s];u [V];x [m];i [A]"],
    "units below": ["Messprotokoll Anlage 3", "time;u;x;i", "s;V;m;A"],
    "some units below": ["Messprotokoll Anlage 3;;;", "time;u;x;i", ";V;m;A"],
    "units below an index without a name": ["Messprotokoll Anlage 3", "time,u,x,i", "[s],[V],[m],[A]"],
    "names that look like units": ["Rig 2;;;", "t;u;x;i", "s;V;m;A"],
    "between the lines": ["Rig 2", "", "time u x i", "", "s V m A"],
    "a separator line": ["sep=;", "Rig 2;;;", "time;u;x;i", "s;V;m;A"],
}


@pytest.mark.parametrize("ending", ["", "later"])
@pytest.mark.parametrize("first", TITLES.values(), ids=TITLES)
def test_a_title_above_the_header_is_passed_over_in_texts_and_sheets_alike(tmp_path, first, ending):
    separator = next(s for s in (";", "\t", ",", " ") if s in first[-1].replace(" [", "["))
    table = np.column_stack([TIME, DRIVE, ANSWER, CURRENT]).tolist()
    lines = [separator.join(map(repr, row)) for row in table]
    (tmp_path / "run.csv").write_text("\n".join([*first, *([""] if ending else []), *lines]), encoding="utf-8")
    same(read_csv(tmp_path / "run.csv", RIG))
    book = openpyxl.Workbook()
    for line in first:
        if not line.startswith("sep="):
            cells = line.replace(" [", "[").split(separator) if separator == " " else line.split(separator)
            book.active.append([_to_cell(cell) for cell in cells])
    for row in table:
        book.active.append(row)
    book.save(tmp_path / "run.xlsx")
    sheet = read_csv(tmp_path / "run.xlsx", RIG)
    values = np.column_stack([sheet.time, *sheet.inputs.values(), *sheet.outputs.values()])
    np.testing.assert_allclose(values, table, rtol=1e-14)  # a workbook holds so many digits


def _to_cell(text: str) -> str | float | None:
    try:
        return float(text)
    except ValueError:
        return text or None


@pytest.mark.parametrize(
    ("first", "message"),
    [
        (
            ["Rig 2", "time;u;x;i", "left;right;above;below"],
            "line 2 looks like the header (time;u;x;i), and line 3 below it holds neither its units nor numbers",
        ),
        (
            ["Rig 2;3 May;hall 4;north", "time;u;x;i"],
            "line 1 looks like the header (Rig 2;3 May;hall 4;north), and line 2",
        ),
        (["Rig 2", "time;u;x;i;"], "the header ends with ';'"),
    ],
)
def test_lines_that_may_be_the_header_or_not_are_named_with_the_remedy(tmp_path, first, message):
    lines = [";".join(map(repr, row)) for row in np.column_stack([TIME, DRIVE, ANSWER, CURRENT]).tolist()]
    (tmp_path / "run.csv").write_text("\n".join([*first, *lines]))
    with pytest.raises(DataError, match=re.escape(message)):
        read_csv(tmp_path / "run.csv", RIG)


@pytest.mark.parametrize(
    ("names", "units"),
    [
        ("time,u,x,i", "s,V,m,A"),
        ("time,u,x,i", "[s],[V],[m],[A]"),
        ("time [s];u;x;i", "s;V;m;A"),
        ("time\tu\tx\ti", "s\tV\tm\t"),
        ("time u x i", "s V m A"),
    ],
)
def test_a_row_of_units_below_the_header_is_read(tmp_path, names, units):
    separator = next(s for s in ",;\t " if s in names.removeprefix("time [s]"))
    columns = [TIME, DRIVE, 1e3 * ANSWER, CURRENT]
    rows = (separator.join(repr(float(value)) for value in row) for row in zip(*columns, strict=True))
    (tmp_path / "run.txt").write_text("\n".join([names, units.replace("m", "mm"), *rows]))
    record = read_csv(tmp_path / "run.txt", RIG)
    np.testing.assert_allclose(record.outputs["x"], ANSWER, rtol=1e-14)
    np.testing.assert_array_equal(record.inputs["u"], DRIVE)


@pytest.mark.parametrize(
    ("lines", "columns", "rows"),
    [
        (["Record Length,20,0.0,1.5", "Interval,1e-3,0.1,1.25", ",,0.2,1.0"], ["-", "-", "time [s]", "x [m]"], 3),
        (["0.0;start;1.5", "0.1;run;1.25", "0.2;end;1.0"], ["time", "-", "x"], 3),
        (["0,0;ramp;1,5", "0,1;ramp;1,25", "0,2;hold;1,0"], ["time", "-", "x"], 3),
        (["zeit;art;weg", "0.0;start;1.5", "0.1;run;1.25"], ["time", "-", "x"], 2),
    ],
)
def test_a_first_line_whose_wanted_columns_are_numbers_is_a_row(tmp_path, lines, columns, rows):
    (tmp_path / "scope.csv").write_text("\n".join(lines), encoding="utf-8")
    record = read_csv(tmp_path / "scope.csv", FREE, columns=columns)
    np.testing.assert_allclose(record.time, np.arange(rows) / 10, atol=1e-12)
    np.testing.assert_allclose(record.outputs["x"], [1.5, 1.25, 1.0][:rows])


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("time;x\n0;1;\n1;2;\n2;3;\n", "the lines end with ';' and the header does not"),
        ("time,x\n0,1,\n1,2,\n2,3,\n", "the lines end with ',' and the header does not"),
        ("time;x;\n0;1\n1;2\n2;3\n", "the header ends with ';': delete it there"),
        ("time;x\n0.5;1\n1.5;2,5\n2.5;3\n", "write decimal points in all rows"),
    ],
)
def test_a_trailing_separator_and_mixed_decimal_signs_are_named(tmp_path, text, remedy):
    (tmp_path / "run.csv").write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=re.escape(remedy)):
        read_csv(tmp_path / "run.csv", FREE)


def test_a_first_row_without_numbers_is_a_row(tmp_path):
    with pytest.raises(DataError, match=r"column 'u \[V\]', line 2: 'low' is not a number"):
        read_csv(edited(tmp_path / "run.csv", {2: "0,low,over,over"}), RIG)


@pytest.mark.parametrize(
    ("field", "remedy"),
    [
        ("2024-05-03 10:00:00.1", "write every row of a column of dates alike"),
        ("10:00:03", "write every row of a column of dates alike"),
        ('"0,25"', "write decimal points, or ';' between the columns"),
        ('"1,234.5"', "write the number without marks between its thousands"),
        ("over", "correct it, or leave the field empty"),
    ],
)
def test_text_in_a_column_of_numbers_has_its_own_remedy(tmp_path, field, remedy):
    with pytest.raises(DataError, match=re.escape(remedy)):
        read_csv(edited(tmp_path / "run.csv", {5: f"{field},0.5,1e-6,0"}), RIG)


# --- what is accepted but said


def test_headers_without_units_are_noted(tmp_path):
    path = write(tmp_path / "run.csv", ["t", "u [V]", "x", "i []"], [TIME, DRIVE, ANSWER, CURRENT])
    (finding,) = read_csv(path, RIG).findings
    assert (finding.code, dict(finding.values["units"])) == (
        RecordCode.UNITS_ASSUMED,
        {"time": "s", "x": "m", "i": "A"},
    )


def test_a_sensor_that_never_moves_is_noted(tmp_path):
    path = write(tmp_path / "run.csv", ["t [s]", "u [V]", "x [m]", "i [A]"], [TIME, DRIVE, np.full(N, 3e-6), CURRENT])
    (finding,) = read_csv(path, RIG).findings
    assert (finding.code, finding.subject, finding.values["value"]) == (RecordCode.OUTPUT_CONSTANT, "x", 3e-6)


# --- one clear message


def edited(path, edits, **how):
    """The good record with some lines (counted from 1, the header is line 1) replaced; None deletes a line."""
    lines = good(path, **how).read_text().splitlines()
    for number, text in edits.items():
        lines[number - 1] = text
    path.write_text("\n".join(line for line in lines if line is not None) + "\n")
    return path


LINE = "{t},0.5,1e-6,0"
BAD_LINES = [
    ({5: "0.3,0.5,abc,0"}, "column 'x [m]', line 5: 'abc' is not a number; correct it, or leave"),
    ({5: "0.3,?,1e-6,0", 9: "0.7,off,1e-6,0"}, "column 'u [V]', lines 5, 9: '?', 'off' are not numbers"),
    ({5: "0.3,0x10,1e-6,0"}, "column 'u [V]', line 5: '0x10' is not a number"),
    ({5: "0.3,True,1e-6,0"}, "column 'u [V]', line 5: 'True' is not a number"),
    ({5: "0.3,1_000,1e-6,0"}, "column 'u [V]', line 5: '1_000' is not a number"),
    ({5: "0.3,0.5,1e-6 #x,0"}, "column 'x [m]', line 5: '1e-6 #x' is not a number"),
    ({5: "0.3,,1e-6,0"}, "input 'u' is empty or NaN at line 5; an input must be known at every row"),
    ({5: ",0.5,1e-6,0"}, "time is empty or NaN at line 5"),
    ({5: "0.3,0.5,inf,0"}, "output 'x' is infinite at line 5"),
    ({5: "0.3,-Infinity,1e-6,0"}, "input 'u' is infinite at line 5"),
    ({5: "0.3,0.5,1e999,0"}, "output 'x' is infinite at line 5"),
    ({5: LINE.format(t=0.2)}, "time is repeated at line 5 (0.2 s after 0.2 s); time must increase from row to row"),
    ({5: LINE.format(t=0.15)}, "time goes back at line 5 (0.15 s after 0.2 s)"),
    ({5: "0.3,0.5"}, "line 5 has 2 fields, the header (line 1) has 4"),
    ({5: "0.3,0,5,1e-6,0"}, "line 5 has 5 fields, the header (line 1) has 4; write a decimal point, or ';'"),
    ({31: "2.9,0.5,1e-"}, "line 31 has 3 fields"),
    (dict.fromkeys(range(3, 32)), "1 rows; a record needs at least 2"),
    (dict.fromkeys(range(2, 32)), "0 rows; a record needs at least 2"),
    ({1: "0,0,0,0"}, "line 1 holds numbers where the header should be; begin the file with a line of names"),
]


@pytest.mark.parametrize(("edits", "message"), BAD_LINES, ids=[f"{k}: {m[:45]}" for k, (_, m) in enumerate(BAD_LINES)])
def test_a_bad_line_is_named(tmp_path, edits, message):
    with pytest.raises(DataError, match=re.escape(message)) as error:
        read_csv(edited(tmp_path / "run.csv", edits), RIG)
    assert str(error.value).startswith("run.csv: ")
    assert "\n" not in str(error.value)


def test_lines_are_those_of_the_file_comments_and_blank_lines_included(tmp_path):
    path = good(tmp_path / "run.csv", before=["# one", "", "# three"])
    lines = path.read_text().splitlines()
    lines[10:10] = ["", "# in between"]
    lines[19] = lines[19].replace(",", ",bad", 1)
    path.write_text("\n".join(lines))
    with pytest.raises(DataError, match=r"column 'u \[V\]', line 20: 'bad"):
        read_csv(path, RIG)
    path.write_text("\n".join(lines).replace("bad", ","))
    with pytest.raises(DataError, match=r"line 20 has 5 fields, the header \(line 4\) has 4"):
        read_csv(path, RIG)


def test_a_decimal_point_among_decimal_commas_is_not_a_number(tmp_path):
    path = good(tmp_path / "run.csv", separator=";", decimal=",")
    lines = path.read_text().splitlines()
    lines[4] = "0,3;1.234,5;0,1;0"
    lines[6] = "0,5;1.5;0,1;0"
    path.write_text("\n".join(lines))
    with pytest.raises(DataError, match=r"column 'u \[V\]', lines 5, 7: '1.234,5', '1.5' are not numbers"):
        read_csv(path, RIG)


def test_many_lines_are_shortened(tmp_path):
    path = edited(tmp_path / "run.csv", {k: f"{TIME[k - 2]},x,1e-6,0" for k in range(4, 16)})
    with pytest.raises(
        DataError, match=r"lines 4, 5, 6, 7, 8 and 7 more: 'x', 'x', 'x', 'x', 'x' and 7 more are not numbers"
    ):
        read_csv(path, RIG)


def test_an_output_without_any_value(tmp_path):
    path = write(tmp_path / "run.csv", ["t", "u", "x", "i"], [TIME, DRIVE, ANSWER, np.full(N, np.nan)])
    with pytest.raises(DataError, match=r"^run\.csv: output 'i' holds no value at all; remove it"):
        read_csv(path, RIG)


HEADERS = [
    (
        ["time", "U [V]", "x"],
        "no column for input 'u' [V]; did you mean 'U [V]'? unused headers: U [V]; rename one, or set",
    ),
    (
        ["time", "voltage", "x"],
        "no column for input 'u' [V]; unused headers: voltage; rename one, or set columns={'u': <header>} (shell: --column u=<header>)",
    ),
    (
        ["time", "drive [mV]", "x"],
        "no column for input 'u' [V]; did you mean 'drive [mV]'? unused headers: drive [mV]; rename one, or set",
    ),
    (["T", "u", "x"], "no column for time [s]; "),
    (
        ["time", "x", "i"],
        "no column for input 'u' [V]; every other column is in use; add a column for it, or set columns={'u': <header>}",
    ),
    (
        ["time", "u", "z"],
        "no column for any output of model 'rig' (output 'x' [m], output 'i' [A]), at least one is needed",
    ),
    (
        ["time", "u", "u [mV]"],
        "input 'u' [V] has 2 columns, 'u' and 'u [mV]'; keep one, or set columns={'u': <header>} (shell: --column u=<header>)",
    ),
    (["time [s]", "u", "x", "t"], "time [s] has 2 columns, 'time [s]' and 't'"),
    (["time", "u", "x [V]"], "column 'x [V]' in V does not convert to output 'x' [m]: V cannot be converted to m"),
    (["time [m]", "u", "x"], "column 'time [m]' in m does not convert to time [s]: m cannot be converted to s"),
    (["time", "u [Volz]", "x"], "column 'u [Volz]' in Volz does not convert to input 'u' [V]: unit 'Volz'"),
]


@pytest.mark.parametrize(("headers", "message"), HEADERS, ids=[m[:50] for _, m in HEADERS])
def test_a_header_that_does_not_fit_is_named(tmp_path, headers, message):
    path = write(tmp_path / "run.csv", headers, [TIME, DRIVE, ANSWER, CURRENT][: len(headers)])
    with pytest.raises(DataError, match=re.escape(message)):
        read_csv(path, RIG)


MAPPINGS = [
    ({"v": "a"}, "columns names 'v', which model 'rig' does not have; known: time, u, x, i"),
    ({"u": "AO1"}, "columns maps 'u' to 'AO1', which the file does not have; did you mean 'AO0'?"),
    ({"u": "AO0", "x": "AO0"}, "columns maps both 'u' and 'x' to 'AO0'; each signal needs its own column"),
    ({"u": "twice"}, "columns maps 'u' to 'twice', which the file has 2 times"),
]


@pytest.mark.parametrize(("mapping", "message"), MAPPINGS)
def test_a_mapping_that_does_not_fit_is_named(tmp_path, mapping, message):
    path = write(tmp_path / "run.csv", ["t", "AO0", "x", "twice", "twice"], [TIME, DRIVE, ANSWER, TIME, TIME])
    with pytest.raises(DataError, match=re.escape(message)):
        read_csv(path, RIG, columns=mapping)


def test_all_problems_of_a_file_come_in_one_message(tmp_path):
    with pytest.raises(DataError) as error:
        read_csv(write(tmp_path / "run.csv", ["zeit", "U", "z"], [TIME, DRIVE, ANSWER]), RIG)
    assert str(error.value).count("\n  - ") == 3
    edits = {5: "0.3,0.5,inf,0", 8: "0.1,0.5,1e-6,0", 11: "0.9,,1e-6,0"}
    with pytest.raises(DataError) as error:
        read_csv(edited(tmp_path / "run.csv", edits), RIG)
    text = str(error.value)
    assert text.startswith("run.csv: 3 problems:\n")
    for part in (
        "output 'x' is infinite at line 5",
        "time goes back at line 8",
        "input 'u' is empty or NaN at line 11",
    ):
        assert part in text
    edits = {1: "time [V],u [V],x [m],i [A]", 5: "0.3,up,down,0"}
    with pytest.raises(DataError, match="3 problems") as error:
        read_csv(edited(tmp_path / "run.csv", edits), RIG)
    for part in ("'up' is not", "'down' is not", "V cannot be converted to s"):
        assert part in str(error.value)


def test_files_that_are_not_there_or_not_readable(tmp_path):
    good(tmp_path / "train_1.csv")
    cases = {
        tmp_path / "train1.csv": "file not found; did you mean 'train_1.csv'?",
        tmp_path / "zzz.csv": "file not found; records there: train_1.csv",
        tmp_path / "no" / "run.csv": "file not found, there is no folder",
        tmp_path: "is a folder; give a file in it (.csv, .tsv",
    }
    for path, message in cases.items():
        with pytest.raises(DataError, match=re.escape(message)):
            read_csv(path, RIG)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (
            "run.xls",
            b"PK\x03\x04",
            "run.xls: files of type '.xls' cannot be read unless they are tables of text; export it as one of .csv",
        ),
        ("run", b"t,u\0x", "run: files of type '(no suffix)' cannot be read"),
        ("run.csv", b"", "run.csv: the file is empty; it needs a header line and rows of numbers"),
        ("run.csv", b"\n \n# nothing\n", "run.csv: the file is empty; it needs a header line"),
        ("run.csv", b"PK\x03\x04\0\0\0", "run.csv: this is not a text file"),
        ("run.csv", b"\xff\xfet\0,\0u", "run.csv: not readable as UTF-16 text"),
        ("run.mat", b"nonsense", "run.mat: not a readable MATLAB file"),
        ("run.npz", b"nonsense", "run.npz: not a readable .npz file"),
        ("run.npz", b"", "run.npz: the file is empty"),
        ("run.parquet", b"nonsense", "run.parquet: not a readable Parquet file"),
    ],
)
def test_a_file_of_the_wrong_kind(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=re.escape(message)):
        read_csv(tmp_path / name, RIG)


@pytest.mark.parametrize(
    ("fails", "expected"),
    [
        (lambda: nearest("x", None), TypeError),  # in a line of the library itself
        (lambda: json.loads(None), DataError),  # in one of another library
    ],
)
def test_a_bug_of_a_reader_is_not_taken_for_a_damaged_file(tmp_path, fails, expected):
    table = SimpleNamespace(values=lambda positions: fails(), dated={})
    with pytest.raises(expected, match=None if expected is TypeError else "not a readable ROS file"):
        RecordFile(tmp_path / "run.bag", FileFormat("ROS", (".bag",), None, "export it"), table).values([0])


def test_a_damaged_matlab_7_3_file_is_refused_with_the_remedy(tmp_path):
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b"\0" * 8 + b"\x00\x02IM"
    (tmp_path / "run.mat").write_bytes(header + b"\0" * 400)
    with pytest.raises(DataError, match=r"^run\.mat: not a readable MATLAB file \(.*; save it again with '-v7'"):
        read_csv(tmp_path / "run.mat", RIG)


def test_binary_columns_that_are_no_numbers(tmp_path):
    frame = pd.DataFrame({"time": TIME, "u": DRIVE, "x": ["a", *map(str, ANSWER[1:])]})
    frame.to_parquet(tmp_path / "text.parquet")
    pd.DataFrame({"time": TIME, "u": pd.date_range("2024-01-01", periods=N), "x": ANSWER}).to_parquet(
        tmp_path / "date.parquet"
    )
    np.savez(tmp_path / "matrix.npz", time=TIME, u=DRIVE, x=np.ones((N, 2)))
    np.savez(tmp_path / "length.npz", time=TIME, u=DRIVE, x=ANSWER[1:])
    np.savez(tmp_path / "complex.npz", time=TIME, u=DRIVE, x=ANSWER * 1j)
    np.savez(tmp_path / "input.npz", time=TIME, u=np.where(TIME == 0, np.nan, DRIVE), x=ANSWER)
    cases = {
        "text.parquet": "column 'x' holds text, not real numbers",
        "date.parquet": "column 'u' holds dates; only the time can",
        "matrix.npz": "unused headers: x(:,1), x(:,2); rename one",
        "length.npz": "columns differ in length ('time' 30, 'u' 30, 'x' 29 rows)",
        "complex.npz": "column 'x' holds complex128, not real numbers",
        "input.npz": "input 'u' is empty or NaN at row 1",
    }
    for name, message in cases.items():
        with pytest.raises(DataError, match=re.escape(message)):
            read_csv(tmp_path / name, RIG)


def test_objects_in_an_archive_are_not_unpickled(tmp_path):
    np.savez(tmp_path / "run.npz", time=np.array([object()]), allow_pickle=True)
    with pytest.raises(DataError, match=r"column 'time' holds Python objects, not real numbers"):
        read_csv(tmp_path / "run.npz", FREE, columns={"x": "time"}, sampling_time=0.1)


# --- several files, speed, real records


def test_several_files_are_read_in_order_with_distinct_names(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        good(tmp_path / folder / "run.csv")
    good(tmp_path / "other.csv")
    experiments = read_experiments(
        [tmp_path / "a/run.csv", tmp_path / "other.csv", str(tmp_path / "b/run.csv")], RIG, hold="first"
    )
    assert [e.name for e in experiments] == ["a/run", "other", "b/run"]
    assert {e.hold for e in experiments} == {"first"}
    assert len(read_experiments(tmp_path / "other.csv", RIG)) == 1


def test_the_problems_of_several_files_come_in_one_message(tmp_path):
    paths = [edited(tmp_path / "one.csv", {5: "0.3,a,1e-6,0"}), good(tmp_path / "two.csv"), tmp_path / "three.csv"]
    with pytest.raises(DataError) as error:
        read_experiments(paths, RIG)
    text = str(error.value)
    assert "one.csv: column 'u [V]', line 5" in text
    assert "three.csv: file not found" in text
    assert "two.csv:" not in text
    with pytest.raises(DataError, match="no file to read"):
        read_experiments([], RIG)


@pytest.mark.rest
def test_a_long_text_file_is_read_with_few_calls_a_row(tmp_path):
    read_csv(good(tmp_path / "warm.csv"), RIG)  # imports
    calls = {}
    for rows in (6_506, 65_062):
        noise = np.random.default_rng(3).normal(size=(2, rows))
        path = write(tmp_path / "run.csv", ["t", "u [V]", "x [um]"], [np.round(np.arange(rows) * 0.0016384, 7), *noise])
        with cProfile.Profile() as profile:
            experiment = read_csv(path, RIG)
        calls[rows] = pstats.Stats(profile).total_calls
        np.testing.assert_array_equal(experiment.inputs["u"], noise[0])
    # calls are counted and not seconds, which other work on the machine changes: 18 a row, with lines, quotes, units, time axis and gaps
    assert calls[65_062] - calls[6_506] < 20 * (65_062 - 6_506)


@pytest.mark.parametrize(
    ("file", "model", "rows", "step", "first", "last"),
    [
        ("emps/train.csv", EMPS, 24_841, 1e-3, (2.53862809, 7.45e-06), (-0.95273243, 0.00361505)),
        ("emps/test.csv", EMPS, 24_841, 1e-3, (2.55322418, 7.67021588e-06), (-0.889864816, 0.00374389941)),
        (
            "silverbox/train_multisine.csv",
            BOX,
            65_062,
            0.0016384,
            (-0.0145043307, 0.0364508525),
            (-0.0189534838, -0.00360594108),
        ),
        (
            "silverbox/test_arrow.csv",
            BOX,
            40_475,
            0.0016384,
            (0.00599271702, 0.000858761247),
            (0.0061203233, 0.0021431869),
        ),
        ("cascaded_tanks/train.csv", BOX, 1024, 4.0, (3.25672305, 5.20500496), (3.26145652, 3.68307012)),
        ("cascaded_tanks/test.csv", BOX, 1024, 4.0, (0.976191966, 4.97276265), (0.948047667, 3.71786069)),
    ],
)
def test_real_records_are_regular_and_complete(shared_data, file, model, rows, step, first, last):
    experiment = read_csv(shared_data / file, model)
    assert experiment.rows == rows
    assert experiment.sampling_time == pytest.approx(step, rel=1e-7)
    (u,), (y,) = experiment.inputs.values(), experiment.outputs.values()
    assert ((u[0], y[0]), (u[-1], y[-1])) == (first, last)
    assert not np.isnan(y).any()
    assert experiment.findings == ()


@pytest.mark.parametrize("form", ["csv", "xlsx", "dates", "frame", "sheets", "gaps"])
@pytest.mark.parametrize("where", [[7], [7, 7, 7], [0, 20, len(TIME) - 1]])
def test_rows_that_a_logger_wrote_twice_count_once(tmp_path, form, where):
    """Nothing is carried by a reading that is repeated at its own time; another reading at that time is no repetition."""
    rows = sorted([*range(len(TIME)), *where])
    answer = ANSWER.copy()
    if form == "gaps":
        answer[7] = np.nan
    table = {"time [s]": TIME[rows], "u [V]": DRIVE[rows], "x [m]": answer[rows]}
    path = tmp_path / ("run.xlsx" if form in ("xlsx", "sheets") else "run.csv")
    model = _oscillator("slow", [Input("u", "V")], [Output("x", "m")])
    source = path
    if form in ("csv", "gaps"):
        write(path, list(table), list(table.values()))
    elif form == "dates":
        start = dt.datetime(2024, 3, 1, 8)
        stamps = [(start + dt.timedelta(seconds=float(t))).isoformat() for t in table["time [s]"]]
        lines = (f"{s},{float(u)!r},{float(x)!r}" for s, u, x in zip(stamps, DRIVE[rows], answer[rows], strict=True))
        path.write_text("\n".join(["time,u [V],x [m]", *lines]))
    elif form == "frame":
        source = table
    else:
        book = pytest.importorskip("openpyxl").Workbook()
        names = [list(table)] if form == "xlsx" else [["time [s]", "u [V]"], ["time [s]", "x [m]"]]
        for k, headers in enumerate(names):
            sheet = book.active if not k else book.create_sheet(f"more{k}")
            for row in [headers, *zip(*(map(float, table[h]) for h in headers), strict=True)]:
                sheet.append(list(row))
        book.save(path)
    record = read_csv(source, model)
    assert record.rows == len(TIME)
    np.testing.assert_allclose(record.time, TIME, atol=1e-6)
    np.testing.assert_allclose(record.outputs["x"], answer, rtol=1e-12)
    counts = [f.values["rows"] for f in record.findings if f.code == RecordCode.ROWS_TWICE]
    assert counts == [len(where)] * (2 if form == "sheets" else 1)
    if form != "frame":
        surveyed = survey_file(path)
        assert RecordCode.TIME_UNUSABLE not in {f.code for f in surveyed.findings}


def test_another_reading_at_the_same_time_is_still_asked_about(tmp_path):
    rows = sorted([*range(len(TIME)), 7, 20])
    answer = ANSWER[rows].copy()
    answer[8] += 1e-3
    path = write(tmp_path / "run.csv", ["time [s]", "u [V]", "x [m]"], [TIME[rows], DRIVE[rows], answer])
    with pytest.raises(
        DataError, match=r"time is repeated at lines 10, 24 .*of other readings at the same time make a record for each"
    ):
        read_csv(path, _oscillator("slow", [Input("u", "V")], [Output("x", "m")]))


@pytest.mark.parametrize("first", [0, 3])
def test_a_clock_of_whole_seconds_leads_to_the_rate_at_which_its_rows_come(tmp_path, first):
    time = np.arange(first, first + len(TIME)) // 8
    path = write(tmp_path / "run.csv", ["time [s]", "u [V]", "x [m]"], [time, DRIVE, ANSWER])
    with pytest.raises(
        DataError, match=r"faster than the clock counts, 8 in 1 s, .*--columns=-,u,.*--sampling-time 0\.125\)$"
    ):
        read_csv(path, _oscillator("slow", [Input("u", "V")], [Output("x", "m")]))
    reasons = [f.values["reason"] for f in survey_file(path).findings if f.code is RecordCode.TIME_UNUSABLE]
    assert len(reasons) == 1
    assert "sampling_time=0.125" in reasons[0]


def test_a_file_that_begins_with_the_newest_row_is_to_be_sorted(tmp_path):
    path = write(tmp_path / "run.csv", ["time [s]", "u [V]", "x [m]"], [TIME[::-1], DRIVE[::-1], ANSWER[::-1]])
    with pytest.raises(
        DataError, match=r"time goes back at lines 3, .*the newest row comes first: sort the rows by their time"
    ):
        read_csv(path, _oscillator("slow", [Input("u", "V")], [Output("x", "m")]))
