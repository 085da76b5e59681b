"""HDF5 files, among them those of MATLAB 7.3: data sets by their path, numbers loaded when they are wanted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from greybox.data.array_table import ArrayInfo, ArrayTable
from greybox.data.channels import Channel, ChannelTable
from greybox.data.columns import check_width
from greybox.data.file_kinds import FileFormat
from greybox.data.headers import parse_header
from greybox.data.notation import read_conversion
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.time_base import Samples

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
        # MATLAB 7.3 marks every variable with its class.
        by_matlab = "MATLAB_class" in {key for _, _, data in _walk(h5py, file, "", 1) for key in data.attrs}
        for name, place, data in _walk(h5py, file, "", policy.deepest_nesting):
            shape = tuple(int(n) for n in data.shape or ())
            # MATLAB stores column by column, HDF5 counts row by row: its arrays stand transposed in the file.
            infos[name] = ArrayInfo(shape[::-1] if by_matlab else shape, _describe_content(data))
            places[name] = (place, by_matlab)
            check_width(len(infos), policy)

    def load(names: Sequence[str]) -> Mapping[str, np.ndarray]:
        with h5py.File(path, "r") as file:
            arrays = {name: np.asarray(file[places[name][0]]) for name in names}
        return {name: array.T if places[name][1] else array for name, array in arrays.items()}

    return ArrayTable.from_infos(infos, load, policy)


def read_hdf5_file(path: Path, policy: ReadingPolicy = READING_POLICY) -> ArrayTable | ChannelTable:
    """An HDF5 file that no MATLAB wrote: where data sets have stamps of their own, they are channels; else a table of arrays.

    Stamps are the data set ``time`` or ``t`` of the same length in the group of a signal or above it; or the attributes ``dt`` (s) or
    ``sampling_rate`` (Hz), and ``t0`` (s), of the data set or its group. The unit is the attribute ``unit`` or ``units``.
    """
    import h5py

    channels: list[Channel] = []
    places: list[tuple[str, _StampSource]] = []
    with h5py.File(path, "r") as file:
        sets = list(_walk(h5py, file, "", policy.deepest_nesting))
        check_width(len(sets), policy)
        clocks = {data.parent.name: data for _, _, data in sets if _is_time(data.name)}
        for _, place, data in sets:
            # A clock is no signal; a table has no one stamp for each number.
            stamps = None if _is_time(place) or data.ndim != 1 else _read_stamps(data, clocks)
            if stamps is None:
                continue
            group = data.parent.name.strip("/").replace("/", ".") or "the file"
            unit = _attribute(data, "unit", "units")
            name = place.rpartition("/")[2]
            # The attribute goes before the unit in the name.
            header = parse_header(name, 0)
            channels.append(
                Channel(
                    header.name if header.unit else name,
                    str(unit or header.unit),
                    group,
                    group,
                    len(data),
                    _describe_content(data),
                    stepwise=data.dtype.kind in "biu",
                )
            )
            places.append((place, stamps))
    if not channels:
        return read_hdf5(path, policy)

    def load(wanted: Sequence[int]) -> Mapping[int, Samples]:
        result: dict[int, Samples] = {}
        with h5py.File(path, "r") as file:
            for k in wanted:
                place, stamps = places[k]
                values = np.asarray(file[place], dtype=np.float64)
                if stamps.place:
                    time: np.ndarray = np.asarray(file[stamps.place], dtype=np.float64)
                    time = read_conversion(stamps.unit, "s")(time) if stamps.unit else time
                else:
                    time = stamps.start + stamps.step * np.arange(len(values))
                result[k] = Samples(time, values)
        return result

    return ChannelTable.from_channels(channels, load, policy)


class _StampSource(NamedTuple):
    """Where the stamps of a data set are, with their unit; or their first and their step (s)."""

    place: str
    unit: str
    start: float
    step: float


def _is_time(place: str) -> bool:
    return parse_header(place.rpartition("/")[2], 0).is_time


def _read_stamps(data: Any, clocks: Mapping[str, Any]) -> _StampSource | None:
    """The nearest stamps that fit a data set."""
    # The nearest clock of the same length: a group may share that of the one above.
    for group in (data.parent, data.parent.parent):
        clock = clocks.get(group.name)
        if clock is not None and clock.shape == data.shape:
            unit = _attribute(clock, "unit", "units") or parse_header(clock.name.rpartition("/")[2], 0).unit
            return _StampSource(clock.name, str(unit), 0.0, 0.0)
    for node in (data, data.parent):
        step, rate = _attribute(node, "dt", "sampling_time"), _attribute(node, "sampling_rate", "sample_rate", "fs")
        start = _attribute(node, "t0", "start_time")
        if isinstance(step, float) or isinstance(rate, float):
            # A step in seconds, or its inverse as a rate.
            seconds = step if isinstance(step, float) else 1 / rate if rate else 0.0
            if seconds > 0:
                return _StampSource("", "", start if isinstance(start, float) else 0.0, float(seconds))
    return None


def _attribute(node: Any, *names: str) -> Any:
    """The first of these attributes as a text or a number, "" for none."""
    for name in names:
        if name in node.attrs:
            value = np.asarray(node.attrs[name])
            if value.size == 1:
                single = value.reshape(-1)[0]
                if isinstance(single, bytes):
                    return single.decode(errors="replace")
                return float(single) if value.dtype.kind in "iuf" else str(single)
    return ""


def _walk(
    h5py: Any, group: Any, prefix: str, levels: int, entered: set[Any] | None = None
) -> Iterator[tuple[str, str, Any]]:
    """Name, path and data set of all in ``group``, but for MATLAB's own bookkeeping and links to other files.

    Each group is ``entered`` once: a link may lead back to the root.
    """
    entered = set() if entered is None else entered
    address = h5py.h5o.get_info(group.id).addr
    if address in entered:
        return
    entered.add(address)
    for key in group:
        # An external link may lead to any file of the reader's machine.
        if key.startswith("#") or not isinstance(group.get(key, getlink=True), h5py.HardLink):
            continue
        inner = group[key]
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(inner, h5py.Dataset):
            yield name, inner.name, inner
        elif isinstance(inner, h5py.Group) and levels > 0:
            yield from _walk(h5py, inner, name, levels - 1, entered)


def _describe_content(data: Any) -> str:
    """What a data set holds, "" for real numbers."""
    kind = data.attrs.get("MATLAB_class", b"")
    if kind in (b"char", b"cell", b"struct", b"function_handle"):
        return bytes(kind).decode()
    if data.external or data.is_virtual:
        return "numbers of another file"
    if "MATLAB_empty" in data.attrs:
        return "nothing"
    # Complex numbers, texts and references are listed, not read.
    return "" if data.dtype.kind in "biuf" else str(data.dtype)


HDF5 = FileFormat("HDF5", (".h5", ".hdf5", ".hdf"), read_hdf5_file, "export it as CSV", (("h5py", "hdf5"),))
