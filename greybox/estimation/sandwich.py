"""The middle of the sandwich: covariance of the scores ``J'r`` when the residual is correlated from sample to sample.

With the residual of each output a stationary autoregression with covariance ``R``, the scores have covariance ``J' R J``. A kernel
estimate (Newey and West, Econometrica 55, 1987) from the scores themselves, which also sees a residual that is larger where the
sensitivities are, widens the result where it is larger. The autoregression leads because a kernel estimate falls short by a tenth or more
on strongly correlated noise, however its bandwidth is chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Protocol

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import matmul_toeplitz, toeplitz

from greybox.base import NUMBERS_AT_A_TIME, ROWS_AT_A_TIME, TINY
from greybox.data.noise.noise_model import AutoRegression, NoisePolicy, fit_autoregression, join_series
from greybox.estimation.options import DEFAULT_POLICY

# Readings of an output beside others from which its residual tells its noise. Fewer can be followed exactly by constants that the others
# hardly need: weighed by their residual they would count ever more, and their noise would end at zero.
LEAST_LEVEL_READINGS = 8


@dataclass(frozen=True)
class ResidualColour:
    """Autoregression and variance of the weighted residual of each output, and its samples (ny,)."""

    models: tuple[AutoRegression, ...]
    variance: tuple[float, ...] = ()
    counts: tuple[int, ...] = ()
    unknowns: int = 0

    @property
    def coloured(self) -> bool:
        """Whether any output's residual is not white."""
        return any(m.order for m in self.models)

    @cached_property
    def times(self) -> list[tuple[float, float]]:
        """For each output the sums of its autocorrelation, and of its square, over positive and negative lags."""
        result = []
        for model, count in zip(self.models, self.counts, strict=True):
            # sum |rho_k| and sum rho_k^2 over both signs of k: the correlation time, and Bartlett's for the variance
            # of a variance.
            rho = compute_correlations(model, max(count, 1))
            result.append((float(2 * np.abs(rho).sum() - 1), float(2 * (rho @ rho) - 1)))
        return result

    def share_variance(self, groups: Sequence[Sequence[int]]) -> ResidualColour:
        """The same with one variance for the outputs of each group, whose noise is one.

        Beside others a handful of readings says nothing of their noise: it counts as what they are weighed with, at least.
        """
        variance = [
            max(v, 1.0) if len(self.counts) > 1 and 0 < n < LEAST_LEVEL_READINGS else v
            for v, n in zip(self.variance, self.counts, strict=True)
        ]
        for outputs in groups:
            samples = sum(self.counts[j] for j in outputs)
            shared = sum(self.variance[j] * self.counts[j] for j in outputs) / max(samples, 1)
            for j in outputs:
                variance[j] = shared
        return replace(self, variance=tuple(variance))

    @property
    def degrees(self) -> float:
        """Of freedom of a variance at the frequency where the residual is loudest, which slow constants rest on."""
        return max(sum(_count_degrees(m, n) for m, n in zip(self.models, self.counts, strict=True)), 1.0)


# Frequencies at which the spectrum of a residual is looked at, from 0 to half the sampling rate.
SPECTRUM_POINTS = 257


def _count_degrees(process: AutoRegression, count: int) -> float:
    """Degrees of freedom of the largest value of the spectrum of ``process`` that ``count`` samples have told."""
    # S(w) = E |A|^-2 with A = 1 - sum a_k e^-iwk; the a_k have the covariance E G^-1 / n, G_jk = rho_|j-k|, and the variance E that of n
    # squares: var log S = 2 / n + d' E G^-1 d / n, d = d log S / d a_k = 2 Re(e^-iwk / A) (Akaike 1969).
    lags, rho = np.arange(1, process.order + 1), process.autocorrelation(max(process.order, 1))
    waves = np.exp(-1j * np.outer(np.linspace(0, np.pi, SPECTRUM_POINTS), lags))
    whitener = 1 - waves @ process.coefficients
    loudest = int(np.argmin(np.abs(whitener)))
    slope = 2 * (waves[loudest] / whitener[loudest]).real
    variance = slope @ np.linalg.pinv(toeplitz(rho)) @ slope * process.innovation_variance if process.order else 0.0
    return count / (1 + variance / 2)


# A residual of fewer samples shows no colour that could be told from chance: it counts as white.
LEAST_SAMPLES = 50


