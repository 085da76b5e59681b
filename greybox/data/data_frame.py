"""Records that are in memory already: a data frame of pandas or polars, or arrays by name, read as the table of a file is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol, TypeGuard

import numpy as np

from greybox.base import DataError
from greybox.data.array_table import ArrayInfo, ArrayTable
from greybox.data.experiment import UNNAMED, Experiment
from greybox.data.file_kinds import FileFormat, RecordFile
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.stamps import is_stamp


class DataFrame(Protocol):
    """What a data frame of pandas and one of polars have in common."""

    @property
    def columns(self) -> Iterable[Any]:
        """The headers."""

    def __getitem__(self, name: Any, /) -> Any:
        """A column."""


Frame = DataFrame | Mapping[str, Any]
"""A data frame, or arrays by name."""


def is_frame(value: Any) -> TypeGuard[Frame]:
    """Whether a value is a table: named columns, as pandas and polars have them, or a mapping from name to column."""
    return isinstance(value, Mapping) or (hasattr(value, "columns") and hasattr(value, "__getitem__"))


def open_frame(frame: Frame, policy: ReadingPolicy = READING_POLICY) -> RecordFile:
    """A data frame as a file that is open: its index comes first unless it counts the rows; without a name it is the time.

    Raises DataError for columns that are no table, and for several records in one mapping.
    """
    if isinstance(frame, Mapping) and (
        records := [n for n, v in frame.items() if is_frame(v) or isinstance(v, Experiment)]
    ):
        raise DataError(
            f"{', '.join(map(repr, records))}: a mapping from name to column is one record, and these are records themselves; give them as"
            " a list, [first, second], or by their names as [gb.read_csv(frame, model, name=name), ...]"
        )
    index: Any = getattr(frame, "index", None)
    arrays: dict[str, np.ndarray] = {}
    # An index of whole numbers without a name counts the rows, also where some of them were left out.
    if index is not None and hasattr(index, "to_numpy") and (index.name is not None or index.dtype.kind not in "iu"):
        arrays["time" if index.name is None else str(index.name)] = index.to_numpy()
    arrays |= {str(name): np.asarray(frame[name]) for name in (frame if isinstance(frame, Mapping) else frame.columns)}
    infos = {}
    for name, array in arrays.items():
        first = array.flat[0] if array.dtype.kind in "OU" and array.size else None
        dated = array.dtype.kind in "Mm" or is_stamp(first)
        infos[name] = ArrayInfo(array.shape, dated=True if dated else None)
    table = ArrayTable.from_infos(infos, lambda names: {name: arrays[name] for name in names}, policy)
    kind = FileFormat("data frame", (), lambda path, policy: table, "correct the frame")
    return RecordFile(Path(UNNAMED), kind, table)
