"""Valid files of every format and layout, to be damaged, and odd ones as instruments, spreadsheets and strangers make them."""

from __future__ import annotations

import io
import string
import zipfile
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.io import savemat

from tests.hardening.mutations import FIELDS

ROWS = 40
TIME = 0.01 * np.arange(ROWS)
DRIVE = np.sin(7 * TIME) + 0.3 * np.sin(31 * TIME)
ANSWER = 0.2 * np.cos(5 * TIME) - 0.1
SIGNALS = {"time": TIME, "u": DRIVE, "y": ANSWER}
MATRIX = np.column_stack(list(SIGNALS.values()))


def write_rows(separator: str = ",", decimal: str = ".", digits: str = "r") -> list[str]:
    return [separator.join(format_number(v, digits).replace(".", decimal) for v in row) for row in MATRIX.tolist()]


def format_number(value: float, digits: str) -> str:
    return repr(value) if digits == "r" else format(value, digits)


def valid_files(folder: Path) -> dict[str, tuple[Path, dict[str, object]]]:
    """Name -> file, and how `read_csv` reads it. Twenty-five, of every format and layout."""
    files: dict[str, tuple[Path, dict[str, object]]] = {}

    def text(
        name: str, head: list[str], rows: list[str], encoding: str = "utf-8", end: str = "\n", **how: object
    ) -> None:
        path = folder / name
        path.write_bytes((end.join([*head, *rows]) + end).encode(encoding))
        files[name] = (path, how)

    text("comma.csv", ["time [s],u [V],y [V]"], write_rows())
    text("semicolon.csv", ["time;u;y"], write_rows(";", ","))
    text("tab.tsv", ["time [ms]\tu [mV]\ty [mV]"], write_rows("\t"))
    text("blanks.dat", ["time [s]   u [V]   y [V]"], write_rows("   ", digits="12.5e"))
    text("commas.txt", ["time u y"], write_rows(" ", ","))
    text("quoted.csv", ['"time [s]","u [V]","y [V]"'], [",".join(f'"{f}"' for f in r.split(",")) for r in write_rows()])
    text("excel.csv", ["sep=;", "time;u;y"], write_rows(";"))
    text("comments.csv", ["# bench 3", "# P_S = 8 kPa", "time,u,y"], write_rows())
    text("headless.csv", [], write_rows(), columns=["time", "u", "y"])
    text("commented.txt", ["% time u y"], write_rows(" "))
    text("timeless.csv", ["u,y"], [row.split(",", 1)[1] for row in write_rows()], sampling_time=0.01)
    text("wide.csv", ["time,u,y," + ",".join(f"c{k}" for k in range(30))], [f"{r}{',1.5' * 30}" for r in write_rows()])
    text("utf16.txt", ["time [s]\tu [V]\ty [V]"], write_rows("\t"), "utf-16", "\r\n")
    text("latin.csv", ["time [s],u [V],y [µV]"], write_rows(), "latin-1", "\r")
    for name, compressed in (("packed.mat", True), ("plain.mat", False)):
        savemat(folder / name, {**SIGNALS, "title": "bench"}, do_compression=compressed)
        files[name] = (folder / name, {})
    savemat(folder / "version4.mat", SIGNALS, format="4")
    savemat(folder / "matrix.mat", {"data": MATRIX}, do_compression=True)
    savemat(folder / "struct.mat", {"log": {"t": TIME, "in": {"u": DRIVE}, "y": ANSWER}}, do_compression=True)
    files["version4.mat"] = (folder / "version4.mat", {})
    files["matrix.mat"] = (folder / "matrix.mat", {"columns": ["time", "u", "y"]})
    files["struct.mat"] = (folder / "struct.mat", {"columns": {"time": "log.t", "u": "log.in.u", "y": "log.y"}})
    with h5py.File(folder / "new.mat", "w", userblock_size=512) as file:
        for name, values in SIGNALS.items():
            file.create_dataset(name, data=values[None, :], compression="gzip").attrs["MATLAB_class"] = np.bytes_(
                "double"
            )
    files["new.mat"] = (folder / "new.mat", {})
    np.savez(folder / "plain.npz", **SIGNALS)
    np.savez_compressed(folder / "packed.npz", **SIGNALS, note=np.array(["text"]))
    np.savez(folder / "matrix.npz", data=MATRIX.astype(np.float32))
    files["plain.npz"] = (folder / "plain.npz", {})
    files["packed.npz"] = (folder / "packed.npz", {})
    files["matrix.npz"] = (folder / "matrix.npz", {"columns": ["time", "u", "y"]})
    pq.write_table(pa.table(SIGNALS), folder / "plain.parquet")
    pq.write_table(pa.table({**SIGNALS, "note": ["text"] * ROWS}), folder / "packed.parquet", compression="gzip")
    files["plain.parquet"] = (folder / "plain.parquet", {})
    files["packed.parquet"] = (folder / "packed.parquet", {})
    return files


