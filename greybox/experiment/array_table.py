"""Tables in MATLAB (.mat), NumPy (.npz) and Parquet files."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from greybox.errors import DataError
from greybox.experiment.problems import RowLabels
from greybox.experiment.table import describe_non_numbers


@dataclass(frozen=True)
class ArrayTable:
    """Named arrays of a file; rows are counted from 1."""

    arrays: Mapping[str, np.ndarray]

    @property
    def headers(self) -> tuple[str, ...]:
        """Names of the arrays."""
        return tuple(self.arrays)

    @property
    def comments(self) -> tuple[str, ...]:
        """None: such files have no lines."""
        return ()

    @property
    def row_labels(self) -> RowLabels:
        """Rows are called by their number."""
        return RowLabels()

    def values(self, positions: Sequence[int]) -> tuple[dict[int, np.ndarray], list[str]]:
        """Columns (N,) as float64 with NaN for gaps, and the problems met."""
        columns: dict[int, np.ndarray] = {}
        problems: list[str] = []
        for k in positions:
            header = self.headers[k]
            columns[k] = _to_column(header, self.arrays[header], self.row_labels, problems)
        rows = {len(values) for values in columns.values()}
        if not problems and len(rows) > 1:
            lengths = ", ".join(f"{self.headers[k]!r} {len(v)}" for k, v in columns.items())
            problems.append(f"columns differ in length ({lengths} rows); each needs one value for each time")
        return columns, problems


def read_mat(path: Path) -> ArrayTable:
    """Variables of a MATLAB file up to version 7; a field ``x`` of a struct ``data`` is called ``data.x``.

    Raises DataError for version 7.3, which is another format, and for a damaged file.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(str(path), simplify_cells=True)
    except NotImplementedError:
        raise DataError(
            f"{path.name}: MATLAB 7.3 files cannot be read;"
            f" in MATLAB save it again with save('{path.name}', '-v7'), or export it as CSV"
        ) from None
    except (MatReadError, ValueError, TypeError, OSError) as error:
        raise DataError(
            f"{path.name}: not a readable MATLAB file ({error}); save it again with '-v7', or export it as CSV"
        ) from error
    arrays: dict[str, np.ndarray] = {}
    for name, value in content.items():
        if name.startswith("__"):
            continue
        members = {f"{name}.{n}": v for n, v in value.items()} if isinstance(value, dict) else {name: value}
        arrays |= {n: np.asarray(v) for n, v in members.items() if not isinstance(v, dict)}
    return ArrayTable(arrays)


def read_npz(path: Path) -> ArrayTable:
    """Arrays of a NumPy archive; names may carry units, as in ``numpy.savez(file, **{"x [um]": x})``."""
    try:
        content: Any = np.load(path, allow_pickle=False)
        if not isinstance(content, np.lib.npyio.NpzFile):
            raise ValueError("it holds a single array, not named ones")
        with content:
            arrays = {name: content[name] for name in content.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise DataError(
            f"{path.name}: not a readable .npz file ({error}); write it with numpy.savez(file, time=..., u=...)"
        ) from error
    return ArrayTable(arrays)


def read_parquet(path: Path) -> ArrayTable:
    """Columns of a Parquet file."""
    import pandas as pd

    try:
        frame = pd.read_parquet(path)
    except ImportError as error:
        raise DataError(
            f"{path.name}: reading Parquet needs the package pyarrow; install it, or export the record as CSV"
        ) from error
    except (ValueError, OSError) as error:
        raise DataError(
            f"{path.name}: not a readable Parquet file ({error}); write it again, or export the record as CSV"
        ) from error
    arrays: dict[str, np.ndarray] = {}
    for name in frame.columns:
        column = frame[name]
        numeric = pd.api.types.is_numeric_dtype(column.dtype)
        arrays[str(name)] = column.to_numpy(dtype=np.float64, na_value=np.nan) if numeric else column.to_numpy()
    return ArrayTable(arrays)


def _to_column(header: str, array: np.ndarray, labels: RowLabels, problems: list[str]) -> np.ndarray:
    if array.ndim == 2 and 1 in array.shape:
        array = array.ravel()
    if array.ndim != 1:
        problems.append(f"column {header!r} has shape {array.shape}; it needs one number for each row")
    elif array.dtype.kind in "biuf":
        return array.astype(np.float64)
    elif array.dtype.kind in "OUS":
        values = [_to_number(v) for v in array]
        bad = [k for k, v in enumerate(values) if v is None]
        if not bad:
            return np.array(values, dtype=np.float64)
        problems.append(describe_non_numbers(header, bad, [str(array[k]) for k in bad], labels))
    else:
        problems.append(f"column {header!r} holds {array.dtype}, not real numbers; write numbers (time in seconds)")
    return np.zeros(0)


def _to_number(value: Any) -> float | None:
    """A number, NaN for a missing one, None for anything else."""
    if value is None:
        return float("nan")
    return float(value) if isinstance(value, (int, float, np.number)) and not isinstance(value, complex) else None
