"""MATLAB files: version 4 through scipy, versions 5 to 7 here, version 7.3 (HDF5) through h5py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from greybox.experiment.array_table import ArrayInfo, ArrayTable
from greybox.experiment.hdf5_file import is_hdf5, read_hdf5
from greybox.experiment.mat5_file import HEADER, read_mat5
from greybox.experiment.policy import READING_POLICY, ReadingPolicy

VERSION_7_3 = b"\x00\x02"
NUMERIC = frozenset(("double", "single", "logical", "int8", "int16", "int32", "uint8", "uint16"))
"""Classes that hold numbers."""


def read_mat(path: Path, policy: ReadingPolicy = READING_POLICY) -> ArrayTable:
    """Variables of a MATLAB file of any version; a field ``x`` of a struct ``data`` is called ``data.x``."""
    with open(path, "rb") as file:
        head = file.read(HEADER)
    if is_hdf5(path) or head[124:126] in (VERSION_7_3, VERSION_7_3[::-1]):
        return read_hdf5(path, policy)
    # Version 4 has no header: its first number is below 5000, and so has a zero byte.
    return _read_mat4(path, policy) if 0 in head[:4] else read_mat5(path, policy)


def _read_mat4(path: Path, policy: ReadingPolicy) -> ArrayTable:
    from scipy.io import loadmat, whosmat

    infos = {
        name: ArrayInfo(tuple(map(int, shape)), "" if kind in NUMERIC else kind)
        for name, shape, kind in whosmat(str(path))
    }

    def load(names: Sequence[str]) -> Mapping[str, np.ndarray]:
        arrays = loadmat(str(path), variable_names=list(names))
        return {name: np.asarray(arrays[name]) for name in names}

    return ArrayTable.from_infos(infos, load, policy)
