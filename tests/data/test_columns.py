"""Which column is which signal, where the headers do not say it."""

from __future__ import annotations

import ast
import re
import shlex
from types import SimpleNamespace

import numpy as np
import pytest

from greybox.base import DataError, unit_converter
from greybox.data.columns import find_stamp_unit, merge_mappings, propose_columns
from greybox.data.file_kinds import open_record_file
from greybox.data.findings import RecordCode
from greybox.data.headers import parse_header, read_endings
from greybox.data.read import read_arrays, read_csv
from greybox.data.survey import survey_file
from greybox.model.balance import Balance
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State

CART = Model(
    "cart",
    [State("v", "m/s")],
    [Input("f", "N")],
    [Output("v", "m/s")],
    [Parameter("M", "kg", 1.0)],
    lambda x, u, p: [Balance("force", "N", p.M, "v", drive=u.f)],
)


def propose(tmp_path, headers, mapping=None):
    """Columns and choices for a file with these headers; each choice as signal -> (column, by name)."""
    path = tmp_path / "run.csv"
    rows = "\n".join(",".join(f"{value}" for value in row) for row in np.arange(3.0 * len(headers)).reshape(3, -1))
    path.write_text(f"{','.join(headers)}\n{rows}\n", encoding="utf-8")
    proposal = propose_columns(open_record_file(path).table, CART, mapping)
    return proposal and (proposal[0], {c.signal.name: (c.column, c.matched) for c in proposal[1]})


@pytest.mark.parametrize(
    ("headers", "columns", "choices"),
    [
        (
            ["time", "Kraft [mN]", "Tempo [km/h]"],
            ("time", "Kraft [mN]", "Tempo [km/h]"),
            {"time": ("time", True), "f": ("Kraft [mN]", False), "v": ("Tempo [km/h]", False)},
        ),
        (
            ["time", "a [N]", "b [N]", "v"],  # two of one unit: a person must say which
            ("time", "a [N]", "b [N]", "v"),
            {"time": ("time", True), "f": ("", False), "v": ("v", True)},
        ),
        (
            ["time", "F", "F", "v"],  # a header that stands twice is chosen by its number
            ("time", "2", "3", "v"),
            {"time": ("time", True), "f": ("", False), "v": ("v", True)},
        ),
    ],
)
def test_columns_are_proposed_by_name_and_unit(tmp_path, headers, columns, choices):
    assert propose(tmp_path, headers) == (columns, choices)


