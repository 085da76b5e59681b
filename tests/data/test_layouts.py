"""Files as people have them: no header, no time, the header in a comment, a matrix, MATLAB 7.3, columns by number."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy.io import loadmat, savemat
from scipy.sparse import csc_array

from greybox.base.errors import DataError
from greybox.data.findings import RecordCode
from greybox.data.read import read_csv
from greybox.data.survey import survey_file
from greybox.extensions.formats.mat_file import read_mat
from greybox.shell.project import find_model
from greybox.simulation.simulate import read_inputs
from tests.data.test_read import ANSWER, DRIVE, RIG, TIME, N

ROWS = [f"{t!r},{u!r},{x!r}" for t, u, x in np.column_stack([TIME, DRIVE, ANSWER]).tolist()]
TABLE = np.column_stack([TIME, DRIVE, ANSWER])


def write(path: Path, lines: list[str], encoding: str = "utf-8") -> Path:
    path.write_bytes(("\n".join(lines) + "\n").encode(encoding))
    return path


def same(record, time=TIME, tolerance=0.0):
    np.testing.assert_allclose(record.time, time, rtol=tolerance, atol=0)
    np.testing.assert_allclose(record.inputs["u"], DRIVE, rtol=tolerance, atol=0)
    np.testing.assert_allclose(record.outputs["x"], ANSWER, rtol=tolerance, atol=0)


# --- text


@pytest.mark.parametrize("separator", [",", ";", "\t", " ", "   ", ", "])
def test_a_file_without_a_header_is_read_by_names_in_order(tmp_path, separator):
    path = write(tmp_path / "run.csv", [row.replace(",", separator) for row in ROWS])
    same(read_csv(path, RIG, columns=["time", "u", "x"]))
    same(read_csv(path, RIG, columns={"time": 1, "u": "2", "x": 3}))


def test_names_in_order_take_the_place_of_a_header_and_carry_units(tmp_path):
    path = write(tmp_path / "run.csv", ["a,b,c,d", *(f"{row},9" for row in ROWS)])
    record = read_csv(path, RIG, columns=["time [ms]", "u [mV]", "x [um]", "-"])
    np.testing.assert_allclose(record.time, 1e-3 * TIME, rtol=1e-14)
    np.testing.assert_allclose(record.outputs["x"], 1e-6 * ANSWER, rtol=1e-14)
    assert [f.code for f in record.findings] == [RecordCode.OUTPUT_NOT_MEASURED]


def test_a_file_without_a_header_and_without_names_says_what_to_do(tmp_path):
    path = write(tmp_path / "run.csv", ROWS)
    with pytest.raises(
        DataError, match=r"^run\.csv: line 1 holds numbers.*columns=\['time', 'u', 'x'\] \(shell: --columns"
    ):
        read_csv(path, RIG)
    with pytest.raises(DataError, match=r"columns gives 2 names \(time, u\), the file has 3 columns"):
        read_csv(path, RIG, columns=["time", "u"])
    with pytest.raises(DataError, match="is one text"):
        read_csv(path, RIG, columns="time,u,x")


def test_a_file_without_time_is_read_with_the_sampling_time(tmp_path):
    path = write(tmp_path / "run.csv", ["u [V],x [m]", *(row.split(",", 1)[1] for row in ROWS)])
    same(read_csv(path, RIG, sampling_time=0.1), tolerance=1e-15)
    with pytest.raises(DataError, match=r"no column for time \[s\].*--sampling-time SECONDS"):
        read_csv(path, RIG)
    assert read_inputs(path, RIG, sampling_time=0.1).rows == N


def test_a_time_column_and_a_sampling_time_contradict_each_other(tmp_path):
    path = write(tmp_path / "run.csv", ["time,u,x", *ROWS])
    with pytest.raises(DataError, match="a time column, 'time', and a sampling time is given"):
        read_csv(path, RIG, sampling_time=0.1)
    same(read_csv(path, RIG, sampling_time=0.1, columns=["-", "u", "x"]), tolerance=1e-15)
    for bad in (0.0, -1.0, float("inf"), float("nan")):
        with pytest.raises(DataError, match="sampling_time"):
            read_csv(path, RIG, sampling_time=bad)


DATES = pd.Timestamp("2026-03-12 08:00:05") + pd.to_timedelta(TIME, unit="s")
CLOCKS = {
    "t in ms": 1e3 * TIME,
    "time_ms": 1e3 * TIME,
    "millis": 1e3 * TIME,
    "Zeit": TIME,
    "elapsed time since start (s)": np.round(TIME),
    "timestamp": 1.7e9 + TIME,
    "Zeitstempel": DATES.strftime("%d.%m.%Y %H:%M:%S.%f"),
    "logged": DATES.strftime("%H:%M:%S.%f"),
}


@pytest.mark.parametrize("suffix", [".csv", ".xlsx"])
@pytest.mark.parametrize("header", CLOCKS)
def test_whatever_counts_the_time_is_not_overridden_by_a_sampling_time(tmp_path, header, suffix):
    frame = pd.DataFrame({"u": DRIVE, header: CLOCKS[header], "x": ANSWER})
    path = tmp_path / f"run{suffix}"
    frame.to_csv(path, index=False) if suffix == ".csv" else frame.to_excel(path, index=False)
    clash = f"a time column, {re.escape(repr(header))}, and a sampling time is given"
    for source in (path, frame, frame.set_index(header)):
        for read in (read_csv, read_inputs):
            with pytest.raises(DataError, match=clash):
                read(source, RIG, sampling_time=0.1)
    with pytest.raises(DataError, match=clash):
        survey_file(path, sampling_time=0.1)
    same(read_csv(path, RIG, sampling_time=0.1, columns=["u", "-", "x"]), tolerance=1e-12)


def test_an_index_without_a_name_and_two_columns_of_dates_are_a_time_as_well():
    rows = {"u": DRIVE, "x": ANSWER}
    for index in (DATES, DATES - DATES[0], pd.Index(TIME)):
        with pytest.raises(DataError, match="a time column, 'time', and a sampling time"):
            read_csv(pd.DataFrame(rows, index=index), RIG, sampling_time=0.1)
    with pytest.raises(DataError, match="a time column, 'utc', and a sampling time"):
        read_csv(pd.DataFrame({"utc": DATES, "local": DATES + pd.Timedelta("1h"), **rows}), RIG, sampling_time=0.1)


def test_what_only_looks_like_a_time_gives_way_to_the_sampling_time():
    cycle = 1 + 0.1 * np.random.default_rng(1).normal(size=N)
    other = {"sample": np.arange(N), "cycle_time_ms": cycle, "dead time [s]": 0.1, "time of test": "morning"}
    same(read_csv(pd.DataFrame({**other, "u": DRIVE, "x": ANSWER}), RIG, sampling_time=0.1), tolerance=1e-15)


COMMENTED = {
    "last comment": ["# rig 3, 5 May", "# time [s], u [V], x [m]"],
    "percent sign": ["% time,u,x"],
    "other separator": ["#time;u;x"],
    "blanks": ["# time [s]  u [V]  x [m]"],
    "something after it": ["# time,u,x", "# gain = 3", ""],
}


@pytest.mark.parametrize("before", COMMENTED.values(), ids=COMMENTED)
def test_the_header_may_be_a_comment(tmp_path, before):
    same(read_csv(write(tmp_path / "run.csv", [*before, *ROWS]), RIG))


def test_rows_below_a_comment_that_names_every_field_may_hold_words(tmp_path):
    """As rostopic echo -p writes them."""
    lines = [
        "%time,field.frame_id,field.name0,u,x",
        *(f"{t},,elbow,{rest}" for t, rest in (r.split(",", 1) for r in ROWS)),
    ]
    same(read_csv(write(tmp_path / "run.csv", lines), RIG))


def test_a_comment_is_no_header_where_there_is_one(tmp_path):
    lines = ["# a,b,c", "time,u,x", *ROWS]
    same(read_csv(write(tmp_path / "run.csv", lines), RIG))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_every_encoding_of_the_micro_sign(tmp_path, encoding):
    lines = ["time [s]\tu [V]\tx [µm]", *(row.replace(",", "\t") for row in ROWS)]
    record = read_csv(write(tmp_path / "run.txt", lines, encoding), RIG)
    np.testing.assert_allclose(record.outputs["x"], 1e-6 * ANSWER, rtol=1e-14)


def test_a_column_by_its_number_gives_way_to_a_header(tmp_path):
    path = write(tmp_path / "run.csv", ["time,2,x", *ROWS])
    same(read_csv(path, RIG, columns={"u": "2"}))
    path = write(tmp_path / "run.csv", ["time,voltage,x", *ROWS])
    same(read_csv(path, RIG, columns={"u": "2"}))
    for number in ("0", "4", "99999999999999999999", "-1"):
        with pytest.raises(DataError, match=f"maps 'u' to '{number}', which the file does not have"):
            read_csv(path, RIG, columns={"u": number})


def test_decimal_commas_without_a_header(tmp_path):
    lines = [row.replace(",", ";").replace(".", ",") for row in ROWS]
    same(read_csv(write(tmp_path / "run.csv", lines), RIG, columns=["time", "u", "x"]))
    lines = [row.replace(",", " ").replace(".", ",") for row in ROWS]
    same(read_csv(write(tmp_path / "run.csv", lines), RIG, columns=["time", "u", "x"]))


# --- matrices and structs


@pytest.mark.parametrize("wide", [False, True])
def test_a_matrix_in_a_matlab_file(tmp_path, wide):
    savemat(tmp_path / "run.mat", {"data": TABLE.T if wide else TABLE, "fs": 10.0, "title": "bench"})
    same(read_csv(tmp_path / "run.mat", RIG, columns=["time", "u", "x"]))
    same(read_csv(tmp_path / "run.mat", RIG, columns={"time": 1, "u": 2, "x": 3}))
    header = "data({},:)" if wide else "data(:,{})"
    same(
        read_csv(tmp_path / "run.mat", RIG, columns={n: header.format(k) for k, n in enumerate(("time", "u", "x"), 1)})
    )


def test_a_matrix_in_other_files(tmp_path):
    np.savez(tmp_path / "run.npz", data=TABLE)
    same(read_csv(tmp_path / "run.npz", RIG, columns=["time", "u", "x"]))
    pd.DataFrame(TABLE, columns=["a", "b", "c"]).to_parquet(tmp_path / "run.parquet")
    same(read_csv(tmp_path / "run.parquet", RIG, columns=["time", "u", "x"]))


def test_two_matrices_need_headers(tmp_path):
    savemat(tmp_path / "run.mat", {"a": TABLE, "b": TABLE})
    with pytest.raises(DataError, match="the matrices a, b; choose columns by their headers"):
        read_csv(tmp_path / "run.mat", RIG, columns=["time", "u", "x"])
    same(read_csv(tmp_path / "run.mat", RIG, columns={"time": "a(:,1)", "u": "b(:,2)", "x": "a(:,3)"}))


def test_nested_structs_and_lists_of_structs(tmp_path):
    """As Simulink's "structure with time" has it."""
    signals = np.array([(DRIVE, "V"), (ANSWER, "m")], dtype=[("values", object), ("unit", object)])
    cells = np.array([TIME, {"x": ANSWER}, "text"], dtype=object)
    content = {"out": {"time": TIME, "signals": signals, "info": {"deep": {"x": ANSWER}}}, "log": cells}
    for compressed in (True, False):
        savemat(tmp_path / "run.mat", content, do_compression=compressed)
        columns = {"time": "out.time", "u": "out.signals(1).values", "x": "out.info.deep.x"}
        same(read_csv(tmp_path / "run.mat", RIG, columns=columns))
        same(read_csv(tmp_path / "run.mat", RIG, columns=columns | {"time": "log{1}", "x": "log{2}.x"}))


