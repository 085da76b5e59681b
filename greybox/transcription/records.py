"""Experiments as plain arrays in the order of a model's inputs and outputs."""

from __future__ import annotations

import numpy as np

from greybox.errors import DataError, nearest
from greybox.experiment import Experiment
from greybox.kernel.record import Record
from greybox.model import Model

# Interval lengths that differ by less than this share of themselves are one length.
SAME_LENGTH = 1e-9


def record_of(model: Model, experiment: Experiment) -> Record:
    """``experiment`` as `Record`; an output that was not measured is a column of NaN.

    Raises DataError where an input of the model is missing.
    """
    missing = [i.name for i in model.inputs if i.name not in experiment.inputs]
    if missing:
        raise DataError(f"experiment {experiment.name!r} has no input {missing[0]!r}; {nearest(missing[0], experiment.inputs)}")
    rows = experiment.rows
    u = np.column_stack([experiment.inputs[i.name] for i in model.inputs]) if model.inputs else np.zeros((rows, 0))
    absent = np.full(rows, np.nan)
    y = np.column_stack([experiment.outputs.get(o.name, absent) for o in model.outputs])
    lengths, row = _distinct(experiment.intervals)
    return Record(
        np.ascontiguousarray(u, float), np.ascontiguousarray(y, float), lengths[row], row.astype(np.int32), lengths, experiment.hold == "first"
    )  # fmt: skip


def _distinct(intervals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distinct interval lengths, and which of them each interval has."""
    order = np.argsort(intervals, kind="stable")
    ordered = intervals[order]
    new = np.concatenate([[False], np.diff(ordered) > SAME_LENGTH * ordered[1:]])
    group = np.cumsum(new)
    row = np.empty(len(intervals), int)
    row[order] = group
    starts = np.concatenate([[0], np.flatnonzero(new)])
    return ordered[starts], row
