"""Files that are damaged, hostile or odd: one sentence with the file, the place and the rule, and little memory."""

from __future__ import annotations

import io
import os
import re
import resource
import sys
import time
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from greybox.base.errors import DataError, ModelError
from greybox.base.units import parse_unit
from greybox.data.policy import ReadingPolicy
from greybox.data.read import read_csv, read_experiments
from tests.data.test_read import ANSWER, DRIVE, RIG, TIME, N, good

SIGNALS = {"time": TIME, "u": DRIVE, "x": ANSWER}


def refused(path, *, mentions="", **options):
    """The one sentence with which a file is refused."""
    with pytest.raises(DataError) as error:
        read_csv(path, RIG, **options)
    text = str(error.value)
    assert path.name in text
    assert mentions in text
    assert len(text) < 2000 and text.replace("\n", "").isprintable()
    return text


def read_or_refuse(path):
    """Damage may leave a file readable; if not, the file is named."""
    text = path.name
    try:
        read_csv(path, RIG)
    except DataError as error:
        text = str(error)
    assert path.name in text


# --- MATLAB


def matlab(path, compressed=True):
    savemat(path, SIGNALS, do_compression=compressed)
    return path


@pytest.mark.parametrize("size", [0, 1, 50, 100, 127, 128, 130, 136, 200, 400])
@pytest.mark.parametrize("compressed", [True, False])
def test_a_matlab_file_cut_short(tmp_path, size, compressed):
    path = matlab(tmp_path / "run.mat", compressed)
    path.write_bytes(path.read_bytes()[:size])
    refused(path)


@pytest.mark.parametrize("compressed", [True, False])
def test_a_matlab_file_with_one_changed_byte_is_read_or_refused(tmp_path, compressed):
    whole = bytearray(matlab(tmp_path / "run.mat", compressed).read_bytes())
    for place in range(0, len(whole), 5):
        changed = bytearray(whole)
        changed[place] ^= 0x41
        (tmp_path / "run.mat").write_bytes(changed)
        read_or_refuse(tmp_path / "run.mat")


def test_a_matlab_file_that_unpacks_to_much_is_refused_before(tmp_path):
    path = tmp_path / "run.mat"
    few = ReadingPolicy(largest_unpacked=1_000_000)
    savemat(path, {"log": {"x": np.zeros(1_000_000)}}, do_compression=True)
    refused(path, mentions="unpacks to more than 1 MB", reading=few)
    savemat(path, {**SIGNALS, "x": np.zeros(1_000_000)}, do_compression=True)
    refused(path, mentions="at most 1 MB are read", reading=few)


def test_a_matlab_7_3_file_that_claims_much_is_refused_before(tmp_path):
    with h5py.File(tmp_path / "run.mat", "w") as file:
        for name in SIGNALS:
            file.create_dataset(name, shape=(10**9,), dtype="f8", chunks=(1000,), compression="gzip")
    refused(tmp_path / "run.mat", mentions="take 24000 MB")


# --- NumPy


