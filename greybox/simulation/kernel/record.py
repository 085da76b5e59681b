"""One experiment as plain arrays, in the order of the model's inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from greybox.base import DataError
from greybox.data.experiment import MAX_DELAY_ROWS
from greybox.simulation.integrators.input_delay import add_input_history
from greybox.simulation.integrators.step import Step


def is_repeated(array: np.ndarray) -> bool:
    """Whether all entries of an array (N,) of float64 are one number in memory."""
    return array.dtype == np.float64 and array.strides == (0,)


@dataclass(frozen=True, eq=False)
class Record:
    """One experiment as plain arrays: float64 (``row`` int32), C-contiguous but for ``h``, which may be one number that is repeated.

    Raises
    ------
    DataError
        If the lengths of the arrays disagree: the kernels read them without asking again.
    """

    u: np.ndarray
    """Inputs (N, nu)."""

    y: np.ndarray
    """Outputs (N, ny), NaN where nothing was measured."""

    h: np.ndarray
    """Interval lengths (N-1,) in seconds."""

    row: np.ndarray
    """Which row of the step's coefficients belongs to each interval (N-1,)."""

    lengths: np.ndarray
    """The distinct interval lengths that those rows stand for (nh,)."""

    is_linear: np.ndarray = field(default_factory=lambda: np.zeros(()))
    """Which inputs (nu,) are linear between samples (1.0), and which held (0.0); one number says it of all."""

    rows_per_sample: int = 1
    """How many rows make a sample; the rows between samples carry the course of the input and have NaN in ``y``."""

    spread: np.ndarray | None = None
    """Standard deviation of the noise of each sample over that of its output (samples, ny); None where it is the same in all rows."""

    log_std: np.ndarray | None = None
    """Standard deviation of the logarithm of each output (ny,), NaN for those whose error is that of the reading; None: all of them."""

    before: np.ndarray | None = None
    """The inputs (K, nu) in rows before the first, a usual interval (`period`) apart, the latest last; None where nothing is known."""

    def __post_init__(self) -> None:
        for name in ("u", "y", "h", "row", "lengths"):
            kind = np.int32 if name == "row" else np.float64
            given = np.asarray(getattr(self, name))
            if name != "h" or not is_repeated(given):
                object.__setattr__(self, name, np.ascontiguousarray(given, dtype=kind))
        columns = self.u.shape[1:]
        object.__setattr__(self, "is_linear", np.array(np.broadcast_to(self.is_linear, columns), np.float64))
        shapes = f"u {self.u.shape}, y {self.y.shape}, h {self.h.shape}, row {self.row.shape}"
        if self.u.ndim != 2 or self.y.ndim != 2 or len(self.u) != len(self.y) or len(self.y) < 1:
            raise DataError(f"record: {shapes}; u and y need one row for each sample, at least one")
        if self.h.shape != (len(self.y) - 1,) or self.row.shape != self.h.shape:
            raise DataError(
                f"record: {shapes}; h and row need one entry for each interval, that is one less than samples"
            )
        if len(self.row) and (self.row.min() < 0 or self.row.max() >= len(self.lengths)):
            raise DataError(
                f"record: row runs from {self.row.min()} to {self.row.max()},"
                f" but there are {len(self.lengths)} interval lengths"
            )

    @cached_property
    def duration(self) -> float:
        """Seconds from the first row to the last."""
        return float(self.h.sum())

    @cached_property
    def period(self) -> float:
        """Usual length of an interval in seconds; zero where there is none."""
        if not len(self.h):
            return 0.0
        return float(self.h[0] if len(self.lengths) == 1 else np.median(self.h))

    @cached_property
    def all_held(self) -> bool:
        """Whether no input moves between samples."""
        return not np.any(self.is_linear)

    def find_ends(self, rows: np.ndarray) -> np.ndarray:
        """The inputs (n, nu) at the end of the intervals after ``rows`` (n,): a held one is what it was at their start."""
        after = np.minimum(rows + 1, len(self.u) - 1)
        return np.where(self.is_linear, self.u[after], self.u[rows])

    def with_other_course(self, column: int, name: str) -> Record:
        """The record with one input, of this column and name, held that was linear between rows, or linear that was held.

        Itself where there are rows between samples.
        """
        if self.rows_per_sample > 1:
            return self
        is_linear = self.is_linear.copy()
        is_linear[column] = 1.0 - is_linear[column]
        return replace(self, is_linear=is_linear)

    def with_bowed_course(self, column: int) -> Record:
        """The record with one input, linear between rows, whose straight pieces have the means of a smooth curve through the rows.

        Itself where the input is held, where there are rows between samples, and where these are uneven.
        """
        if not self.is_linear[column] or self.rows_per_sample > 1 or len(self.lengths) > 1:
            return self
        # The mean of a smooth u over an interval is (u_k + u_k+1)/2 - h^2 u''/12: that of a straight line through u - d2u/12.
        u = self.u.copy()
        u[1:-1, column] -= np.diff(self.u[:, column], 2) / 12
        return replace(self, u=u)

    def with_inputs(self, u: np.ndarray, names: Sequence[str]) -> Record:
        """The record with other values (N, nu) of its inputs, which have these names."""
        return replace(self, u=u)

    def first(self, rows: int) -> Record:
        """The beginning of the record."""
        return self.cut(0, rows)

    def cut(self, first: int, end: int) -> Record:
        """Rows ``first`` up to but without ``end``, both of them samples where there are rows between these."""
        rows, intervals = slice(first, end), slice(first, end - 1)
        # What was before a part is in the whole; with uneven rows the latest are taken to lie a usual interval apart.
        known = self.u[max(0, first - MAX_DELAY_ROWS) : first]
        if self.before is not None:
            known = np.concatenate([self.before, known])
        spread = None
        if self.spread is not None:
            per = self.rows_per_sample
            spread = self.spread[first // per : -(-end // per)]
        return replace(
            self,
            u=self.u[rows],
            y=self.y[rows],
            h=self.h[intervals],
            row=self.row[intervals],
            spread=spread,
            before=known if len(known) else None,
        )

    def scale_errors(self, errors: np.ndarray, slopes: np.ndarray, weight: np.ndarray) -> None:
        """Errors over the noise of their output to errors over that of their row, in place.

        Parameters
        ----------
        errors
            Of the first samples (n, ny), ``(y - yhat) weight``.
        slopes
            Of these (n, ny, L).
        weight
            One over the standard deviation of each output (ny,).
        """
        if self.log_std is not None:
            seen = self.samples(self.y)[: len(errors)]
            for j in np.flatnonzero(np.isfinite(self.log_std)):
                with np.errstate(invalid="ignore", divide="ignore"):
                    run = seen[:, j] - errors[:, j] / weight[j]
                    # w = (log y - log yhat) / s, dw = -dyhat / (yhat s): a run at or below zero has no logarithm and is no run.
                    errors[:, j] = (np.log(seen[:, j]) - np.log(run)) / self.log_std[j]
                slopes[:, j] /= (run * weight[j] * self.log_std[j])[:, None]
        if self.spread is not None:
            # w = e / sd(t): what is left is as large in every row, and the colour is that of w.
            errors /= self.spread[: len(errors)]
            slopes /= self.spread[: len(errors), :, None]

    def samples(self, values: np.ndarray) -> np.ndarray:
        """Of an array with one entry for each row (N, ...) the entries that are samples."""
        return values[:: self.rows_per_sample]

    def count_unknown_rows(self, step: Step) -> int:
        """How many of the first rows an input may still reach that nobody recorded: they do not count."""
        if step.past is None or self.before is None:
            return 0
        ago = len(self.before) - np.flatnonzero(np.isnan(self.before[:, step.past.column]))
        return max(step.past.rows + 1 - int(ago[-1]), 0) if len(ago) else 0

    def read_by(self, step: Step) -> Record:
        """The record as ``step`` reads it: one row of coefficients where one is enough, the past of a delayed input beside the inputs."""
        record = self if step.per_interval else replace(self, row=np.zeros_like(self.row))
        if step.past is None:
            return record
        before, y = self.before, self.y
        if unknown := self.count_unknown_rows(step):
            before, y = np.where(np.isnan(before), self.u[:1], before), y.copy()  # type: ignore[arg-type]
            y[:unknown] = np.nan
        u = add_input_history(self.u, self.h, step.past, bool(self.is_linear[step.past.column]), before)
        # What was added runs straight from row to row: a step tells by it which of its substeps it is.
        added = np.ones(u.shape[1] - len(self.is_linear))
        return replace(record, u=u, y=y, before=None, is_linear=np.concatenate([self.is_linear, added]))
