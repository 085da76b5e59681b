"""Records for a difference equation: one output and the inputs at equal steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.errors import DataError, nearest
from greybox.experiment import Experiment
from greybox.numerics import SAME_SAMPLING_TIME


@dataclass(frozen=True, eq=False)
class SampledRecord:
    """One record: ``y`` (N,), NaN where nothing was measured, ``u`` (N, nu), every ``sampling_time`` seconds.

    ``basis``: for each input the functions (N, m) that it is a sum of, where that is so.
    """

    name: str
    y: np.ndarray
    u: np.ndarray
    sampling_time: float
    basis: tuple[np.ndarray, ...] = ()

    @property
    def rows(self) -> int:
        """Number of rows N."""
        return len(self.y)

    def segments(self, least: int) -> list[SampledRecord]:
        """Parts without gaps in ``y`` of at least ``least`` rows."""
        measured = np.flatnonzero(np.isfinite(self.y))
        runs = np.split(measured, np.flatnonzero(np.diff(measured) > 1) + 1) if len(measured) else []
        return [
            replace(self, y=self.y[r], u=self.u[r], basis=tuple(b[r] for b in self.basis))
            for r in runs
            if len(r) >= least
        ]


@dataclass(frozen=True, eq=False)
class SampledData:
    """One output and its inputs over several ``experiments`` of the same sampling time, each a `SampledRecord`."""

    output: str
    inputs: tuple[str, ...]
    sampling_time: float
    records: tuple[SampledRecord, ...]
    experiments: tuple[Experiment, ...]

    @property
    def measured(self) -> int:
        """Number of measured values of the output over all records."""
        return int(sum(np.isfinite(s.y).sum() for s in self.records))


def to_sampled_record(
    experiment: Experiment, output: str, inputs: Sequence[str], *, need_output: bool = True
) -> SampledRecord:
    """``experiment`` as a `SampledRecord`; without measured output all of ``y`` is NaN. Raises DataError."""
    if experiment.sampling_time is None:
        steps = experiment.intervals
        raise DataError(
            f"experiment {experiment.name!r}: time is irregular (steps from {steps.min():.6g} to {steps.max():.6g} s), and a"
            " difference equation needs equal steps; resample it with"
            f" greybox.blackbox.resample(experiment, {float(np.median(steps)):.6g})"
        )
    absent = [name for name in inputs if name not in experiment.inputs]
    if absent:
        raise DataError(
            f"experiment {experiment.name!r}: no input {absent[0]!r}; {nearest(absent[0], experiment.inputs)}"
        )
    y = experiment.outputs.get(output)
    if need_output and (y is None or not np.isfinite(y).any()):
        raise DataError(
            f"experiment {experiment.name!r}: output {output!r} was not measured;"
            f" {nearest(output, experiment.outputs)}, or run it from rest with initial='zero'"
        )
    u = np.column_stack([np.empty((experiment.rows, 0)), *(experiment.inputs[n] for n in inputs)])
    return SampledRecord(
        experiment.name, np.full(experiment.rows, np.nan) if y is None else y, u, experiment.sampling_time
    )


def to_sampled_data(
    experiments: Experiment | Sequence[Experiment], output: str | None = None, inputs: Sequence[str] | str | None = None
) -> SampledData:
    """The ``output`` (None: the only one) and ``inputs`` (None: all) of the records that measured that output.

    Raises DataError for unknown names, irregular time, and records of different sampling times.
    """
    group = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    if not group:
        raise DataError("no experiment; give at least one record")
    known = list(dict.fromkeys(name for e in group for name in e.outputs))
    if output is None and len(known) != 1:
        raise DataError(
            f"which output? A black-box model has one: give output=...; known: {', '.join(known) or 'none'}"
        )
    wanted = known[0] if output is None else output
    if wanted not in known:
        raise DataError(f"no experiment has an output {wanted!r}; {nearest(wanted, known)}")
    names = (inputs,) if isinstance(inputs, str) else tuple(group[0].inputs if inputs is None else inputs)
    if not names:
        raise DataError(f"output {wanted!r}: no input; name at least one")
    measured = [e for e in group if wanted in e.outputs and np.isfinite(e.outputs[wanted]).any()]
    if not measured:
        raise DataError(f"output {wanted!r} holds no value in any experiment")
    records = [to_sampled_record(e, wanted, names) for e in measured]
    steps = [record.sampling_time for record in records]
    if not np.allclose(steps, steps[0], rtol=SAME_SAMPLING_TIME, atol=0):
        listing = ", ".join(f"{r.name!r} every {r.sampling_time:.6g} s" for r in records)
        raise DataError(
            f"experiments of different sampling times: {listing}; a difference equation is valid for one sampling time; resample them"
        )
    return SampledData(wanted, names, steps[0], tuple(records), tuple(measured))


def delay_rows(values: np.ndarray, by: int) -> np.ndarray:
    """``values`` (N, ...) ``by`` rows later, zero before they begin."""
    return np.concatenate([np.zeros_like(values[:by]), values[: max(len(values) - by, 0)]]) if by else values
