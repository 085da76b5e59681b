"""Channels: signals of one file that each have stamps of their own, as a table on one time base."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from greybox.base import DataError, Finding, shorten
from greybox.data.columns import ColumnMatch, SignalKind, check_size, check_width, describe_wrong_count
from greybox.data.findings import RecordCode
from greybox.data.headers import TIME
from greybox.data.input_course import Hold, choose_course
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.problems import RowLabels
from greybox.data.stamps import Stamps, Start
from greybox.data.time_base import ChannelUse, Samples, bring_to_one_base, correct_clocks, find_stamp_problems


@dataclass(frozen=True)
class Channel:
    """One signal of a file before it is loaded.

    Attributes
    ----------
    name, unit
        As the file has them; "" for no unit.
    group
        Group, sheet or topic that it is in; in front of the name where several channels are called alike.
    clock
        Which clock stamped it. Channels of one clock cannot be shifted against each other.
    rows
        Samples.
    holds
        What it holds if not numbers.
    stepwise
        Whether it moves in steps: switches, counters, states of a machine.
    """

    name: str
    unit: str
    group: str
    clock: str
    rows: int
    holds: str = ""
    stepwise: bool = False


ChannelLoader = Callable[[Sequence[int]], Mapping[int, Samples]]
"""Gives the samples of the channels at these places of the list, times in seconds of one origin."""


@dataclass(frozen=True)
class ChannelTable:
    """The channels of a file as a table: column 0 is the common time, the others are the channels.

    Parameters
    ----------
    channels
        In the order of the file.
    load
        Loads some of them.
    uses
        Position -> what the channel is for and how it moves between its samples; an output unless it is said.
    step
        Seconds between the rows of the common time; None takes the stamps of the fastest channel.
    names
        Headers in the place of the file's own.
    findings
        What the file says of its clocks.
    start
        When its time is zero; None where it does not say.
    policy, channel_policy
        How much may be loaded; how channels are compared.
    """

    channels: tuple[Channel, ...]
    load: ChannelLoader = field(repr=False)
    uses: Mapping[int, ChannelUse] = field(default_factory=dict)
    step: float | None = None
    names: tuple[str, ...] | None = None
    findings: tuple[Finding, ...] = ()
    policy: ReadingPolicy = field(default=READING_POLICY, repr=False)
    start: Start | None = None
    headless = False
    header_line = 1

    @classmethod
    def from_channels(
        cls,
        channels: Sequence[Channel],
        load: ChannelLoader,
        policy: ReadingPolicy = READING_POLICY,
        findings: Sequence[Finding] = (),
        start: Start | None = None,
    ) -> ChannelTable:
        """The table of a file's channels. Raises DataError for none, and for more than the policy allows."""
        check_width(len(channels), policy)
        if not channels:
            raise DataError("the file has no signals; record some, or export it as CSV")
        return cls(tuple(channels), load, findings=tuple(findings), policy=policy, start=start)

    @property
    def headers(self) -> tuple[str, ...]:
        """``time [s]``, then each channel with its unit; with its group where another has the same name."""
        if self.names is not None:
            return self.names
        count = Counter(channel.name for channel in self.channels)
        titles = [c.name if count[c.name] == 1 else f"{c.group}.{c.name}" for c in self.channels]
        written = (f"{t} [{c.unit}]" if c.unit else t for t, c in zip(titles, self.channels, strict=True))
        return f"{TIME} [s]", *written

    @property
    def comments(self) -> tuple[str, ...]:
        """None: such files have no lines."""
        return ()

    @property
    def row_labels(self) -> RowLabels:
        """Rows are called by their number on the common time."""
        return RowLabels()

    @property
    def numbered(self) -> tuple[int, ...]:
        """All columns, the common time first."""
        return tuple(range(len(self.channels) + 1))

    @property
    def dated(self) -> Mapping[int, bool]:
        """None: stamps are seconds already."""
        return {}

    def rename(self, names: Sequence[str]) -> ChannelTable:
        """The table with a name for each column, the common time first. Raises DataError for another number of names."""
        if len(names) != len(self.channels) + 1:
            raise DataError(describe_wrong_count(names, len(self.channels) + 1))
        return replace(self, names=tuple(names))

    def for_signals(
        self, match: ColumnMatch, common: Hold, named: Mapping[str, Hold], step: float | None
    ) -> ChannelTable:
        """The table that knows which channel is which signal.

        An input moves between its samples as ``named`` (name -> course) says, else in steps if it is a switch or a counter, else as
        all of them, ``common``. Outputs and conditions are straight.
        """
        uses = {}
        for signal, column in match.columns.items():
            if signal.kind is SignalKind.TIME:
                continue
            stated = named.get(signal.name, common)
            course: Hold = "mean" if stated == "mean" and signal.kind is SignalKind.OUTPUT else "first"
            if signal.kind is SignalKind.INPUT:
                k, channel = column.position - 1, self.channels[column.position - 1]
                course = named.get(signal.name, "zero" if channel.stepwise or channel.holds else common)
                if course == "auto":
                    course = choose_course(self.load([k])[k].values)
            uses[column.position] = ChannelUse(signal.name, signal.kind, course)
        return replace(self, uses=uses, step=step)

    def values(self, positions: Sequence[int]) -> tuple[dict[int, np.ndarray | Stamps], list[str], tuple[Finding, ...]]:
        """Columns (N,) as float64 on the common time with NaN for gaps, the problems met, and what was done to clocks and rates."""
        wanted = [k for k in positions if k > 0]
        problems = [
            f"column {shorten(self.headers[k])!r} holds {self.channels[k - 1].holds}, not real numbers"
            for k in wanted
            if self.channels[k - 1].holds
        ]
        if problems or not wanted:
            return {k: np.zeros(0) for k in positions}, problems, ()
        shared = self._find_shared(wanted)
        needed = list(dict.fromkeys([*wanted, *(k for pair in shared for k in pair)]))
        check_size(2 * sum(self.channels[k - 1].rows for k in needed), 1, self.policy)
        loaded = {k + 1: s for k, s in self.load([k - 1 for k in needed]).items()}
        samples = {k: s.without_repeats() for k, s in loaded.items()}
        problems = [
            f"column {shorten(self.headers[k])!r}: {problem}"
            for k in needed
            for problem in find_stamp_problems(samples[k])
        ]
        if problems:
            return {k: np.zeros(0) for k in positions}, problems, ()
        clocks = {k: self.channels[k - 1].clock for k in needed}
        pairs = [(*pair, self.channels[pair[0] - 1].name) for pair in shared]
        samples, findings = correct_clocks(samples, wanted, clocks, pairs)
        started = tuple(f for f in self.findings if f.subject in set(clocks.values()))
        uses = {k: self.uses.get(k, ChannelUse(self.headers[k], SignalKind.OUTPUT, "first")) for k in wanted}
        base = bring_to_one_base({k: samples[k] for k in wanted}, uses, self.step, self.policy)
        columns = {0: base.time, **base.columns}
        lost = {self.headers[k]: len(s.time) - len(samples[k].time) for k, s in loaded.items() if k in wanted}
        twice = (Finding(RecordCode.ROWS_TWICE, subject=n, values={"rows": rows}) for n, rows in lost.items() if rows)
        return {k: columns[k] for k in positions}, list(base.problems), (*started, *twice, *findings, *base.findings)

    def _find_shared(self, wanted: Sequence[int]) -> list[tuple[int, int]]:
        """Pairs of channels by which the clocks of the wanted ones can be compared: of one name, with the first clock in front."""
        clocks = list(dict.fromkeys(self.channels[k - 1].clock for k in wanted))
        by_clock: dict[str, dict[str, int]] = {clock: {} for clock in clocks}
        for k, channel in enumerate(self.channels, start=1):
            if channel.clock in by_clock and not channel.holds:
                by_clock[channel.clock].setdefault(channel.name, k)
        first = by_clock[clocks[0]]
        return [
            (first[name], k)
            for clock in clocks[1:]
            for name, k in by_clock[clock].items()
            if name in first and name.lower() not in ("t", TIME)
        ]
