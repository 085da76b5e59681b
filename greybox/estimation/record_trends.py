"""Constants of which each record has a value of its own: does one value do for all, and which condition of the records do they follow?

The values are compared by generalised least squares with their joint covariance, which allows for what the records do not explain
(G. A. F. Seber, A. J. Lee 2003, Linear Regression Analysis, sections 3.10 and 4.3): first one value for all, then a straight line over each
condition, then one value for each level of a condition.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from greybox.base import pseudo_inverse
from greybox.data.experiment import Experiment
from greybox.estimation.result_parts import Trace

# Probability with which values that are the same are said to differ, and values that follow no condition to follow one.
ERROR_PROBABILITY = 0.01
# Standard errors within which a line may miss the origin, and still be called in proportion.
ORIGIN_DEVIATIONS = 2.0
# Share of the largest value that these may be; a line that is known less well is in proportion to nothing.
ORIGIN_SHARE = 0.2


class TrendKind(StrEnum):
    """What values by record say."""

    ALIKE = "alike"
    """One value does for all."""

    PROPORTIONAL = "proportional"
    """They go with a condition, through the origin."""

    LINEAR = "linear"
    """They lie on a straight line over a condition, or scatter about one."""

    MONOTONE = "monotone"
    """They rise or fall from level to level of a condition, on no straight line."""

    PAIR = "pair"
    """They differ between the only two records, whose conditions differ too: two points show no more."""

    DIFFERENT = "different"
    """They differ, and follow no condition."""


@dataclass(frozen=True)
class RecordTrend:
    """What the values of one constant in several records have in common.

    Parameters
    ----------
    kind
        What was found.
    condition
        The condition that the values follow; empty where they follow none.
    levels
        Its lowest and its highest value.
    values
        The constant there: the mean of the records at that level, or along the line where it goes through the origin; the common value,
        twice, where one does for all.
    share
        Share of the differences between the records that the condition explains.
    also
        Other conditions that explain them significantly: what goes together in the records cannot be told apart.
    """

    kind: TrendKind
    condition: str = ""
    levels: tuple[float, float] = (np.nan, np.nan)
    values: tuple[float, float] = (np.nan, np.nan)
    share: float = 0.0
    also: tuple[str, ...] = ()

    @property
    def ratio(self) -> float | None:
        """The constant at the highest over that at the lowest level; None where it changes its sign, or is zero."""
        low, high = self.values
        return high / low if low * high > 0 else None


def shared_conditions(experiments: Sequence[Experiment]) -> dict[str, np.ndarray]:
    """The conditions that every record has, and that differ: name -> values (E,)."""
    names = [
        n for n in (experiments[0].conditions if experiments else {}) if all(n in e.conditions for e in experiments)
    ]
    levels = {name: np.array([e.conditions[name] for e in experiments]) for name in names}
    return {name: values for name, values in levels.items() if np.ptp(values) > 0}


def find_trend(values: np.ndarray, covariance: np.ndarray, conditions: Mapping[str, np.ndarray]) -> RecordTrend | None:
    """What the values of a constant by record have in common.

    Parameters
    ----------
    values, covariance
        The constant in each record (E,), and the joint covariance of these estimates (E, E). A record that does not determine it has a
        variance that is not finite, and is left out.
    conditions
        Condition -> its value in each record (E,).

    Returns
    -------
    RecordTrend or None
        None where fewer than two records determine the constant.
    """
    from scipy import stats

    known = np.isfinite(np.diag(covariance)) & (np.diag(covariance) > 0)
    count = int(known.sum())
    if count < 2:
        return None
    theta, precision = values[known], pseudo_inverse(covariance[np.ix_(known, known)])
    one = np.ones((count, 1))
    mean, scatter, _ = _least_squares(one, theta, precision)
    # Q = r' C^-1 r of equal values is chi-squared with E - 1 degrees of freedom.
    if stats.chi2.sf(scatter, count - 1) > ERROR_PROBABILITY:
        return RecordTrend(TrendKind.ALIKE, values=(float(mean[0]), float(mean[0])))
    followed: list[tuple[float, RecordTrend]] = []
    for name, given in conditions.items():
        z = given[known]
        levels = np.unique(z)
        if len(levels) < 2:
            continue
        ends = float(levels[0]), float(levels[-1])
        if count == 2:
            at = float(theta[z == ends[0]][0]), float(theta[z == ends[1]][0])
            followed.append((1.0, RecordTrend(TrendKind.PAIR, name, ends, at, 1.0)))
            continue
        line, left, spread = _least_squares(np.column_stack([one, z]), theta, precision)
        p_value, excess = _compare(scatter, left, 1, count - 2)
        each, left_by_level, _ = _least_squares((z[:, None] == levels).astype(float), theta, precision)
        at = float(each[0]), float(each[-1])
        if p_value <= ERROR_PROBABILITY:
            # Through the origin: within its error, which must be small enough to say so.
            reach = ORIGIN_DEVIATIONS * np.sqrt(excess * spread[0, 0])
            passes = abs(line[0]) <= reach <= ORIGIN_SHARE * np.abs(theta).max()
            kind = TrendKind.PROPORTIONAL if passes else TrendKind.LINEAR
            if passes and ends[0] > 0:
                at = float(line[0] + line[1] * ends[0]), float(line[0] + line[1] * ends[1])
            followed.append((p_value, RecordTrend(kind, name, ends, at, 1 - left / scatter)))
            continue
        # One value for each level: it needs levels that were repeated, to be held against what repeats differ by.
        steps = np.diff(each)
        if count > len(levels) > 2 and (np.all(steps > 0) or np.all(steps < 0)):
            p_value, _ = _compare(scatter, left_by_level, len(levels) - 1, count - len(levels))
            if p_value <= ERROR_PROBABILITY:
                followed.append((p_value, RecordTrend(TrendKind.MONOTONE, name, ends, at, 1 - left_by_level / scatter)))
    if not followed:
        return RecordTrend(TrendKind.DIFFERENT, values=(float(theta.min()), float(theta.max())))
    # Of several conditions the one that explains most leads.
    followed.sort(key=lambda each: (each[0], -each[1].share))
    best = followed[0][1]
    others = tuple(trend.condition for _, trend in followed[1:])
    return RecordTrend(best.kind, best.condition, best.levels, best.values, best.share, others)


def _least_squares(design: np.ndarray, y: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Coefficients (k,), weighted sum of squares that is left, and covariance (k, k) of the coefficients."""
    # Generalised least squares: (X'PX)^-1 X'P y, with the covariance (X'PX)^-1.
    covariance = pseudo_inverse(design.T @ precision @ design)
    coefficients = covariance @ (design.T @ precision @ y)
    residual = y - design @ coefficients
    return coefficients, max(float(residual @ precision @ residual), 0.0), covariance


