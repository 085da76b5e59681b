"""Records brought to equal steps, for difference equations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from greybox.base.errors import DataError
from greybox.base.findings import Finding
from greybox.base.numerics import SAME_SAMPLING_TIME, TIME_ROUNDING
from greybox.data.experiment import Experiment
from greybox.data.findings import RecordCode


def resample(experiment: Experiment, sampling_time: float) -> Experiment:
    """Bring a record to equal steps, from its first row on.

    A held input keeps the value of the row before; other inputs and the outputs are interpolated linearly. An output has a gap
    where one of the rows around it has one. Interpolation attenuates what is faster than a few of the old steps: choose a step near
    the record's own.

    Parameters
    ----------
    experiment
        The record, of regular or irregular time.
    sampling_time
        The new step in seconds.

    Returns
    -------
    Experiment
        The record at the new step, with a finding that says so.

    Raises
    ------
    DataError
        For a step that is not positive or leaves fewer than two rows.

    Examples
    --------
    >>> slower = gb.blackbox.resample(record, 0.5)  # doctest: +SKIP
    """
    if not (math.isfinite(sampling_time) and sampling_time > 0):
        raise DataError(f"resample {experiment.name!r}: a step of {sampling_time} s; give a positive number of seconds")
    rows = int(np.floor(experiment.duration / sampling_time + TIME_ROUNDING)) + 1
    if rows < 2:
        raise DataError(
            f"resample {experiment.name!r}: steps of {sampling_time:g} s leave {rows} row of a record of"
            f" {experiment.duration:g} s; give a shorter step"
        )
    old, new = experiment.time, experiment.time[0] + sampling_time * np.arange(rows)
    # The row in force at each new time, within the rounding of the clock.
    before = np.clip(np.searchsorted(old, new + TIME_ROUNDING * sampling_time, side="right") - 1, 0, len(old) - 1)

    def interpolate(values: np.ndarray) -> np.ndarray:
        return np.interp(new, old, values)

    def hold(values: np.ndarray) -> np.ndarray:
        return values[before]

    resampled = {"sampling_time": sampling_time, "rows": experiment.rows}
    # A held input interpolated would move before it did.
    convert = {name: hold if course == "zero" else interpolate for name, course in experiment.courses.items()}
    return replace(
        experiment,
        time=new,
        inputs={name: convert[name](values) for name, values in experiment.inputs.items()},
        outputs={name: interpolate(values) for name, values in experiment.outputs.items()},
        findings=(*experiment.findings, Finding(RecordCode.RESAMPLED, values=resampled)),
    )


def keep_measured_rows(experiment: Experiment, output: str) -> Experiment | None:
    """Keep the rows at which a slow sensor was read.

    For a sensor slower than the rest, whose column is empty in between. Inputs are averaged over the rows of each long step, which
    is what a held input does in it; other outputs keep what they have at those rows.

    Parameters
    ----------
    experiment
        The record, of regular time.
    output
        The output of the slow sensor.

    Returns
    -------
    Experiment or None
        The record at the rows where ``output`` is measured; None where these do not lie several equal steps apart.
    """
    if experiment.sampling_time is None or output not in experiment.outputs:
        return None
    measured = np.flatnonzero(np.isfinite(experiment.outputs[output]))
    # The sensor's own step: the greatest that every distance between two readings is a multiple of; a reading that
    # failed leaves a gap.
    stride = int(np.gcd.reduce(np.diff(measured))) if len(measured) > 2 else 1
    if stride < 2:
        return None
    rows = np.arange(measured[0], experiment.rows, stride)
    rows = rows[rows <= measured[-1]]

    def average(values: np.ndarray) -> np.ndarray:
        # Mean over the long step: what a linear plant integrates of a held input.
        ends = np.append(rows[1:], min(rows[-1] + stride, experiment.rows))
        return np.array([values[a:b].mean() for a, b in zip(rows, ends, strict=True)])

    return replace(
        experiment,
        time=experiment.time[rows],
        inputs={name: average(values) for name, values in experiment.inputs.items()},
        outputs={name: values[rows] for name, values in experiment.outputs.items()},
    )


def match_sampling_time(experiment: Experiment, output: str, sampling_time: float, label: str) -> Experiment:
    """``experiment`` at the ``sampling_time`` of the model ``label`` of ``output``: as it is, at its measured rows alone, or
    resampled where its time is irregular. Raises DataError for another sampling time."""
    step = experiment.sampling_time
    if step is not None and np.isclose(step, sampling_time, rtol=SAME_SAMPLING_TIME):
        return experiment
    sparse = keep_measured_rows(experiment, output)
    slow_step = sparse.sampling_time if sparse is not None else None
    if sparse is not None and slow_step is not None and np.isclose(slow_step, sampling_time, rtol=SAME_SAMPLING_TIME):
        return sparse
    if step is not None:
        raise DataError(
            f"experiment {experiment.name!r} is sampled every {step:.6g} s, but {label} of {output!r} was identified"
            f" at {sampling_time:.6g} s; give greybox.blackbox.resample(experiment, {sampling_time:.6g})"
        )
    return resample(experiment, sampling_time)