def test_a_unit_that_a_name_suggests_is_proposed_with_the_column(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("clock_ms,f_kN,v [km/h]\n0,1,2\n10,2,3\n", encoding="utf-8")
    _, choices = propose_columns(open_record_file(path).table, CART)
    assert [(c.column, c.matched, c.unit) for c in choices] == [
        ("clock_ms", False, "ms"),
        ("f_kN", False, "kN"),
        ("v [km/h]", True, ""),
    ]
    answers = {f"{c.signal.name} [{c.unit}]": c.column for c in choices[:2]}
    assert propose_columns(open_record_file(path).table, CART, answers) is None
    # What is said later of a signal takes the place of what was said of it before.
    assert merge_mappings({"time": "a", "f": "b"}, {"time [ms]": "c"}) == {"f": "b", "time [ms]": "c"}


def test_nothing_is_proposed_where_every_signal_has_its_column(tmp_path):
    assert propose(tmp_path, ["time", "f", "v"]) is None
    assert propose(tmp_path, ["time", "drive", "v"], {"f": "drive"}) is None


def test_a_choice_that_another_file_has_not_is_asked_anew(tmp_path):
    _, choices = propose(tmp_path, ["time", "drive", "v"], {"f": "Kraft [N]"})
    assert choices["f"] == ("", False)


# --- what a header means: stated, asked, told


def record(tmp_path, headers, rows=((0, 1, 2), (10, 2, 3), (20, 4, 5)), **how):
    path = tmp_path / "run.csv"
    lines = [";".join(headers), *(";".join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(lines), encoding="utf-8")
    return read_csv(path, CART, **how)


@pytest.mark.parametrize(
    ("header", "key"),
    [
        ("time_ms", "time [ms]"),
        ("t_ms", "time [ms]"),
        ("Zeit_us", "time [us]"),
        ("time ms", "time [ms]"),
        ("timeMs", "time [ms]"),
        ("clock.min", "time [min]"),
        ("millis", "time [ms]"),
        ("micros()", "time [us]"),
        ("Timestamp-ns", "time [ns]"),
        ("elapsed_hours", "time [h]"),
        ("TIME_MS", "time [ms]"),
        ("tms", "time [ms]"),
        ("time_us_raw", "time [us]"),
        ("ms since start", "time [ms]"),
        ("time|ms|", "time [ms]"),
    ],
)
def test_a_time_that_only_ends_like_a_unit_is_asked_for_and_the_answer_works_as_typed(tmp_path, header, key):
    with pytest.raises(DataError) as error:
        record(tmp_path, [header, "f", "v"])
    (answer,) = re.findall(r"write columns=(\{.*?\})", str(error.value))
    columns = ast.literal_eval(answer)
    assert f"--column {shlex.quote(f'{key}={header}')}" in str(error.value)
    assert columns == {key: header}
    unit = key.partition("[")[2].strip("]")
    expected = unit_converter(unit, "s")([0, 10, 20])
    np.testing.assert_allclose(record(tmp_path, [header, "f", "v"], columns=columns).time, expected)
    # What a person chose without its unit is asked as well.
    with pytest.raises(DataError, match=re.escape(f"write columns={answer}")):
        record(tmp_path, [header, "f", "v"], columns={"time": header})


@pytest.mark.parametrize(
    ("header", "name", "factor"),
    [
        ("t/ms", "time", 1e-3),
        ("t in ms", "time", 1e-3),
        ("time, min", "time", 60.0),
        ("time(ms)", "time", 1e-3),
        ("time <us>", "time", 1e-6),
        ("Time {ms}", "time", 1e-3),
        ("time [in ms]", "time", 1e-3),
        ("[ms] time", "time", 1e-3),
    ],
)
def test_a_time_whose_unit_is_stated_in_any_notation_is_read(tmp_path, header, name, factor):
    np.testing.assert_allclose(record(tmp_path, [header, "f", "v"]).time, factor * np.array([0, 10, 20]), rtol=1e-12)


@pytest.mark.parametrize(
    ("header", "key", "factor"),
    [
        ("v_mm/s", "v [mm/s]", 1e-3),
        ("speed_kmh", "v [km/h]", 1 / 3.6),
        ("Tempo km/h", "v [km/h]", 1 / 3.6),
        ("v.cm/s", "v [cm/s]", 1e-2),
        ("wheel kmh left", "v [km/h]", 1 / 3.6),
        ("v (km/h) front", "v [km/h]", 1 / 3.6),
    ],
)
def test_a_signal_that_ends_like_a_unit_is_asked_for(tmp_path, header, key, factor):
    with pytest.raises(DataError, match=re.escape(f"{{{key!r}: {header!r}}}")):
        record(tmp_path, ["time", "f", header], columns={"v": header})
    told = record(tmp_path, ["time", "f", header], columns={key: header})
    np.testing.assert_allclose(told.outputs["v"], factor * np.array([2, 3, 5]), rtol=1e-12)
    as_it_is = record(tmp_path, ["time", "f", header], columns={"v [m/s]": header})
    np.testing.assert_array_equal(as_it_is.outputs["v"], [2, 3, 5])


def test_a_unit_of_another_quantity_is_asked_for_where_a_person_chose_the_column(tmp_path):
    for header in ("PWM_%", "% PWM", "n_rpm", "U/mV"):
        with pytest.raises(DataError, match=re.escape(f"{{'f [N]': {header!r}}}")):
            record(tmp_path, ["time", header, "v"], columns={"f": header})
        told = record(tmp_path, ["time", header, "v"], columns={"f [N]": header})
        np.testing.assert_array_equal(told.inputs["f"], [1, 2, 4])
    # A minimum, a mean and a letter are words of names.
    for header in ("f_min", "f_bar", "f_A"):
        np.testing.assert_array_equal(
            record(tmp_path, ["time", header, "v"], columns={"f": header}).inputs["f"], [1, 2, 4]
        )


@pytest.mark.parametrize(
    ("name", "unit", "asked"),
    [
        ("x_mm", "mm", False),
        ("x_mm", "m", True),
        ("v_s", "m/s", False),
        ("u_A", "V", False),
        ("p_bar", "bar", False),
        ("phi_r", "rad", False),
    ],
)
def test_a_signal_of_the_model_that_is_called_so_is_asked_only_where_its_unit_differs(tmp_path, name, unit, asked):
    model = Model(
        "named",
        [State(name, unit)],
        [],
        [Output(name, unit)],
        [Parameter("tau", "s", 1.0)],
        lambda x, u, p: [Balance("decay", unit, p.tau, name, loss=-x[name])],
    )
    path = tmp_path / "run.csv"
    path.write_text(f"time [s],{name}\n0,4\n1,3\n2,1\n", encoding="utf-8")
    if asked:
        with pytest.raises(DataError, match=re.escape(f"{{'{name} [mm]': '{name}'}}")):
            read_csv(path, model)
        np.testing.assert_allclose(
            read_csv(path, model, columns={f"{name} [mm]": name}).outputs[name], [4e-3, 3e-3, 1e-3]
        )
    else:
        np.testing.assert_array_equal(read_csv(path, model).outputs[name], [4, 3, 1])


def test_brackets_within_a_header_state_the_unit(tmp_path):
    read = record(tmp_path, ["time [ms] raw", "f", "v [km/h] (front)"], columns={"time": 1, "v": "v (front)"})
    np.testing.assert_allclose(read.time, [0, 0.01, 0.02])
    np.testing.assert_allclose(read.outputs["v"], np.array([2, 3, 5]) / 3.6)


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("/arm.joint[2]", "/arm.joint[2]", ""),
        ("/arm.joint[2] [rad]", "/arm.joint[2]", "rad"),
        ("a[3][4] [V]", "a[3][4]", "V"),
        ("k[1]", "k", "1"),
        ("log{2}.x", "log{2}.x", ""),
        ("data(:,1)", "data(:,1)", ""),
        ("p(bar(g))", "p", "bar(g)"),
    ],
)
def test_an_index_is_no_unit(header, name, unit):
    column = parse_header(header, 0)
    assert (column.name, column.unit) == (name, unit) and not [r for r in read_endings(column) if r.unit]


