"""HDF5 files, among them those of MATLAB 7.3: data sets by their path, numbers loaded when they are wanted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from greybox.experiment.array_table import ArrayInfo, ArrayTable
from greybox.experiment.policy import READING_POLICY, ReadingPolicy
from greybox.experiment.table import check_width

SIGNATURE = b"\x89HDF\r\n\x1a\n"
PLACES = (0, 512, 1024, 2048)
"""Where the signature may stand: MATLAB writes a text of 512 bytes before it."""


def is_hdf5(path: Path) -> bool:
    """Whether a file is HDF5 inside, as MATLAB 7.3 writes it."""
    with open(path, "rb") as file:
        start = file.read(PLACES[-1] + len(SIGNATURE))
    return any(start[place : place + len(SIGNATURE)] == SIGNATURE for place in PLACES)


def read_hdf5(path: Path, policy: ReadingPolicy = READING_POLICY) -> ArrayTable:
    """Data sets of an HDF5 file; ``x`` in a group ``data`` is called ``data.x``. Links to other files are not followed."""
    import h5py

    infos: dict[str, ArrayInfo] = {}
    places: dict[str, tuple[str, bool]] = {}
    with h5py.File(path, "r") as file:
        by_matlab = "MATLAB_class" in {key for _, _, data in _walk(h5py, file, "", 1) for key in data.attrs}
        for name, place, data in _walk(h5py, file, "", policy.deepest_nesting):
            shape = tuple(int(n) for n in data.shape or ())
            infos[name] = ArrayInfo(shape[::-1] if by_matlab else shape, _describe_content(data))
            places[name] = (place, by_matlab)
            check_width(len(infos), policy)

    def load(names: Sequence[str]) -> Mapping[str, np.ndarray]:
        with h5py.File(path, "r") as file:
            arrays = {name: np.asarray(file[places[name][0]]) for name in names}
        return {name: array.T if places[name][1] else array for name, array in arrays.items()}

    return ArrayTable.from_infos(infos, load, policy)


def _walk(h5py: Any, group: Any, prefix: str, levels: int) -> Iterator[tuple[str, str, Any]]:
    """Name, path and data set of all in ``group``, but for MATLAB's own bookkeeping and links to other files."""
    for key in group:
        if key.startswith("#") or not isinstance(group.get(key, getlink=True), h5py.HardLink):
            continue
        inner = group[key]
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(inner, h5py.Dataset):
            yield name, inner.name, inner
        elif isinstance(inner, h5py.Group) and levels > 0:
            yield from _walk(h5py, inner, name, levels - 1)


def _describe_content(data: Any) -> str:
    """What a data set holds, "" for real numbers."""
    kind = data.attrs.get("MATLAB_class", b"")
    if kind in (b"char", b"cell", b"struct", b"function_handle"):
        return bytes(kind).decode()
    if data.external or data.is_virtual:
        return "numbers of another file"
    if "MATLAB_empty" in data.attrs:
        return "nothing"
    return "" if data.dtype.kind in "biuf" else str(data.dtype)
