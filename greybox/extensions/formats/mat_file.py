"""MATLAB files: version 4 through scipy, versions 5 to 7 here, version 7.3 (HDF5) through h5py."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from greybox.base import DataError
from greybox.data.array_table import ArrayInfo, ArrayTable
from greybox.data.columns import check_width, raise_limit
from greybox.data.file_kinds import FileFormat
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.extensions.formats.hdf5_file import is_hdf5, read_hdf5

# MATLAB files of versions 5 to 7: numbers and structs, every size checked against the bytes that are there.
#
# A file is a list of elements: type, number of bytes, content. The element of a variable holds elements for its class, dimensions, name
# and numbers, and may be compressed as a whole (MathWorks, "MAT-File Level 5 File Format"). Readers in C follow sizes beyond the end
# of a damaged file, so that it may end the process.

# Bytes before the first element of a MATLAB file: text, version, order of bytes.
HEADER = 128
MATRIX, COMPRESSED = 14, 15  # types of elements
STORED_AS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
CELL, STRUCT, OBJECT = 1, 2, 3  # classes of variables; from 6 to 15 they are numbers
CONTAINERS = (CELL, STRUCT, OBJECT)
NUMERIC = range(6, 16)
HOLDS = {4: "text", 5: "a sparse matrix", 16: "a function", 17: "an object, such as a table"}
# Bit in the flags of an array that has an imaginary part.
COMPLEX = 0x08
BYTES_OF_HEAD = 1 << 16
"""Enough for class, dimensions and name of a variable."""

Leaf = np.ndarray | str
"""An array of numbers, or what is there instead."""


@dataclass(frozen=True)
class MatVariable:
    """Where the element of a variable is in the file, and what its head says."""

    place: int
    size: int
    compressed: bool
    name: str
    info: ArrayInfo
    is_struct: bool


@dataclass(frozen=True)
class _Head:
    """Class, dimensions and name of a variable, and where its content begins."""

    kind: int
    is_complex: bool
    shape: tuple[int, ...]
    name: str
    content: int

    @property
    def info(self) -> ArrayInfo:
        """What can be said without the content."""
        if self.kind in NUMERIC:
            return ArrayInfo(self.shape, "complex numbers" if self.is_complex else "")
        return ArrayInfo(self.shape, HOLDS.get(self.kind, "a struct"))


def read_mat5(path: Path, policy: ReadingPolicy = READING_POLICY) -> ArrayTable:
    """Variables of a file; a field ``x`` of a struct ``data`` is called ``data.x``. Structs are loaded, others when they are wanted.

    Raises ValueError for a damaged file, DataError for structs that would unpack to more than the policy allows.
    """
    infos: dict[str, ArrayInfo] = {}
    members: dict[str, np.ndarray] = {}
    variables: dict[str, MatVariable] = {}
    with open(path, "rb") as file:
        mark, end = file.read(HEADER)[126:128], path.stat().st_size
        if mark not in (b"IM", b"MI"):
            raise ValueError("its header is not that of a MATLAB file")
        # The mark is a number of two bytes: it reads IM where the file has the lower byte first.
        order = "<" if mark == b"IM" else ">"
        room = policy.largest_unpacked
        for variable in _list_variables(file, order, end):
            check_width(len(infos) + 1, policy)
            if not variable.is_struct:
                infos[variable.name], variables[variable.name] = variable.info, variable
                continue
            content = _unpack(file, variable, order, room)
            # One limit for all structs together: many small ones unpack to as much as a large one.
            room -= len(content)
            for name, leaf in _list_leaves(memoryview(content), order, policy.deepest_nesting):
                check_width(len(infos) + 1, policy)
                infos[name] = ArrayInfo((), leaf) if isinstance(leaf, str) else ArrayInfo(leaf.shape)
                if not isinstance(leaf, str):
                    members[name] = leaf

    def load(names: Sequence[str]) -> Mapping[str, np.ndarray]:
        arrays = {name: members[name] for name in names if name in members}
        with open(path, "rb") as file:
            for name in names:
                if name not in members:
                    content = memoryview(_unpack(file, variables[name], order, policy.largest_unpacked))
                    arrays[name] = _read_numbers(content, _read_head(content, order), order)
        return arrays

    return ArrayTable.from_infos(infos, load, policy)


def _list_variables(file: BinaryIO, order: str, end: int) -> Iterator[MatVariable]:
    """Every variable of the file, from its head."""
    place = HEADER
    while place + 8 <= end:
        file.seek(place)
        kind, size = struct.unpack(f"{order}II", file.read(8))
        # Checked before it is read: a damaged size would ask for any amount of memory.
        if place + 8 + size > end:
            raise ValueError(f"it is cut short: {size} bytes should follow byte {place + 8} of {end}")
        if kind not in (MATRIX, COMPRESSED):
            raise ValueError(f"it is damaged at byte {place}: no variable begins there")
        # Its head alone: the numbers stay in the file until they are wanted.
        start = file.read(min(size, BYTES_OF_HEAD))
        if kind == COMPRESSED:
            head = _strip_tag(memoryview(zlib.decompressobj().decompress(start, BYTES_OF_HEAD)), order, whole=False)
        else:
            head = memoryview(start)
        first = _read_head(head, order)
        yield MatVariable(place + 8, size, kind == COMPRESSED, first.name, first.info, first.kind in CONTAINERS)
        place += 8 + size


def _unpack(file: BinaryIO, variable: MatVariable, order: str, most: int) -> bytes:
    """The content of a variable's element. Raises DataError where it is more than ``most`` bytes, before it is all unpacked."""
    file.seek(variable.place)
    if variable.compressed:
        unpack = zlib.decompressobj()
        # One byte more than is allowed, beside the tag of eight: so it shows that there is too much.
        content = unpack.decompress(file.read(variable.size), most + 9)
        too_much = len(content) > most + 8
        content = content if too_much else bytes(_strip_tag(memoryview(content), order))
    else:
        too_much = variable.size > most
        content = b"" if too_much else file.read(variable.size)
    if too_much:
        raise DataError(
            f"variable {variable.name!r} unpacks to more than {most / 1e6:.0f} MB; save the needed variables alone, or raise the"
            f" limit {raise_limit('largest_unpacked')}"
        )
    return content


