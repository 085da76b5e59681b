"""Records brought to equal steps, for difference equations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.base.errors import DataError
from greybox.base.numerics import SAME_SAMPLING_TIME, TIME_ROUNDING
from greybox.base.values import Finding
from greybox.data.experiment import Experiment
from greybox.data.findings import RecordCode
from greybox.estimation.errors import OutputRun, OutputScore
from greybox.estimation.predictor import PredictingModel
from greybox.estimation.validate import FIRST_ROWS


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


# Cross-validation of free runs: parts of the records that a model was not fitted to judge it.


@dataclass(frozen=True, eq=False)
class Fold:
    """One division of the records.

    Attributes
    ----------
    estimation
        What a model is fitted to.
    judged
        The records with the readings that judge it.
    known
        The same records with the readings that tell their first state, from the first ``rows`` (None: all).
    skip
        First rows of each record that do not count.
    """

    estimation: tuple[Experiment, ...]
    judged: tuple[Experiment, ...]
    known: tuple[Experiment, ...]
    rows: int | None = None
    skip: int = 0

    @classmethod
    def of(cls, estimation: Sequence[Experiment], validation: Sequence[Experiment] = (), skip: int = 0) -> Fold:
        """One with records for validation; without them the estimation records judge, and all their rows tell the first state."""
        records = tuple(estimation)
        if not validation:
            return cls(records, records, records)
        others = tuple(validation)
        return cls(records, others, others, skip or FIRST_ROWS, skip)

    def score(self, model: PredictingModel, output: str) -> OutputScore:
        """Errors of the free runs, from rest for a model that was fitted from rest."""
        initial = "zero" if getattr(model, "history", "") == "zero" else "estimated"
        runs = []
        for judged, known in zip(self.judged, self.known, strict=True):
            run = model.simulate(known, initial=initial, rows=self.rows)[output]  # type: ignore[call-arg]
            runs.append(OutputRun(judged.name, output, judged.time, judged.outputs[output], run, self.skip))
        return OutputScore.of(runs)


# Ends of the parts of a single record that are held out in turn, as shares of its rows: its end first.
PARTS = ((0.7, 1.0), (0.0, 0.35), (0.35, 0.7))
# A part judges if an input moves there by this share of its range: one at rest would praise any model with the right gain.
MOVING_SHARE = 0.3
# Measured values that such a part must hold.
FEWEST_VALUES = 60
# Rows of all records that are looked at.
SCANNED_ROWS = 20000


def hold_out(experiments: Sequence[Experiment], outputs: Sequence[str], inputs: Sequence[str]) -> list[Fold]:
    """Of several records each third is held out in turn, the last first; of a single one each part, its readings left out.

    The inputs of a part stay, so that a run over the whole record reaches it with the state that it has there. Where no part can judge,
    such as behind a step that has settled, the records that a model is fitted to do.
    """
    # The first rows of each record, SCANNED_ROWS in all.
    share = min(1.0, SCANNED_ROWS / sum(e.rows for e in experiments))
    records = tuple(e if share == 1 else e.window(0, max(2, int(share * e.rows))) for e in experiments)
    if len(records) > 1:
        thirds = [third.tolist() for third in np.array_split(np.arange(len(records)), min(3, len(records)))]
        return [
            Fold.of([r for k, r in enumerate(records) if k not in third], [records[k] for k in third])
            for third in (thirds[-1], *thirds[:-1])
        ]
    (record,) = records
    folds = []
    for begin, end in PARTS:
        held = np.zeros(record.rows, bool)
        held[round(begin * record.rows) : round(end * record.rows)] = True
        # The first reading stays: it says where a record rests.
        held[0] = False
        moving = any(
            np.ptp(u[held]) > MOVING_SHARE * np.ptp(u) for u in (record.inputs[n] for n in inputs) if held.any()
        )
        if moving and all(_count(record, n, rows) >= FEWEST_VALUES for n in outputs for rows in (held, ~held)):
            kept = _with_readings(record, ~held)
            folds.append(Fold((kept,), (_with_readings(record, held),), (kept,)))
    return folds or [Fold.of(records)]


def _count(record: Experiment, output: str, rows: np.ndarray) -> int:
    return int(np.isfinite(record.outputs[output][rows]).sum())


def _with_readings(record: Experiment, rows: np.ndarray) -> Experiment:
    """The record with its readings in these ``rows`` (N,) alone."""
    return record.with_outputs({name: np.where(rows, y, np.nan) for name, y in record.outputs.items()})