STORED = ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8", "?"]


@pytest.mark.parametrize("compressed", [True, False])
def test_every_class_of_numbers_is_read_as_scipy_reads_it(tmp_path, compressed):
    rng = np.random.default_rng(4)
    arrays = {f"a{k}": rng.integers(0, 2 if kind == "?" else 100, (N, 3)).astype(kind) for k, kind in enumerate(STORED)}
    arrays |= {
        "row": TIME[None, :],
        "wide": rng.normal(size=(3, 7)),
        "empty": np.zeros((0, 0)),
        "cube": np.zeros((2, 3, 4)),
    }
    arrays |= {
        "complex": TIME * 1j,
        "title": "text",
        "sparse": csc_array(np.eye(3)),
        "a_name_as_long_as_matlab_allows_which_is_sixty_three_x": TIME,
    }
    savemat(tmp_path / "run.mat", arrays, do_compression=compressed)
    table = read_mat(tmp_path / "run.mat")
    assert {name for name, info in table.infos.items() if info.holds} == {"complex", "title", "sparse"}
    expected = loadmat(tmp_path / "run.mat")
    for name, info in table.infos.items():
        if not info.holds:
            np.testing.assert_array_equal(table.load([name])[name], expected[name])


def test_only_the_wanted_columns_are_loaded(tmp_path):
    """A column that is not wanted may be longer, of text, or damaged."""
    savemat(
        tmp_path / "run.mat", {"time": TIME, "u": DRIVE, "x": ANSWER, "image": np.zeros((200, 300)), "note": "text"}
    )
    same(read_csv(tmp_path / "run.mat", RIG))
    np.savez(tmp_path / "run.npz", time=TIME, u=DRIVE, x=ANSWER, note=np.array(["text"]), objects=np.zeros(7, complex))
    same(read_csv(tmp_path / "run.npz", RIG))
    frame = pd.DataFrame({"time": TIME, "u": DRIVE, "x": ANSWER, "note": ["text"] * N})
    frame.to_parquet(tmp_path / "run.parquet")
    same(read_csv(tmp_path / "run.parquet", RIG))
    frame.set_index("time").to_parquet(tmp_path / "run.parquet")
    same(read_csv(tmp_path / "run.parquet", RIG))


