"""MATLAB files: versions 4 to 7 through scipy, version 7.3 (HDF5) through h5py."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from greybox.errors import DataError
from greybox.experiment.array_table import ArrayInfo, ArrayTable
from greybox.experiment.hdf5_file import is_hdf5, read_hdf5
from greybox.experiment.policy import READING_POLICY, ReadingPolicy
from greybox.experiment.table import raise_limit

NUMERIC = frozenset(
    ("double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))
)
"""Classes of MATLAB that hold numbers."""
CONTAINERS = ("struct", "object")
HEADER = 128
VERSION_7_3 = b"\x00\x02"
COMPRESSED = 15  # type of a compressed element


def read_mat(path: Path, policy: ReadingPolicy = READING_POLICY) -> ArrayTable:
    """Variables of a MATLAB file; a field ``x`` of a struct ``data`` is called ``data.x``. Structs are loaded, other variables
    when they are wanted.

    Raises DataError for a file that would unpack to more than the policy allows.
    """
    with open(path, "rb") as file:
        version = file.read(HEADER)[124:126]
    if is_hdf5(path) or version == VERSION_7_3:
        return read_hdf5(path, policy)
    from scipy.io import loadmat, whosmat

    _check_unpacked(path, policy)
    listing = whosmat(str(path))
    containers = [name for name, _, kind in listing if kind in CONTAINERS]
    members: dict[str, np.ndarray] = {}
    if containers:
        content = loadmat(str(path), simplify_cells=True, variable_names=containers)
        for name in containers:
            members |= _list_members(name, content.get(name), policy.deepest_nesting)
    infos = {
        name: ArrayInfo(tuple(shape), "" if kind in NUMERIC else kind)
        for name, shape, kind in listing
        if kind not in CONTAINERS
    }
    infos |= {name: ArrayInfo(array.shape, _describe_content(array)) for name, array in members.items()}

    def load(names: Sequence[str]) -> Mapping[str, np.ndarray]:
        variables = [name for name in names if name not in members]
        arrays = loadmat(str(path), simplify_cells=True, variable_names=variables) if variables else {}
        return {name: members[name] if name in members else np.asarray(arrays[name]) for name in names}

    return ArrayTable.from_infos(infos, load, policy)


def _describe_content(array: np.ndarray) -> str:
    """What an array holds, "" for real numbers."""
    if array.dtype.kind in "biuf":
        return ""
    return {"U": "text", "S": "text", "O": "cells"}.get(array.dtype.kind, str(array.dtype))


def _list_members(name: str, value: Any, levels: int) -> dict[str, np.ndarray]:
    """The arrays in a struct, and in the structs in it: ``out.signals.values``; members of a list are ``out.signals(1).values``."""
    if levels < 0:
        return {}
    members: dict[str, np.ndarray] = {}
    if isinstance(value, dict):
        for key, inner in value.items():
            members |= _list_members(f"{name}.{key}", inner, levels - 1)
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        for k, inner in enumerate(np.ravel(np.asarray(value, dtype=object)), 1):
            if isinstance(inner, dict):
                members |= _list_members(f"{name}({k})", inner, levels - 1)
    elif isinstance(value, np.ndarray):
        members[name] = value
    elif np.isscalar(value):
        members[name] = np.asarray(value)
    return members


def _check_unpacked(path: Path, policy: ReadingPolicy) -> None:
    """Refuse a file of version 5 to 7 that is cut short, or that unpacks to more than the policy allows. Raises DataError."""
    with open(path, "rb") as file:
        head = file.read(HEADER)
        if len(head) < HEADER or 0 in head[:4] or head[126:128] not in (b"IM", b"MI"):
            return  # version 4 has no compression, and scipy says what is wrong with others
        order = "<" if head[126:128] == b"IM" else ">"
        total = 0
        for size in _unpacked_sizes(file, order, path.stat().st_size, policy.largest_unpacked):
            total += size
            if total > policy.largest_unpacked:
                raise DataError(
                    f"{path.name}: it unpacks to more than {policy.largest_unpacked / 1e6:.0f} MB; save the needed variables alone,"
                    f" or raise the limit {raise_limit('largest_unpacked')}"
                )


def _unpacked_sizes(file: BinaryIO, order: str, end: int, most: int) -> Iterator[int]:
    """The size of each element of a file once it is unpacked; what is beyond ``most`` is not counted to its end."""
    place = HEADER
    while place + 8 <= end:
        file.seek(place)
        kind, size = struct.unpack(f"{order}II", file.read(8))
        if place + 8 + size > end:
            raise DataError(f"the file is cut short: an element of {size} bytes begins at byte {place} of {end}")
        if kind == COMPRESSED:
            yield _count_unpacked(file, size, most)
        else:
            yield size
        place += 8 + size


def _count_unpacked(file: BinaryIO, size: int, most: int, block: int = 1 << 16) -> int:
    unpack, total = zlib.decompressobj(), 0
    while size > 0 and total <= most:
        packed = file.read(min(block, size))
        if not packed:
            break
        size -= len(packed)
        while packed and total <= most:
            total += len(unpack.decompress(packed, 16 * block))
            packed = unpack.unconsumed_tail
    return total
