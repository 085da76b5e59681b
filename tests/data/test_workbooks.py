"""Workbooks mean what their cells hold: stamps finer than a millisecond, headers that are alike, formulas without values, wrong sizes."""

import datetime as dt
import re
import zipfile

import numpy as np
import pytest

from greybox import Balance, Input, Model, Output, Parameter, State, read_csv
from greybox.base import DataError

openpyxl = pytest.importorskip("openpyxl")
mac = pytest.importorskip("openpyxl.utils.datetime").CALENDAR_MAC_1904

LAG = Model(
    "lag",
    [State("x", "m")],
    [Input("u", "V")],
    [Output("x", "m")],
    [Parameter("T", "s", 1.0, (0.01, 100.0)), Parameter("K", "m/V", 1.0, (0.01, 100.0))],
    lambda x, u, p: [Balance("b", "m", p.T, "x", fall=-x.x, drive=p.K * u.u)],
)
N = 40
DRIVE = np.repeat([0.0, 1.0], N // 2).tolist()
ANSWER = np.round(np.sin(0.1 * np.arange(N)), 4).tolist()


def write_book(path, times, head=("time", "u [V]", "x [m]"), shown="General", epoch=None):
    book = openpyxl.Workbook()
    book.epoch = epoch or book.epoch
    page = book.active
    page.append(list(head))
    for row in zip(times, DRIVE, ANSWER, *[ANSWER[::-1]] * (len(head) - 3), strict=True):
        page.append(row)
    for (cell,) in page.iter_rows(min_row=2, max_col=1):
        cell.number_format = shown
    book.save(path)
    return path


@pytest.mark.parametrize("step", [0.00025, 0.0015, 1 / 3])
@pytest.mark.parametrize(
    ("start", "shown"), [(0.4, "h:mm:ss"), (0.0, "[h]:mm:ss"), (45413.3, "yyyy-mm-dd hh:mm:ss.000")]
)
def test_stamps_finer_than_a_millisecond_are_kept(tmp_path, start, shown, step):
    times = [start + k * step / 86400 for k in range(N)]
    record = read_csv(write_book(tmp_path / "run.xlsx", times, shown=shown), LAG)
    np.testing.assert_allclose(record.time, step * np.arange(N), rtol=0, atol=2e-6)
    assert not {str(f.code) for f in record.findings} & {"time_jitter", "time_rows_missing", "time_rounded"}


@pytest.mark.parametrize("epoch", [None, mac])
@pytest.mark.parametrize(("start", "step"), [(0.99, 60.0), (0.0, 1.5 * 86400), (0.0, 3600.0)])
def test_a_time_of_day_goes_on_behind_midnight_in_either_count_of_days(tmp_path, epoch, start, step):
    times = [start + k * step / 86400 for k in range(N)]
    record = read_csv(write_book(tmp_path / "run.xlsx", times, shown="h:mm:ss", epoch=epoch), LAG)
    np.testing.assert_allclose(record.time, step * np.arange(N), rtol=0, atol=1e-6)


def test_a_date_of_1904_s_count_is_the_date_that_is_shown(tmp_path):
    times = [dt.datetime(2024, 5, 1, 7, 12) + dt.timedelta(seconds=k) for k in range(N)]
    record = read_csv(write_book(tmp_path / "run.xlsx", times, shown="d.m.yyyy hh:mm:ss", epoch=mac), LAG)
    assert str(record.findings[0].values["start"]) == "2024-05-01 07:12:00" and record.time[-1] == N - 1


def test_two_columns_of_one_header_are_refused_as_in_a_text(tmp_path):
    path = write_book(tmp_path / "run.xlsx", range(N), ("time [s]", "u [V]", "x [m]", "x [m]"))
    with pytest.raises(DataError, match="output 'x' \\[m\\] has 2 columns"):
        read_csv(path, LAG)
    np.testing.assert_array_equal(read_csv(path, LAG, columns={"x": 4}).outputs["x"], ANSWER[::-1])


@pytest.mark.parametrize("part", ["all", "half"])
@pytest.mark.parametrize("column", ["time", "x"])
def test_formulas_that_nobody_has_computed_are_no_gaps(tmp_path, column, part):
    path = write_book(tmp_path / "run.xlsx", range(N), ("time [s]", "u [V]", "x [m]"))
    book = openpyxl.load_workbook(path)
    for row in range(2, N + 2, 1 if part == "all" else 2):
        cell = book.active.cell(row, ["time", "u", "x"].index(column) + 1)
        cell.value = f"=1*{cell.value}"
    book.save(path)
    with pytest.raises(DataError, match=f"column '{column} .*'=1\\*.* has not computed its formulas"):
        read_csv(path, LAG)


@pytest.mark.parametrize("size", ["A1", "A1:C31"])
def test_a_sheet_is_as_large_as_its_cells_say(tmp_path, size):
    plain = write_book(tmp_path / "run.xlsx", range(N), ("time [s]", "u [V]", "x [m]"))
    with zipfile.ZipFile(plain) as source, zipfile.ZipFile(tmp_path / "other.xlsx", "w") as target:
        for name in source.namelist():
            data = source.read(name)
            if name.endswith("sheet1.xml"):
                data = re.sub(rb'<dimension ref="[^"]*"', f'<dimension ref="{size}"'.encode(), data)
            target.writestr(name, data)
    assert read_csv(tmp_path / "other.xlsx", LAG).rows == N


def test_of_several_rows_below_the_names_those_of_units_count(tmp_path):
    book = openpyxl.Workbook()
    for row in (["time", "u", "x"], ["Zeit", "Spannung", "Weg"], ["ms", "mV", "mm"]):
        book.active.append(row)
    for row in zip(range(N), DRIVE, ANSWER, strict=True):
        book.active.append([1000 * value for value in row])
    book.save(tmp_path / "run.xlsx")
    record = read_csv(tmp_path / "run.xlsx", LAG)
    np.testing.assert_allclose(
        [record.time[-1], record.inputs["u"][-1], record.outputs["x"][-1]], [N - 1, 1, ANSWER[-1]]
    )
