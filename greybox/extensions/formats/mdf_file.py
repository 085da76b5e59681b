"""MDF 3 and 4 files of measuring systems, through asammdf: channel groups, each with its own stamps."""

from __future__ import annotations

import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from greybox.data.channels import Channel, ChannelTable
from greybox.data.columns import check_width
from greybox.data.file_kinds import FileFormat
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.stamps import SECOND, Start, start_at
from greybox.data.time_base import Samples

MASTERS = (2, 3)
"""Types of channel that are the stamps of their group: master and virtual master."""
INTEGERS = (0, 1, 2, 3)
"""Types of data that are integers: unsigned and signed, in both byte orders."""
NUMBERS = (0, 1, 2, 3, 4, 5)
"""Those, and floating point numbers."""


def read_mdf(path: Path, policy: ReadingPolicy = READING_POLICY) -> ChannelTable:
    """The channels of all groups; stamps are in seconds from the start of the measurement. Samples that are marked invalid are left out.

    Groups of several sources of acquisition have a clock each.
    """
    channels: list[Channel] = []
    places: list[tuple[int, int]] = []
    # From an open stream: by its name, the library would open an unfinished file for writing.
    with open(path, "rb") as stream, _open(stream) as file:
        check_width(sum(len(group.channels) for group in file.groups), policy)
        for g, group in enumerate(file.groups):
            head = group.channel_group
            name = str(getattr(head, "acq_name", "") or getattr(head, "comment", "") or f"group {g + 1}")
            source = getattr(head, "acq_source", None)
            # Groups of one source of acquisition share its clock.
            clock = str(getattr(source, "name", "") or getattr(head, "acq_name", "") or "the file")
            master = file.masters_db.get(g)
            for c, channel in enumerate(group.channels):
                # Stamps are no signals.
                if c == master or channel.channel_type in MASTERS:
                    continue
                kind = getattr(channel, "data_type", None)
                conversion = channel.conversion
                # A number of type 0 leaves the values as they are; scaled integers are samples of something continuous.
                scaled = conversion is not None and bool(getattr(conversion, "conversion_type", 0))
                rows = int(getattr(head, "cycles_nr", 0))
                holds = "" if kind in NUMBERS else "text or bytes"
                # A conversion may have a unit where the channel states none.
                unit = str(channel.unit or (conversion.unit if conversion is not None else "") or "").strip()
                channels.append(Channel(channel.name, unit, name, clock, rows, holds, kind in INTEGERS and not scaled))
                places.append((g, c))
        began = _find_start(file)

    def load(wanted: Sequence[int]) -> Mapping[int, Samples]:
        with open(path, "rb") as stream, _open(stream) as file:
            return {k: _read_samples(file, *places[k]) for k in wanted}

    return ChannelTable.from_channels(channels, load, policy, start=began)


def _find_start(file: Any) -> Start | None:
    """When the measurement began: with its zone, or by the clock on the wall where the file names none."""
    if not getattr(file.header, "abs_time", 0):
        return None
    stamp = file.header.start_time
    zone = stamp.utcoffset()
    nanoseconds = int(np.datetime64(stamp.replace(tzinfo=None), "ns").astype(np.int64))
    return start_at(nanoseconds - (0 if zone is None else round(zone.total_seconds()) * SECOND), zoned=zone is not None)


def _open(stream: Any) -> Any:
    from asammdf import MDF

    try:
        return MDF(stream)
    except Exception as error:  # raised again
        # What the library has half made complains when it is thrown away, unless it counts as closed.
        for frame, _ in traceback.walk_tb(error.__traceback__):
            half_made: Any = frame.f_locals.get("self")
            # Its blocks have slots; only the file itself has attributes of its own.
            if type(half_made).__module__.startswith("asammdf") and hasattr(half_made, "__dict__"):
                half_made._closed = True
                temporary = getattr(half_made, "_tempfile", None)
                if temporary is not None:
                    temporary.close()
        raise


def _read_samples(file: Any, group: int, index: int) -> Samples:
    signal = file.get(group=group, index=index, ignore_invalidation_bits=False)
    if signal.samples.dtype.kind in "SU":  # a table of texts stands for the numbers
        signal = file.get(group=group, index=index, ignore_invalidation_bits=False, raw=True)
    if signal.samples.dtype.kind not in "biuf" or signal.samples.ndim != 1:
        raise ValueError(f"channel {signal.name!r} does not hold one number for each stamp")
    values = signal.samples.astype(np.float64)
    invalid = getattr(signal, "invalidation_bits", None)
    if invalid is not None and len(invalid) == len(values):
        # An invalid sample is a gap, not a number.
        values = np.where(np.asarray(invalid, dtype=bool), np.nan, values)
    return Samples(np.asarray(signal.timestamps, dtype=np.float64), values)


MDF = FileFormat("MDF", (".mf4", ".mdf"), read_mdf, "export it as CSV", (("asammdf", "mdf"),))
