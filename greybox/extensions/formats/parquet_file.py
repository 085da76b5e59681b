"""Parquet files through pyarrow: the schema first, columns when they are wanted."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

import numpy as np

from greybox.base.errors import DataError
from greybox.data.array_table import ArrayInfo, ArrayTable
from greybox.data.columns import check_width
from greybox.data.formats import FileFormat
from greybox.data.policy import READING_POLICY, ReadingPolicy


def read_parquet(path: Path, policy: ReadingPolicy = READING_POLICY) -> ArrayTable:
    """Columns of a Parquet file; an index that pandas stored is a column like the others."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        check_width(len(file.schema_arrow), policy)
        rows = file.metadata.num_rows
        types, infos = pa.types, {}
        for column in file.schema_arrow:
            # A column without any value has the type null: gaps alone.
            numeric = (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal, types.is_null)
            kind = "text" if str(column.type) in ("string", "large_string") else str(column.type)
            infos[column.name] = ArrayInfo((rows,), "" if any(is_kind(column.type) for is_kind in numeric) else kind)

    def load(names: Sequence[str]) -> Mapping[str, np.ndarray]:
        with pq.ParquetFile(path) as file:
            table = file.read(columns=list(names), use_threads=False)
        # Numbers, NaN for nulls.
        columns = {name: table.column(name).cast(pa.float64(), safe=False) for name in names}
        return {name: np.asarray(column.to_numpy(), dtype=np.float64) for name, column in columns.items()}

    return ArrayTable.from_infos(infos, load, policy)


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
    return ArrayInfo(shape, "" if dtype.kind in "biuf" else holds)


NPZ = FileFormat(".npz", (".npz",), read_npz, "write it with numpy.savez(file, time=..., u=...)")
PARQUET = FileFormat(
    "Parquet", (".parquet",), read_parquet, "write it again, or export the record as CSV", (("pyarrow", "parquet"),)
)
