"""Noise from repetition: periods of a periodic input, or several records with the same input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from greybox.base.numerics import FEWEST_SIEVED, NUMBERS_AT_A_TIME, PERIOD_CLOSURE, ROWS_AT_A_TIME, SIEVE_ROWS
from greybox.data.experiment import Experiment, stack_signals
from greybox.data.noise.policy import NOISE_POLICY, NoisePolicy
from greybox.data.sampling import find_time_gaps


def find_period(inputs: np.ndarray, policy: NoisePolicy = NOISE_POLICY) -> int | None:
    """The period in rows of ``inputs`` (N, nu), if they repeat to the last digits for two periods or more."""
    rows = len(inputs)
    span = np.ptp(inputs, axis=0) if rows else np.zeros(0)
    moving = inputs[:, span > 0] / span[span > 0]
    if not moving.size:
        return None
    if 2 * rows > NUMBERS_AT_A_TIME:
        return _find_long_period(moving, policy)
    # sum over t of (u[t + lag] - u[t])^2 for all lags at once
    product = np.zeros(max(0, rows // 2 + 1 - policy.min_period_rows))
    for column in moving.T:  # one after another, and nothing kept of them: a long record is in memory a few times only
        product += _correlate_with_itself(column)[policy.min_period_rows : rows // 2 + 1]
    power = np.concatenate([[0.0], np.cumsum((moving**2).sum(axis=1))])
    lags = np.arange(policy.min_period_rows, rows // 2 + 1)
    difference = power[rows - lags] + power[rows] - power[lags] - 2 * product
    for lag in lags[difference < PERIOD_CLOSURE * power[rows]]:
        if np.abs(moving[lag:] - moving[:-lag]).max() <= policy.same_input:
            return int(lag)
    return None


def _find_long_period(moving: np.ndarray, policy: NoisePolicy) -> int | None:
    """The same without a Fourier transform of the whole record, which would take ten times its memory.

    A period repeats each value, first of all those at the largest steps: the lags are sieved by these rows, then by rows all over the
    record, and what is left is compared whole, from the shortest lag on.
    """
    rows, reach = len(moving), len(moving) // 2
    lags = np.arange(policy.min_period_rows, reach + 1, dtype=np.int32)
    for row in _choose_rows(moving[: rows - reach]):
        if len(lags) <= FEWEST_SIEVED:
            break
        left = np.ones(len(lags), bool)
        for column in moving.T:
            left &= np.abs(column[lags + row] - column[row]) <= policy.same_input
        lags = lags[left]
    return next((int(lag) for lag in lags if _repeats_after(moving, int(lag), policy)), None)


def _choose_rows(moving: np.ndarray) -> list[int]:
    """Rows by which lags are sieved: both sides of the largest steps of any column, and rows all over the record."""
    steps = np.zeros(max(len(moving) - 1, 0))
    for column in moving.T:
        np.maximum(steps, np.abs(np.diff(column)), out=steps)
    count = min(SIEVE_ROWS, len(steps))
    largest = np.argpartition(steps, -count)[-count:] if count else np.zeros(0, int)
    evenly = np.linspace(0, len(moving) - 1, SIEVE_ROWS).astype(int)
    return list(dict.fromkeys([*np.stack([largest, largest + 1], axis=1).ravel().tolist(), *evenly.tolist()]))


def _repeats_after(moving: np.ndarray, lag: int, policy: NoisePolicy) -> bool:
    """Whether every row of ``moving`` (N, n) is that of ``lag`` rows before."""
    starts = range(lag, len(moving), ROWS_AT_A_TIME)
    return all(
        np.abs(moving[k : k + ROWS_AT_A_TIME] - moving[k - lag : k - lag + len(moving[k : k + ROWS_AT_A_TIME])]).max()
        <= policy.same_input
        for k in starts
    )


def _correlate_with_itself(values: np.ndarray) -> np.ndarray:
    """Sum of the products of ``values`` (N,) with themselves, each lag (2 N,) later."""
    spectrum = np.fft.rfft(values, 2 * len(values))
    for first in range(0, len(spectrum), ROWS_AT_A_TIME):
        part = spectrum[first : first + ROWS_AT_A_TIME]
        part[:] = np.square(np.abs(part))
    return np.fft.irfft(spectrum, 2 * len(values))


def deviations_between_periods(
    experiment: Experiment, output: str, inputs: Sequence[str], policy: NoisePolicy = NOISE_POLICY
) -> list[np.ndarray]:
    """Each period of ``output`` minus the mean of all periods; empty where the input is not periodic.

    Of three periods or more the first is left out, and further ones as long as they are clearly louder than those that follow:
    they hold how the record began.
    """
    if not experiment.regular or output not in experiment.outputs:
        return []
    rows = find_period(stack_signals([experiment.inputs[n] for n in inputs], experiment.rows), policy)
    if rows is None:
        return []
    count = experiment.rows // rows
    folded = experiment.outputs[output][: count * rows].reshape(count, rows)
    folded = folded[1:] if count > 2 else folded
    while len(folded) > 2 and _is_louder(folded[0], folded[1:], policy):
        folded = folded[1:]
    return deviations_from_mean(list(folded), policy)


def deviations_between_repeats(
    experiments: Sequence[Experiment], output: str, inputs: Sequence[str], policy: NoisePolicy = NOISE_POLICY
) -> list[list[np.ndarray]]:
    """Deviations of ``output`` in each set of experiments that had the same inputs at the same times, and the same conditions."""
    left = [e for e in experiments if output in e.outputs]
    sets = []
    while left:
        first, *others = left
        alike = [e for e in others if _is_repeat(first, e, inputs, policy)]
        if alike:
            sets.append(deviations_from_mean([e.outputs[output] for e in (first, *alike)], policy))
        left = [e for e in others if not any(e is a for a in alike)]
    return [deviations for deviations in sets if deviations]


def deviations_from_mean(repeats: list[np.ndarray], policy: NoisePolicy = NOISE_POLICY) -> list[np.ndarray]:
    """Repeats (n,) each of the same signal minus their mean, enlarged so that their variance is that of the noise.

    ``(y - mean) sqrt(K / (K - 1))`` for K repeats. Each repeat's own mean is removed. Where the first half is clearly louder
    than the second, the repeats did not begin alike and only the second half is returned.
    """
    y = np.array(repeats, float)
    difference = y - y.mean(axis=0)
    finite = np.isfinite(difference)
    if len(y) < 2 or finite.sum() < policy.min_period_rows:
        return []
    half = difference.shape[1] // 2
    early, late = (
        np.nanvar(part) if np.isfinite(part).any() else np.nan for part in (difference[:, :half], difference[:, half:])
    )
    if early > policy.settled_ratio * late:
        difference = difference[:, half:]
    usable = [d for d in difference if np.isfinite(d).any()]
    return [(d - np.nanmean(d)) * np.sqrt(len(y) / (len(y) - 1)) for d in usable]


def _is_louder(first: np.ndarray, others: np.ndarray, policy: NoisePolicy) -> bool:
    """Whether ``first`` (n,) is farther from the mean of the ``others`` (m, n) than they are from it, chance allowed for."""
    count = len(others)
    mean = others.mean(axis=0)
    distance = np.nanmean((first - mean) ** 2) / (1 + 1 / count)
    return bool(distance > policy.settled_ratio * np.nanmean((others - mean) ** 2) * count / (count - 1))


def _is_repeat(one: Experiment, other: Experiment, inputs: Sequence[str], policy: NoisePolicy) -> bool:
    """Whether two experiments had the same conditions, the same times and the same inputs, one of which moves."""
    if dict(one.conditions) != dict(other.conditions):
        return False
    if one.rows != other.rows or not inputs or not np.allclose(one.intervals, other.intervals, rtol=1e-6, atol=0.0):
        return False
    pairs = [(one.inputs[n], other.inputs[n]) for n in inputs]
    moves = any(np.ptp(a) > 0 for a, _ in pairs)
    return moves and all(np.abs(a - b).max() <= policy.same_input * (np.ptp(a) or 1.0) for a, b in pairs)


# Noise from the flat pieces of a record: the input rests, the plant has settled, and what still moves is the sensor.


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
