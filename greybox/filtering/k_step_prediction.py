"""Prediction over several samples: from the states after the last measurement, by the model alone."""

from __future__ import annotations

import numpy as np

from greybox.filtering.batch_filter import BatchFilter
from greybox.filtering.kalman_filter import KalmanFilter
from greybox.kernel import Record


def predict_outputs(kalman: KalmanFilter, record: Record, pn: np.ndarray, x0: np.ndarray, steps: int) -> np.ndarray:
    """Outputs (N, ny) of each sample given the measurements up to ``steps`` samples before it, the first states ``x0`` (nx,) being known.

    The first ``steps`` samples have no measurement to go by: they are those of the free run. With process noise of intensity zero
    all of them are.
    """
    batch = BatchFilter(kalman, record, pn)
    free = kalman.simulate_free_run(record, pn, x0)
    samples = np.arange(0, len(record.y), record.rows_per_sample)
    states = free[samples]
    if steps < len(samples):
        run = kalman.run(record, pn, x0)
        filtered, _ = batch.correct(run.predicted, run.covariance)
        origin = samples[:-steps]
        x = filtered[origin]
        for row in range(steps * record.rows_per_sample):
            x = batch.move(x, origin + row)
        states[steps:] = x
    return batch.outputs(states, samples)[0]
