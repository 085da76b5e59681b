"""Runs of a filtered model over its records: freely, and one step ahead."""

from __future__ import annotations

import numpy as np

from greybox.estimation.prediction_error import PredictionErrorObjective
from greybox.filtering import predict_outputs
from greybox.filtering.batch_filter import BatchFilter

Runs = tuple[tuple[np.ndarray, np.ndarray], ...]


def compute_free_runs(cost: PredictionErrorObjective) -> Runs:
    """For each record outputs (N, ny) and states (N, nx) without any correction, at ``z = 0``."""
    result = []
    for e, record in enumerate(cost.records):
        pn, x0 = evaluate_start(cost, e)
        states = cost.kalman.free_run(record, pn, x0)
        y, _ = BatchFilter(cost.kalman, record, pn).outputs(states, np.arange(len(states)))
        result.append((y, states))
    return tuple(result)


def compute_one_step_runs(cost: PredictionErrorObjective) -> Runs:
    """For each record outputs (N, ny) and states (N, nx) given the measurements before each row, at ``z = 0``."""
    result = []
    for e, record in enumerate(cost.records):
        pn, x0 = evaluate_start(cost, e)
        states = cost.kalman.run(record, pn, x0).predicted
        y, _ = BatchFilter(cost.kalman, record, pn).outputs(states, np.arange(len(states)))
        result.append((y, states))
    return tuple(result)


def predict_ahead(cost: PredictionErrorObjective, steps: int) -> list[np.ndarray]:
    """Outputs (samples, ny) of each record given the measurements up to ``steps`` samples before, at ``z = 0``."""
    return [predict_outputs(cost.kalman, r, *evaluate_start(cost, e), steps) for e, r in enumerate(cost.records)]


def evaluate_start(cost: PredictionErrorObjective, experiment: int) -> tuple[np.ndarray, np.ndarray]:
    """``[p; noise]`` (np + ny,) and first states (nx,) of an experiment at ``z = 0``."""
    z = np.zeros(cost.unknowns.size)
    pn = cost.unknowns.parameters(z, experiment)
    return pn, cost.unknowns.compute_initial_state(z, pn, experiment)[0]
