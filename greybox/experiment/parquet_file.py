"""Parquet files through pyarrow: the schema first, columns when they are wanted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from greybox.experiment.array_table import ArrayInfo, ArrayTable
from greybox.experiment.policy import READING_POLICY, ReadingPolicy
from greybox.experiment.table import check_width


def read_parquet(path: Path, policy: ReadingPolicy = READING_POLICY) -> ArrayTable:
    """Columns of a Parquet file; an index that pandas stored is a column like the others."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        check_width(len(file.schema_arrow), policy)
        rows = file.metadata.num_rows
        infos = {
            column.name: ArrayInfo((rows,), "" if _is_number(pa.types, column.type) else _describe_type(column.type))
            for column in file.schema_arrow
        }

    def load(names: Sequence[str]) -> Mapping[str, np.ndarray]:
        with pq.ParquetFile(path) as file:
            table = file.read(columns=list(names), use_threads=False)
        return {name: _to_array(table.column(name).cast(pa.float64(), safe=False)) for name in names}

    return ArrayTable.from_infos(infos, load, policy)


def _is_number(types: Any, kind: Any) -> bool:
    known = (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal, types.is_null)
    return any(is_kind(kind) for is_kind in known)


def _describe_type(kind: Any) -> str:
    return "text" if str(kind) in ("string", "large_string") else str(kind)


def _to_array(column: Any) -> np.ndarray:
    """Numbers with NaN for nulls."""
    return np.asarray(column.to_numpy(), dtype=np.float64)
