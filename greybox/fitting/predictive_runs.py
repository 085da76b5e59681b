"""Runs of a filtered model over its records: freely, and one step ahead."""

from __future__ import annotations

import numpy as np

from greybox.filtering import predicted_outputs
from greybox.filtering.passage import Passage
from greybox.fitting.predictive_cost import PredictionError

Runs = tuple[tuple[np.ndarray, np.ndarray], ...]


def free_runs(cost: PredictionError) -> Runs:
    """For each record outputs (N, ny) and states (N, nx) without any correction, at ``z = 0``."""
    result = []
    for e, record in enumerate(cost.records):
        pn, x0 = at(cost, e)
        states = cost.kalman.free_run(record, pn, x0)
        y, _ = Passage(cost.kalman, record, pn).outputs(states, np.arange(len(states)))
        result.append((y, states))
    return tuple(result)


def one_step_runs(cost: PredictionError) -> Runs:
    """For each record outputs (N, ny) and states (N, nx) given the measurements before each row, at ``z = 0``."""
    result = []
    for e, record in enumerate(cost.records):
        pn, x0 = at(cost, e)
        states = cost.kalman.run(record, pn, x0).predicted
        y, _ = Passage(cost.kalman, record, pn).outputs(states, np.arange(len(states)))
        result.append((y, states))
    return tuple(result)


def ahead(cost: PredictionError, steps: int) -> list[np.ndarray]:
    """Outputs (samples, ny) of each record given the measurements up to ``steps`` samples before, at ``z = 0``."""
    return [predicted_outputs(cost.kalman, r, *at(cost, e), steps) for e, r in enumerate(cost.records)]


def at(cost: PredictionError, experiment: int) -> tuple[np.ndarray, np.ndarray]:
    """``[p; noise]`` (np + ny,) and first states (nx,) of an experiment at ``z = 0``."""
    z = np.zeros(cost.unknowns.size)
    pn = cost.unknowns.parameters(z, experiment)
    return pn, cost.unknowns.beginning(z, pn, experiment)[0]
