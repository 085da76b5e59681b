"""The statistics behind the residual tests: each returns a statistic and a p-value. Series may hold NaN in gaps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc, fdtrc

from greybox.estimation.sandwich import compute_toeplitz_form
from greybox.linear_algebra import RankTolerance, decompose_symmetric
from greybox.noise import AutoRegression
from greybox.numerics import REDUNDANT_VARIANCE

LAGGED_SIGNALS = RankTolerance(REDUNDANT_VARIANCE, REDUNDANT_VARIANCE)


def ljung_box_test(series: np.ndarray, lags: int) -> tuple[float, float]:
    """``Q = n (n + 2) sum rho_k^2 / (n - k)`` over lags 1 ... ``lags``, chi-square for white noise (Ljung and Box 1978).

    Over a gap a lag has fewer pairs; each correlation is weighted by its own number of pairs.
    """
    r = series - np.nanmean(series)
    measured = np.isfinite(r)
    r = np.where(measured, r, 0.0)
    n, square = int(measured.sum()), float(r @ r)
    if square == 0:
        return 0.0, 1.0
    statistic = 0.0
    for k in range(1, lags + 1):
        pairs = int((measured[k:] & measured[:-k]).sum())
        if pairs:
            statistic += n * (n + 2) * (float(r[k:] @ r[:-k]) / square) ** 2 / pairs
    return statistic, float(chdtrc(lags, statistic))


def lagged_matrix(signal: np.ndarray, lags: int) -> np.ndarray:
    """``signal`` (N,) less its mean, delayed by 0 ... ``lags`` samples (N, lags + 1), zero before it began."""
    signal = signal - signal.mean()
    return np.column_stack([np.concatenate([np.zeros(k), signal[: len(signal) - k]]) for k in range(lags + 1)])


def input_independence_test(
    residuals: Sequence[np.ndarray], regressors: Sequence[np.ndarray], colour: AutoRegression
) -> tuple[float, float]:
    """``c' P^+ c`` with ``c = sum U'r`` of the regressors U (N, m) and its covariance ``P = sum U' R U``, chi-square if unrelated.

    R is the covariance of the residual as the autoregression ``colour`` has it: for coloured residuals the white-noise
    formula takes chance for dependence (Ljung, System identification, 2nd ed., section 16.6).
    """
    size = regressors[0].shape[1]
    c, p = np.zeros(size), np.zeros((size, size))
    everything = np.concatenate(residuals)
    variance = float(np.nanmean(everything**2))
    if variance == 0 or not np.isfinite(variance):
        return 0.0, 1.0
    for r, u in zip(residuals, regressors, strict=True):
        measured = np.isfinite(r)
        u = np.where(measured[:, None], u, 0.0)
        c += u.T @ np.where(measured, r, 0.0)
        p += variance * compute_toeplitz_form(u, colour.autocorrelation(len(r)))
    spread = decompose_symmetric(p, LAGGED_SIGNALS)
    if not spread.rank:
        return 0.0, 1.0
    statistic = float(c @ spread.solve(c))
    return statistic, float(chdtrc(spread.rank, statistic))


def normality_test(series: np.ndarray) -> tuple[float, float]:
    """Jarque and Bera's statistic of skewness and kurtosis, chi-square with two degrees of freedom for a normal sample."""
    usable = series[np.isfinite(series)]
    if len(usable) < 8 or np.ptp(usable) == 0:
        return 0.0, 1.0
    z = (usable - usable.mean()) / usable.std()
    skewness, kurtosis = float((z**3).mean()), float((z**4).mean())
    statistic = len(z) / 6 * (skewness**2 + (kurtosis - 3) ** 2 / 4)
    return statistic, float(chdtrc(2, statistic))


def equal_variance_test(blocks: Sequence[np.ndarray]) -> tuple[float, float]:
    """Levene's statistic of equal variance over blocks, about the medians (Brown and Forsythe 1974): robust to heavy tails."""
    if len(blocks) < 2 or all(np.ptp(b) == 0 for b in blocks):
        return 0.0, 1.0
    return _analyse_variance([np.abs(b - np.median(b)) for b in blocks])


def equal_mean_test(blocks: Sequence[np.ndarray]) -> tuple[float, float]:
    """The F statistic of equal means over blocks."""
    if len(blocks) < 2 or all(np.ptp(b) == 0 for b in blocks):
        return 0.0, 1.0
    return _analyse_variance(blocks)


def _analyse_variance(blocks: Sequence[np.ndarray]) -> tuple[float, float]:
    """The F statistic of equal means, and its tail probability. `scipy.stats` has it too and takes half a second to import."""
    values = np.concatenate(list(blocks))
    between = sum(len(b) * (b.mean() - values.mean()) ** 2 for b in blocks) / (len(blocks) - 1)
    within = sum(((b - b.mean()) ** 2).sum() for b in blocks) / (len(values) - len(blocks))
    if within == 0:
        return (0.0, 1.0) if between == 0 else (np.inf, 0.0)
    return float(between / within), float(fdtrc(len(blocks) - 1, len(values) - len(blocks), between / within))


def split_into_blocks(residuals: Sequence[np.ndarray], count: int, least: int) -> list[np.ndarray]:
    """Usable values of consecutive parts, about ``count`` over all records in proportion to their rows, ``least`` values at least."""
    total = sum(len(r) for r in residuals)
    parts: list[np.ndarray] = []
    for r in residuals:
        pieces = np.array_split(r, max(1, round(count * len(r) / total)))
        parts += [p[np.isfinite(p)] for p in pieces]
    return [p for p in parts if len(p) >= least]