def test_what_a_person_says_of_a_unit_goes_before_the_header_and_is_noted(tmp_path):
    told = record(tmp_path, ["time [s]", "f [N]", "v [1/s]"], columns={"v [km/h]": "v"})
    np.testing.assert_allclose(told.outputs["v"], np.array([2, 3, 5]) / 3.6)
    assert [f.values["columns"] for f in told.findings if f.code is RecordCode.UNITS_READ] == [
        [["v [1/s]", "km/h", "told"]]
    ]


def test_all_columns_with_a_doubtful_unit_come_in_one_message(tmp_path):
    with pytest.raises(DataError, match="3 problems") as error:
        record(tmp_path, ["time [8bits]", "f [pi]", "v [foo]"])
    for key in ("'time [s]'", "'f [N]'", "'v [m/s]'"):
        assert key in str(error.value)
    with pytest.raises(DataError, match=r"write 'time \[ms\]' for 'time_ms' in columns"):
        record(tmp_path, ["a", "b", "c"], rows=[(0, 1, 2)] * 3, columns=["time_ms", "f", "v"])


@pytest.mark.parametrize(("unit", "factor"), [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)])
@pytest.mark.parametrize("start", [1.1e9, 1711848600.0, 2.2e9])
def test_stamps_since_1970_are_known_by_their_size(tmp_path, unit, factor, start):
    stamps = [round(s / factor) for s in (start, start + 10, start + 20)]
    rows = [(stamp, k, k * k) for k, stamp in enumerate(stamps)]
    record_of = record(tmp_path, ["time", "f", "v"], rows)
    np.testing.assert_allclose(np.diff(record_of.time), 10, rtol=1e-6)
    (note,) = [f.values["columns"] for f in record_of.findings if f.code is RecordCode.UNITS_READ]
    assert note == [["time", unit, "size"]]
    if unit != "s":
        with pytest.raises(DataError, match=re.escape(f"'time [{unit}]'")):
            record(tmp_path, ["time [s]", "f", "v"], rows)


