"""The numbers by which a record is judged: when time is uniform, when a sensor is in doubt, when a gap is too long."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class RecordPolicy:
    """Rules for records. Shares and ratios have no unit; rows and steps are counted."""

    min_rows: int = 10
    """Fewest rows of a measured record: with fewer there is nothing to learn from."""

    step_tolerance: float = 1e-3
    """A step may differ from the mean step by this share of it; clocks of loggers stay within."""
    grid_tolerance: float = 0.1
    """A stamp may lie this share of the mean step off the uniform grid; beyond it, the clock drifts or jitters."""
    rounding_units: float = 1.2
    """Printed units that rounding may change a step by: two roundings of half a unit, and the error of the mean step itself."""
    coarsest_print: float = 0.45
    """Largest printed unit, as a share of the step; with a coarser one a missing row could pass for two roundings."""
    printed_units: tuple[float, ...] = (1.0, 60.0, 3600.0)
    """Units in which a file may have printed time, in seconds: the one in which its last place is coarsest counts."""
    max_decimals: int = 12
    """Printed decimal places that are looked for; double precision shows no more of a time in seconds."""

    gap_steps: float = 1.5
    """A step of more than this many usual ones is a gap in time: at least one row is missing."""
    max_gap_share: float = 0.05
    """Largest share of the steps that can be gaps; with more of them there is no usual step."""
    long_gap_rows: int = 20
    """Missing rows from which a gap is long; fewer do little harm to a simulation."""
    neighbourhood_rows: int = 20
    """Rows before and after a gap in which an input that rests shows that it rests."""
    lags_tried: int = 12
    """Time differences, up to the length of a gap, over which the change of an input is measured."""
    lost_input_change: float = 1.0
    """Change of an input (rms, over its standard deviation) in a gap, from which it is known no better than by its mean."""

    frozen_rows: int = 20
    """Rows with one value from which a sensor counts as frozen."""
    input_goes_on: float = 0.5
    """Share of an input's earlier range that it must still cover for the plant to be moving."""
    repeat_share: float = 0.05
    """Share of repeated values from which a sensor is coarse, or the plant rests, and a frozen stretch says nothing."""
    spike_ratio: float = 5.0
    """Distance from both neighbours, over the distance that 95 % of the rows stay within, from which a row is a spike."""
    pulse_share: float = 0.25
    """Share of an input's range; an input that leaves so far for one row may have caused the spike."""
    max_spike_share: float = 0.02
    """Largest share of the rows that can be spikes; more of them are a kind of noise."""
    min_stays: int = 3
    """Times that a sensor stays at the same end of its range before it counts as saturated."""
    min_saturated_rows: int = 10
    """Rows that it stays there altogether."""

    condition_spread: float = 0.05
    """Largest standard deviation of a column over its mean for its mean to be a condition of the whole record."""


@dataclass(frozen=True)
class ReadingPolicy:
    """How far into a text file the reader looks, how much it takes at a time, and how large a file may be.

    The limits hold before anything is unpacked, so that a small file cannot fill the memory.
    """

    largest_file: int = 2_000_000_000
    """Bytes of a file: 50 million rows of text, minutes of reading."""
    largest_unpacked: int = 400_000_000
    """Bytes that the wanted columns take in memory: 5 million rows of 10 signals."""
    most_columns: int = 10_000
    """Columns, or variables, of a file; rigs have tens, loggers hundreds."""
    deepest_nesting: int = 8
    """Levels of structs inside structs; a logger's are two or three deep."""
    longest_message_array: int = 64
    """Numbers of an array in a message, each of which becomes a signal; joints are tens, images and scans are no signals."""
    longest_line: int = 200_000
    """Bytes of a line of text: 10 000 columns of 20 characters."""
    longest_header: int = 200
    """Characters of a header; in a longer one neither unit nor name are looked for."""
    most_comments: int = 1_000
    """Lines of comment that are kept, for a header or a condition among them."""
    bytes_per_block: int = 1_000_000
    """Bytes looked at together when the encoding is found."""

    rows_per_chunk: int = 20_000
    """Lines taken apart at a time: large enough for speed, small enough for memory."""
    separator_lines: int = 20
    """Lines on which the separator is decided."""
    header_lines: int = 60
    """Lines in which the first row of numbers is looked for, to find a header that is not the first line."""

    def times(self, factor: float) -> ReadingPolicy:
        """The same with limits so many times as large."""
        names = ("largest_file", "largest_unpacked", "most_columns", "deepest_nesting", "longest_line")
        return replace(self, **{name: int(factor * getattr(self, name)) for name in names})


@dataclass(frozen=True)
class ChannelPolicy:
    """How signals with stamps of their own are compared and interpolated. Shares have no unit; samples and rows are counted."""

    least_shared_samples: int = 20
    """Samples of a signal on two clocks from which their offset is estimated: four numbers are fitted to them."""
    least_correlation: float = 0.9
    """Correlation of the two copies from which they are the same signal; noise of a third of the signal leaves 0.9."""
    most_correlated_rows: int = 2_000_000
    """Rows of the grid on which the start of the search is found by correlation; longer records get a coarser one."""
    recorder_latency: float = 0.05
    """Difference (s) of the shortest ways to the recorder from which it is an offset of the clocks; networks take milliseconds."""
    offset_iterations: int = 30
    """Most steps of the search; it settles in five, and may need more where the grid is coarse."""
    offset_resolution: float = 1e-6
    """A step of the search below this share of the grid's ends it."""
    drift_significance: float = 5.0
    """Standard deviations from which one clock runs faster than the other; below, the drift is zero."""
    band_limited_samples: int = 32
    """Samples on either side by which a band-limited signal is interpolated; the error is below 1e-5 up to 0.8 of its band."""
    kaiser_beta: float = 10.0
    """Shape of the window over these samples: side lobes of 1e-5."""
    held_values: float = 0.2
    """Share of samples that change, at most, for a signal to be called held: commands, switches, set points."""


RECORD_POLICY = RecordPolicy()
CHANNEL_POLICY = ChannelPolicy()
READING_POLICY = ReadingPolicy()
