"""TDMS files of LabVIEW, through nptdms: channels whose stamps are a start, an offset and an increment, or a channel of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from greybox.base import DataError, Finding
from greybox.data.channels import Channel, ChannelTable
from greybox.data.columns import check_width
from greybox.data.file_kinds import FileFormat
from greybox.data.findings import RecordCode
from greybox.data.headers import parse_header
from greybox.data.notation import read_conversion
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.stamps import start_at
from greybox.data.time_base import Samples


class _Stamps(NamedTuple):
    """Start of the recorder (s), offset and increment (s) of a channel; or the channel of its group that holds the stamps."""

    start: float
    offset: float
    increment: float
    channel: str


def read_tdms(path: Path, policy: ReadingPolicy = READING_POLICY) -> ChannelTable:
    """The channels of all groups, each group with its own clock. Times count from the first start that the file states."""
    from nptdms import TdmsFile

    channels: list[Channel] = []
    places: list[tuple[str, str, _Stamps]] = []
    starts: dict[str, float] = {}
    with TdmsFile.open(path) as file:
        check_width(sum(len(group.channels()) for group in file.groups()), policy)
        for group in file.groups():
            clock = next((c for c in group.channels() if parse_header(c.name, 0).is_time), None)
            for channel in group.channels():
                if clock is not None and channel.name == clock.name:
                    continue
                # A channel without stamps is no signal over time.
                stamps = _read_stamps(channel, clock)
                if stamps is None:
                    continue
                header = parse_header(channel.name, 0)
                unit = str(channel.properties.get("unit_string", "") or header.unit).strip()
                kind = np.dtype(channel.dtype).kind if channel.dtype is not None else "O"
                # Numbers are read, stamps and texts are listed with what they hold.
                holds = "" if kind in "biuf" else "text or stamps"
                starts.setdefault(group.name, stamps.start)
                name = header.name if header.unit else channel.name
                channels.append(
                    Channel(name, unit, group.name, group.name, len(channel), holds, stepwise=kind in "biu")
                )
                places.append((group.name, channel.name, stamps))
    if not channels:
        raise DataError("no channel has stamps (wf_increment, or a channel 'time' in its group); export it as CSV")
    # The earliest start is the origin: groups that began later keep their distance, and say so.
    known = [start for start in starts.values() if np.isfinite(start)]
    origin = min(known, default=0.0)
    findings = [
        Finding(RecordCode.CLOCK_START, subject=group, values={"start": start - origin})
        for group, start in starts.items()
        if np.isfinite(start) and start > origin
    ]

    def load(wanted: Sequence[int]) -> Mapping[int, Samples]:
        result: dict[int, Samples] = {}
        with TdmsFile.open(path) as file:
            for k in wanted:
                group, name, stamps = places[k]
                values = np.asarray(file[group][name][:], dtype=np.float64)
                if stamps.channel:
                    clock = file[group][stamps.channel]
                    time = clock[:]
                    if time.dtype.kind == "M":  # dates, to the microsecond as TDMS counts
                        time = np.asarray(time.astype("datetime64[us]").astype(np.int64) * 1e-6)
                    else:
                        clock_unit = str(clock.properties.get("unit_string", "") or parse_header(clock.name, 0).unit)
                        time = np.asarray(time, dtype=np.float64)
                        time = read_conversion(clock_unit, "s")(time) if clock_unit else time
                    time = time - origin if np.isfinite(stamps.start) else time
                else:
                    begin = stamps.start - origin if np.isfinite(stamps.start) else 0.0
                    # t = start + offset + k increment
                    time = begin + stamps.offset + stamps.increment * np.arange(len(values))
                result[k] = Samples(time, values)
        return result

    start = start_at(round(origin * 1e6) * 1000) if known else None
    return ChannelTable.from_channels(channels, load, policy, findings, start)


def _read_stamps(channel: Any, clock: Any) -> _Stamps | None:
    properties = channel.properties
    # A time channel of the group goes before the increments: it was measured.
    if clock is not None and len(clock) == len(channel):
        absolute = np.dtype(clock.dtype).kind == "M"
        return _Stamps(_to_epoch(clock[0]) if absolute and len(clock) else np.nan, 0.0, 0.0, clock.name)
    increment = float(properties.get("wf_increment", 0.0))
    if not increment > 0:
        return None
    start = properties.get("wf_start_time")
    return _Stamps(
        np.nan if start is None else _to_epoch(start), float(properties.get("wf_start_offset", 0.0)), increment, ""
    )


def _to_epoch(stamp: Any) -> float:
    """Seconds since 1970, in microseconds at the finest; NaN of a clock that was never set."""
    microseconds = int(np.datetime64(stamp).astype("datetime64[us]").astype(np.int64))
    return microseconds * 1e-6 if start_at(microseconds * 1000) else np.nan


TDMS = FileFormat("TDMS", (".tdms",), read_tdms, "export it as CSV", (("nptdms", "tdms"),))
