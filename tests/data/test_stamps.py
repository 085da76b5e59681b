"""Dates and times of day: every way to write them gives the seconds that the calendar of Python gives."""

from __future__ import annotations

import datetime as dt
import json
from itertools import pairwise
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from greybox import Balance, Input, Model, Output, Parameter, State, read_csv, read_experiments
from greybox.base import DataError
from greybox.data.findings import RecordCode
from greybox.data.survey import survey_file

openpyxl = pytest.importorskip("openpyxl")
pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")

LAG = Model(
    "lag",
    states=[State("x", "V")],
    inputs=[Input("u", "V")],
    outputs=[Output("x", "V")],
    parameters=[Parameter("tau", "s", 1.0, (1e-4, 1e4))],
    balances=lambda x, u, p: [Balance("b", "V", p.tau, "x", drive=u.u, decay=-x.x)],
)
N = 30
DRIVE = (np.arange(N) // 5 % 2).astype(float)
ANSWER = np.sin(np.arange(N) / 4)
START = dt.datetime(2023, 12, 31, 23, 58, 7, 250000)
STEPS = [13.5 * k for k in range(N)]  # over midnight and the new year
MOMENTS = [START + dt.timedelta(seconds=s) for s in STEPS]
MONTHS = ["Jan", "Feb", "Mrz", "Apr", "Mai", "Jun", "Jul", "Aug", "Sep", "Okt", "Nov", "Dez"]


def write_table(path, stamps, header="time", separator=","):
    rows = [f"{s}{separator}{u}{separator}{x:.6f}" for s, u, x in zip(stamps, DRIVE, ANSWER, strict=True)]
    path.write_text("\n".join([separator.join([header, "u [V]", "x [V]"]), *rows]) + "\n", encoding="utf-8")
    return path


def codes(record):
    return {f.code for f in record.findings}


WAYS = {
    "iso": lambda m: m.isoformat(),
    "pandas": str,
    "zone": lambda m: m.isoformat() + "+05:30",
    "zulu": lambda m: f"{m:%Y%m%dT%H%M%S}.{m:%f}Z",
    "nanoseconds": lambda m: f"{m:%Y-%m-%d %H:%M:%S}.{m:%f}000 UTC",
    "german": lambda m: f"{m:%d.%m.%Y %H:%M:%S}.{m:%f}",
    "short german": lambda m: f"{m:%d.%m.%y} {m:%H:%M:%S}.{m:%f}",
    "german month": lambda m: f"{m.day}. {MONTHS[m.month - 1]} {m:%Y %H:%M:%S}.{m:%f}",
    "matlab": lambda m: f"{m:%d-%b-%Y %H:%M:%S}.{m:%f}",
    "american": lambda m: f"{m.month}/{m.day}/{m:%Y %I:%M:%S}.{m:%f} {m:%p}",
    "british": lambda m: f"{m:%d/%m/%Y %H:%M:%S}.{m:%f}",
    "slashes": lambda m: f"{m:%Y/%m/%d %H:%M:%S}.{m:%f}",
    "milliseconds behind a colon": lambda m: f"{m:%H:%M:%S}:{m.microsecond // 1000:03d}",
    "time of day": lambda m: f"{m:%H:%M:%S}.{m:%f}",
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("header", ["time", "time [min]", "Zeit", ""])
def test_every_way_to_write_a_stamp_gives_the_same_seconds(tmp_path, way, header):
    path = write_table(tmp_path / "run.csv", map(WAYS[way], MOMENTS), header)
    record = read_csv(path, LAG)
    np.testing.assert_allclose(record.time, STEPS, rtol=0, atol=1e-9)
    assert RecordCode.DATES_READ in codes(record)
    assert RecordCode.UNITS_ASSUMED not in codes(record)
    assert (RecordCode.MIDNIGHT_PASSED in codes(record)) == ("time of day" in way or "colon" in way)
    survey = survey_file(path)
    assert survey.signals[0].use == "time"
    assert survey.signals[0].stop == pytest.approx(STEPS[-1], abs=1e-9)


@pytest.mark.parametrize("header", ["time", "time [s]", "timestamp"])
@pytest.mark.parametrize(("form", "step"), [("%Y%m%d%H%M%S", 13), ("%Y%m%d%H%M", 420), ("%Y%m%d", 86400)])
def test_dates_of_one_number_are_read(tmp_path, form, step, header):
    start = dt.datetime(2023, 12, 23, 23, 58)
    path = write_table(
        tmp_path / "run.csv", [f"{start + dt.timedelta(seconds=step * k):{form}}" for k in range(N)], header
    )
    record = read_csv(path, LAG, columns={"time": header})
    np.testing.assert_allclose(record.time, step * np.arange(N), rtol=0, atol=1e-9)
    assert RecordCode.DATES_READ in codes(record)
    assert survey_file(path).signals[0].stop == pytest.approx(step * (N - 1))
    # A counter passes through numbers that are no dates.
    counter = read_csv(write_table(tmp_path / "c.csv", [int(20231123 + 7 * k) for k in range(N)], "time"), LAG)
    assert counter.duration == 7 * (N - 1)


def test_a_table_of_dates_without_a_header_is_read_whole(tmp_path):
    path = tmp_path / "run.csv"
    write_table(path, map(str, MOMENTS))
    path.write_text(path.read_text(encoding="utf-8").split("\n", 1)[1], encoding="utf-8")
    record = read_csv(path, LAG, columns=["time", "u", "x"])
    assert record.rows == N
    np.testing.assert_allclose(record.time, STEPS, atol=1e-9)


@pytest.mark.parametrize("separator", ["\t", ";", " "])
def test_day_and_time_of_day_in_two_columns_are_one_stamp(tmp_path, separator):
    moments = [START + dt.timedelta(hours=20 * k) for k in range(N)]
    path = tmp_path / "run.txt"
    head = separator.join(["Datum", "Uhrzeit", "u", "x"])
    rows = [
        separator.join([f"{m:%d.%m.%Y}", f"{m:%H:%M:%S}.{m:%f}", f"{u}", f"{x:.5f}"])
        for m, u, x in zip(moments, DRIVE, ANSWER, strict=True)
    ]
    path.write_text("\n".join([head, *rows]), encoding="utf-8")
    record = read_csv(path, LAG)
    np.testing.assert_allclose(record.time, 72000.0 * np.arange(N), atol=1e-9)
    assert RecordCode.COLUMNS_IGNORED not in codes(record)


def test_dates_that_can_be_read_both_ways_are_refused_until_somebody_says_which(tmp_path):
    moments = [dt.datetime(2024, 4, 3, 12) + dt.timedelta(days=k) for k in range(9)]
    rows = [f"{m:%m/%d/%Y %H:%M},{u},{x:.5f}" for m, u, x in zip(moments, DRIVE, ANSWER, strict=False)]
    for header in ("time", "time [dd/mm/yyyy]", "time [mm/dd/yyyy]"):
        (tmp_path / "run.csv").write_text("\n".join([f"{header},u,x", *rows]), encoding="utf-8")
        if header == "time":
            with pytest.raises(DataError, match="'04/03/2024 12:00' day/month or month/day"):
                read_csv(tmp_path / "run.csv", LAG)
        else:
            order = "%d/%m/%Y" if "dd/mm" in header else "%m/%d/%Y"
            days = [dt.datetime.strptime(f"{m:%m/%d/%Y}", order) for m in moments]
            seconds = [(day - days[0]).total_seconds() for day in days]
            np.testing.assert_allclose(read_csv(tmp_path / "run.csv", LAG).time, seconds)
    survey = survey_file(write_table(tmp_path / "both.csv", [f"03/04/2024 10:{k:02d}" for k in range(N)]))
    assert any(f.code == RecordCode.TIME_UNUSABLE and "day/month" in f.values["reason"] for f in survey.findings)


@pytest.mark.parametrize(
    "rows",
    [
        ["2024-03-01 10:00:00", "10:00:05"],
        ["2024-03-01 10:00:00", "2024-03-01 10:00:05Z"],
        ["13/01/2024", "01/13/2024"],
    ],
)
def test_stamps_of_two_kinds_in_one_column_are_refused(tmp_path, rows):
    with pytest.raises(DataError, match=r"lines 3, 5|month/day in another"):
        read_csv(write_table(tmp_path / "run.csv", [rows[k % 2] for k in range(N)]), LAG)


@pytest.mark.parametrize(
    ("zone", "begin", "minutes"),
    [
        ("Europe/Berlin", dt.datetime(2024, 10, 26, 23, tzinfo=dt.UTC), 15),
        ("Europe/Berlin", dt.datetime(2024, 10, 26, 20, tzinfo=dt.UTC), 60),
        ("Europe/Berlin", dt.datetime(2024, 3, 30, 11, tzinfo=dt.UTC), 120),
        ("Europe/Berlin", dt.datetime(2024, 10, 26, 12, tzinfo=dt.UTC), 180),
        ("Europe/London", dt.datetime(2024, 3, 30, 22, tzinfo=dt.UTC), 10),
        ("America/New_York", dt.datetime(2024, 11, 3, 2, tzinfo=dt.UTC), 20),
        ("America/New_York", dt.datetime(2024, 3, 10, 3, tzinfo=dt.UTC), 30),
        ("Australia/Sydney", dt.datetime(2024, 4, 6, 11, tzinfo=dt.UTC), 30),
    ],
)
@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M", "%d.%m.%Y %H:%M:%S", "%Y-%m-%dT%H:%M:%S%z"])
def test_a_change_of_summer_time_does_not_move_time(tmp_path, zone, begin, minutes, form):
    local = [(begin + k * dt.timedelta(minutes=minutes)).astimezone(ZoneInfo(zone)) for k in range(N)]
    record = read_csv(write_table(tmp_path / "run.csv", [m.strftime(form) for m in local]), LAG)
    np.testing.assert_allclose(record.time, 60.0 * minutes * np.arange(N))
    assert (RecordCode.SUMMER_TIME in codes(record)) == ("%z" not in form)


def test_a_gap_or_a_step_back_that_is_no_change_of_summer_time_stays(tmp_path):
    wednesday = [dt.datetime(2024, 10, 23, 1) + dt.timedelta(minutes=15 * k + 60 * (k > 9)) for k in range(N)]
    record = read_csv(write_table(tmp_path / "gap.csv", wednesday), LAG)
    assert max(b - a for a, b in pairwise(record.time)) == 4500
    back = [dt.datetime(2024, 10, 23, 1) + dt.timedelta(minutes=15 * k - 60 * (k > 9)) for k in range(N)]
    with pytest.raises(DataError, match="time goes back at line 12"):
        read_csv(write_table(tmp_path / "back.csv", back), LAG)


@pytest.mark.parametrize("hours", [2, 3, 24])
def test_rows_hours_apart_on_a_sunday_of_a_month_of_changes_are_no_change_of_summer_time(tmp_path, hours):
    moments = [dt.datetime(2024, 4, 13) + k * dt.timedelta(hours=hours) for k in range(N)]
    record = read_csv(write_table(tmp_path / "slow.csv", [f"{m:%Y-%m-%d %H:%M}" for m in moments]), LAG)
    np.testing.assert_allclose(record.time, 3600.0 * hours * np.arange(N))
    assert RecordCode.SUMMER_TIME not in codes(record)


@pytest.mark.parametrize(
    ("form", "limit", "first"),
    [
        ("%Y-%m-%d %H:%M:%S%z", "2024-10-27 04:00+01:00", 20),
        ("%Y-%m-%d %H:%M:%S%z", "2024-10-27 03:00Z", 20),
        ("%Y-%m-%d %H:%M:%S%z", "2024-10-27 04:00", "no time zone, and the record counts from 2024-10-26 22:00:00 UTC"),
        ("%Y-%m-%d %H:%M:%S", "2024-10-27 01:00", 4),
        ("%Y-%m-%d %H:%M:%S", "2024-10-27 04:00", 20),
        (
            "%Y-%m-%d %H:%M:%S",
            "2024-10-27 04:00+01:00",
            "a time zone, and the record counts from 2024-10-27 00:00:00, which",
        ),
    ],
)
def test_a_part_begins_where_the_clock_of_the_file_says_so(tmp_path, form, limit, first):
    begin = dt.datetime(2024, 10, 26, 22, tzinfo=dt.UTC)
    local = [(begin + k * dt.timedelta(minutes=15)).astimezone(ZoneInfo("Europe/Berlin")) for k in range(N)]
    path = write_table(tmp_path / "run.csv", [m.strftime(form) for m in local])
    if isinstance(first, int):
        assert read_csv(path, LAG, window=(limit, None)).time[0] == 900 * first
    else:
        with pytest.raises(DataError, match=first):
            read_csv(path, LAG, window=(limit, None))


def test_a_part_that_begins_behind_midnight_begins_there(tmp_path):
    clock = [dt.datetime(2024, 1, 1, 23, 50) + k * dt.timedelta(minutes=1) for k in range(N)]
    path = write_table(tmp_path / "run.csv", [f"{m:%H:%M:%S}" for m in clock])
    assert read_csv(path, LAG, window=("00:05:00", "00:15:00")).time.tolist() == [60.0 * k for k in range(15, 26)]
    assert read_csv(path, LAG, window=("23:55", "00:15:00")).time.tolist() == [60.0 * k for k in range(5, 26)]
    with pytest.raises(DataError, match="hours:minutes and as minutes:seconds"):
        read_csv(path, LAG, window=("00:05", None))


def _workbook(path, **sheets):
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        page = book.create_sheet(name)
        for row in rows:
            page.append(row)
    book.save(path)
    return path


# Cells of the time of a sheet, whose rows begin at MOMENTS.
DAYS_AND_TIMES = {
    "day and time of day": (["Datum", "Uhrzeit"], [[dt.datetime(m.year, m.month, m.day), m.time()] for m in MOMENTS]),
    "the other way round": (["clock", "day"], [[m.time(), dt.datetime(m.year, m.month, m.day)] for m in MOMENTS]),
    "as texts": (["Date", "Time"], [[f"{m:%d.%m.%Y}", f"{m:%H:%M:%S.%f}"] for m in MOMENTS]),
    "day and stamp": (["Tag", "Zeit"], [[dt.datetime(m.year, m.month, m.day), m] for m in MOMENTS]),
}


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("kind", DAYS_AND_TIMES)
def test_a_sheet_with_a_day_and_a_time_of_day_is_read_beside_one_with_a_stamp(tmp_path, kind, first):
    head, times = DAYS_AND_TIMES[kind]
    levels = [[*head, "x [V]"], *([*time, x] for time, x in zip(times, ANSWER, strict=True))]
    drive = [["Zeit", "u [V]"], *map(list, zip(MOMENTS, DRIVE, strict=True))]
    sheets = {"levels": levels, "drive": drive} if first else {"drive": drive, "levels": levels}
    path = _workbook(tmp_path / "run.xlsx", **sheets)
    survey = survey_file(path)
    signals = {(s.header, s.start, s.stop) for s in survey.signals if s.use != "text"}
    assert signals == {("x [V]", 0.0, STEPS[-1]), ("u [V]", 0.0, STEPS[-1])}
    assert RecordCode.SHEET_NOT_READ not in {f.code for f in survey.findings}
    np.testing.assert_allclose(read_csv(path, LAG).outputs["x"], ANSWER)


@pytest.mark.parametrize("head", [["index"], ["begin", "end"]])
def test_a_sheet_whose_time_cannot_be_told_is_named(tmp_path, head):
    times = [[k] if head == ["index"] else [m, m] for k, m in enumerate(MOMENTS)]
    levels = [[*head, "x [V]"], *([*time, x] for time, x in zip(times, ANSWER, strict=True))]
    drive = [["Zeit", "u [V]"], *map(list, zip(MOMENTS, DRIVE, strict=True))]
    (note,) = (
        str(f)
        for f in survey_file(_workbook(tmp_path / "run.xlsx", levels=levels, drive=drive)).findings
        if f.code is RecordCode.SHEET_NOT_READ
    )
    assert note.startswith("sheet 'levels' is not read, as sheet 'drive' is: ")


def test_marks_between_thousands_are_told_of_a_sheet_beside_others(tmp_path):
    levels = [["Zeit", "x [V]", "y [V]"], *([m, f"1.{k:03}", "2,5"] for k, m in enumerate(MOMENTS))]
    drive = [["Zeit", "u [V]"], *map(list, zip(MOMENTS, DRIVE, strict=True))]
    path = _workbook(tmp_path / "run.xlsx", levels=levels, drive=drive)
    assert "without marks between its thousands" in " ".join(map(str, survey_file(path).findings))
    with pytest.raises(DataError, match=r"'x \[V\]' holds texts with marks between thousands"):
        read_csv(path, LAG)


CELLS = {
    "date": MOMENTS,
    "time of day": [(dt.datetime(2024, 1, 1, 8) + dt.timedelta(seconds=s)).time() for s in STEPS],
    "length of time": [dt.timedelta(seconds=s) for s in STEPS],
    "text": [m.isoformat() for m in MOMENTS],
}


@pytest.mark.parametrize("kind", CELLS)
@pytest.mark.parametrize("header", ["time", "time [min]", "Zeit", None])
def test_cells_of_a_workbook_carry_their_unit(tmp_path, kind, header):
    rows = [[header, "u [V]", "x [V]"], *map(list, zip(CELLS[kind], DRIVE, ANSWER, strict=True))]
    record = read_csv(_workbook(tmp_path / "run.xlsx", data=rows), LAG)
    # A cell of a date is a double in days, which openpyxl reads to the microsecond.
    np.testing.assert_allclose(record.time, STEPS, rtol=0, atol=2e-6)


def test_dated_sheets_have_one_origin(tmp_path):
    moved = [m + dt.timedelta(seconds=25) for m in MOMENTS]
    path = _workbook(
        tmp_path / "two.xlsx",
        drive=[["time", "u [V]"], *map(list, zip(MOMENTS, DRIVE, strict=True))],
        answer=[["Zeit", "x [V]"], *map(list, zip(moved, ANSWER, strict=True))],
    )
    record = read_csv(path, LAG, hold="first")
    (start,) = (f for f in record.findings if f.code == RecordCode.CLOCK_START)
    assert start.subject == "answer" and start.values["start"] == pytest.approx(25, abs=2e-6)
    # The answer stands at its own rows, 25 s behind the first of the drive.
    np.testing.assert_allclose(record.time, 25 + np.array(STEPS)[: record.rows], rtol=0, atol=2e-6)
    expected = np.interp(record.time, STEPS, DRIVE)
    np.testing.assert_allclose(record.inputs["u"], expected, atol=1e-5)


def test_rows_below_an_empty_one_are_said(tmp_path):
    rows = [["time [s]", "u", "x"], *map(list, zip(STEPS, DRIVE, ANSWER, strict=True))]
    rows[21:21] = [[None, None, None]]
    record = read_csv(_workbook(tmp_path / "run.xlsx", data=rows), LAG)
    (finding,) = (f for f in record.findings if f.code == RecordCode.ROWS_BELOW_TABLE)
    assert (record.rows, finding.values["rows"], finding.values["row"]) == (20, 10, 21)
    assert RecordCode.ROWS_BELOW_TABLE in {f.code for f in survey_file(tmp_path / "run.xlsx").findings}


def test_text_in_a_column_that_is_not_wanted_does_not_matter(tmp_path):
    rows = [["time", "u", "remark", "x"], *([t, u, "ok", x] for t, u, x in zip(STEPS, DRIVE, ANSWER, strict=True))]
    rows[4][3] = "over"
    path = _workbook(tmp_path / "run.xlsx", data=rows)
    with pytest.raises(DataError, match="column 'x', row 4: 'over' is not a number"):
        read_csv(path, LAG)
    rows[4][3] = 0.5
    assert read_csv(_workbook(path, data=rows), LAG).rows == N


PARQUET = {
    "us": lambda: pa.array(MOMENTS, pa.timestamp("us")),
    "ns with a zone": lambda: pa.array(MOMENTS, pa.timestamp("ns", "Europe/Berlin")),
    "ms": lambda: pa.array(MOMENTS, pa.timestamp("ms")),
    "text": lambda: pa.array([m.isoformat() for m in MOMENTS]),
    "time of day": lambda: pa.array(
        [(dt.datetime(2024, 1, 1, 8) + dt.timedelta(seconds=s)).time() for s in STEPS], pa.time64("us")
    ),
    "length of time": lambda: pa.array([dt.timedelta(seconds=s) for s in STEPS], pa.duration("ms")),
}


@pytest.mark.parametrize("kind", PARQUET)
@pytest.mark.parametrize("header", ["time [min]", "__index_level_0__"])
def test_columns_of_parquet_and_numpy_are_read_as_time(tmp_path, kind, header):
    stamps = PARQUET[kind]()
    pq.write_table(pa.table({header: stamps, "u": DRIVE, "x": ANSWER}), tmp_path / "run.parquet")
    np.testing.assert_allclose(read_csv(tmp_path / "run.parquet", LAG).time, STEPS, rtol=0, atol=1e-9)
    if stamps.type.id in (pa.timestamp("us").id, pa.duration("ms").id):
        np.savez(tmp_path / "run.npz", **{header: stamps.to_numpy(), "u": DRIVE, "x": ANSWER})
        np.testing.assert_allclose(read_csv(tmp_path / "run.npz", LAG).time, STEPS, rtol=0, atol=1e-9)


def test_dated_files_of_one_call_have_one_origin(tmp_path):
    first = write_table(tmp_path / "a.csv", (f"{m:%d.%m.%Y %H:%M:%S}.{m:%f}" for m in MOMENTS))
    moved = [m - dt.timedelta(seconds=25) for m in MOMENTS]
    pq.write_table(pa.table({"time": moved, "u": DRIVE, "x": ANSWER}), tmp_path / "b.parquet")
    a, b = read_experiments([first, tmp_path / "b.parquet"], LAG)
    assert (a.time[0], b.time[0]) == (25.0, 0.0)
    zoned = write_table(tmp_path / "c.csv", (m.isoformat() + "Z" for m in MOMENTS))
    a, c = read_experiments([first, zoned], LAG)
    assert (a.time[0], c.time[0]) == (0.0, 0.0)
    assert RecordCode.ORIGINS_APART in codes(c) and RecordCode.ORIGINS_APART not in codes(a)


def write_recording(path, begins):
    """A recording of a measuring system that ``begins`` at a moment by the world's clock, or has a clock that was never set."""
    seconds = np.asarray(STEPS, dtype=float)
    if path.suffix == ".tdms":
        nptdms = pytest.importorskip("nptdms")
        start = np.datetime64(begins.replace(tzinfo=None), "us") if begins else np.datetime64("1904-01-01", "us")
        facts = {"wf_increment": float(seconds[1] - seconds[0]), "wf_start_time": start}
        with nptdms.TdmsWriter(path) as file:
            file.write_segment([nptdms.ChannelObject("rig", n, v, facts) for n, v in (("u", DRIVE), ("x", ANSWER))])
    elif path.suffix == ".mf4":
        asammdf = pytest.importorskip("asammdf")
        with asammdf.MDF(version="4.10") as file:
            file.start_time = begins or dt.datetime.fromtimestamp(0, dt.UTC)
            file.append([asammdf.Signal(v, seconds, name=n) for n, v in (("u", DRIVE), ("x", ANSWER))])
            file.save(path, overwrite=True)
    else:
        writer = pytest.importorskip("mcap.writer")
        first = round(begins.timestamp()) * 10**9 if begins else 0
        with open(path, "wb") as stream:
            file = writer.Writer(stream)
            file.start()
            schema = file.register_schema("sample", "jsonschema", b'{"type": "object"}')
            topic = file.register_channel("rig", "json", schema)
            for t, u, x in zip(seconds, DRIVE, ANSWER, strict=True):
                stamp = first + round(1e9 * t)
                file.add_message(topic, stamp, json.dumps({"u": float(u), "x": float(x)}).encode(), stamp)
            file.finish()
    return path


@pytest.mark.parametrize("kind", [".tdms", ".mf4", ".mcap"])
def test_recordings_of_one_call_have_one_origin(tmp_path, kind):
    columns = {"u": "rig.u", "x": "rig.x"} if kind == ".mcap" else None
    noon = dt.datetime(2026, 3, 29, 12, 0, tzinfo=dt.UTC)
    paths = [
        write_recording(tmp_path / f"{k}{kind}", noon + dt.timedelta(seconds=after)) for k, after in enumerate((25, 0))
    ]
    late, early = read_experiments(paths, LAG, columns=columns)
    np.testing.assert_allclose(early.time, STEPS, rtol=0, atol=1e-6)
    np.testing.assert_allclose(late.time, np.asarray(STEPS) + 25, rtol=0, atol=1e-6)
    # A table with the zone written out counts from the same.
    zoned = write_table(tmp_path / "c.csv", ((noon + dt.timedelta(seconds=40 + s)).isoformat() for s in STEPS))
    table, early = read_experiments([zoned], LAG) + read_experiments(paths[1:], LAG, columns=columns)
    assert (table.time[0], early.time[0]) == (0.0, 0.0)
    unset = write_recording(tmp_path / f"unset{kind}", None)
    early, unset = read_experiments([paths[1], unset], LAG, columns=columns)
    assert (early.time[0], unset.time[0]) == (0.0, 0.0)
    assert RecordCode.ORIGINS_APART in codes(unset)


# Where a clock that counts days begins: Excel, the fraction of a day, MATLAB, Julian and modified Julian dates.
@pytest.mark.parametrize("first", [45000.25, 0.0, 739000.5, 2460000.5, 60310.0])
@pytest.mark.parametrize("header", ["time", "time [s]"])
@pytest.mark.parametrize("step", [0.1, 1.0, 600.0])
def test_a_clock_that_counts_days_is_asked_for_its_unit(tmp_path, first, header, step):
    days = [f"{first + k * step / 86400:.11f}" for k in range(N)]
    path = write_table(tmp_path / "run.csv", days, header)
    if first == 0 and step == 600:  # 144 Hz as well as ten minutes
        assert read_csv(path, LAG).time[1] == pytest.approx(1 / 144)
        return
    with pytest.raises(DataError, match=r"time \[d\]"):
        read_csv(path, LAG)
    assert RecordCode.TIME_UNUSABLE in {f.code for f in survey_file(path).findings}
    told = read_csv(path, LAG, columns={"time [d]": header})
    np.testing.assert_allclose(np.diff(told.time), step, rtol=1e-3)
    np.testing.assert_allclose(np.diff(read_csv(path, LAG, columns={"time [s]": header}).time), step / 86400, rtol=1e-3)


@pytest.mark.parametrize(
    "rate", [10, 24, 48, 50, 60, 96, 120, 144, 240, 360, 864, 1000, 1024, 2000, 10000, 44100, 48000]
)
@pytest.mark.parametrize("first", [0.0, 3600.0])
def test_a_usual_rate_is_asked_for_nothing(tmp_path, rate, first):
    path = write_table(tmp_path / "run.csv", (f"{first + k / rate:.9f}" for k in range(N)))
    np.testing.assert_allclose(np.diff(read_csv(path, LAG).time), 1 / rate, rtol=1e-3)


@pytest.mark.parametrize(
    ("largest", "header", "is_said"), [(80, "u", True), (1, "u", False), (4096, "u", False), (80, "u [%]", False)]
)
def test_a_plain_number_that_may_be_per_cent_is_said(tmp_path, largest, header, is_said):
    model = Model(
        "valve",
        states=[State("x", "V")],
        inputs=[Input("u", "1")],
        outputs=[Output("x", "V")],
        parameters=[Parameter("tau", "s", 1.0, (1e-4, 1e4)), Parameter("g", "V", 1.0)],
        balances=lambda x, u, p: [Balance("b", "V", p.tau, "x", drive=p.g * u.u, decay=-x.x)],
    )
    rows = [f"{k},{largest * u},{x:.6f}" for k, (u, x) in enumerate(zip(DRIVE, ANSWER, strict=True))]
    (tmp_path / "run.csv").write_text("\n".join([f"time [s],{header},x [V]", *rows]), encoding="utf-8")
    assert (RecordCode.MAY_BE_PER_CENT in codes(read_csv(tmp_path / "run.csv", model))) is is_said


def test_a_record_of_centuries_is_asked_for_its_unit(tmp_path):
    path = write_table(tmp_path / "run.csv", (k * 10**9 for k in range(N)), "t")
    with pytest.raises(DataError, match=r"time \[us\]"):
        read_csv(path, LAG)
    assert read_csv(path, LAG, columns={"time [ns]": "t"}).time[1] == pytest.approx(1.0)


def test_hours_or_minutes_in_front_of_a_colon_are_asked_where_both_are_possible(tmp_path):
    def clock(seconds):
        return f"{seconds // 60}:{seconds % 60:02d}"

    path = write_table(tmp_path / "run.csv", (clock(7 * k) for k in range(N)))
    with pytest.raises(DataError, match="hours:minutes or minutes:seconds"):
        read_csv(path, LAG)
    assert read_csv(path, LAG, columns={"time [mm:ss]": "time"}).time[-1] == 7 * (N - 1)
    assert read_csv(path, LAG, columns={"time [hh:mm]": "time"}).time[-1] == 60 * 7 * (N - 1)
    # A record of a day begins at any hour, and one of minutes and seconds near zero.
    assert read_csv(write_table(tmp_path / "day.csv", (clock(600 + k) for k in range(N))), LAG).time[1] == 60
    mixed = [clock(3590 + k) if k < 10 else f"1:00:{k - 10:02d}" for k in range(N)]
    assert read_csv(write_table(tmp_path / "hour.csv", mixed), LAG).time.tolist() == list(range(N))


def test_a_part_of_a_record_is_read(tmp_path):
    path = write_table(tmp_path / "run.csv", map(str, MOMENTS))
    whole = read_csv(path, LAG)
    for window in ((27, 135.0), ("27", "135"), ("2023-12-31 23:58:34", "1.1.2024 00:00:23")):
        part = read_csv(path, LAG, window=window)
        np.testing.assert_array_equal(part.time, whole.time[2:11])
        np.testing.assert_array_equal(part.outputs["x"], whole.outputs["x"][2:11])
    with pytest.raises(DataError, match="0 rows from 1000"):
        read_csv(path, LAG, window=(1000.0, None))
    with pytest.raises(DataError, match="the record counts from a date"):
        read_csv(path, LAG, window=("23:58", None))
    plain = write_table(tmp_path / "plain.csv", STEPS, "time [s]")
    with pytest.raises(DataError, match="this record has no dates"):
        read_csv(plain, LAG, window=(None, "2024-01-01"))
    rows = [*plain.read_text(encoding="utf-8").splitlines()]
    rows[20] = rows[20].replace("1.0,", "oops,").replace("0.0,", "oops,")
    plain.write_text("\n".join(rows), encoding="utf-8")
    with pytest.raises(DataError, match="line 21"):
        read_csv(plain, LAG, window=(100, None))


@pytest.mark.parametrize("name", ["run.log", "run", "run.asc", "run.001"])
def test_a_text_of_another_ending_is_read(tmp_path, name):
    assert read_csv(write_table(tmp_path / name, STEPS, "time [s]"), LAG).rows == N
    (tmp_path / name).write_bytes(bytes(range(256)) * 9)
    with pytest.raises(DataError, match="cannot be read unless they are tables of text"):
        read_csv(tmp_path / name, LAG)


def test_readings_repeated_at_one_time_say_how_replicates_are_read(tmp_path):
    with pytest.raises(DataError, match="make a record for each replicate"):
        read_csv(write_table(tmp_path / "run.csv", [k // 2 for k in range(N)], "time [h]"), LAG)


def test_a_workbook_with_more_texts_than_cells_is_refused_before_they_are_read(tmp_path):
    import zipfile

    rows = [["time", "u", "x"], *map(list, zip(STEPS, DRIVE, ANSWER, strict=True))]
    plain = _workbook(tmp_path / "plain.xlsx", data=rows)
    for part in ("xl/sharedStrings.xml", "xl/styles.xml", "docProps/other.xml"):
        with (
            zipfile.ZipFile(plain) as source,
            zipfile.ZipFile(tmp_path / "large.xlsx", "w", zipfile.ZIP_DEFLATED) as target,
        ):
            for member in source.infolist():
                if member.filename != part:
                    target.writestr(member.filename, source.read(member))
            target.writestr(part, b"<sst>" + b"<si><t>a</t></si>" * 1_200_000 + b"</sst>")
        with pytest.raises(DataError, match=f"the workbook holds {part} .20 MB. beside its sheets"):
            read_csv(tmp_path / "large.xlsx", LAG)


def test_a_link_back_to_the_root_of_an_hdf5_file_is_followed_once(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        group = file.create_group("log")
        for name, values in (("time", np.array(STEPS)), ("u", DRIVE), ("x", ANSWER)):
            group[name] = values
        file["loop"] = file["/"]
        group["up"], group["again"] = file["/"], group
        # A chain in which each group has eight names for the next: 8^6 ways to its end.
        inner = file.create_group("chain")
        for _ in range(6):
            following = inner.create_group("0")
            for k in range(1, 8):
                inner[str(k)] = following
            inner = following
    record = read_csv(tmp_path / "run.h5", LAG)
    assert record.rows == N
    assert [s.name for s in survey_file(tmp_path / "run.h5").signals] == ["u", "x"]
