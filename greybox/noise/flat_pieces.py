"""Noise from the flat pieces of a record: the input rests, the plant has settled, and what still moves is the sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from greybox.experiment import Experiment
from greybox.experiment.sampling import find_time_gaps
from greybox.noise.policy import NOISE_POLICY, NoisePolicy


@dataclass(frozen=True)
class FlatPieces:
    """Settled ends of the stretches in which the input rested.

    Parameters
    ----------
    pieces
        Readings (n,) of each, its mean removed.
    most
        Standard deviation that hardly any piece exceeds.
    std
        Standard deviation over all of them.
    agree
        Whether the pieces have one level.
    """

    pieces: tuple[np.ndarray, ...]
    most: float
    std: float
    agree: bool


def find_flat_pieces(
    experiments: Sequence[Experiment], output: str, inputs: Sequence[str], policy: NoisePolicy = NOISE_POLICY
) -> FlatPieces | None:
    """The flat pieces of an output; None where there are too few to show a level."""
    pieces = []
    for record in experiments:
        if output not in record.outputs or not inputs:
            continue
        for start, stop in _find_resting_stretches(record, inputs, policy):
            piece = _settled_end(record.outputs[output][start:stop], policy)
            if piece is not None:
                pieces.append(piece)
    columns = [e.outputs[output] for e in experiments if output in e.outputs]
    rounding = estimate_resolution(columns, policy) / np.sqrt(12)
    counts = np.array([len(piece) - 1 for piece in pieces], float)
    if counts.sum() < policy.flat_min_samples:
        return None
    levels = np.array([float(np.sqrt(piece @ piece / (len(piece) - 1))) for piece in pieces])
    # A sensor that shows one code at rest jumps between codes as soon as it moves: alone this says nothing.
    if levels.max() <= rounding:
        return None
    levels = np.maximum(levels, rounding)
    order = np.argsort(levels)
    below = np.cumsum(counts[order]) / counts.sum()
    low, high = (levels[order][np.searchsorted(below, q)] for q in policy.flat_quantiles)
    std = float(np.sqrt(levels**2 @ counts / counts.sum()))
    return FlatPieces(tuple(pieces), float(high), std, bool(high <= policy.flat_ratio * low))


def estimate_resolution(columns: Sequence[np.ndarray], policy: NoisePolicy = NOISE_POLICY) -> float:
    """The step of a sensor that shows codes; 0 where its readings are as good as continuous."""
    values = np.concatenate([c[np.isfinite(c)] for c in columns]) if columns else np.zeros(0)
    codes = np.unique(values)
    if len(codes) < 2 or len(codes) > policy.code_share * len(values):
        return 0.0
    steps = np.diff(codes)
    return float(np.quantile(steps, policy.code_step))


def _find_resting_stretches(record: Experiment, inputs: Sequence[str], policy: NoisePolicy) -> list[tuple[int, int]]:
    """First and last row (exclusive) of the stretches in which no input moves and no row is missing."""
    moves = np.zeros(record.rows - 1, bool)
    for name in inputs:
        values = record.inputs[name]
        moves |= ~(np.abs(np.diff(values)) <= policy.same_input * np.ptp(values))
    moves[find_time_gaps(record.time)] = True
    edges = np.concatenate([[0], np.flatnonzero(moves) + 1, [record.rows]])
    return [(int(a), int(b)) for a, b in pairwise(edges) if b - a >= 2 * policy.flat_min_rows]


def _settled_end(values: np.ndarray, policy: NoisePolicy) -> np.ndarray | None:
    """The second half of a stretch less its mean, if its level stands still there; None where it still moves."""
    end = values[len(values) // 2 :]
    end = end[np.isfinite(end)]
    if len(end) < policy.flat_min_rows:
        return None
    end = end - end.mean()
    time = np.linspace(-1.0, 1.0, len(end))
    slope = float(time @ end / (time @ time))
    rest = end - slope * time
    drift = slope**2 * float(time @ time)
    if drift > policy.flat_drift * float(rest @ rest):
        return None
    return end