def estimate_residual_colour(
    rows: Sequence[tuple[np.ndarray, np.ndarray]],
    unknowns: int,
    noise_given: bool,
    variance_floor: np.ndarray | None = None,
    noise_policy: NoisePolicy = DEFAULT_POLICY.noise,
) -> ResidualColour:
    """Autoregression of each output's weighted residual over all records, and its variance.

    If the noise is given that is at least one, or the ``variance_floor`` (ny,) that a robust loss leaves of it. ``noise_policy``: how the
    autoregression is chosen.
    """
    outputs = rows[0][0].shape[1]
    total = sum(int(np.isfinite(r).sum()) for r, _ in rows)
    models, variances, counts = [], [], []
    for j in range(outputs):
        series = join_series([r[:, j] for r, _ in rows])
        count = int(np.isfinite(series).sum())
        squares = np.square(series)
        squares[np.isnan(squares)] = 0.0  # in its place: a long record is in memory a few times only
        # Unknowns are shared by the outputs in the proportion of their samples.
        square = float(squares.sum()) / max(count, 1) * total / max(total - unknowns, 1)
        del squares
        variances.append(
            max(square, 1.0 if variance_floor is None else float(variance_floor[j])) if noise_given else square
        )
        counts.append(count)
        is_enough = count >= LEAST_SAMPLES
        # One colour for all records of an output: the sensor and the model are the same in each.
        models.append(
            fit_autoregression(series, overwrite_input=True, policy=noise_policy) if is_enough else AutoRegression()
        )
    return ResidualColour(tuple(models), tuple(variances), tuple(counts), unknowns)


class ColumnLayout(Protocol):
    """Where the Jacobian's columns of each record belong among all unknowns (a `DecisionVector`)."""

    @property
    def size(self) -> int:
        """Number of unknowns."""

    def columns(self, experiment: int) -> np.ndarray:
        """Which unknowns one experiment concerns."""


@dataclass(frozen=True, eq=False)
class ScoreSums:
    """Sums over residuals ``r`` with their slopes ``J``.

    ``score`` (size,) ``J'r``; ``information`` (size, size) ``J'J``; ``white`` (size, size) the covariance of the score if the residual is
    white, and ``coloured`` if it is the stationary process that its colour says.
    """

    score: np.ndarray
    information: np.ndarray
    white: np.ndarray
    coloured: np.ndarray


def sum_scores(
    variables: ColumnLayout,
    rows: Sequence[tuple[np.ndarray, np.ndarray]],
    colour: ResidualColour,
    experiments: Sequence[int] = (),
) -> ScoreSums:
    """Score, information and covariance of the score of weighted residuals with this ``colour``.

    ``experiments``: which one each of ``rows`` is, in their order if left out.
    """
    score, (information, white, coloured) = np.zeros(variables.size), np.zeros((3, variables.size, variables.size))
    for e, (r, jacobian) in zip(experiments or range(len(rows)), rows, strict=True):
        block = np.ix_(variables.columns(e), variables.columns(e))
        for j, process in enumerate(colour.models):
            squares = np.zeros_like(information[block])
            for part in _split_rows(len(r)):
                columns = _take_slopes(r, jacobian, j, part)
                score[block[1][0]] += np.where(np.isfinite(r[part, j]), r[part, j], 0.0) @ columns
                squares += columns.T @ columns
            information[block] += squares
            white[block] += colour.variance[j] * squares
            if process.order:
                take = partial(_take_slopes, r, jacobian, j)
                squares = _compute_form(take, len(r), compute_correlations(process, len(r)))
            coloured[block] += colour.variance[j] * squares
    return ScoreSums(score, information, white, coloured)


# Share of the noise that the unknowns take from which it is given back: less is a hundredth of a standard deviation.
LEAST_TAKEN = 0.02
# Share up to which it can be: beyond, the residual shows another process than the noise. Of two coast-downs whose model lacks a part the
# unknowns have taken 0.42 and 0.46, and given back it would hide a change of a hundred per cent.
MOST_TAKEN = 0.4
# Searches for the noise at most: what is left of its bias falls by more than half in each.
ROUNDS_GIVEN_BACK = 6
# Correlation with the row before, up to which a record tells a stationary process.
LARGEST_REFLECTION = 0.999


