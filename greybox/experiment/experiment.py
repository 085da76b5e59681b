"""One measured record as a frozen value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from greybox.errors import DataError
from greybox.experiment.arrays import compute_fingerprint, describe_range, to_read_only_array
from greybox.experiment.problems import (
    FEWEST_ROWS,
    RowLabels,
    find_array_problems,
    find_measurement_problems,
    raise_problems,
)
from greybox.experiment.sampling import describe_timing, find_sampling_time
from greybox.experiment.sensor_faults import inspect_record
from greybox.experiment.time_gaps import common_sampling_time, split_record

Hold = Literal["zero", "first", "band-limited"]
HOLDS = {
    "zero": "input held between samples",
    "first": "input linear between samples",
    "band-limited": "band-limited input between samples",
}


@dataclass(frozen=True, eq=False)
class Experiment:
    """A record of one experiment, in the units of the model it was read for. Arrays are read-only float64.

    ``time`` (N,) in seconds, increasing. ``inputs``: name -> (N,), finite. ``outputs``: name -> (N,), NaN where nothing
    was measured. ``hold`` says how the input moves between samples: ``"zero"`` stays until the next row (a computer
    drives it), ``"first"`` runs straight to it (the input itself is a measured, smooth signal), ``"band-limited"`` has no
    content above half the sampling rate (a smooth signal behind an anti-alias filter). ``source`` is the file it came
    from, ``conditions`` are constants of this experiment alone, ``notes`` what one should know about it (a part keeps
    those of the whole).

    ``sampling_time`` in seconds, None when time is irregular (rule: `greybox.experiment.sampling`). ``fingerprint``: 16
    hex digits of the SHA-256 over names and arrays; equal data, equal fingerprint, whatever the file was called.

    Raises DataError when lengths differ, time does not increase, or an input is not finite. Measured arrays are better
    given to `Experiment.from_arrays`, which also refuses records that hold nothing to learn from.
    """

    name: str
    time: np.ndarray
    inputs: Mapping[str, np.ndarray]
    outputs: Mapping[str, np.ndarray]
    hold: Hold = "zero"
    source: str = ""
    conditions: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    sampling_time: float | None = field(init=False)
    fingerprint: str = field(init=False)

    def __post_init__(self) -> None:
        if self.hold not in HOLDS:
            raise DataError(
                f"experiment {self.name!r}: hold {self.hold!r} is unknown;"
                " say 'zero' (held) or 'first' (linear between samples) or 'band-limited' (no content above half the rate)"
            )
        problems: list[str] = []
        time = to_read_only_array("time", self.time, problems)
        rows = None if problems else len(time)
        inputs = {n: to_read_only_array(f"input {n!r}", v, problems, rows) for n, v in self.inputs.items()}
        outputs = {n: to_read_only_array(f"output {n!r}", v, problems, rows) for n, v in self.outputs.items()}
        both = sorted(set(inputs) & set(outputs))
        problems += [f"{n!r} is both an input and an output; each signal needs its own name" for n in both]
        problems += [
            f"condition {n!r} is {v}; give a finite number" for n, v in self.conditions.items() if not math.isfinite(v)
        ]
        raise_problems(f"experiment {self.name!r}", problems or find_array_problems(time, inputs, outputs, RowLabels()))
        values = {
            "time": time, "inputs": MappingProxyType(inputs), "outputs": MappingProxyType(outputs),
            "conditions": MappingProxyType({n: float(v) for n, v in self.conditions.items()}),
            "notes": tuple(self.notes), "sampling_time": find_sampling_time(time),
            "fingerprint": compute_fingerprint(time, inputs, outputs),
        }  # fmt: skip
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @classmethod
    def from_arrays(
        cls,
        time: ArrayLike,
        inputs: Mapping[str, ArrayLike],
        outputs: Mapping[str, ArrayLike],
        *,
        name: str = "experiment",
        hold: Hold = "zero",
        source: str = "",
        conditions: Mapping[str, float] | None = None,
        notes: tuple[str, ...] = (),
        allow_constant_input: bool = False,
    ) -> Experiment:
        """A measured record from arrays in the model's units: ``time`` (N,) in seconds, each signal (N,), NaN for gaps
        of outputs.

        Raises DataError, besides what `Experiment` refuses, for fewer than 10 rows, for an output without any value,
        for a record in which no output moves, and for inputs that are all constant at zero unless
        ``allow_constant_input``.
        """
        bare = cls(name, time, inputs, outputs, hold, source, conditions or {})  # type: ignore[arg-type]
        raise_problems(
            f"experiment {name!r}",
            find_measurement_problems(bare.inputs, bare.outputs, bare.rows, allow_constant_input),
        )
        said = (*inspect_record(bare.time, bare.inputs, bare.outputs), *describe_timing(bare.time, bare.sampling_time))
        return replace(bare, notes=(*notes, *said))

    @property
    def rows(self) -> int:
        """Number of rows N."""
        return len(self.time)

    @property
    def regular(self) -> bool:
        """Whether the record is sampled uniformly."""
        return self.sampling_time is not None

    @property
    def duration(self) -> float:
        """Seconds from the first row to the last."""
        return float(self.time[-1] - self.time[0])

    @property
    def intervals(self) -> np.ndarray:
        """Lengths (N-1,) in seconds of the intervals between rows: the sampling time if regular, else each its own."""
        if self.sampling_time is None:
            return np.diff(self.time)
        return np.full(self.rows - 1, self.sampling_time)

    def window(self, start_row: int, stop_row: int) -> Experiment:
        """Rows ``start_row`` up to but without ``stop_row``, counted from 0, with the times of the whole record."""
        if not 0 <= start_row < stop_row - 1 < self.rows:
            raise DataError(
                f"experiment {self.name!r}: window [{start_row}, {stop_row}) does not fit {self.rows} rows;"
                " give 0 <= start, stop <= rows and at least 2 rows"
            )
        cut = slice(start_row, stop_row)
        part = replace(
            self,
            name=f"{self.name}[{start_row}:{stop_row}]",
            time=self.time[cut],
            inputs={n: v[cut] for n, v in self.inputs.items()},
            outputs={n: v[cut] for n, v in self.outputs.items()},
        )
        return _with_step(part, self.sampling_time) if self.regular else part

    def split(self, fraction: float) -> tuple[Experiment, Experiment]:
        """The first ``fraction`` (0 to 1) of the rows and the rest, each with its own times: train and validation."""
        if not 0 < fraction < 1:
            raise DataError(
                f"experiment {self.name!r}: cannot split at fraction {fraction:g}; give a number between 0 and 1"
            )
        row = round(fraction * self.rows)
        if min(row, self.rows - row) < 2:
            raise DataError(
                f"experiment {self.name!r}: fraction {fraction:g} splits {self.rows} rows into {row} and"
                f" {self.rows - row}; each part needs at least 2, give a fraction nearer to 0.5"
            )
        return self.window(0, row), self.window(row, self.rows)

    def split_at_time_gaps(self, fewest: int = FEWEST_ROWS) -> tuple[Experiment, ...]:
        """The pieces between holes in time, each a record of its own with an initial state of its own; itself without holes.

        A hole is a step of more than one and a half usual ones (`greybox.experiment.sampling`): the logger dropped out, or two
        runs were pasted together. In it the input is unknown, and what a fit simulates through it is made up. Pieces of fewer
        than ``fewest`` rows, or without a measured value, are left out, which ``notes`` say. Pieces that are sampled alike have the
        same `sampling_time`. Raises DataError where no piece is left.
        """
        parts = split_record(self, fewest)
        step = common_sampling_time(parts)
        return parts if step is None else tuple(_with_step(part, step) for part in parts)

    def with_hold(self, hold: Hold) -> Experiment:
        """The same record with another course of the input between samples: ``"zero"``, ``"first"``, ``"band-limited"``."""
        return _with_step(replace(self, hold=hold), self.sampling_time)

    def with_outputs(self, outputs: Mapping[str, np.ndarray]) -> Experiment:
        """The same record with these outputs, name -> (N,), in place of its own; none for the inputs alone."""
        return _with_step(replace(self, outputs=outputs), self.sampling_time)

    def __str__(self) -> str:
        pace = f"every {self.sampling_time:.6g} s" if self.regular else "at irregular times"
        lines = [
            f"{self.name}: {self.rows} rows {pace}, {self.duration:.6g} s, {HOLDS[self.hold]}, data {self.fingerprint}"
        ]
        for kind, signals in (("input", self.inputs), ("output", self.outputs)):
            lines += [f"  {kind:<9} {name}: {describe_range(values)}" for name, values in signals.items()]
        lines += [f"  condition {name}: {value:g}" for name, value in self.conditions.items()]
        return "\n".join([*lines, *(f"  note      {note}" for note in self.notes)])

    def __reduce__(self) -> tuple[Any, ...]:
        # Read-only mappings cannot be pickled and arrays lose their protection: rebuild through the constructor.
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.init}
        values |= {n: dict(values[n]) for n in ("inputs", "outputs", "conditions")}
        return _restore, (values, self.sampling_time)


def _restore(values: Mapping[str, Any], sampling_time: float | None) -> Experiment:
    return _with_step(Experiment(**values), sampling_time)


def _with_step(experiment: Experiment, sampling_time: float | None) -> Experiment:
    # The whole record knows the step better than a part of it, and equal steps make equal discrete models.
    object.__setattr__(experiment, "sampling_time", sampling_time)
    return experiment