def _strip_tag(data: memoryview, order: str, *, whole: bool = True) -> memoryview:
    """The content of the one matrix that a compressed element holds."""
    if len(data) < 8:
        raise ValueError("a compressed variable is cut short")
    kind, size = struct.unpack(f"{order}II", data[:8])
    if kind != MATRIX or (whole and size > len(data) - 8):
        raise ValueError("a compressed variable is damaged")
    return data[8 : 8 + size]


def _next_element(data: memoryview, place: int, order: str) -> tuple[int, memoryview, int]:
    """Type and content of the element at ``place``, and where the next one begins. Raises ValueError at the end of the data."""
    if place + 8 > len(data):
        raise ValueError("a variable is cut short")
    kind, size = struct.unpack(f"{order}II", data[place : place + 8])
    if kind >> 16:  # a small element: its content stands in the place of the size
        kind, size = kind & 0xFFFF, kind >> 16
        if size > 4:
            raise ValueError(f"a variable is damaged: a small element of {size} bytes")
        return kind, data[place + 4 : place + 4 + size], place + 8
    if place + 8 + size > len(data):
        raise ValueError("a variable is cut short")
    # Elements are filled up to whole multiples of eight bytes.
    return kind, data[place + 8 : place + 8 + size], place + 8 + size + (-size % 8)


