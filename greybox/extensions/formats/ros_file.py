"""Recordings of ROS 1 and ROS 2, and MCAP files, through rosbags and mcap: topics, every number of a message a channel.

A message is stamped when it was made, in its header, or else when it was recorded. The two are different clocks.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from greybox.base import DataError
from greybox.data.channels import Channel, ChannelTable
from greybox.data.columns import check_size, check_width, raise_limit
from greybox.data.file_kinds import FileFormat
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.stamps import start_at
from greybox.data.time_base import Samples

RECORDER = "recorder"
# In a second; stamps of ROS count them.
NANOSECONDS = 10**9


class _Message(NamedTuple):
    """One message: its topic, when it was recorded (ns), and how it is decoded."""

    topic: str
    recorded: int
    decode: Callable[[], Any]


Messages = Callable[[Sequence[str] | None], Iterator[_Message]]
"""The messages of these topics, or of all, in the order of the file."""


def read_bag(path: Path, policy: ReadingPolicy = READING_POLICY) -> ChannelTable:
    """The numbers of the messages of a ROS 1 recording."""
    return _read_rosbags(path, policy)


def read_ros2_database(path: Path, policy: ReadingPolicy = READING_POLICY) -> ChannelTable:
    """The numbers of the messages of a ROS 2 recording, a folder of ``.db3`` files with ``metadata.yaml`` beside them."""
    if not (path.parent / "metadata.yaml").is_file():
        raise DataError("metadata.yaml is missing beside it; write it with ros2 bag reindex")
    return _read_rosbags(path.parent, policy)


def _read_rosbags(path: Path, policy: ReadingPolicy) -> ChannelTable:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    standard = get_typestore(Stores.LATEST)

    def iterate(topics: Sequence[str] | None) -> Iterator[_Message]:
        with AnyReader([path], default_typestore=standard) as reader:
            wanted = [c for c in reader.connections if topics is None or c.topic in topics]
            for connection, recorded, raw in reader.messages(connections=wanted) if wanted else ():
                kind = connection.msgtype
                yield _Message(connection.topic, recorded, lambda raw=raw, kind=kind: reader.deserialize(raw, kind))  # type: ignore[misc]

    with AnyReader([path], default_typestore=standard) as reader:
        counts: dict[str, int] = {}
        for connection in reader.connections:
            counts[connection.topic] = counts.get(connection.topic, 0) + connection.msgcount
    return _to_table(counts, iterate, policy)


def read_mcap(path: Path, policy: ReadingPolicy = READING_POLICY) -> ChannelTable:
    """The numbers of the messages of an MCAP file: JSON, and ROS 1 and 2 by the definitions in the file. Other topics are left out."""
    from mcap.reader import make_reader

    with open(path, "rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    if summary is None or summary.statistics is None:
        raise DataError("it has no summary, so the recording was cut short; repair it with mcap recover")
    # The largest chunk is unpacked as a whole.
    unpacked = max((index.uncompressed_size for index in summary.chunk_indexes), default=0)
    if unpacked > policy.largest_unpacked:
        raise DataError(
            f"a chunk unpacks to {unpacked / 1e6:.0f} MB, at most {policy.largest_unpacked / 1e6:.0f} MB are read; record the"
            f" needed topics alone, or raise the limit {raise_limit('largest_unpacked')}"
        )
    decoders = {k: _make_decoder(c, summary.schemas.get(c.schema_id)) for k, c in summary.channels.items()}
    counts: dict[str, int] = {}
    for k, channel in summary.channels.items():
        if decoders[k] is not None:
            number = summary.statistics.channel_message_counts.get(k, 0)
            counts[channel.topic] = counts.get(channel.topic, 0) + number
    if not counts:
        kinds = ", ".join(sorted({c.message_encoding or "unknown" for c in summary.channels.values()})) or "none"
        raise DataError(f"its messages are encoded as {kinds}; JSON and ROS are read, export the others as CSV")

    def iterate(topics: Sequence[str] | None) -> Iterator[_Message]:
        with open(path, "rb") as file:
            reader = make_reader(file, validate_crcs=True)
            for _, channel, message in reader.iter_messages(topics=topics):
                decode = decoders[channel.id]
                if decode is not None:
                    data = message.data
                    yield _Message(channel.topic, message.log_time, lambda d=decode, raw=data: d(raw))  # type: ignore[misc]

    return _to_table(counts, iterate, policy)


def _make_decoder(channel: Any, schema: Any) -> Callable[[bytes], Any] | None:
    if channel.message_encoding == "json":
        return json.loads
    if schema is None or (channel.message_encoding, schema.encoding) not in (("cdr", "ros2msg"), ("ros1", "ros1msg")):
        return None
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    ros1 = channel.message_encoding == "ros1"
    store = get_typestore(Stores.EMPTY)
    # ROS 1 leaves out the folder in the middle, and rosbags asks for it.
    package, _, kind = schema.name.partition("/")
    name = schema.name if "/msg/" in schema.name else f"{package}/msg/{kind}"
    store.register(get_types_from_msg(schema.data.decode(), name))
    return lambda raw: store.deserialize_ros1(raw, name) if ros1 else store.deserialize_cdr(raw, name)


def _to_table(counts: Mapping[str, int], iterate: Messages, policy: ReadingPolicy) -> ChannelTable:
    leaves: dict[str, dict[str, Any]] = {}
    stamped: dict[str, bool] = {}
    filled = [topic for topic, count in counts.items() if count]
    origin: int | None = None
    for message in iterate(filled):
        origin = message.recorded if origin is None else origin
        if message.topic not in leaves:
            content = message.decode()
            leaves[message.topic] = dict(_list_numbers(content, "", policy))
            stamped[message.topic] = _find_stamp(content) is not None
            check_width(sum(map(len, leaves.values())), policy)
        # The first message of each topic shows its numbers; the file is not read to the end for that.
        if len(leaves) == len(filled):
            break
    channels: list[Channel] = []
    places: list[tuple[str, str]] = []
    for topic, numbers in leaves.items():
        for name, value in numbers.items():
            clock = f"stamps of {topic}" if stamped[topic] else RECORDER
            channels.append(
                Channel(
                    f"{topic}.{name}", "", topic, clock, counts[topic], stepwise=isinstance(value, (bool, np.bool_))
                )
            )
            places.append((topic, name))
    start = origin or 0

    def load(wanted: Sequence[int]) -> Mapping[int, Samples]:
        # Each topic is read once, for all its signals.
        topics = list(dict.fromkeys(places[k][0] for k in wanted))
        check_size(sum(counts[topic] for topic in topics), 2, policy)
        shortest: dict[str, int] = {}
        stamps: dict[str, list[int]] = {topic: [] for topic in topics}
        values: dict[int, list[float]] = {k: [] for k in wanted}
        by_topic = {topic: [k for k in wanted if places[k][0] == topic] for topic in topics}
        for message in iterate(topics):
            content = message.decode()
            made = _find_stamp(content) if stamped[message.topic] else message.recorded
            # A header that was left empty for once: the recorder's stamp stands in.
            made = message.recorded if made is None else made
            stamps[message.topic].append(made)
            # Least delay from the stamp to the recorder: what is more than that was spent waiting in the network,
            # and is no offset of clocks.
            shortest[message.topic] = min(shortest.get(message.topic, message.recorded - made), message.recorded - made)
            numbers = dict(_list_numbers(content, "", policy))
            for k in by_topic[message.topic]:
                # An array may be shorter in this message than it was in the first.
                values[k].append(float(numbers.get(places[k][1], np.nan)))
        # Differences in whole nanoseconds: as doubles, stamps since 1970 are exact to a quarter of a microsecond
        # only.
        times = {topic: (np.array(t, dtype=np.int64) - start) / NANOSECONDS for topic, t in stamps.items()}
        return {
            k: Samples(times[topic := places[k][0]], np.array(values[k]), shortest[topic] / NANOSECONDS) for k in wanted
        }

    return ChannelTable.from_channels(channels, load, policy, start=start_at(start))


def _find_stamp(content: Any) -> int | None:
    """The stamp (ns) in the header of a message; None where there is none, or it was left at zero."""
    stamp = _member(_member(content, "header"), "stamp")
    seconds = _member(stamp, "sec")
    nanoseconds = _member(stamp, "nanosec", "nsec")
    if not isinstance(seconds, (int, np.integer)) or not isinstance(nanoseconds, (int, np.integer)):
        return None
    return (int(seconds) * NANOSECONDS + int(nanoseconds)) or None


def _member(content: Any, *names: str) -> Any:
    for name in names:
        value = content.get(name) if isinstance(content, Mapping) else getattr(content, name, None)
        if value is not None:
            return value
    return None


# Numbers of an array in a message, each of which becomes a signal; joints are tens, images and scans are no signals.
LONGEST_MESSAGE_ARRAY = 64


def _list_numbers(content: Any, prefix: str, policy: ReadingPolicy, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Name and value of every number of a message: ``position.x``, ``velocity[2]``. Long arrays, such as images, are left out."""
    if isinstance(content, (bool, int, float, np.number, np.bool_)):
        yield prefix or "value", content
        return
    if depth > policy.deepest_nesting:
        return
    if isinstance(content, Mapping):
        members: Iterator[tuple[str, Any]] = ((str(k), v) for k, v in content.items())
    elif is_dataclass(content) and not isinstance(content, type):
        members = ((f.name, getattr(content, f.name)) for f in fields(content))
    elif isinstance(content, (list, tuple, np.ndarray)):
        if len(content) <= LONGEST_MESSAGE_ARRAY:
            for k, item in enumerate(content):
                yield from _list_numbers(item, f"{prefix}[{k}]", policy, depth + 1)
        return
    else:
        return
    for name, value in members:
        if not (depth == 0 and name == "header"):
            yield from _list_numbers(value, f"{prefix}.{name}" if prefix else name, policy, depth + 1)


BAG = FileFormat("ROS 1", (".bag",), read_bag, "repair it with rosbag reindex", (("rosbags", "ros"),))
MCAP = FileFormat("MCAP", (".mcap",), read_mcap, "repair it with mcap recover", (("mcap", "ros"), ("rosbags", "ros")))
ROS2 = FileFormat("ROS 2", (".db3",), read_ros2_database, "repair it with ros2 bag reindex", (("rosbags", "ros"),))