def test_counters_are_no_stamps():
    for values in ([0.0, 10.0], [5e11, 6e11], [3e9, 4e9], [np.nan, np.nan], []):
        assert find_stamp_unit(np.array(values)) == ""


def test_the_survey_proposes_what_a_model_and_the_reader_accept(tmp_path):
    path = tmp_path / "run.csv"
    headers = ["clock_ms", "enc [inc]", "raw [foo]", "T [°C]", "n [U/min]", "s_mm", "g [pi]"]
    rows = [";".join(str((k + 1) * (j + 2) % 7 if j else 10 * k) for j in range(7)) for k in range(8)]
    path.write_text("\n".join([";".join(headers), *rows]), encoding="utf-8")
    survey = survey_file(path)
    assert {s.header: s.model_unit for s in survey.signals[1:]} == dict(
        zip(headers[1:], ["1", "1", "K", "turn/min", "mm", "1"], strict=True)
    )
    assert survey.columns["time [ms]"] == "clock_ms"
    outputs = [Output(s.name, s.model_unit, lambda x, u, p: x.q) for s in survey.signals[1:]]
    model = SimpleNamespace(name="any", inputs=(), outputs=outputs, stated_parameters=())
    arrays = read_arrays(path, model, columns=dict(survey.columns))
    np.testing.assert_allclose(arrays.time, 0.01 * np.arange(8))


@pytest.mark.parametrize(
    ("header", "cell_format", "value", "share"),
    [
        ("u", "0%", 0.5, 0.5),
        ("u [%]", "0.0%", 0.5, 0.5),
        ("u (%)", "#,##0.00%", 0.25, 0.25),
        ("u [%]", "General", 50, 0.5),
        ("u [%]", '0.0"%"', 50, 0.5),
        ("u [1]", "0%", 0.5, 0.5),
        ("u [%]", r"0\%", 50, 0.5),
    ],
)
@pytest.mark.parametrize("unit", ["1", "%"])
def test_cells_that_are_shown_as_percent_are_percent(tmp_path, header, cell_format, value, share, unit):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["time [s]", header, "x"])
    for k in range(4):
        book.active.append([k, None if k == 1 else value * (k + 1), k])
    for row in range(2, 6):
        book.active.cell(row, 2).number_format = cell_format
    book.save(tmp_path / "run.xlsx")
    model = SimpleNamespace(name="any", inputs=(), outputs=(Output("u", unit), Output("x", "V")), stated_parameters=())
    read = read_arrays(tmp_path / "run.xlsx", model).outputs["u"]
    np.testing.assert_allclose(read[[0, 2, 3]], np.array([1, 3, 4]) * share * (100 if unit == "%" else 1))


@pytest.mark.parametrize("empty", [0, 25, 60])
def test_a_percent_format_is_seen_however_late_its_numbers_begin(tmp_path, empty):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["time [s]", "u", "x"])
    for k in range(70):
        book.active.append([k, None if k < empty else 0.25, k])
        book.active.cell(k + 2, 2).number_format = "General" if k < empty else "0%"
    book.save(tmp_path / "run.xlsx")
    model = SimpleNamespace(name="any", inputs=(), outputs=(Output("u", "%"), Output("x", "V")), stated_parameters=())
    assert read_arrays(tmp_path / "run.xlsx", model).outputs["u"][-1] == pytest.approx(25)


