"""Gaps in the time of a record that nothing may be simulated through.

In a gap nobody knows the input: it is taken to continue. That does little harm over a few rows, or where the drive rests.
A simulation through a long gap of a moving input answers an input that was never there, so that whatever follows the gap
contradicts the model. Such a record is two records (`Experiment.split_at_time_gaps`). The same holds where the equations are
integrated in steps, whatever the input does: every interval of a record takes as many of them as its longest.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from greybox.experiment.experiment import Experiment
from greybox.experiment.policy import RECORD_POLICY, RecordPolicy
from greybox.experiment.problems import is_constant, raise_problems
from greybox.experiment.sampling import find_time_gaps

SPLIT_REMEDY = "split the record there with split_at_time_gaps() (shell: --split-holes)"


class UnknownInputGap(NamedTuple):
    """A gap from ``start`` to ``stop`` (s) of ``rows`` missing rows; ``change`` of the input in it, over its standard deviation."""

    start: float
    stop: float
    rows: int
    name: str
    change: float


def refuse_unknown_input(records: Iterable[Experiment], policy: RecordPolicy = RECORD_POLICY) -> None:
    """Raise DataError for a record with a long gap in which an input moves on, unknown; it names the longest."""
    for record in records:
        gaps = _find_unknown_input(record, policy)
        if gaps:
            worst = max(gaps, key=lambda gap: gap.rows)
            more = f" (and {len(gaps) - 1} more)" if len(gaps) > 1 else ""
            reason = (
                f"{worst.rows} rows are missing, and over such a time input {worst.name!r} changes by {worst.change:.2g} times its"
                " standard deviation, so that a simulation through the gap is meaningless"
            )
            remedy = f"{SPLIT_REMEDY}, or fill in the missing rows of the input and leave the outputs empty"
            _refuse_gap(record, worst.start, worst.stop, more, f"{reason}; {remedy}")


def refuse_long_time_gaps(records: Iterable[Experiment], policy: RecordPolicy = RECORD_POLICY) -> None:
    """Raise DataError for a record with a long gap: of a model that is integrated in steps."""
    for record in records:
        longest = max(_find_long_gaps(record, policy), key=lambda gap: gap[1], default=None)
        if longest:
            k, rows = longest
            reason = (
                f"{rows} rows are missing, and a model that is integrated in steps takes as many of them in every interval as in the"
                " longest"
            )
            _refuse_gap(record, float(record.time[k]), float(record.time[k + 1]), "", f"{reason}; {SPLIT_REMEDY}")


def _refuse_gap(record: Experiment, start: float, stop: float, more: str, reason: str) -> None:
    raise_problems(f"experiment {record.name!r}", [f"time has a gap from {start:.6g} to {stop:.6g} s{more}: {reason}"])


def _find_long_gaps(record: Experiment, policy: RecordPolicy) -> list[tuple[int, int]]:
    """Each long gap of ``record``: the row before it, and how many rows are missing."""
    usual = float(np.median(np.diff(record.time)))
    gaps = find_time_gaps(record.time, policy)
    missing = [(int(k), round(float(record.time[k + 1] - record.time[k]) / usual) - 1) for k in gaps]
    return [(k, rows) for k, rows in missing if rows >= policy.long_gap_rows]


def _find_unknown_input(record: Experiment, policy: RecordPolicy) -> list[UnknownInputGap]:
    """The gaps of ``record`` through which no simulation means anything."""
    after, near = find_time_gaps(record.time, policy), policy.neighbourhood_rows
    unknown = []
    for k, rows in _find_long_gaps(record, policy):
        around = slice(max(0, k + 1 - near), k + 1 + near)
        moving = {name: u for name, u in record.inputs.items() if not is_constant(u[around])}
        changes = {name: _measure_change(u, after, k, rows, policy.lags_tried) for name, u in moving.items()}
        worst = max(changes, key=lambda name: changes[name], default="")
        if worst and changes[worst] >= policy.lost_input_change:
            start, stop = float(record.time[k]), float(record.time[k + 1])
            unknown.append(UnknownInputGap(start, stop, rows, worst, changes[worst]))
    return unknown


def _measure_change(u: np.ndarray, after: np.ndarray, k: int, rows: int, lags_tried: int) -> float:
    """How much the input ``u`` (N,) changes in a gap of ``rows`` rows after row ``k``, in its standard deviations.

    The larger of what it does elsewhere in up to as many rows (rms, no pair is across a gap) and of the jump across this one.
    """
    pieces = np.split(u, after + 1)
    lags = np.unique(np.geomspace(1, rows, lags_tried).astype(int))
    changes = [np.concatenate([p[lag:] - p[:-lag] for p in pieces if len(p) > lag] or [[]]) for lag in lags]
    elsewhere = max((float(np.sqrt(np.mean(m**2))) for m in changes if len(m)), default=0.0)
    return max(elsewhere, float(abs(u[k + 1] - u[k]))) / float(np.std(u))