def archive(path, **members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in members.items():
            file.writestr(f"{name}.npy", data)
    return path


def array_bytes(array, shape=None):
    stream = io.BytesIO()
    np.save(stream, array)
    data = stream.getvalue()
    return data if shape is None else data.replace(str(array.shape).encode(), shape, 1)


def test_an_archive_with_one_changed_byte_is_read_or_refused(tmp_path):
    np.savez_compressed(tmp_path / "run.npz", **SIGNALS)
    whole = bytearray((tmp_path / "run.npz").read_bytes())
    for place in range(0, len(whole), 5):
        changed = bytearray(whole)
        changed[place] ^= 0x41
        (tmp_path / "run.npz").write_bytes(changed)
        read_or_refuse(tmp_path / "run.npz")


def test_an_archive_whose_members_are_no_arrays(tmp_path):
    refused(archive(tmp_path / "run.npz", time=b"text", u=b"", x=b"\x93NUM"), mentions="no array")


def test_an_array_that_claims_more_than_it_has(tmp_path):
    members = {name: array_bytes(values) for name, values in SIGNALS.items()}
    members["x"] = array_bytes(ANSWER, shape=b"(99999999999,)")
    refused(archive(tmp_path / "run.npz", **members), mentions="shape")


def test_an_archive_that_is_encrypted_or_packed_in_an_unknown_way(tmp_path):
    np.savez(tmp_path / "run.npz", **SIGNALS)
    whole = (tmp_path / "run.npz").read_bytes()
    local, central = whole.index(b"PK\x03\x04"), whole.index(b"PK\x01\x02")
    for place, value in ((6, 1), (8, 99)):  # flags, method
        changed = bytearray(whole)
        changed[local + place] = changed[central + place + 2] = value
        (tmp_path / "run.npz").write_bytes(changed)
        refused(tmp_path / "run.npz", mentions="not a readable .npz file")


def test_an_archive_that_unpacks_to_much_is_refused_before(tmp_path):
    np.savez_compressed(tmp_path / "run.npz", time=np.zeros(3_000_000), u=np.zeros(3_000_000), x=np.zeros(3_000_000))
    refused(tmp_path / "run.npz", mentions="at most 1 MB are read", reading=ReadingPolicy(largest_unpacked=1_000_000))


def test_nothing_outside_the_archive_is_written(tmp_path):
    archive(
        tmp_path / "run.npz", **{"../../evil": array_bytes(TIME), **{n: array_bytes(v) for n, v in SIGNALS.items()}}
    )
    assert read_csv(tmp_path / "run.npz", RIG).rows == N
    assert [file.name for file in tmp_path.iterdir()] == ["run.npz"]


# --- Parquet


def parquet(path, metadata=None, **columns):
    table = pa.table({**SIGNALS, **columns})
    pq.write_table(table.replace_schema_metadata(metadata) if metadata else table, path)
    return path


@pytest.mark.parametrize(
    "metadata", [b"{}", b"[]", b"5", b"not json", b'{"columns": [{}], "index_columns": [{"kind": "x"}]}']
)
def test_what_pandas_says_of_a_file_is_not_needed(tmp_path, metadata):
    assert read_csv(parquet(tmp_path / "run.parquet", {b"pandas": metadata}), RIG).rows == N


@pytest.mark.rest
def test_a_parquet_file_with_one_changed_byte_is_read_or_refused(tmp_path):
    whole = bytearray(parquet(tmp_path / "run.parquet").read_bytes())
    for place in range(0, len(whole), 5):
        changed = bytearray(whole)
        changed[place] ^= 0x41
        (tmp_path / "run.parquet").write_bytes(changed)
        read_or_refuse(tmp_path / "run.parquet")


@pytest.mark.rest
def test_a_parquet_file_that_unpacks_to_much_is_refused_before(tmp_path):
    rows = 60_000_000
    column = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int8)), pa.array([1.0]))
    schema = pa.schema([(name, column.type) for name in SIGNALS])
    with pq.ParquetWriter(tmp_path / "run.parquet", schema) as file:
        file.write_table(pa.table(dict.fromkeys(SIGNALS, column), schema=schema))
    assert (tmp_path / "run.parquet").stat().st_size < 1_000_000
    refused(tmp_path / "run.parquet")


def test_the_oldest_parquet_reader_that_is_allowed_runs_no_code_of_a_file():
    """CVE-2023-47248: before 14.0.1 pyarrow unpickled extension types."""
    text = (Path(__file__).resolve().parents[2] / "pyproject.toml").read_text(encoding="utf-8")
    floors = re.findall(r"pyarrow>=([\d.]+)", text)
    assert floors and all(tuple(map(int, floor.split("."))) >= (14, 0, 1) for floor in floors)


# --- text


def test_a_quoted_field_longer_than_a_field_may_be(tmp_path):
    lines = good(tmp_path / "run.csv").read_text().splitlines()
    lines[4] = '0.3,"' + "9" * 150_000 + '",1,2'
    (tmp_path / "run.csv").write_text("\n".join(lines))
    refused(tmp_path / "run.csv", mentions="line 5")


def test_a_line_without_an_end(tmp_path):
    (tmp_path / "run.csv").write_bytes(b"time,u,x\n" + b"1," * 10_000_000)
    refused(tmp_path / "run.csv", mentions="a line is longer than 200000")


def test_a_header_of_many_columns_is_refused_at_once(tmp_path):
    (tmp_path / "run.csv").write_bytes(b"a," * 90_000 + b"\n1\n")
    began = time.process_time()
    refused(tmp_path / "run.csv", mentions="90001 columns, at most 10000 are read")
    assert time.process_time() - began < 5


def test_a_limit_can_be_raised(tmp_path):
    header = ["time", "u", "x", *(f"c{k}" for k in range(1_200))]
    rows = [[t, u, x, *[0] * 1_200] for t, u, x in np.column_stack([TIME, DRIVE, ANSWER]).tolist()]
    (tmp_path / "run.csv").write_text("\n".join(",".join(map(str, row)) for row in (header, *rows)))
    reading = ReadingPolicy(most_columns=1_000)
    refused(tmp_path / "run.csv", mentions="--read-limit FACTOR", reading=reading)
    assert read_csv(tmp_path / "run.csv", RIG, reading=reading.times(2)).rows == N


def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path):
    path = good(tmp_path / "run.csv")
    refused(path, mentions="files of at most 0 MB are read", reading=ReadingPolicy(largest_file=100))


@pytest.mark.parametrize("error", ["#N/A", "#DIV/0!", "#NV", "#WERT!", "#NAME?"])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_an_error_of_a_spreadsheet_in_the_first_field_is_no_comment(tmp_path, error, separator):
    path = good(tmp_path / "run.csv", separator=separator)
    lines = path.read_text().splitlines()
    lines[6] = separator.join([error, *lines[6].split(separator)[1:]])
    path.write_text("\n".join(lines))
    refused(path, mentions="line 7")