# Fields of time, u and x, and what a reader makes of them: u (V), or the fields that are refused and why.
DECIMAL_SIGNS = {
    "points between thousands": (
        ("0,5", "1.250", "0,1"),
        ("1,5", "1.251", "0,2"),
        "'1.250', '1.251' are not numbers; write {w}",
    ),
    "points beside whole numbers": (
        ("0,5", "950", "0,1"),
        ("1,5", "1.050", "0,2"),
        "'1.050' is not a number; write {w}",
    ),
    "points and decimal commas": (("0", "950,6", "1"), ("1", "1.050,3", "2"), "'1.050,3' is not a number; write {w}"),
    "in all rows": (("0", "1.050,6", "1"), ("1", "1.050,3", "2"), "'1.050,6', '1.050,3' are not numbers; write {w}"),
    "commas between thousands": (
        ("0.5", "1,250", "0.1"),
        ("1.5", "950", "0.2"),
        "write decimal points in all rows, and {w}",
    ),
    "decimal commas": (("0,5", "1,25", "0,1"), ("1,5", "-0,75", "0,2"), [1.25, -0.75]),
    "decimal points": (("0.5", "1.250", "0.1"), ("1.5", "1.251", "0.2"), [1.25, 1.251]),
    "points alone": (("0", "1.250", "1"), ("1", "1.251", "2"), [1.25, 1.251]),
    "points in the longer numbers": (("0", "980", "1"), ("1", "13.400", "2"), "write {w}"),
    "points in negative numbers": (("0", "-13.400", "1"), ("1", "-980", "2"), "write {w}"),
    "points beside a zero": (("0", "0", "1"), ("1", "1.250", "2"), "write {w}"),
    "commas in the longer numbers": (("0", "980", "1"), ("1", "13,400", "2"), "{w}"),
    "points beside longer numbers": (("0", "1980", "1"), ("1", "13.400", "2"), [1980.0, 13.4]),
    "zeros left out": (("0", "980", "1"), ("1", "13.4", "2"), [980.0, 13.4]),
    "zeros left out of others": (("0.5", "980", "1"), ("1", "13.401", "2"), [980.0, 13.401]),
    "three decimals below one": (("0,5", "0,125", "0,1"), ("1,5", "0,250", "0,2"), [0.125, 0.25]),
    "three decimals beside others": (("0,5", "1,125", "0,1"), ("1,5", "2,250", "0,2"), [1.125, 2.25]),
}


@pytest.mark.parametrize("wanted", ["u and x", "u alone"])
@pytest.mark.parametrize("kind", ["xlsx", "csv"])
@pytest.mark.parametrize("case", DECIMAL_SIGNS)
def test_texts_of_a_workbook_have_the_decimal_sign_of_the_table_as_those_of_csv(tmp_path, case, kind, wanted):
    *rows, read = DECIMAL_SIGNS[case]
    path = tmp_path / f"run.{kind}"
    table = [("time [s]", "u [V]", "x [V]"), *rows]
    if kind == "csv":
        path.write_text("\n".join(map(";".join, table)))
    else:
        book = pytest.importorskip("openpyxl").Workbook()
        for row in table:
            book.active.append(row)
        book.save(path)
    outputs = (Output("u", "V"), Output("x", "V"))[: 2 if wanted == "u and x" else 1]
    model = SimpleNamespace(name="any", inputs=(), outputs=outputs, stated_parameters=())
    reason = "the number without marks between its thousands"
    if isinstance(read, list):
        assert read_arrays(path, model).outputs["u"].tolist() == read
    else:
        with pytest.raises(DataError, match=r"column 'u \[V\]'") as refused:
            read_arrays(path, model)
        assert read.format(w=reason) in str(refused.value)
    # Looked at without a model, the column is not passed over, nor shown with wrong numbers.
    notes = " ".join(map(str, survey_file(path).findings))
    assert (reason in notes) == (not isinstance(read, list) and "{w}" in read)


