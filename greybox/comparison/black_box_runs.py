"""Black-box models as contestants: their runs over records, each on the time grid it was identified at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from greybox.blackbox import keep_measured_rows, resample
from greybox.comparison.result import BlackBoxModel, ComparisonRun
from greybox.errors import DataError
from greybox.experiment import Experiment

FIRST_ROWS = 50  # that tell the initial state of a record that is only judged, if `skip` does not say
SAME = 2e-3  # relative difference of sampling times that are one


def run_black_box(
    model: BlackBoxModel,
    experiments: Sequence[Experiment],
    *,
    training: bool,
    skip: int,
    at_rest: bool,
    steps: Sequence[int] = (),
) -> list[ComparisonRun]:
    """Free run and one-step prediction of ``model`` over each record that has its output, and predictions ``steps`` samples ahead.

    The initial state comes from all rows of a ``training`` record, and from the first ``skip`` (or 50) of another; with ``at_rest``
    everything was zero before.
    """
    found = []
    for experiment in experiments:
        if model.output not in experiment.outputs or not np.isfinite(experiment.outputs[model.output]).any():
            continue
        seen = match_sampling_time(experiment, model.output, model.sampling_time, model.label)
        ratio = seen.rows / experiment.rows
        rows = None if training else max(1, round(ratio * (skip or FIRST_ROWS)))
        initial = "zero" if at_rest else "estimated"
        free = model.simulate(seen, initial=initial, rows=rows)[model.output]
        one, *more = (model.predict(seen, k, initial=initial, rows=rows)[model.output] for k in (1, *steps))
        left_out = 0 if training else int(np.searchsorted(seen.time, experiment.time[min(skip, experiment.rows - 1)]))
        found.append(
            ComparisonRun(
                experiment.name, model.output, seen.time, seen.outputs[model.output], free, one, left_out,
                dict(zip(steps, more, strict=True)),
            )
        )  # fmt: skip
    return found


def match_sampling_time(experiment: Experiment, output: str, wanted: float, label: str) -> Experiment:
    """``experiment`` at the sampling time ``wanted`` by the model ``label`` of ``output``: as it is, at its measured rows alone, or
    resampled where its time is irregular. Raises DataError for another sampling time."""
    step = experiment.sampling_time
    if step is not None and np.isclose(step, wanted, rtol=SAME):
        return experiment
    sparse = keep_measured_rows(experiment, output)
    slow = sparse.sampling_time if sparse is not None else None
    if sparse is not None and slow is not None and np.isclose(slow, wanted, rtol=SAME):
        return sparse
    if step is not None:
        raise DataError(
            f"experiment {experiment.name!r} is sampled every {step:.6g} s, but {label} of {output!r} was identified"
            f" at {wanted:.6g} s; give greybox.blackbox.resample(experiment, {wanted:.6g})"
        )
    return resample(experiment, wanted)