def give_back(
    variables: ColumnLayout,
    rows: Sequence[tuple[np.ndarray, np.ndarray]],
    colour: ResidualColour,
    sums: ScoreSums,
    inverse: np.ndarray,
) -> ResidualColour:
    """Colour and variance of the noise behind residuals of this ``colour``, whose slow parts the unknowns have followed.

    Of noise ``e`` with covariance ``C`` a fit leaves ``r = e - J A^-1 J'e``, whose covariance is
    ``C - J A^-1 J'C - C J A^-1 J' + J A^-1 B A^-1 J'`` with ``B = J'C J``: looked for is the noise whose residual has the size and the
    colour that are seen. ``sums`` are those of ``colour``, ``inverse`` (size, size) is ``A^-1``. A record too long for its unknowns to
    matter is left as it is.
    """
    if sum(len(r) for r, _ in rows) > ROWS_AT_A_TIME:
        return colour
    seen, least = [m.autocorrelation(m.order + 1) for m in colour.models], colour.variance
    squares = [sum(float(np.nansum(r[:, j] ** 2)) for r, _ in rows) for j in range(len(seen))]
    rho, form = list(seen), sums.coloured
    for _ in range(ROUNDS_GIVEN_BACK):
        share = np.sum(inverse * form) / max(np.dot(colour.variance, colour.counts), TINY)
        if not LEAST_TAKEN < share < MOST_TAKEN:
            break
        models, variance, middle = list(colour.models), list(colour.variance), inverse @ form @ inverse
        for j, process in enumerate(colour.models):
            left, pairs = np.zeros((2, process.order + 1))
            for e, (r, jacobian) in enumerate(rows):
                block, measured = np.ix_(variables.columns(e), variables.columns(e)), np.isfinite(r[:, j])
                slopes, correlations = _take_slopes(r, jacobian, j, slice(None)), process.autocorrelation(len(r))
                driven = variance[j] * matmul_toeplitz(correlations, slopes) * measured[:, None]
                taken, followed = slopes @ inverse[block], slopes @ middle[block]
                for k in range(process.order + 1):
                    early, late = slice(0, len(r) - k), slice(k, len(r))
                    count = np.count_nonzero(measured[early] & measured[late])
                    # Sums over rows and columns, without a copy of either.
                    lost = np.vdot(taken[early], driven[late]) + np.vdot(driven[early], taken[late])
                    pairs[k] += count
                    left[k] += variance[j] * correlations[k] * count - lost + np.vdot(followed[early], slopes[late])
            if not squares[j] or left[0] <= 0:
                continue
            rho[j] = rho[j] + seen[j] - left / np.maximum(pairs, 1) * pairs[0] / left[0]
            variance[j] = max(variance[j] * squares[j] / left[0], least[j])
            models[j] = _to_autoregression(rho[j])
        growth = np.divide(variance, np.maximum(colour.variance, TINY))
        colour = replace(colour, models=tuple(models), variance=tuple(variance))
        # What a further search would change is a hundredth of a standard deviation.
        if np.abs(growth - 1).max() < LEAST_TAKEN:
            break
        form = sum_scores(variables, rows, colour).coloured
    return colour


def _to_autoregression(rho: np.ndarray) -> AutoRegression:
    """The process with the autocorrelation ``rho`` (p + 1,) at its first lags."""
    # Yule and Walker: the last coefficient of each order is its reflection coefficient.
    reflection = [float((np.linalg.pinv(toeplitz(rho[:k])) @ rho[1 : k + 1])[-1]) for k in range(1, len(rho))]
    return AutoRegression(tuple(np.clip(reflection, -LARGEST_REFLECTION, LARGEST_REFLECTION).tolist()))


# The kernel estimate of the scores' covariance looks so many correlation times back.
INTERVAL_CORRELATION_TIMES = 5.0
# It looks back over this share of a record at most.
RECORD_SHARE = 0.125


def estimate_kernel_score_covariance(
    variables: ColumnLayout,
    rows: Sequence[tuple[np.ndarray, np.ndarray]],
    colour: ResidualColour,
    projector: np.ndarray,
) -> np.ndarray:
    """Covariance (n, n) of the projected scores after Newey and West, with Bartlett's weights.

    ``projector`` (n, size) takes scores to those of the parameters with the initial states estimated as well.
    """
    total = np.zeros((len(projector), len(projector)))
    reach = max((time for time, _ in colour.times), default=1.0) * INTERVAL_CORRELATION_TIMES
    for e, (r, jacobian) in enumerate(rows):
        scores, lanes = np.empty((len(r), len(projector))), projector[:, variables.columns(e)].T
        for part in _split_rows(len(r)):
            measured = np.isfinite(r[part])
            slopes, residual = np.where(measured[:, :, None], jacobian[part], 0.0), np.where(measured, r[part], 0.0)
            # P J_t' r_t: what each row adds to the score.
            scores[part] = np.einsum("tjk,tj->tk", slopes, residual) @ lanes
        # A fixed share of the record at most: at lags near its length a product of few pairs would be taken for a
        # covariance.
        lags = int(min(max(reach, 1.0), max(RECORD_SHARE * len(r), 1.0)))
        # S = sum_k (1 - k / L) (G_k + G_k'): Bartlett's weights keep it positive semidefinite.
        total += compute_toeplitz_form(scores, 1 - np.arange(lags) / lags)
    return total


def _split_rows(count: int) -> Iterator[slice]:
    """Rows of a record that are looked at together: a long record is in memory a few times only."""
    return (slice(first, min(first + ROWS_AT_A_TIME, count)) for first in range(0, count, ROWS_AT_A_TIME))