@pytest.mark.parametrize("kind", ["xlsx", "csv", "frame"])
@pytest.mark.parametrize(
    "headers",
    [("Zeit [s]", "Druck [mbar]"), ("t [s]", "Raumlufttemperatur [mbar]"), ("t [s]", "Pression d'huile [mbar]")],
)
def test_points_in_a_table_of_another_language_are_asked_about(tmp_path, kind, headers):
    table = [headers, ("0", "1.250"), ("1", "13.400"), ("2", "9.810")]
    if kind == "frame":
        pandas = pytest.importorskip("pandas")
        path = tmp_path / "run.parquet"
        source = pandas.DataFrame(table[1:], columns=list(headers))
    elif kind == "csv":
        source = path = tmp_path / "run.csv"
        path.write_text("\n".join(map(";".join, table)), encoding="utf-8")
    else:
        book = pytest.importorskip("openpyxl").Workbook()
        for row in table:
            book.active.append(row)
        source = path = tmp_path / "run.xlsx"
        book.save(path)
    model = Model(
        "vessel",
        states=[State("p", "Pa", 1e5)],
        inputs=[],
        outputs=[Output("p", "Pa")],
        parameters=[Parameter("tau", "s", 1.0, (1e-3, 1e3))],
        balances=lambda x, u, p: [Balance("b", "Pa", p.tau, "p", decay=-x.p)],
    )
    names = {"time [s]": headers[0], "p": headers[1]}
    with pytest.raises(DataError, match="a point between thousands") as asked:
        read_csv(source, model, columns=names)
    assert f"'p [1000*mbar]': \"{headers[1]}\"" in str(asked.value) or f"'p [1000*mbar]': {headers[1]!r}" in str(
        asked.value
    )
    for unit, scale in (("1000*mbar", 1e5), ("mbar", 1e2)):
        told = read_csv(source, model, columns={"time [s]": headers[0], f"p [{unit}]": headers[1]})
        np.testing.assert_allclose(told.outputs["p"], scale * np.array([1.25, 13.4, 9.81]))
    if kind != "frame":
        assert "may stand between thousands" in " ".join(map(str, survey_file(path).findings))


@pytest.mark.parametrize("header", ["frame", "Sample", "index", "Frame No", "n", "idx", "step_nr"])
def test_a_time_that_counts_rows_is_asked_what_one_is(tmp_path, header):
    path = tmp_path / "run.csv"
    path.write_text(f"{header},x [V]\n0,100\n1,120\n2,140\n")
    model = SimpleNamespace(name="any", inputs=(), outputs=(Output("x", "V"),), stated_parameters=())
    with pytest.raises(DataError, match=r"a unit of another quantity.*if one is 0\.01 s") as asked:
        read_arrays(path, model, columns={"time": header})
    assert f"'time [0.01*s]': {header!r}" in str(asked.value)
    for key, step in (("time [s/30]", 1 / 30), ("time [0.01*s]", 0.01), ("time [s]", 1.0)):
        assert read_arrays(path, model, columns={key: header}).time == pytest.approx(step * np.arange(3))
    # Whoever names all columns says it in the same words.
    named = read_arrays(path, model, columns=["time [s/30]", "x [0.1 V]"])
    assert named.time[1] == pytest.approx(1 / 30) and named.outputs["x"][0] == pytest.approx(10)


@pytest.mark.parametrize("header", ["adc_counts", "lsb", "Encoder Ticks", "inc_raw", "ADC0"])
def test_a_column_of_counts_is_no_reading_in_a_unit(tmp_path, header):
    (tmp_path / "run.csv").write_text(f"time [s],{header}\n0,100\n1,120\n2,140\n")

    def read(unit, key):
        model = SimpleNamespace(name="any", inputs=(), outputs=(Output("x", unit),), stated_parameters=())
        return read_arrays(tmp_path / "run.csv", model, columns={key: header}).outputs["x"]

    with pytest.raises(DataError, match="a unit of another quantity"):
        read("V", "x")
    np.testing.assert_array_equal(read("V", "x [V]"), [100, 120, 140])
    np.testing.assert_array_equal(read("1", "x"), [100, 120, 140])


@pytest.mark.parametrize(("unit", "told"), [("rad", "turn/4096"), ("m", "0.001*m"), ("kPa", "0.001*kPa")])
def test_what_one_count_is_must_be_said(tmp_path, unit, told):
    (tmp_path / "run.csv").write_text("time [s],ENC [counts]\n0,100\n1,120\n2,140\n")
    model = SimpleNamespace(name="any", inputs=(), outputs=(Output("x", unit),), stated_parameters=())
    with pytest.raises(DataError, match="say what one count is") as refused:
        read_arrays(tmp_path / "run.csv", model, columns={"x": "ENC [counts]"})
    # The answer that is proposed is one that works.
    key = re.search(r"'(x \[.*?\])': 'ENC", str(refused.value))[1]
    assert key == f"x [{told}]"
    read = read_arrays(tmp_path / "run.csv", model, columns={key: "ENC [counts]"}).outputs["x"]
    one = 2 * np.pi / 4096 if unit == "rad" else 0.001
    np.testing.assert_allclose(read, one * np.array([100, 120, 140]), rtol=1e-12)