def _compare(before: float, after: float, added: int, degrees: int) -> tuple[float, float]:
    """Probability of so much less scatter by chance, and the excess of what is left over what the intervals of the values allow."""
    from scipy import stats

    if degrees < 1 or stats.chi2.sf(after, degrees) > ERROR_PROBABILITY:
        # What is left is within the intervals: their size is the measure.
        return float(stats.chi2.sf(before - after, added)), 1.0
    excess = after / degrees
    return float(stats.f.sf((before - after) / added / excess, added, degrees)), excess


def trend_values(trend: RecordTrend, unit: str, records: int) -> dict[str, Any]:
    """What a finding holds of a trend."""
    return {
        "kind": str(trend.kind),
        "condition": trend.condition,
        "levels": list(trend.levels) if trend.condition else [],
        "at": list(trend.values),
        "ratio": trend.ratio,
        "share": trend.share,
        "also": list(trend.also),
        "unit": unit,
        "records": records,
    }


# One measurement in two records: what the model leaves of them is one noise, though readings were averaged, scaled or given fresh noise.

# Correlation of two residuals from which they are one; what an incomplete model leaves of repeated experiments has a colour.
SHARED_NOISE = 0.4
# ... in its standard deviation over records that share nothing, the best of all alignments among thousands of rows.
SHARED_DEVIATIONS = 6.0
# Geometric mean of the lag-one correlations up to which two residuals may share a noise: what an incomplete model leaves of both is smooth,
# of the share r_1 of the power of each, and correlates by sqrt(r_1a r_1b), which is below `SHARED_NOISE`. A smoothed copy has a colour.
WHITE = 0.3
# A residual of coarse readings is decided by the signal: records that repeat it share it.
LEAST_STEPS = 1.0
# Deviations beyond which a residual is cut: a few glitches at the same place are no shared noise.
CUT_DEVIATIONS = 2.5
# Rows of a record that are compared: copies show it in these, and all pairs of many long records take seconds.
COMPARED_ROWS = 20000


def find_shared_noise(first: Trace, second: Trace) -> float:
    """The correlation of what the model leaves of two records, where it is one noise in any of their outputs; 0 elsewhere.

    Rows are aligned where they agree best, and those of the denser record averaged where it has several times as many.
    """
    shared = 0.0
    for name in first.measured.keys() & second.measured.keys():
        residuals = [r for t in (first, second) if (r := _standardise(t, name)) is not None]
        if len(residuals) < 2 or abs(residuals[0].colour * residuals[1].colour) > WHITE**2:
            continue
        short, dense = sorted((r.values for r in residuals), key=len)
        for factor in {1, round(len(dense) / len(short))}:
            rows = len(dense) // factor
            whole = dense[: rows * factor].reshape(rows, factor).mean(axis=1) * np.sqrt(factor)
            size = 2 ** int(np.ceil(np.log2(rows + len(short))))
            # c_s = sum_t a_t b_{t+s} at all shifts s, by the theorem of convolution.
            products = np.fft.irfft(np.fft.rfft(whole, size) * np.conj(np.fft.rfft(short, size)), size)
            best = float(products[np.argmax(np.abs(products))]) / len(short)
            if abs(best) > max(SHARED_NOISE, SHARED_DEVIATIONS / np.sqrt(len(short)), abs(shared)):
                shared = best
    return shared


class _Residual(NamedTuple):
    """What the model leaves of an output: ``values`` (N,) with variance one, gaps at zero, and the lag-one correlation of those between."""

    values: np.ndarray
    colour: float


def _standardise(trace: Trace, name: str) -> _Residual | None:
    """What the model leaves of an output; None where the steps of its readings decide it."""
    residual = trace.residual(name)[:COMPARED_ROWS]
    known = np.isfinite(residual)
    if not known.any():  # its run fails at once
        return None
    levels = np.unique(trace.measured[name][:COMPARED_ROWS][known])
    # Cut before anything is measured of it: one glitch moves the mean, is most of the power and makes any colour look white.
    values = residual[known] - np.median(residual[known])
    deviation = 1.4826 * np.median(np.abs(values))
    values = np.clip(values, -CUT_DEVIATIONS * deviation, CUT_DEVIATIONS * deviation)
    values -= values.mean()
    power = float(np.mean(values**2))
    if not (len(levels) > 1 and power > (LEAST_STEPS * np.diff(levels).min()) ** 2):
        return None
    whole = np.zeros(len(residual))
    whole[known] = values
    return _Residual(whole / np.sqrt(np.mean(whole**2)), float(np.mean(values[1:] * values[:-1])) / power)