def write_matlab_7_3(path: Path, **variables: object) -> Path:
    """As MATLAB writes it: HDF5 after 512 bytes of text, arrays transposed, the class as an attribute."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            if isinstance(value, dict):
                group = file.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                for key, inner in value.items():
                    group.create_dataset(key, data=np.atleast_2d(inner).astype(float)).attrs["MATLAB_class"] = (
                        np.bytes_("double")
                    )
            elif isinstance(value, str):
                data = file.create_dataset(name, data=np.array([[ord(c)] for c in value], dtype=np.uint16))
                data.attrs["MATLAB_class"] = np.bytes_("char")
            else:
                array = np.asarray(value, dtype=float)
                array = array.T if array.ndim == 2 else array[None, :]
                file.create_dataset(name, data=array, compression="gzip").attrs["MATLAB_class"] = np.bytes_("double")
        file.create_group("#refs#")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


def test_a_file_of_matlab_7_3(tmp_path):
    same(read_csv(write_matlab_7_3(tmp_path / "run.mat", time=TIME, u=DRIVE, x=ANSWER, title="bench"), RIG))
    same(read_csv(write_matlab_7_3(tmp_path / "m.mat", data=TABLE), RIG, columns=["time", "u", "x"]))
    struct = write_matlab_7_3(tmp_path / "s.mat", log={"t": TIME, "u": DRIVE, "x": ANSWER})
    same(read_csv(struct, RIG, columns={"time": "log.t", "u": "log.u", "x": "log.x"}))


def test_a_link_to_another_file_is_not_followed(tmp_path):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["x"] = ANSWER
    with h5py.File(tmp_path / "run.mat", "w") as file:
        file["time"], file["u"] = TIME, DRIVE
        file["x"] = h5py.ExternalLink("secret.h5", "/x")
    with pytest.raises(DataError, match="no column for any output"):
        read_csv(tmp_path / "run.mat", RIG)


def test_a_missing_package_is_named_with_the_line_that_installs_it(tmp_path, monkeypatch):
    import sys

    path = write_matlab_7_3(tmp_path / "run.mat", time=TIME, u=DRIVE, x=ANSWER)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(
        DataError,
        match=re.escape(
            "run.mat: reading it needs the package h5py; install it with: pip install 'greybox-sysid[hdf5]'"
        ),
    ):
        read_csv(path, RIG)


# --- the command, and the raw files of public rigs


def model_of(folder: Path):
    return find_model(str(folder / "plain.py"))


RAW = [
    ("hanging_load/raw.csv", {"columns": ["time", "r", "y", "u"]}, 16060, 0.02),
    ("hydraulic_motor/raw.csv", {"columns": ["time", "u", "y"]}, 15246, 0.02),
    ("two_cylinders/raw.csv", {"columns": ["time", "r1", "r2", "y1", "y2"]}, 2390, 0.1),
    ("dc_motor_tacho/raw_prbs_fs10.csv", {"sampling_time": 0.1}, 200, 0.1),
    ("dc_motor_tacho/raw_staircase_fs500.csv", {"sampling_time": 0.002}, 534, 0.002),
]


@pytest.mark.parametrize(("file", "how", "rows", "step"), RAW, ids=[file for file, *_ in RAW])
def test_raw_files_of_public_rigs_are_read(shared_data, file, how, rows, step):
    path = shared_data / file
    record = read_csv(path, model_of(path.parent), **how)
    assert record.rows == rows
    assert record.sampling_time == pytest.approx(step, rel=1e-6)


@pytest.mark.parametrize(("file", "how", "rows", "step"), RAW, ids=[file for file, *_ in RAW])
def test_raw_files_of_public_rigs_are_read_by_one_command(run, tmp_path, shared_data, file, how, rows, step):
    path = shared_data / file
    options = ["--columns", ",".join(how["columns"])] if "columns" in how else ["--sampling-time", how["sampling_time"]]
    result = run("fit", path.parent / "plain.py", path, *options, "--write-study", "study.toml")
    assert result.exit_code == 0, result.output
    text = Path("study.toml").read_text()
    assert ("columns = [" in text) or ("sampling_time = " in text)
    drive = run("simulate", path.parent / "plain.py", path, *options, "--output", "run.csv", "--no-report")
    assert drive.exit_code == 0, drive.output
    assert len(Path("run.csv").read_text().splitlines()) == rows + 1


def test_options_that_exclude_each_other_are_named(run, tmp_path):
    write(tmp_path / "run.csv", ROWS)
    result = run("check", "micro_actuator", "run.csv", "--columns", "time,u,x", "--column", "u=2")
    assert result.exit_code == 2 and "--columns and --column exclude each other" in result.output
    result = run("check", "micro_actuator", "run.csv", "--columns", "time,,x")
    assert result.exit_code == 2 and "a name is empty" in result.output
    result = run(
        "simulate", "micro_actuator", "--step", "1", "--duration", "1", "--sampling-time", "0.01", "--columns", "u"
    )
    assert result.exit_code == 2 and "--columns: no effect" in result.output