def test_columns_that_a_look_at_a_file_proposes_are_read_by_a_model_in_other_units(tmp_path):
    (tmp_path / "run.csv").write_text("t_ms,p_bar,angle_deg\n0,1,90\n10,2,180\n20,2,90\n")
    proposed = survey_file(tmp_path / "run.csv").columns
    assert set(proposed) == {"time [ms]", "p_bar [bar]", "angle_deg [deg]"}
    outputs = (Output("p_bar", "Pa"), Output("angle_deg", "rad"))
    model = SimpleNamespace(name="any", inputs=(), outputs=outputs, stated_parameters=())
    read = read_arrays(tmp_path / "run.csv", model, columns=proposed)
    np.testing.assert_allclose(read.outputs["p_bar"], [1e5, 2e5, 2e5])
    np.testing.assert_allclose(read.outputs["angle_deg"], [np.pi / 2, np.pi, np.pi / 2])


@pytest.mark.parametrize(
    "header", ["PWM_%", "duty [%]", "PWM (%)", "Tastgrad in %", "valve pct [pct]", "Stellgrad [Prozent]"]
)
def test_a_share_in_per_cent_is_asked_of_what(tmp_path, header):
    path = tmp_path / "run.csv"
    path.write_text(f"time [s],{header},v [m/s]\n0,50,0\n1,100,1\n2,0,2\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"if 100 % is 12 N") as asked:
        read_csv(path, CART, columns={"f": header})
    assert f"'f [0.12*N]': {header!r}" in str(asked.value)
    assert read_csv(path, CART, columns={"f [0.12*N]": header}).inputs["f"].tolist() == [6.0, 12.0, 0.0]


@pytest.mark.parametrize(
    ("headers", "units"),
    [
        (("Time [MS]", "x [mv]"), ("ms", "mV")),
        (("t (mS)", "x [MV]"), ("ms", "mV")),
        (("time [S]", "x [v]"), ("s", "V")),
    ],
)
def test_a_unit_in_other_capitals_is_asked_for_in_the_units_that_it_may_be(tmp_path, headers, units):
    path = tmp_path / "run.csv"
    path.write_text(",".join(headers) + "\n0,1000\n20,3000\n40,2000\n")
    model = SimpleNamespace(name="any", inputs=(), outputs=(Output("x", "V"),), stated_parameters=())
    with pytest.raises(DataError, match=r"capital and small letters") as asked:
        read_arrays(path, model)
    # What the message says to type is right, and does not take the numbers in the unit of the model.
    keys = [f"{name} [{unit}]" for name, unit in zip(("time", "x"), units, strict=True)]
    columns = {k: h for k, h in zip(keys, headers, strict=True) if f"{{{k!r}: {h!r}}}" in str(asked.value)}
    read = read_arrays(path, model, columns=columns)
    np.testing.assert_allclose(read.time, np.array([0, 20, 40]) * (1e-3 if units[0] == "ms" else 1))


@pytest.mark.parametrize("unit", ["MS", "ticks", "°C"])
def test_a_look_at_a_file_takes_no_time_in_seconds_whose_unit_is_another(tmp_path, unit):
    path = tmp_path / "run.csv"
    path.write_text(f"time [{unit}],x\n0,1\n20,3\n40,2\n")
    survey = survey_file(path)
    (reason,) = [f.values["reason"] for f in survey.findings if f.code is RecordCode.TIME_UNUSABLE]
    assert f"'time [{unit}]'" in reason and "write columns=" in reason
    assert all(s.step is None for s in survey.signals)
    told = survey_file(path, columns={"time [10 ms]": f"time [{unit}]"})
    assert {s.step for s in told.signals} == {0.2} and not told.findings
