"""Values: the noise of each output, where it is known from, and what is known of it: a level, or a bound with a direction."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

import numpy as np
from scipy.linalg.blas import dtbsv

from greybox.base import ROWS_AT_A_TIME, Finite, Printable
from greybox.data.noise.growing import GrowingNoise


@dataclass(frozen=True)
class NoisePolicy:
    """Rules for level and colour of the noise. Shares and ratios have no unit.

    Parameters
    ----------
    max_order
        Highest order of an autoregression that is tried; the noise of sensors and filters needs no more.
    min_relative_level
        Least noise over the movement of the signal: where a record shows none (a simulation), misfits are judged against this.
    """

    max_order: int = 12
    min_relative_level: float = 1e-6


NOISE_POLICY = NoisePolicy()


# Noise of a sensor that is not installed yet, as a share of the largest value that it would show.
NEW_SENSOR_NOISE = 0.01
# Standard deviations of an amplitude that is detected nine times in ten at a false-alarm rate of one per cent.
DETECTION_RATIO = 3.3

# Coloured noise as an autoregression: fitted by Burg's method, with gaps, its order by BIC.


# Samples over which the autocorrelation of coloured noise is summed.
MEMORY_SAMPLES = 500


@dataclass(frozen=True, eq=False)
class AutoRegression(Printable):
    """Noise of unit variance ``r[k] = a1 r[k-1] + ... + ap r[k-p] + e[k]``, stated by its reflection coefficients (p,).

    Order zero is white noise. Reflection coefficients lie between -1 and 1, and every such sequence is a stationary process
    (Burg 1975; Brockwell and Davis, Time series, section 5.2).
    """

    reflection: tuple[float, ...] = ()

    @property
    def order(self) -> int:
        """Number of coefficients; zero is white."""
        return len(self.reflection)

    @cached_property
    def predictors(self) -> tuple[tuple[np.ndarray, float], ...]:
        """Best predictors from the last 0, 1, ... p samples: coefficients (m,), nearest sample first, and error variance."""
        predictors: list[tuple[np.ndarray, float]] = [(np.zeros(0), 1.0)]
        for k in self.reflection:  # Levinson and Durbin
            a, variance = predictors[-1]
            predictors.append((np.append(a - k * a[::-1], k), variance * (1 - k * k)))
        return tuple(predictors)

    @property
    def coefficients(self) -> np.ndarray:
        """``a1 ... ap`` (p,)."""
        return self.predictors[-1][0]

    @property
    def innovation_variance(self) -> float:
        """Variance of ``e`` as a share of the variance of the noise: one for white noise."""
        return self.predictors[-1][1]

    @property
    def memory(self) -> float:
        """How long the noise remembers, in samples: the sum of the sizes of its autocorrelation from the first lag on, 0 for white."""
        return float(np.abs(self.autocorrelation(MEMORY_SAMPLES)[1:]).sum()) if self.order else 0.0

    def autocorrelation(self, count: int) -> np.ndarray:
        """Autocorrelation at lags 0 ... count-1."""
        rho: np.ndarray = np.ones(1)
        for k, (a, variance) in zip(self.reflection, self.predictors, strict=False):
            # Levinson and Durbin: rho_m = k_m E_{m-1} + sum_j a_j rho_{m-j}, with a and E of order m - 1.
            rho = np.append(rho, k * variance + a @ rho[:0:-1][: len(a)])
        if count <= len(rho):
            return rho[:count]
        if not self.order:
            return np.append(rho, np.zeros(count - 1))
        # Yule and Walker: rho[k] - a1 rho[k-1] - ... - ap rho[k-p] = 0 from lag p on, a banded triangle of equations. BLAS solves
        # it as fast as a filter would, and `scipy.signal` takes half a second to import. A block of lags at a time, which the last
        # p lags before it drive: the band of all lags would take p + 1 times the memory of the result.
        row = np.append(1.0, -self.coefficients)
        result = np.empty(count)
        known = np.convolve(row, rho)[: len(rho)]
        for first in range(0, count, ROWS_AT_A_TIME):
            block = result[first : first + ROWS_AT_A_TIME]
            if first:
                known = -np.convolve(row, result[first - self.order : first])[self.order :]
            driven = np.zeros(len(block))
            driven[: len(known)] = known[: len(block)]
            diagonals = np.tile(row, (len(block), 1)).T  # as BLAS has it in memory
            block[:] = dtbsv(self.order, diagonals, driven, lower=1, diag=1)
        return result

    def whiten(self, values: np.ndarray, *, overwrite_input: bool = False) -> np.ndarray:
        """Innovations of unit variance of ``values`` (N, ...), which has unit variance; NaN (gaps) stay NaN.

        The filter begins anew after a gap: the first samples there are predicted from as many as there are, each divided by the
        standard deviation of its own prediction error, so that white noise of variance one comes out everywhere. With
        ``overwrite_input`` the innovations stand in ``values``.
        """
        values = np.asarray(values, float)
        measured = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
        behind = _count_samples_behind(measured, self.order)
        result = values if overwrite_input else np.empty(values.shape)
        # A long series is in memory a few times only. From its end: what lies before a row is then still as it was.
        for first in reversed(range(0, len(values), ROWS_AT_A_TIME)):
            block = slice(first, first + ROWS_AT_A_TIME)
            white = np.full(values[block].shape, np.nan)
            for m, (a, variance) in enumerate(self.predictors):
                with_so_many = np.flatnonzero(measured[block] & (behind[block] == m))
                if not len(with_so_many):
                    continue
                rows = first + with_so_many
                predicted = np.zeros_like(values[rows])
                for j, c in enumerate(a):
                    predicted += c * values[rows - j - 1]
                white[with_so_many] = (values[rows] - predicted) / np.sqrt(variance)
            result[block] = white
        return result

    def predict(self, values: np.ndarray, steps: int) -> np.ndarray:
        """Prediction (N,) of ``values`` (N,) from the samples up to ``steps`` before each; zero where nothing is known."""
        known = np.asarray(values, float)
        result = np.zeros(len(known))
        for first in range(0, len(known) - steps, ROWS_AT_A_TIME):
            # A block, and the samples before it that it is predicted from.
            last = min(first + ROWS_AT_A_TIME, len(known) - steps)
            begin = max(first - self.order, 0)
            result[first + steps : last + steps] = self._predict_block(known[begin:last], steps)[first - begin :]
        return result

    def _predict_block(self, known: np.ndarray, steps: int) -> np.ndarray:
        """The value ``steps`` behind each row (N,), from the samples up to that row."""
        measured = np.isfinite(known)
        behind = _count_samples_behind(measured, self.order) + measured  # samples in a row up to and with this one
        guess = np.zeros((len(known), steps))
        for m in range(1, self.order + 1):
            a = self.predictors[m][0]
            rows = np.flatnonzero(measured & ((behind == m) | (behind > m) & (m == self.order)))
            past = np.stack([known[rows - j] for j in range(m)], axis=1)
            for ahead in range(steps):
                # A prediction stands in for the reading that the next one needs.
                guess[rows, ahead] = past @ a
                past = np.column_stack([guess[rows, ahead], past[:, :-1]])
        return guess[:, steps - 1]


def join_series(parts: Iterable[np.ndarray]) -> np.ndarray:
    """Several series (n,) as one, with a NaN between them, so that nothing is carried over."""
    return np.concatenate([piece for part in parts for piece in (np.asarray(part, float), [np.nan])] or [np.zeros(0)])


# Samples that a record must have for each order: with fewer a coefficient is chance.
SAMPLES_PER_ORDER = 10


def fit_autoregression(
    values: np.ndarray,
    *,
    max_order: int | None = None,
    copies: float = 1.0,
    overwrite_input: bool = False,
    policy: NoisePolicy = NOISE_POLICY,
) -> AutoRegression:
    """Fit an autoregression by Burg's method, its order chosen by Schwarz's criterion (BIC).

    Each order is judged by the stretches without a gap that it was found from: with gaps these are few.

    Parameters
    ----------
    values : array (N,)
        A series of mean zero, NaN in gaps.
    max_order
        Highest order tried; None takes the policy's.
    copies
        How many times over the series holds the same information (deviations from the mean of two repeats are each other's mirror
        image: 2).
    overwrite_input
        Whether ``values`` may be written to: a long series is then in memory once less.
    policy
        Highest order and samples for each order.

    Returns
    -------
    AutoRegression
        Of order zero where white noise explains the series as well.

    Examples
    --------
    >>> import numpy as np
    >>> fit_autoregression(np.random.default_rng(0).normal(size=1000)).order
    0
    """
    max_order = policy.max_order if max_order is None else max_order
    forward = _trim_gaps(np.asarray(values, float))
    if not overwrite_input:
        forward = forward.copy()
    backward = forward.copy()
    is_whole = bool(np.isfinite(forward).all())
    count = np.isfinite(forward).sum() / copies
    reflection: list[float] = []
    best, chosen, criterion = 0.0, 0, 0.0
    for order in range(1, min(max_order, int(count / SAMPLES_PER_ORDER)) + 1):
        f, b = forward[1:], backward[:-1]
        both = slice(None) if is_whole else np.isfinite(f) & np.isfinite(b)
        used_f, used_b = f[both], b[both]
        energy = float(used_f @ used_f + used_b @ used_b)
        if len(used_f) < SAMPLES_PER_ORDER or energy <= 0:
            break
        # Burg: k = 2 f'b / (f'f + b'b) leaves least energy of the errors forward and backward.
        k = 2 * float(used_f @ used_b) / energy
        if not abs(k) < 1:
            break
        reflection.append(k)
        for first in range(
            0, len(f), ROWS_AT_A_TIME
        ):  # in their places: a long series is in memory twice, and not five times
            rows = slice(first, first + ROWS_AT_A_TIME)
            # f - k b and b - k f, both from the errors of the order below.
            change = k * f[rows]
            f[rows] -= k * b[rows]
            b[rows] -= change
        forward, backward = f, b
        # BIC: N ln of the variance that is left, and ln N for each coefficient.
        criterion += len(used_f) / copies * np.log(1 - k * k) + np.log(count)
        if criterion < best:
            best, chosen = criterion, order
    return AutoRegression(tuple(reflection[:chosen]))


def _trim_gaps(values: np.ndarray) -> np.ndarray:
    """``values`` (N,) without the gaps at their ends, of which nothing is to be learnt."""
    measured = np.flatnonzero(np.isfinite(values))
    return values[measured[0] : measured[-1] + 1] if len(measured) else values[:0]


def _count_samples_behind(measured: np.ndarray, most: int) -> np.ndarray:
    """How many samples in a row, up to ``most``, lie directly before each one."""
    if measured.all():
        behind = np.full(len(measured), most, np.int32)  # half the memory, of a long record
        behind[:most] = np.arange(min(most, len(measured)))
        return behind
    last_gap = np.maximum.accumulate(np.where(measured, -1, np.arange(len(measured))))
    before = np.concatenate([[-1], last_gap[:-1]])
    return np.minimum(np.arange(len(measured)) - before - 1, most)


WHITE = AutoRegression()


class NoiseSource(StrEnum):
    """Where the noise of an output is known from, the most trustworthy first."""

    GIVEN = "given"
    QUIET_RECORD = "quiet_record"
    REPEATED_PERIODS = "repeated_periods"
    REPEATED_EXPERIMENTS = "repeated_experiments"
    FLAT_PIECES = "flat_pieces"
    SPECTRUM = "spectrum"
    DIFFERENCES = "differences"
    RESIDUAL = "residual"
    INNOVATIONS = "innovations"

    @classmethod
    def former_names(cls) -> dict[str, NoiseSource]:
        """The phrases that the first files name a source by."""
        return {
            "quiet record": cls.QUIET_RECORD,
            "repeated periods": cls.REPEATED_PERIODS,
            "repeated experiments": cls.REPEATED_EXPERIMENTS,
            "the records' differences": cls.DIFFERENCES,
            "the residual of the fit": cls.RESIDUAL,
            "the innovations": cls.INNOVATIONS,
        }

    @classmethod
    def _missing_(cls, value: object) -> NoiseSource | None:
        return cls.former_names().get(str(value))

    @property
    def is_independent(self) -> bool:
        """Whether it does not use the records that are fitted."""
        return self in (NoiseSource.GIVEN, NoiseSource.QUIET_RECORD)

    @property
    def direction(self) -> BoundDirection:
        """What a level from this source says, where nothing else is known of it.

        Differences and the residual of a fit hold what the plant did too.
        """
        bounds = (NoiseSource.SPECTRUM, NoiseSource.DIFFERENCES, NoiseSource.RESIDUAL)
        return BoundDirection.AT_MOST if self in bounds else BoundDirection.ABOUT


class BoundDirection(StrEnum):
    """What a level says of the noise: this large, not larger, or not smaller."""

    ABOUT = "about"
    AT_MOST = "at_most"
    AT_LEAST = "at_least"


@dataclass(frozen=True)
class NoiseBound:
    """What is known of the noise of one output.

    Parameters
    ----------
    level
        Standard deviation in the unit of the output.
    direction
        Whether the noise is about as large, at most or at least.
    source
        Where this is known from.
    correlation_time
        How long the noise remembers in s: the sum of its autocorrelation from the first lag on, times the sampling period. None where
        that is not known.
    relative_error
        Standard deviation of the level over the level, from the number of samples it was estimated from.

    Examples
    --------
    >>> NoiseBound(0.03, BoundDirection.AT_MOST, NoiseSource.SPECTRUM).floor is None
    True
    """

    level: Finite
    direction: BoundDirection
    source: NoiseSource
    correlation_time: float | None = None
    relative_error: Finite = 0.0

    @property
    def floor(self) -> float | None:
        """The level that a perfect model would leave; None where only a bound is known."""
        return self.level if self.direction is BoundDirection.ABOUT else None

    @property
    def ceiling(self) -> float | None:
        """The level beyond which a residual is more than noise; None where nobody knows it."""
        return None if self.direction is BoundDirection.AT_LEAST else self.level


@dataclass(frozen=True)
class NoiseModel(Printable):
    """Level and colour of the noise of each output.

    Parameters
    ----------
    outputs
        Names of the model's outputs, in their order (ny).
    std : array (ny,)
        Standard deviations in the model's units: what a fit weighs its outputs with. Where only a ceiling is known they may lie below
        it. Of an output with too few samples for any source it is the spread of the measurement, until there is a fit with a residual.
    sources
        Where each is known from, by name of the measured outputs. An output that reads the same in every row has none.
    colour
        An autoregression for each output (ny), of order zero where the noise is white or its colour unknown.
    known
        Whether no level was estimated from the records that are fitted.
    bounds
        What is known of each, by name of the measured outputs; what a source says in general where one is missing.
    named
        The name of the level of an output, by its name, where it is that of the residual and may be that of others as well.
    growth
        How the noise grows with the signal, by name of the outputs of which this is so; ``std`` is then its rms over the records.
    """

    outputs: tuple[str, ...]
    std: np.ndarray
    sources: Mapping[str, NoiseSource]
    colour: tuple[AutoRegression, ...]
    known: bool
    bounds: Mapping[str, NoiseBound] = field(default_factory=dict)
    named: Mapping[str, str] = field(default_factory=dict)
    growth: Mapping[str, GrowingNoise] = field(default_factory=dict)
    by_residual: frozenset[str] = frozenset()
    """Outputs whose colour is that of the residual: it counts as their noise, whatever its size."""

    @property
    def sharing(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the outputs that have one level in common, for each level that has a name."""
        levels = dict.fromkeys(self.named.values())
        return tuple(
            tuple(j for j, name in enumerate(self.outputs) if self.named.get(name) == level) for level in levels
        )

    @property
    def coloured(self) -> bool:
        """Whether the noise of any output is known to be coloured."""
        return any(a.order for a in self.colour)

    def bound(self, output: str) -> NoiseBound | None:
        """What is known of the noise of an output; None for one without a source."""
        source = self.sources.get(output)
        if output in self.bounds or source is None:
            return self.bounds.get(output)
        return NoiseBound(float(self.std[self.outputs.index(output)]), source.direction, source)

    @property
    def is_level_known(self) -> bool:
        """Whether the level of every output with a source is known, and not bounded only."""
        bounds = [self.bound(name) for name in self.sources]
        return all(b is not None and b.direction is BoundDirection.ABOUT for b in bounds)

    def ceiling_ratio(self, output: str) -> float:
        """How many times the standard deviation that is weighed with the noise may be: 1 where its level is known."""
        bound = self.bound(output)
        if bound is None or bound.direction is not BoundDirection.AT_MOST:
            return 1.0
        return max(bound.level / float(self.std[self.outputs.index(output)]), 1.0)