def odd_files() -> Iterator[tuple[str, bytes]]:
    """Names and contents of some seven hundred odd files, each odd in its own way."""
    rows, header = write_rows(), "time [s],u [V],y [V]"
    good = "\n".join([header, *rows])

    def lines(*changes: tuple[int, str]) -> bytes:
        changed = [header, *rows]
        for k, line in changes:
            changed[k] = line
        return "\n".join(changed).encode("utf-8", "surrogatepass")

    # a field of every column and of header, first, middle and last row
    for place in (0, 1, 20, ROWS):
        for column in range(3):
            for k, field in enumerate(FIELDS):
                parts = [header, *rows][place].split(",")
                parts[column] = field
                yield f"field_{place}_{column}_{k}.csv", lines((place, ",".join(parts)))
    for k, unit in enumerate(
        (
            "nan",
            "inf",
            "V V",
            "V^",
            "^2",
            "(",
            ")",
            "((((",
            "m/0",
            "10^999",
            "V**V",
            "%%",
            "µ",
            "Ω",
            "°C",
            "lambda",
            "V" * 200,
            "1/",
            "0",
            "-1",
            "a;b",
        )
    ):
        yield f"unit_{k}.csv", lines((0, f"time,u,y [{unit}]"))
        yield f"paren_{k}.csv", lines((0, f"time,u,y ({unit})"))
    for k, name in enumerate(
        (
            "",
            " ",
            "time",
            "u",
            "Time",
            "t",
            "U",
            "y.1",
            "{y}",
            "%s",
            "y" * 300,
            "\u202ey",
            "y\x00",
            "__y",
            "../y",
            "<y>",
            "y=1",
            "-y",
            '"y"',
            "y,y",
        )
    ):
        yield f"header_{k}.csv", lines((0, f"time,u,{name}"))
        yield f"first_{k}.csv", lines((0, f"{name},u,y"))
    texts = {
        "empty": "",
        "newline": "\n",
        "blank": "   \n\t\n",
        "header_only": header,
        "comments_only": "# a\n# b\n",
        "one_row": "\n".join([header, rows[0]]),
        "no_numbers": "a,b,c\nd,e,f\ng,h,i",
        "two_tables": f"{good}\n\n{good}",
        "backwards": "\n".join([header, *rows[::-1]]),
        "repeated": "\n".join([header, *[rows[3]] * 30]),
        "units_row": "\n".join(["time,u,y", "s,V,V", *rows]),
        "preamble": "\n".join(["Oscilloscope 3000", "Serial 12", "", header, *rows]),
        "footer": f"{good}\nend of file",
        "html": "<html><body><table><tr><td>1</td></tr></table></body></html>",
        "json": '{"time": [1, 2], "u": [1, 2]}',
        "xml": '<?xml version="1.0"?><a/>',
        "formulas": "\n".join([header, *["=A1,+B1,@C1"] * 12]),
        "long_quote": f'{header}\n"{"9" * 140_000}',
        "open_quote": f'{good}\n"0.5,1,1',
        "commas": "," * 5000,
        "brackets": "[" * 50_000,
        "one_line": "1," * 90_000,
        "constant": "\n".join([header, *[f"{k},1,1" for k in range(30)]]),
        "zeros": "\n".join([header, *[f"{k},0,0" for k in range(30)]]),
        "huge": "\n".join([header, *[f"{k},1e308,-1e308" for k in range(30)]]),
        "tiny": "\n".join([header, *[f"{k},{k}e-320,{k}e-322" for k in range(30)]]),
        "late_time": "\n".join([header, *[f"{1e15 + k},{k % 7},{k % 5}" for k in range(30)]]),
        "integers": "\n".join([header, *[f"{k},{10**30 + k},{k}" for k in range(30)]]),
        "many_columns": ",".join(["time", "u", "y", *[f"c{k}" for k in range(9000)]])
        + "\n"
        + "\n".join(r + ",1" * 9000 for r in rows[:12]),
    }
    for name, text in texts.items():
        for suffix in ("csv", "txt", "dat", "tsv"):
            yield f"{name}.{suffix}", text.encode()
    for encoding in ("utf-16", "utf-16-le", "utf-16-be", "utf-32", "cp1252", "utf-7", "cp037"):
        yield f"{encoding}.csv", good.encode(encoding)
        yield f"{encoding}_odd.csv", good.encode(encoding) + b"\xff"
    for k, separator in enumerate((",", ";", "\t", "|", ":", "  ", "\v", "\f", "\x1f", "\u2003")):
        yield f"separator_{k}.csv", good.replace(",", separator).encode()
    # every format's suffix on every other format's content, and on none
    inner = {
        "csv": good.encode(),
        "npz": _npz(),
        "mat": _mat(),
        "parquet": _parquet(),
        "h5": b"\x89HDF\r\n\x1a\n" + bytes(200),
    }
    for suffix in ("csv", "txt", "mat", "npz", "parquet"):
        for kind, content in inner.items():
            yield f"really_{kind}.{suffix}", content
        for k, content in enumerate(
            (
                b"",
                b"\0",
                bytes(600),
                b"PAR1",
                b"PK\x03\x04",
                b"PAR1PAR1",
                b"MATLAB 5.0",
                string.printable.encode(),
                bytes(range(256)) * 4,
            )
        ):
            yield f"bytes_{k}.{suffix}", content
    members = {"time": TIME, "u": DRIVE, "y": ANSWER}
    shapes = {
        "scalar": np.float64(1),
        "matrix": MATRIX,
        "cube": np.zeros((2, 3, 4)),
        "none": np.zeros(0),
        "short": ANSWER[1:],
        "long": np.zeros(10**6),
    }
    kinds = {
        "complex": ANSWER * 1j,
        "text": np.array(["a"] * ROWS),
        "bool": ANSWER > 0,
        "half": ANSWER.astype(np.float16),
        "date": TIME.astype("M8[s]"),
    }
    for name, values in {**shapes, **kinds, "nan": np.full(ROWS, np.nan), "inf": np.full(ROWS, np.inf)}.items():
        yield f"{name}.npz", _npz(**{**members, "y": values})
        if name != "date":
            yield f"{name}.mat", _mat(**{**members, "y": values})


def _npz(**arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **(arrays or SIGNALS))
    return stream.getvalue()


def _mat(**arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    savemat(stream, arrays or SIGNALS)
    return stream.getvalue()


def _parquet() -> bytes:
    stream = io.BytesIO()
    pq.write_table(pa.table(SIGNALS), stream)
    return stream.getvalue()


def packed_lies() -> Iterator[tuple[str, bytes]]:
    """Archives that claim to be other than they are."""
    for k in range(4):
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w") as archive:
            for name in ("time.npy", "u.npy", "../y.npy", "y.npy")[: k + 1]:
                archive.writestr(name, b"\x93NUMPY\x01\x00" + bytes(k))
        yield f"lie_{k}.npz", stream.getvalue()
