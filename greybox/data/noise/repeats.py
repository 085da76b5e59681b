"""Noise from repetition: periods of a periodic input, or several records with the same input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from greybox.base.numerics import FEWEST_SIEVED, NUMBERS_AT_A_TIME, PERIOD_CLOSURE, ROWS_AT_A_TIME, SIEVE_ROWS
from greybox.data.experiment import Experiment, stack_signals
from greybox.data.noise.noise_model import fit_autoregression, join_series
from greybox.data.sampling import find_time_gaps
from greybox.data.sensor_faults import compute_rounding_std

# Two inputs are the same where they differ by less than this share of their range.
SAME_INPUT = 1e-06
# Fewest rows of a period, and fewest values of repeats, from which noise is estimated.
MIN_PERIOD_ROWS = 20


def find_repetition(inputs: np.ndarray) -> int | None:
    """The period in rows of ``inputs`` (N, nu), if they repeat to the last digits for two periods or more."""
    rows = len(inputs)
    span = np.ptp(inputs, axis=0) if rows else np.zeros(0)
    moving = inputs[:, span > 0] / span[span > 0]
    if not moving.size:
        return None
    if 2 * rows > NUMBERS_AT_A_TIME:
        return _find_long_period(moving)
    # sum over t of (u[t + lag] - u[t])^2 for all lags at once
    product = np.zeros(max(0, rows // 2 + 1 - MIN_PERIOD_ROWS))
    for column in moving.T:  # one after another, and nothing kept of them: a long record is in memory a few times only
        product += _correlate_with_itself(column)[MIN_PERIOD_ROWS : rows // 2 + 1]
    power = np.concatenate([[0.0], np.cumsum((moving**2).sum(axis=1))])
    lags = np.arange(MIN_PERIOD_ROWS, rows // 2 + 1)
    difference = power[rows - lags] + power[rows] - power[lags] - 2 * product
    for lag in lags[difference < PERIOD_CLOSURE * power[rows]]:
        if np.abs(moving[lag:] - moving[:-lag]).max() <= SAME_INPUT:
            return int(lag)
    return None


def _find_long_period(moving: np.ndarray) -> int | None:
    """The same without a Fourier transform of the whole record, which would take ten times its memory.

    A period repeats each value, first of all those at the largest steps: the lags are sieved by these rows, then by rows all over the
    record, and what is left is compared whole, from the shortest lag on.
    """
    rows, reach = len(moving), len(moving) // 2
    lags = np.arange(MIN_PERIOD_ROWS, reach + 1, dtype=np.int32)
    for row in _choose_rows(moving[: rows - reach]):
        if len(lags) <= FEWEST_SIEVED:
            break
        left = np.ones(len(lags), bool)
        for column in moving.T:
            left &= np.abs(column[lags + row] - column[row]) <= SAME_INPUT
        lags = lags[left]
    return next((int(lag) for lag in lags if _repeats_after(moving, int(lag))), None)


def _choose_rows(moving: np.ndarray) -> list[int]:
    """Rows by which lags are sieved: both sides of the largest steps of any column, and rows all over the record."""
    steps = np.zeros(max(len(moving) - 1, 0))
    for column in moving.T:
        np.maximum(steps, np.abs(np.diff(column)), out=steps)
    count = min(SIEVE_ROWS, len(steps))
    largest = np.argpartition(steps, -count)[-count:] if count else np.zeros(0, int)
    evenly = np.linspace(0, len(moving) - 1, SIEVE_ROWS).astype(int)
    return list(dict.fromkeys([*np.stack([largest, largest + 1], axis=1).ravel().tolist(), *evenly.tolist()]))


def _repeats_after(moving: np.ndarray, lag: int) -> bool:
    """Whether every row of ``moving`` (N, n) is that of ``lag`` rows before."""
    starts = range(lag, len(moving), ROWS_AT_A_TIME)
    return all(
        np.abs(moving[k : k + ROWS_AT_A_TIME] - moving[k - lag : k - lag + len(moving[k : k + ROWS_AT_A_TIME])]).max()
        <= SAME_INPUT
        for k in starts
    )


def _correlate_with_itself(values: np.ndarray) -> np.ndarray:
    """Sum of the products of ``values`` (N,) with themselves, each lag (2 N,) later."""
    # Wiener and Khinchin; as many zeros behind the values as there are, so that no lag wraps around.
    spectrum = np.fft.rfft(values, 2 * len(values))
    for first in range(0, len(spectrum), ROWS_AT_A_TIME):
        part = spectrum[first : first + ROWS_AT_A_TIME]
        part[:] = np.square(np.abs(part))
    return np.fft.irfft(spectrum, 2 * len(values))


def deviations_between_periods(experiment: Experiment, output: str, inputs: Sequence[str]) -> list[np.ndarray]:
    """Each period of ``output`` minus the mean of all periods; empty where the input is not periodic.

    Of three periods or more the first is left out, and further ones as long as they are clearly louder than those that follow:
    they hold how the record began.
    """
    if not experiment.regular or output not in experiment.outputs:
        return []
    rows = find_repetition(stack_signals([experiment.inputs[n] for n in inputs], experiment.rows))
    if rows is None:
        return []
    count = experiment.rows // rows
    folded: np.ndarray = experiment.outputs[output][: count * rows].reshape(count, rows)
    folded = folded[1:] if count > 2 else folded
    while len(folded) > 2 and _is_louder(folded[0], folded[1:]):
        folded = folded[1:]
    return deviations_from_mean(list(folded))


def deviations_between_repeats(
    experiments: Sequence[Experiment], output: str, inputs: Sequence[str]
) -> list[list[np.ndarray]]:
    """Deviations of ``output`` in each set of experiments that had the same inputs at the same times, and the same conditions."""
    left = [e for e in experiments if output in e.outputs]
    sets = []
    while left:
        first, *others = left
        alike = [e for e in others if _is_repeat(first, e, inputs)]
        if alike:
            sets.append(deviations_from_mean([e.outputs[output] for e in (first, *alike)]))
        left = [e for e in others if not any(e is a for a in alike)]
    return [deviations for deviations in sets if deviations]


# Ratio of early to late variance from which a repeat still shows how its record began.
SETTLED_RATIO = 1.5


# The same within what is left: fewer rows, whose noise may remember itself.
DYING_RATIO = 3.0


def _dies_away(difference: np.ndarray, ratio: float = SETTLED_RATIO) -> bool:
    """Whether the first half of ``difference`` (K, n) has so many times the variance of the second."""
    half = difference.shape[1] // 2
    parts = difference[:, :half], difference[:, half:]
    early, late = (np.nanvar(part) if np.isfinite(part).any() else np.nan for part in parts)
    return bool(early > ratio * late)


def deviations_from_mean(repeats: list[np.ndarray]) -> list[np.ndarray]:
    """Repeats (n,) each of the same signal minus their mean, enlarged so that their variance is that of the noise.

    ``(y - mean) sqrt(K / (K - 1))`` for K repeats. Each repeat's own mean is removed. Where the first half is clearly louder
    than the second, the repeats did not begin alike and only the second half is returned; nothing where what they began with is still
    dying away there.
    """
    y = np.array(repeats, float)
    difference = y - y.mean(axis=0)
    finite = np.isfinite(difference)
    if len(y) < 2 or finite.sum() < MIN_PERIOD_ROWS:
        return []
    if _dies_away(difference):
        difference = difference[:, difference.shape[1] // 2 :]
        if _dies_away(difference, DYING_RATIO):
            return []
    usable = [d for d in difference if np.isfinite(d).any()]
    # A mean of n periods holds a share of each: a deviation from it has (n - 1) / n of the variance.
    return [(d - np.nanmean(d)) * np.sqrt(len(y) / (len(y) - 1)) for d in usable]


def _is_louder(first: np.ndarray, others: np.ndarray) -> bool:
    """Whether ``first`` (n,) is farther from the mean of the ``others`` (m, n) than they are from it, chance allowed for."""
    count = len(others)
    mean = others.mean(axis=0)
    # A mean of n has 1 / n of the variance: first - mean has 1 + 1 / n of it, others - mean (n - 1) / n.
    distance = np.nanmean((first - mean) ** 2) / (1 + 1 / count)
    return bool(distance > SETTLED_RATIO * np.nanmean((others - mean) ** 2) * count / (count - 1))


def _is_repeat(one: Experiment, other: Experiment, inputs: Sequence[str]) -> bool:
    """Whether two experiments had the same conditions, the same times and the same inputs, one of which moves."""
    if dict(one.conditions) != dict(other.conditions):
        return False
    if one.rows != other.rows or not inputs or not np.allclose(one.intervals, other.intervals, rtol=1e-6, atol=0.0):
        return False
    pairs = [(one.inputs[n], other.inputs[n]) for n in inputs]
    moves = any(np.ptp(a) > 0 for a, _ in pairs)
    return moves and all(np.abs(a - b).max() <= SAME_INPUT * (np.ptp(a) or 1.0) for a, b in pairs)


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


# Fewest rows of all such ends together.
FLAT_MIN_SAMPLES = 60
# Shares of the rows below which the quietest and the loudest pieces lie.
FLAT_QUANTILES: tuple[float, float] = (0.1, 0.9)
# Ratio of their levels up to which all pieces have one level; beyond it the noise depends on what the sensor shows.
FLAT_RATIO = 3.0


def find_flat_pieces(experiments: Sequence[Experiment], output: str, inputs: Sequence[str]) -> FlatPieces | None:
    """The flat pieces of an output; None where there are too few to show a level."""
    pieces = []
    for record in experiments:
        if output not in record.outputs or not inputs:
            continue
        for start, stop in _find_resting_stretches(record, inputs):
            piece = _settled_end(record.outputs[output][start:stop])
            if piece is not None:
                pieces.append(piece)
    columns = [e.outputs[output] for e in experiments if output in e.outputs]
    rounding = compute_rounding_std(estimate_resolution(columns))
    pieces = _leave_out_moving(pieces, rounding)
    counts = np.array([len(piece) - 1 for piece in pieces], float)
    if counts.sum() < FLAT_MIN_SAMPLES:
        return None
    # s^2 = sum e^2 / (n - 1): the mean of each piece was taken off.
    levels = np.array([float(np.sqrt(piece @ piece / (len(piece) - 1))) for piece in pieces])
    # A sensor that shows one code at rest jumps between codes as soon as it moves: alone this says nothing.
    if levels.max() <= rounding:
        return None
    levels = np.maximum(levels, rounding)
    order = np.argsort(levels)
    below = np.cumsum(counts[order]) / counts.sum()
    low, high = (levels[order][np.searchsorted(below, q)] for q in FLAT_QUANTILES)
    # Pooled by degrees of freedom.
    std = float(np.sqrt(levels**2 @ counts / counts.sum()))
    return FlatPieces(tuple(pieces), float(high), std, bool(high <= FLAT_RATIO * low))


# How seldom the loudest of pieces of one level is as much louder than the others...
LOUD_CHANCE = 1e-4
# ...and share of all rows that pieces which had not settled may hold: where more are loud, noise depends on what the sensor shows.
MOST_MOVING = 0.25
# Samples that noise may remember: beyond, a piece is loud by itself, and no autoregression of so few pieces says how seldom.
QUIET_MEMORY = 3.0


def _leave_out_moving(pieces: Sequence[np.ndarray], rounding: float) -> list[np.ndarray]:
    """The pieces without the few that are louder than all others by more than chance: there the plant still swung or crept.

    Where most show one code of the sensor, the quiet ones show no noise, and so none that is louder.
    """
    from scipy.stats import f as variance_ratio

    kept = list(pieces)
    if np.median([piece.std() for piece in kept] or [0.0]) <= rounding:
        return kept
    most = MOST_MOVING * sum(map(len, kept))
    while len(kept) > 2:
        loudest = max(kept, key=lambda piece: float(piece @ piece) / (len(piece) - 1))
        others = [piece for piece in kept if piece is not loudest]
        freedom, rest = len(loudest) - 1, sum(len(piece) - 1 for piece in others)
        square = sum(float(piece @ piece) for piece in others) / rest
        noise = fit_autoregression(join_series(others))
        if len(loudest) > most or noise.memory > QUIET_MEMORY or not square > 0:
            break
        # The mean square of n samples with correlations rho_k varies as that of n / (1 + 2 sum rho_k^2) independent ones (Bartlett 1935).
        colour = 1 + 2 * float((noise.autocorrelation(len(loudest))[1:] ** 2).sum())
        limit = variance_ratio.isf(LOUD_CHANCE / len(kept), freedom / colour, rest / colour)
        if not float(loudest @ loudest) / freedom > limit * square:
            break
        most -= len(loudest)
        kept = others
    return kept


# Different readings over all readings up to which a sensor shows codes.
CODE_SHARE = 0.5
# Share of them that are read more than once: a code held at rest says nothing of those that a motion runs past.
REPEATED_CODES = 0.05
# Share of the distances between neighbouring readings that are shorter than one step of the sensor: averaged or filtered codes.
CODE_STEP = 0.1


def estimate_resolution(columns: Sequence[np.ndarray]) -> float:
    """The step of a sensor that shows codes; 0 where its readings are as good as continuous."""
    values = np.concatenate([c[np.isfinite(c)] for c in columns]) if columns else np.zeros(0)
    codes, readings = np.unique(values, return_counts=True)
    if len(codes) < 2 or len(codes) > CODE_SHARE * len(values) or np.mean(readings > 1) < REPEATED_CODES:
        return 0.0
    steps = np.diff(codes)
    return float(np.quantile(steps, CODE_STEP))


# Fewest points of a grid at which readings must lie to show it: those about one round number lie near that point of any coarser grid.
FEWEST_ON_GRID = 20
# Share of its step by which a reading may lie off the grid: the arithmetic of long numbers.
OFF_GRID = 0.01


# Most significant digits that are told from the digits a number has in memory.
MOST_DIGITS = 12


def estimate_written_step(columns: Sequence[np.ndarray]) -> float:
    """The last digit with which readings were written, or the codes of a sensor, where all lie on one grid; 0 where they do not.

    Of readings that were written with so many significant digits it is the root mean square of each one's last digit.
    """
    values = np.concatenate([c[np.isfinite(c)] for c in columns]) if columns else np.zeros(0)
    different = np.unique(values)
    steps = np.diff(different)
    # One reading computed in two ways differs in its last bits.
    steps = steps[steps > 4 * np.spacing(np.abs(values).max(initial=0.0))]
    if len(steps) < FEWEST_ON_GRID:
        return 0.0
    # The step as the mean over all of them: one distance alone has the rounding of how two readings were printed.
    step = steps.sum() / np.round(steps / steps.min()).sum()
    if _is_whole(steps / step):
        return float(step)
    written = different[np.abs(different) > np.finfo(float).tiny]  # below it a number loses its digits
    leading = np.floor(np.log10(np.abs(written)))
    for digits in range(1, MOST_DIGITS + 1):
        last = 10.0 ** (leading - digits + 1)
        points = np.unique(np.round(written / last) * last)
        if len(points) >= FEWEST_ON_GRID and _is_whole(written / last):
            return float(np.sqrt(np.mean(last**2)))
    return 0.0


def _is_whole(in_steps: np.ndarray) -> bool:
    """Whether all numbers are whole ones."""
    return bool(np.abs(in_steps - np.round(in_steps)).max() <= OFF_GRID)


# Fewest rows of the settled end of a stretch with the input at rest.
FLAT_MIN_ROWS = 10


def _find_resting_stretches(record: Experiment, inputs: Sequence[str]) -> list[tuple[int, int]]:
    """First and last row (exclusive) of the stretches in which no input moves and no row is missing."""
    moves = np.zeros(record.rows - 1, bool)
    for name in inputs:
        values = record.inputs[name]
        moves |= ~(np.abs(np.diff(values)) <= SAME_INPUT * np.ptp(values))
    moves[find_time_gaps(record.time)] = True
    edges = np.concatenate([[0], np.flatnonzero(moves) + 1, [record.rows]])
    return [(int(a), int(b)) for a, b in pairwise(edges) if b - a >= 2 * FLAT_MIN_ROWS]


# Energy of a straight line over that of the rest above which an end is still moving: noise that remembers ten samples seldom reaches it.
FLAT_DRIFT = 0.3


def _settled_end(values: np.ndarray) -> np.ndarray | None:
    """The second half of a stretch less its mean, if its level stands still there; None where it still moves."""
    end = values[len(values) // 2 :]
    end = end[np.isfinite(end)]
    if len(end) < FLAT_MIN_ROWS:
        return None
    end = end - end.mean()
    time = np.linspace(-1.0, 1.0, len(end))
    # Least squares on a line through the middle, and the sum of squares that it explains.
    slope = float(time @ end / (time @ time))
    rest = end - slope * time
    drift = slope**2 * float(time @ time)
    if drift > FLAT_DRIFT * float(rest @ rest):
        return None
    return end
