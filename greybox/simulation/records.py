"""Experiments as plain arrays in the order of a model's inputs and outputs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary, WeakValueDictionary

import numpy as np

from greybox.base import TIME_ROUNDING, DataError, nearest
from greybox.data.experiment import (
    MAX_DELAY_ROWS,
    Experiment,
    number_unnamed_records,
    refuse_unknown_input,
    stack_signals,
)
from greybox.data.sampling import find_time_gaps
from greybox.model import Model
from greybox.simulation.kernel.record import Record
from greybox.simulation.plant import PlantModel, to_plant_record


def to_experiments(experiments: Experiment | Iterable[Experiment]) -> tuple[Experiment, ...]:
    """One or several measured experiments as a tuple, each with a name.

    Raises DataError for none, for what is no experiment (the path of a file), for one without a measured output, and for one with a
    long gap in time.
    """
    result = (experiments,) if isinstance(experiments, Experiment | str | Path) else tuple(experiments)
    if not result:
        raise DataError("no experiment to fit; give at least one")
    for item in result:
        if not isinstance(item, Experiment):
            raise DataError(
                f"{item!r} is not an experiment; read a file with read_csv(path, model), or give Experiment.from_arrays(...)"
            )
        if not item.outputs:
            raise DataError(f"experiment {item.name!r} has no measured output; there is nothing to compare with")
    refuse_unknown_input(result)
    return number_unnamed_records(result)


def to_record(model: Model, experiment: Experiment) -> Record:
    """An experiment as the kernels read it, its columns in the order of the model's inputs and outputs.

    An output that was not measured is a column of NaN. An effect of the model may say what the input does between samples; else the
    experiment does. A band-limited input becomes a finer one that is linear between rows (`Record.rows_per_sample`), with NaN in the
    outputs of the rows that were put between.

    Raises
    ------
    DataError
        Where an input of the model is missing, where outputs were measured but none of the model's, and for a band-limited input
        that was not sampled uniformly.
    """
    if isinstance(model, PlantModel):
        return to_plant_record(model, experiment)
    # An input that is missing cannot be guessed; an output that is missing is a gap.
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
    # An effect says it of the input that it acts at; one that is added to a model overrules those before it.
    by_effects = {b.site: b.effect.hold for b in model.bound_effects if b.effect.hold} if model.effects else {}
    courses = {**experiment.courses, **by_effects}
    late = {b.site: b.effect.late for b in model.bound_effects if b.effect.late} if model.effects else {}
    inputs = tuple((i.name, courses[i.name], late.get(i.name, 0)) for i in model.inputs)
    laid_out = _LAID_OUT.setdefault(experiment, WeakValueDictionary())
    record = laid_out.get((inputs, tuple(names)))
    if record is None:
        record = laid_out[inputs, tuple(names)] = _lay_out(experiment, inputs, names)
    return record


# A search holds a hundred models of the same records: they share one layout as long as any of them holds it.
_LAID_OUT: WeakKeyDictionary[Experiment, WeakValueDictionary[tuple[Any, ...], Record]] = WeakKeyDictionary()


def _lay_out(experiment: Experiment, inputs: Sequence[tuple[str, str, int]], outputs: Sequence[str]) -> Record:
    """``inputs``: name, course between the rows, and the rows by which it is written late."""
    rows, courses = experiment.rows, [course for _, course, _ in inputs]
    u = [_shift(experiment.inputs[name], late) for name, _, late in inputs]
    measured = (experiment.outputs.get(name) for name in outputs)
    y = stack_signals([np.full(rows, np.nan) if values is None else values for values in measured], rows)
    if "band-limited" in courses and experiment.sampling_time is None:
        raise DataError(
            f"experiment {experiment.name!r}: a band-limited input needs uniform sampling; resample it or take hold='first'"
        )
    # A mean of an output is what it was in the middle of its interval (but for h^2 y'' / 24): half an interval before its stamp.
    points = BAND_LIMITED_POINTS if "band-limited" in courses else 2 if experiment.outputs_are_means else 1
    earlier = points // 2 if experiment.outputs_are_means else 0
    place, intervals = np.arange(points * (rows - 1) + 1) - earlier, experiment.intervals
    if points > 1:
        # NaN between the samples: those rows count in no cost.
        samples, y = y, np.full((len(place), y.shape[1]), np.nan)
        y[::points] = samples
        intervals = intervals[np.clip(place[:-1] // points, 0, max(rows - 2, 0))] / points
    if points > 1 or "mean" in courses:
        u = [_read_input(values, course, place, points) for values, course in zip(u, courses, strict=True)]
    lengths, row = _group_intervals(intervals)
    # Equal intervals take the memory of one.
    h = np.broadcast_to(lengths, row.shape) if len(lengths) == 1 else lengths[row]
    spacing = float(np.median(intervals)) if len(h) else 1.0
    before = _find_rows_before(experiment, inputs, spacing, earlier)
    is_linear = ~np.isin(courses, ("zero", "mean"))
    return Record(stack_signals(u, len(place)), y, h, row, lengths, is_linear, points, before=before)


def _read_input(values: np.ndarray, course: str, place: np.ndarray, points: int) -> np.ndarray:
    """An input (N,) where ``points`` rows make a sample, in rows (M,) at ``place``, counted from the stamp of the first sample."""
    if course == "first":
        return np.interp(place / points, np.arange(len(values)), values)
    if course == "band-limited":
        finer = interpolate_band_limited(values[:, None], points)[:, 0]
        return finer[np.clip(place, 0, len(finer) - 1)]
    # From one stamp to the next acts what was written at the first, or what was meant at the second over the time between.
    return values[np.clip(place // points + (course == "mean"), 0, len(values) - 1)]


def _find_rows_before(
    experiment: Experiment, inputs: Sequence[tuple[str, str, int]], spacing: float, earlier: int
) -> np.ndarray | None:
    """What is known of the inputs before the record, in rows (K, nu) ``spacing`` seconds apart, the latest last; NaN in gaps.

    The record begins so many rows ``earlier`` than its first stamp.
    """
    ages = experiment.before_ages
    if not len(ages):
        return None
    rows = min(MAX_DELAY_ROWS, max(1, math.ceil(ages[0] / spacing - TIME_ROUNDING) - earlier))
    # Rows that are due at one time but for its rounding are that row.
    times = -spacing * (np.arange(rows, 0, -1) + earlier - TIME_ROUNDING)
    latest = np.maximum(np.searchsorted(-ages, times, side="right") - 1, 0)
    # Nobody recorded what the input was in a gap.
    unknown = np.isin(latest, find_time_gaps(np.append(-ages, 0.0))) & (times + ages[latest] > spacing)
    columns = []
    for name, course, _ in inputs:
        first = experiment.inputs[name][:1]
        known = np.append(experiment.before.get(name, np.full(len(ages), first[0])), first)
        past = np.interp(times, np.append(-ages, 0.0), known)
        if course in ("zero", "mean"):
            past = known[latest + (course == "mean")]
        columns.append(np.where(unknown, np.nan, past))
    return stack_signals(columns, rows)


def _shift(values: np.ndarray, late: int) -> np.ndarray:
    """An input (N,) that was written so many rows late where it acted; beyond the ends of the record it is what it is there."""
    return values[np.clip(np.arange(len(values)) + late, 0, len(values) - 1)] if late else values


# Points in each interval, between which the input is linear.
BAND_LIMITED_POINTS = 12


# Half the length of the interpolating filter, in intervals.
HALF_LENGTH = 32
# Shape of the filter's Kaiser window: flat to 0.01 % up to 0.45 of the sampling rate.
BAND_LIMITED_KAISER_BETA = 9.0


def interpolate_band_limited(u: np.ndarray, points: int) -> np.ndarray:
    """A band-limited signal (N, n) at ``points`` points in each interval: ``(points (N - 1) + 1, n)``.

    A windowed sinc, flat up to 0.45 of the sampling rate (0.01 %); towards its ends the record is continued as its mirror image
    about the end point. Straight lines through points of a signal lose ``(w h)^2 / 12`` of it at the frequency ``w`` and spacing ``h``;
    that much is given back, so that the lines, and not the points, carry the signal's own spectrum.
    """
    if len(u) < 2 or u.shape[1] == 0:
        return np.zeros((points * (len(u) - 1) + 1, u.shape[1])) + u[:1]
    margin = min(HALF_LENGTH, len(u) - 1)
    # Odd mirror image: value and slope go on at the ends, where an even one would make a corner.
    ends = np.pad(u, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    half = HALF_LENGTH * points
    # Kaiser-windowed sinc at ``points`` times the rate; its sum is made ``points``, one for each phase, so that a
    # constant keeps its size.
    taps = np.sinc(np.arange(-half, half + 1) / points) * np.kaiser(2 * half + 1, BAND_LIMITED_KAISER_BETA)
    fine = _filter_phases(ends, taps * (points / taps.sum()), points, HALF_LENGTH)
    lines = fine.copy()
    # u - (h^2 / 12) u'': straight lines lose (w h)^2 / 12 of a sine, which the second difference gives back.
    lines[1:-1] -= (fine[2:] - 2 * fine[1:-1] + fine[:-2]) / 12
    return lines[points * margin : points * (margin + len(u) - 1) + 1]


def _filter_phases(values: np.ndarray, taps: np.ndarray, points: int, half_length: int) -> np.ndarray:
    """``values`` (N, n) at ``points`` points in each interval, each phase filtered with its share of the ``taps``.

    Beyond the ends the line through these goes on. As `scipy.signal.resample_poly`, which takes half a second to import.
    """
    slope, steps = (values[-1] - values[0]) / (len(values) - 1), np.arange(1, half_length + 1)[:, None]
    wider = np.vstack([values[0] - slope * steps[::-1], values, values[-1] + slope * steps])
    fine = np.empty((points * (len(values) - 1) + 1, values.shape[1]))
    for phase in range(points):
        count = len(fine[phase::points])
        for column in range(values.shape[1]):
            filtered = np.convolve(wider[:, column], taps[phase::points])
            fine[phase::points, column] = filtered[2 * half_length : 2 * half_length + count]
    return fine


def _group_intervals(intervals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distinct interval lengths, and which of them each interval has."""
    # The usual case, without five copies of a long record.
    if len(intervals) and np.ptp(intervals) <= TIME_ROUNDING * intervals[0]:
        return intervals[:1].copy(), np.zeros(len(intervals), np.int32)
    order = np.argsort(intervals, kind="stable")
    ordered = intervals[order]
    # Lengths that differ by the rounding of the clock share one exponential.
    is_new = np.concatenate([[False], np.diff(ordered) > TIME_ROUNDING * ordered[1:]])
    row = np.empty(len(intervals), int)
    row[order] = np.cumsum(is_new)
    starts = np.concatenate([[0], np.flatnonzero(is_new)])
    return ordered[starts], row