def test_an_error_of_a_spreadsheet_is_not_confused_with_a_comment(tmp_path):
    path = good(tmp_path / "run.csv", before=["#N/A values were left out", "#!shebang", "#1"])
    assert read_csv(path, RIG).rows == N


def test_a_missing_value_of_a_spreadsheet_is_a_gap(tmp_path):
    path = good(tmp_path / "run.csv")
    lines = path.read_text().splitlines()
    lines[6] = ",".join([*lines[6].split(",")[:3], "#N/A"])
    path.write_text("\n".join(lines))
    assert np.isnan(read_csv(path, RIG).outputs["i"][5])


@pytest.mark.rest
def test_bytes_that_are_no_text_give_a_short_message(tmp_path):
    rng = np.random.default_rng(3)
    for k in range(6):
        content = bytes(rng.integers(128, 256, 4000, dtype=np.uint8))
        (tmp_path / "run.csv").write_bytes(content if k % 2 else content.replace(b"\n", b"") + b"\n" + content)
        refused(tmp_path / "run.csv")


@pytest.mark.parametrize("value", ["1e150", "-1e300", "1e101"])
@pytest.mark.parametrize("column", [0, 1, 2])
def test_numbers_whose_squares_overflow_are_refused(tmp_path, value, column):
    path = good(tmp_path / "run.csv")
    lines = path.read_text().splitlines()
    fields = lines[6].split(",")
    fields[column] = value
    path.write_text("\n".join([*lines[:6], ",".join(fields), *lines[7:]]))
    refused(path, mentions="at line 7; the squares of such numbers overflow")


def test_one_of_two_records_with_such_numbers_is_refused(tmp_path):
    lines = good(tmp_path / "run.csv").read_text().splitlines()
    time, _, *rest = lines[6].split(",")
    (tmp_path / "other.csv").write_text("\n".join([*lines[:6], ",".join([time, "-1e300", *rest]), *lines[7:]]))
    with pytest.raises(DataError, match="the squares of such numbers overflow"):
        read_experiments([tmp_path / "run.csv", tmp_path / "other.csv"], RIG)


def test_numbers_whose_squares_vanish_are_refused(tmp_path):
    rows = "\n".join(f"{t},{u},{1e-200 * x}" for t, u, x in zip(TIME, DRIVE, ANSWER, strict=True))
    (tmp_path / "run.csv").write_text(f"time,u,x\n{rows}")
    refused(tmp_path / "run.csv", mentions="output 'x' never exceeds 1e-206")


def test_numbers_that_overflow_in_the_units_of_the_model_are_refused(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(
        "time,u [GV],x\n" + "\n".join(f"{t},{1e95 * (1 + u)},{x}" for t, u, x in zip(TIME, DRIVE, ANSWER, strict=True))
    )
    refused(path, mentions="input 'u' is beyond 1e+100")


# --- units in headers

UNITS = [
    "nan",
    "inf",
    "NaN",
    "(" * 5000,
    "m" * 100_000,
    "10^400",
    "m^(1/0)",
    "0*m",
    "1e-300^9",
    "__import__",
    "None",
    "3",
    "m**1e999",
]


@pytest.mark.parametrize("unit", UNITS, ids=[unit[:12] for unit in UNITS])
def test_a_unit_that_is_none_is_named(tmp_path, unit):
    (tmp_path / "run.csv").write_text(
        f"time,u,x [{unit}]\n" + "\n".join(f"{t},{u},{x}" for t, u, x in zip(TIME, DRIVE, ANSWER, strict=True))
    )
    if unit != "3":
        with pytest.raises(ModelError) as error:
            parse_unit(unit)
        assert len(str(error.value)) < 500
    refused(tmp_path / "run.csv")


# --- what is no file


@pytest.mark.skipif(sys.platform == "win32", reason="pipes and devices of POSIX")
def test_pipes_and_devices_are_named_as_such(tmp_path):
    os.mkfifo(tmp_path / "fifo.csv")
    refused(tmp_path / "fifo.csv", mentions="is a pipe or a device")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the peak of memory of a process, in kilobytes")
def test_a_large_text_takes_little_memory_beyond_its_columns(tmp_path):
    """300 000 rows of 8 columns, of which 3 are wanted: 7 MB of numbers from 40 MB of text."""
    rng = np.random.default_rng(1)
    rows = "\n".join(",".join(map(repr, row)) for row in rng.normal(size=(1000, 7)).tolist()).split("\n")
    with open(tmp_path / "run.csv", "w") as file:
        file.write("time,u,x,a,b,c,d,e\n")
        for k in range(300_000):
            file.write(f"{k / 1000},{rows[k % 1000]}\n")
    child = os.fork()
    if child == 0:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        record = read_csv(tmp_path / "run.csv", RIG)
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        os._exit(0 if record.rows == 300_000 and grown < 150_000 else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