def _take_slopes(r: np.ndarray, jacobian: np.ndarray, output: int, rows: slice) -> np.ndarray:
    """Slopes (n, L) of one output in some rows, zero where it was not measured."""
    columns, measured = np.ascontiguousarray(jacobian[rows, output]), np.isfinite(r[rows, output])
    return columns if measured.all() else np.where(measured[:, None], columns, 0.0)


def compute_correlations(process: AutoRegression, count: int) -> np.ndarray:
    """Autocorrelation over ``count`` rows; of a long record no further than it reaches, which is seldom far."""
    if _is_long(count):
        rho = process.autocorrelation(ROWS_AT_A_TIME)
        if (reach := _find_reach(rho)) < ROWS_AT_A_TIME // 2:
            return rho[: reach + 1]
    return process.autocorrelation(count)


def _is_long(count: int) -> bool:
    """Whether a Fourier transform of so many rows takes too much memory."""
    return 2 * count - 1 > NUMBERS_AT_A_TIME


class Columns(Protocol):
    """Columns X (N, L): an array, or what makes some of its rows when they are asked for."""

    def __len__(self) -> int: ...

    def __getitem__(self, rows: slice, /) -> np.ndarray: ...


def compute_toeplitz_form(columns: Columns, rho: np.ndarray) -> np.ndarray:
    """``X' T X`` (L, L) of ``columns`` X (N, L) with the symmetric Toeplitz matrix T whose first column is ``rho`` (up to N), then zero."""
    return _compute_form(columns.__getitem__, len(columns), rho)


def _compute_form(take: Callable[[slice], np.ndarray], n: int, rho: np.ndarray) -> np.ndarray:
    """The same of ``n`` rows of columns, of which ``take`` gives some."""
    width = take(slice(0, 0)).shape[1]
    if _is_long(n) or n * width > NUMBERS_AT_A_TIME:
        return _compute_long_form(take, n, width, rho)
    columns = take(slice(0, n))
    # T = I: white.
    if not rho[1:].any():
        return columns.T @ columns
    # Twice the length: a shorter circle would wrap the end of the record on to its beginning.
    size = next_fast_len(2 * n - 1, real=True)
    # T as a corner of a circulant, whose product is a multiplication of spectra: N log N in place of N^2.
    circle = np.concatenate([rho, np.zeros(size - 2 * len(rho) + 1), rho[:0:-1]])
    spectrum = rfft(circle)
    filtered = np.empty_like(columns)
    step = max(1, NUMBERS_AT_A_TIME // size)
    for k in range(0, columns.shape[1], step):
        filtered[:, k : k + step] = irfft(
            rfft(columns[:, k : k + step], size, axis=0) * spectrum[:, None], size, axis=0
        )[:n]
    form = columns.T @ filtered
    return (form + form.T) / 2


# Columns of which a block of a long form has as many rows as its Fourier transform; of more columns it has fewer.
FEW_COLUMNS = 4


def _compute_long_form(take: Callable[[slice], np.ndarray], n: int, width: int, rho: np.ndarray) -> np.ndarray:
    """The same a block of rows at a time, each with the rows around it that ``rho`` reaches: FFTs of a bounded size.

    Correlations that are below the last digit of the first one, and stay there, are taken for zero.
    """
    reach = _find_reach(rho)
    step = max(NUMBERS_AT_A_TIME // 16 * FEW_COLUMNS // max(width, FEW_COLUMNS), reach)
    size = next_fast_len(step + 2 * reach, real=True)
    kernel = np.zeros(size)
    kernel[: reach + 1] = rho[: reach + 1]
    # Negative lags stand at the end of the circle.
    kernel[size - reach :] = rho[reach:0:-1]
    spectrum = rfft(kernel)
    form = np.zeros((width, width))
    for first in range(0, n, step):
        last, before, after = min(first + step, n), max(first - reach, 0), min(first + step + reach, n)
        columns = take(slice(before, after))
        within = columns[first - before : last - before]
        for k in range(len(form)):
            filtered = irfft(rfft(columns[:, k], size) * spectrum, size)
            form[:, k] += filtered[first - before : last - before] @ within
    return (form + form.T) / 2


def _find_reach(rho: np.ndarray) -> int:
    """The last lag at which ``rho`` is more than the last digit of its first value."""
    least = np.finfo(float).eps * abs(rho[0])
    for first in reversed(range(0, len(rho), ROWS_AT_A_TIME)):
        beyond = np.flatnonzero(np.abs(rho[first : first + ROWS_AT_A_TIME]) > least)
        if len(beyond):
            return first + int(beyond[-1])
    return 0
