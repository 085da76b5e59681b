"""Parquet files through pyarrow: the schema first, columns when they are wanted."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

import numpy as np

from greybox.base import DataError, nearest
from greybox.data.array_table import ArrayInfo, ArrayTable, read_cells
from greybox.data.columns import check_width
from greybox.data.file_kinds import FileFormat, RecordFile
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.stamps import MISSING, StampKind, Stamps, from_datetimes, is_stamp


def read_parquet(path: Path, policy: ReadingPolicy = READING_POLICY) -> ArrayTable:
    """Columns of a Parquet file; an index that pandas stored is a column like the others."""
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        infos = _inspect_columns(file, policy)

    def load(names: Sequence[str]) -> Mapping[str, np.ndarray | Stamps]:
        with pq.ParquetFile(path) as file:
            # One column after the other, and what arrow has of it is given back: a long record is in memory once.
            return {name: _to_column(file.read(columns=[name], use_threads=False).column(name)) for name in names}

    return ArrayTable.from_infos(infos, load, policy)


def _inspect_columns(file: Any, policy: ReadingPolicy) -> dict[str, ArrayInfo]:
    """What is known of the columns of an open file. Raises DataError for more than the policy allows."""
    import pyarrow as pa

    check_width(len(file.schema_arrow), policy)
    rows = file.metadata.num_rows
    types, infos = pa.types, {}
    for column in file.schema_arrow:
        # A column without any value has the type null: gaps alone.
        numeric = (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal, types.is_null)
        dated, is_number = None, False
        if types.is_temporal(column.type) or _is_text(column.type):
            # A text may be a date or a number, which its first value shows.
            first = next(file.iter_batches(1, columns=[column.name], use_threads=False), None)
            example = (
                first.column(0).to_pylist()[0] if first is not None and len(first) and _is_text(column.type) else None
            )
            if types.is_temporal(column.type) or is_stamp(example):
                dated = ":" in example if isinstance(example, str) else not types.is_date(column.type)
            is_number = isinstance(example, str) and dated is None and read_cells([example]) != [None]
        readable = dated is not None or is_number or any(is_kind(column.type) for is_kind in numeric)
        kind = "text" if _is_text(column.type) else str(column.type)
        infos[column.name] = ArrayInfo((rows,), "" if readable else kind, dated)
    return infos


def _is_text(kind: Any) -> bool:
    return str(kind) in ("string", "large_string", "string_view")


def _to_column(column: Any) -> np.ndarray | Stamps:
    """A column (N,) as numbers of its own, NaN for nulls, or as stamps."""
    import pyarrow as pa

    if pa.types.is_time(column.type):
        # Since midnight, in the unit of the column.
        ticks = column.cast(pa.time64("ns")).cast(pa.int64()).to_numpy()
        return Stamps(np.where(column.is_null(), MISSING, np.nan_to_num(ticks)).astype(np.int64), StampKind.CLOCK)
    if pa.types.is_temporal(column.type):
        return from_datetimes(column.to_numpy(), zoned=getattr(column.type, "tz", None) is not None)
    if _is_text(column.type):
        return np.array(column.to_pylist(), dtype=object)
    numbers = np.array(column.cast(pa.float64(), safe=False).to_numpy(), dtype=np.float64)
    del column
    pa.default_memory_pool().release_unused()
    return numbers


# Many records in one file: a column names the record of each row, and the rows of a record stand together.


def find_record_rows(path: Path, column: str) -> dict[str, tuple[int, int]]:
    """Name of each record in a Parquet file -> its first row and the one behind its last, in the order of the file.

    Parameters
    ----------
    path
        The file.
    column
        The column that names the record of each row: text, whole numbers or categories.

    Raises
    ------
    DataError
        Without such a column, for rows that name no record, and for a record whose rows do not stand together.
    """
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        known = file.schema_arrow.names
        if column not in known:
            raise DataError(
                f"{path.name}: no column {column!r} that names the record of each row; {nearest(column, known)}"
            )
        names = file.read(columns=[column], use_threads=False).column(column).combine_chunks()
    if names.null_count:
        raise DataError(
            f"{path.name}: {names.null_count} rows name no record in column {column!r}; fill or remove them"
        )
    if not hasattr(names, "dictionary"):
        names = names.dictionary_encode()
    codes, titles = names.indices.to_numpy(zero_copy_only=False), names.dictionary.to_pylist()
    if not len(codes):
        raise DataError(f"{path.name}: no rows")
    starts = [0, *(np.flatnonzero(np.diff(codes)) + 1).tolist()]
    rows: dict[str, tuple[int, int]] = {}
    for first, behind in pairwise([*starts, len(codes)]):
        title = str(titles[codes[first]])
        if title in rows:
            raise DataError(
                f"{path.name}: the rows of record {title!r} do not stand together (rows {rows[title][0] + 1} and {first + 1});"
                f" sort the file by {column!r} and time"
            )
        rows[title] = (first, behind)
    return rows


def open_parquet_part(
    path: Path, rows: tuple[int, int], column: str, policy: ReadingPolicy = READING_POLICY
) -> RecordFile:
    """The rows from the first to the one before the last of a Parquet file, as a file of its own without the ``column`` of names.

    Neighbouring parts are read together: a row group is decoded once for all records in it that are read one after the other.
    """
    stamp = path.stat()
    source = _open_source(path, stamp.st_size, stamp.st_mtime_ns)
    first, behind = rows
    infos = {
        name: replace(info, shape=(behind - first,)) for name, info in source.infos(policy).items() if name != column
    }
    return RecordFile(
        path, PARQUET, ArrayTable.from_infos(infos, lambda names: source.load(names, first, behind), policy)
    )


class _ParquetSource:
    """An open file, and the columns of the row groups that were read last."""

    def __init__(self, path: Path) -> None:
        import pyarrow.parquet as pq

        self._file = pq.ParquetFile(path)
        groups = self._file.metadata.num_row_groups
        counts = [self._file.metadata.row_group(k).num_rows for k in range(groups)]
        self._edges = np.concatenate([[0], np.cumsum(counts)])
        self._columns = lru_cache(maxsize=KEPT_COLUMNS)(self._read_column)
        self.infos = lru_cache(partial(_inspect_columns, self._file))

    def load(self, names: Sequence[str], first: int, behind: int) -> dict[str, np.ndarray | Stamps]:
        """Rows ``first`` to ``behind - 1`` of some columns."""
        groups = range(
            int(np.searchsorted(self._edges, first, side="right")) - 1, int(np.searchsorted(self._edges, behind))
        )
        arrays: dict[str, np.ndarray | Stamps] = {}
        for name in names:
            columns = [
                (self._columns(name, k), slice(max(first - self._edges[k], 0), behind - self._edges[k])) for k in groups
            ]
            parts = [c.nanoseconds[rows] if isinstance(c, Stamps) else c[rows] for c, rows in columns]
            joined, (example, _) = np.concatenate(parts), columns[0]
            arrays[name] = replace(example, nanoseconds=joined) if isinstance(example, Stamps) else joined
        return arrays

    def _read_column(self, name: str, group: int) -> np.ndarray | Stamps:
        return _to_column(self._file.read_row_group(group, columns=[name], use_threads=False).column(name))


# Columns of row groups that are kept: those of a dozen signals, of the two groups that a record may lie across.
KEPT_COLUMNS = 24


@lru_cache(maxsize=1)
def _open_source(path: Path, size: int, changed: int) -> _ParquetSource:
    """The file, open from one record to the next; opened anew where its size or the time of its last change is another."""
    return _ParquetSource(path)


# Archives of NumPy arrays (.npz): headers first, arrays when they are wanted, nothing unpickled.

SUFFIX = ".npy"
HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_npz(path: Path, policy: ReadingPolicy = READING_POLICY) -> ArrayTable:
    """Arrays of a NumPy archive; names may carry units, as in ``numpy.savez(file, **{"x [um]": x})``.

    Raises DataError for a member that is no array, or shorter than it claims to be.
    """
    with zipfile.ZipFile(path) as archive:
        check_width(len(archive.infolist()), policy)
        members = {member.filename.removesuffix(SUFFIX): member for member in archive.infolist()}
        infos = {}
        for name, member in members.items():
            with archive.open(member) as file:
                infos[name] = _read_info(file, member.file_size)

    def load(names: Sequence[str]) -> Mapping[str, np.ndarray]:
        arrays = {}
        with zipfile.ZipFile(path) as archive:
            for name in names:
                with archive.open(members[name]) as file:
                    arrays[name] = np.lib.format.read_array(file, allow_pickle=False)
        return arrays

    return ArrayTable.from_infos(infos, load, policy)


def _read_info(file: IO[bytes], size: int) -> ArrayInfo:
    """Shape and type of an array from its header; ``size``: bytes of the member."""
    if file.read(len(np.lib.format.MAGIC_PREFIX)) != np.lib.format.MAGIC_PREFIX:
        raise DataError("a member is no array; write it with numpy.savez(file, time=..., u=...)")
    # Two bytes after the mark: the version of the header that follows.
    version = tuple(file.read(2))
    if version not in HEADERS:
        return ArrayInfo((), "an array of another format")
    shape, _, dtype = HEADERS[version](file)
    if dtype.hasobject:
        return ArrayInfo(shape, "Python objects")
    # Checked before it is read: a damaged shape would ask for any amount of memory.
    if int(np.prod(shape, dtype=object)) * dtype.itemsize > size:
        raise DataError(f"an array claims the shape {shape}, which its {size} bytes cannot hold; write the file again")
    holds = {"U": "text", "S": "text"}.get(dtype.kind, str(dtype))
    return ArrayInfo(shape, "" if dtype.kind in "biufMm" else holds, True if dtype.kind in "Mm" else None)


NPZ = FileFormat(".npz", (".npz",), read_npz, "write it with numpy.savez(file, time=..., u=...)")
PARQUET = FileFormat(
    "Parquet", (".parquet",), read_parquet, "write it again, or export the record as CSV", (("pyarrow", "parquet"),)
)