def _read_head(data: memoryview, order: str) -> _Head:
    _, flags, place = _next_element(data, 0, order)
    if len(flags) != 8:
        raise ValueError("a variable is damaged: it has no class")
    # The class is the lowest byte of the flags, what it holds besides the next one.
    (word,) = struct.unpack(f"{order}I", flags[:4])
    kind, is_complex = word & 0xFF, bool((word >> 8) & COMPLEX)
    shape: tuple[int, ...] = ()
    if kind != 17:  # an object's first element is its name
        _, dimensions, place = _next_element(data, place, order)
        shape = struct.unpack(f"{order}{len(dimensions) // 4}i", dimensions[: len(dimensions) // 4 * 4])
        if not 2 <= len(shape) <= 16 or min(shape) < 0:
            raise ValueError(f"a variable is damaged: dimensions {shape[:3]}")
    _, name, place = _next_element(data, place, order)
    return _Head(kind, is_complex, shape, bytes(name).decode("latin-1"), place)


def _read_numbers(data: memoryview, head: _Head, order: str) -> np.ndarray:
    kind, content, _ = _next_element(data, head.content, order)
    if kind not in STORED_AS:
        raise ValueError(f"variable {head.name!r} is damaged: numbers of type {kind}")
    # Stored in the smallest type that holds them, whatever the class.
    values = np.frombuffer(content, dtype=np.dtype(f"{order}{STORED_AS[kind]}"))
    # In Python's integers: the product of damaged dimensions overflows.
    if len(values) != int(np.prod(head.shape, dtype=object)):
        raise ValueError(f"variable {head.name!r} is damaged: {len(values)} numbers for {head.shape}")
    # MATLAB stores column by column.
    return values.reshape(head.shape, order="F")


def _list_leaves(data: memoryview, order: str, levels: int, prefix: str = "") -> Iterator[tuple[str, Leaf]]:
    """Everything in a struct or a cell array, and in those in it: ``out.signals.values``, of several structs ``out.signals(1).values``,
    of cells ``out{1}``."""
    head = _read_head(data, order)
    name = prefix or head.name
    if head.kind not in CONTAINERS:
        is_number = head.kind in NUMERIC and not head.is_complex
        yield name, _read_numbers(data, head, order) if is_number else head.info.holds
        return
    if levels <= 0:
        raise DataError(f"structs are nested too deeply in {name!r}; raise the limit {raise_limit('deepest_nesting')}")
    for whole, content in _list_inner(data, head, name, order):
        if len(content):
            yield from _list_leaves(content, order, levels - 1, whole)


def _list_inner(data: memoryview, head: _Head, name: str, order: str) -> Iterator[tuple[str, memoryview]]:
    """Name and content of each variable directly in a struct, an object or a cell array."""
    place, count = head.content, int(np.prod(head.shape, dtype=object))
    if head.kind == CELL:
        for k in range(count):
            _, content, place = _next_element(data, place, order)
            yield f"{name}{{{k + 1}}}", content
        return
    if head.kind == OBJECT:
        _, _, place = _next_element(data, place, order)
    _, width, place = _next_element(data, place, order)
    _, names, place = _next_element(data, place, order)
    length = struct.unpack(f"{order}i", width)[0] if len(width) == 4 else 0
    if length < 1:
        raise ValueError(f"struct {name!r} is damaged: it has no field names")
    # Names of one length each, filled up with zeros.
    fields = [
        bytes(names[k : k + length]).split(b"\0")[0].decode("latin-1")
        for k in range(0, len(names) - length + 1, length)
    ]
    # The fields of the first struct, then those of the next.
    for k in range(count if fields else 0):
        for field in fields:
            kind, content, place = _next_element(data, place, order)
            if kind != MATRIX:
                raise ValueError(f"struct {name!r} is damaged: field {field!r} is no variable")
            yield f"{name}.{field}" if count == 1 else f"{name}({k + 1}).{field}", content


VERSION_7_3 = b"\x00\x02"
NUMERIC_CLASSES = frozenset(("double", "single", "logical", "int8", "int16", "int32", "uint8", "uint16"))
"""Classes that hold numbers."""


def read_mat(path: Path, policy: ReadingPolicy = READING_POLICY) -> ArrayTable:
    """Variables of a MATLAB file of any version; a field ``x`` of a struct ``data`` is called ``data.x``."""
    with open(path, "rb") as file:
        head = file.read(HEADER)
    if is_hdf5(path) or head[124:126] in (VERSION_7_3, VERSION_7_3[::-1]):
        return read_hdf5(path, policy)
    # Version 4 has no header: its first number is below 5000, and so has a zero byte.
    if 0 not in head[:4]:
        return read_mat5(path, policy)
    from scipy.io import loadmat, whosmat

    infos = {
        name: ArrayInfo(tuple(map(int, shape)), "" if kind in NUMERIC_CLASSES else kind)
        for name, shape, kind in whosmat(str(path))
    }

    def load(names: Sequence[str]) -> Mapping[str, np.ndarray]:
        arrays = loadmat(str(path), variable_names=list(names))
        return {name: np.asarray(arrays[name]) for name in names}

    return ArrayTable.from_infos(infos, load, policy)


MAT = FileFormat("MATLAB", (".mat",), read_mat, "save it again with '-v7', or export it as CSV", (("h5py", "hdf5"),))
