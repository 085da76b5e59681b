"""Experiments as plain arrays in the order of a model's inputs and outputs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from greybox.errors import DataError, nearest
from greybox.experiment import Experiment
from greybox.experiment.time_gaps import refuse_unknown_input
from greybox.kernel.record import Record
from greybox.model import Model

# Interval lengths that differ by less than this share of themselves are one length.
SAME_LENGTH = 1e-9
# Points in each interval of a band-limited input; half the length of the interpolating filter in intervals, and its window.
FINER = 12
HALF_LENGTH, KAISER = 32, 9.0


def to_experiments(given: Experiment | Iterable[Experiment]) -> tuple[Experiment, ...]:
    """One or several measured experiments as a tuple.

    Raises DataError for none, for what is no experiment (the path of a file), for one without a measured output, and for one with a
    long gap in time.
    """
    group = (given,) if isinstance(given, Experiment | str | Path) else tuple(given)
    if not group:
        raise DataError("no experiment to fit; give at least one")
    for item in group:
        if not isinstance(item, Experiment):
            raise DataError(
                f"{item!r} is not an experiment; read a file with read_csv(path, model), or give Experiment.from_arrays(...)"
            )
        if not item.outputs:
            raise DataError(f"experiment {item.name!r} has no measured output; there is nothing to compare with")
    refuse_unknown_input(group)
    return group


def to_record(model: Model, experiment: Experiment) -> Record:
    """``experiment`` as `Record`; an output that was not measured is a column of NaN.

    An effect of the model may say what the input does between samples; else the experiment does. A band-limited input becomes a
    finer one that is linear between rows, `FINER` of them in each interval (`Record.every`), with NaN in the outputs of the rows put
    between. Raises DataError where an input of the model is missing, where outputs were measured but none of the model's, and for a
    band-limited input that was not sampled uniformly.
    """
    missing = [i.name for i in model.inputs if i.name not in experiment.inputs]
    if missing:
        raise DataError(
            f"experiment {experiment.name!r} has no input {missing[0]!r}; {nearest(missing[0], experiment.inputs)}"
        )
    names = [o.name for o in model.outputs]
    if experiment.outputs and not any(name in experiment.outputs for name in names):
        has = ", ".join(map(repr, experiment.outputs))
        raise DataError(
            f"experiment {experiment.name!r} has none of the outputs of model {model.title!r}: it has {has};"
            f" {nearest(next(iter(experiment.outputs)), names)}"
        )
    rows = experiment.rows
    u = np.column_stack([experiment.inputs[i.name] for i in model.inputs]) if model.inputs else np.zeros((rows, 0))
    absent = np.full(rows, np.nan)
    y = np.column_stack([experiment.outputs.get(o.name, absent) for o in model.outputs])
    hold = next((e.hold for e in reversed(model.effects) if e.hold), experiment.hold)
    if hold == "band-limited":
        return _finer(experiment, u, y)
    lengths, row = _distinct(experiment.intervals)
    return Record(u, y, lengths[row], row, lengths, hold == "first")


def _finer(experiment: Experiment, u: np.ndarray, y: np.ndarray) -> Record:
    if experiment.sampling_time is None:
        raise DataError(
            f"experiment {experiment.name!r}: a band-limited input needs uniform sampling; resample it or take hold='first'"
        )
    rows = FINER * (len(y) - 1) + 1
    measured = np.full((rows, y.shape[1]), np.nan)
    measured[::FINER] = y
    length = np.array([experiment.sampling_time / FINER])
    between = interpolate_band_limited(u, FINER)
    return Record(
        between, measured, np.full(rows - 1, length[0]), np.zeros(rows - 1), length, first_order=True, every=FINER
    )


def interpolate_band_limited(u: np.ndarray, finer: int) -> np.ndarray:
    """A band-limited signal (N, n) at ``finer`` points in each interval: ``(finer (N - 1) + 1, n)``.

    A windowed sinc, flat up to 0.45 of the sampling rate (0.01 %); towards its ends the record is continued as its mirror image
    about the end point. Straight lines through points of a signal lose ``(w h)^2 / 12`` of it at the frequency ``w`` and spacing ``h``;
    that much is given back, so that the lines, and not the points, carry the signal's own spectrum.
    """
    if len(u) < 2 or u.shape[1] == 0:
        return np.zeros((finer * (len(u) - 1) + 1, u.shape[1])) + u[:1]
    from scipy.signal import firwin, resample_poly  # half a second to import, and few records are band-limited

    margin = min(HALF_LENGTH, len(u) - 1)
    ends = np.pad(u, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    half = HALF_LENGTH * finer
    taps = firwin(2 * half + 1, 1 / finer, window=("kaiser", KAISER))
    fine = resample_poly(ends, finer, 1, axis=0, window=taps, padtype="line")
    lines = fine.copy()
    lines[1:-1] -= (fine[2:] - 2 * fine[1:-1] + fine[:-2]) / 12
    return lines[finer * margin : finer * (margin + len(u) - 1) + 1]


def _distinct(intervals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distinct interval lengths, and which of them each interval has."""
    if (
        len(intervals) and np.ptp(intervals) <= SAME_LENGTH * intervals[0]
    ):  # the usual case, without five copies of a long record
        return intervals[:1].copy(), np.zeros(len(intervals), np.int32)
    order = np.argsort(intervals, kind="stable")
    ordered = intervals[order]
    new = np.concatenate([[False], np.diff(ordered) > SAME_LENGTH * ordered[1:]])
    group = np.cumsum(new)
    row = np.empty(len(intervals), int)
    row[order] = group
    starts = np.concatenate([[0], np.flatnonzero(new)])
    return ordered[starts], row
