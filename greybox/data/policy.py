"""The numbers by which a record is judged: when time is uniform, when a sensor is in doubt, when a gap is too long."""

from __future__ import annotations

from dataclasses import dataclass, replace


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
    longest_line: int = 200_000
    """Bytes of a line of text: 10 000 columns of 20 characters."""

    rows_per_chunk: int = 20_000
    """Lines taken apart at a time: large enough for speed, small enough for memory."""

    def times(self, factor: float) -> ReadingPolicy:
        """The same with limits so many times as large."""
        names = ("largest_file", "largest_unpacked", "most_columns", "deepest_nesting", "longest_line")
        return replace(self, **{name: int(factor * getattr(self, name)) for name in names})


READING_POLICY = ReadingPolicy()
