"""The numbers by which a residual is tested."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import ClassVar

import casadi as ca
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import chdtrc, fdtrc

from greybox.base import Printable
from greybox.base.linear_algebra import RankTolerance, decompose_symmetric, eliminate
from greybox.base.numerics import REDUNDANT_VARIANCE, ROWS_AT_A_TIME
from greybox.data.noise.noise_model import AutoRegression, fit_autoregression, join_series
from greybox.estimation.objective import SimulationErrorObjective
from greybox.estimation.optimum import restore_residuals
from greybox.estimation.options import FitOptions
from greybox.estimation.result import Fit
from greybox.estimation.sandwich import Columns, compute_correlations, compute_toeplitz_form
from greybox.simulation.records import to_record

__all__ = ["ResidualSeries", "ResidualTest", "ResidualTestKind", "ResidualTests", "residual_tests"]

# The statistics behind the residual tests: each returns a statistic and a p-value. Series may hold NaN in gaps.

LAGGED_SIGNALS = RankTolerance(REDUNDANT_VARIANCE, REDUNDANT_VARIANCE)


def ljung_box_test(series: np.ndarray, lags: int) -> tuple[float, float]:
    """``Q = n (n + 2) sum rho_k^2 / (n - k)`` over lags 1 ... ``lags``, chi-square for white noise (Ljung and Box 1978).

    Over a gap a lag has fewer pairs; each correlation is weighted by its own number of pairs.
    """
    mean, n = measure_mean([series])
    products, pairs = np.zeros(lags + 1), np.zeros(lags + 1, int)
    for rows in _blocks(len(series)):
        # A block, and the samples before it that it is multiplied with.
        first = max(rows.start - lags, 0)
        r = series[first : rows.stop] - mean
        measured = np.isfinite(r)
        r[~measured] = 0.0
        for k in range(lags + 1):
            late, early = slice(max(rows.start, k) - first, len(r)), slice(max(rows.start, k) - first - k, len(r) - k)
            products[k] += r[late] @ r[early]
            pairs[k] += (measured[late] & measured[early]).sum()
    if products[0] == 0:
        return 0.0, 1.0
    seen = np.flatnonzero(pairs[1:]) + 1
    statistic = float(n * (n + 2) * ((products[seen] / products[0]) ** 2 / pairs[seen]).sum())
    return statistic, float(chdtrc(lags, statistic))


def measure_mean(parts: Sequence[np.ndarray], power: int = 1, about: float = 0.0) -> tuple[float, int]:
    """Mean of a power of the finite values of all ``parts`` (N,), ``about`` a value, and how many there are; NaN of none."""
    total, count = 0.0, 0
    for part in parts:
        for rows in _blocks(len(part)):
            known = part[rows][np.isfinite(part[rows])]
            total, count = total + float(((known - about) ** power).sum()), count + len(known)
    return total / count if count else np.nan, count


@dataclass(frozen=True, eq=False)
class LaggedInput:
    """An input delayed by 0 ... ``lags`` samples, zero before it began, as rows (N, lags + 1): a long record has 21 numbers for each row.

    Parameters
    ----------
    signal
        The input (N,).
    mean
        What is taken off it.
    lags
        Delays.
    slopes, share
        What is taken off: sensitivities (N, k) times their shares (k, lags + 1).
    """

    signal: np.ndarray
    mean: float
    lags: int
    slopes: np.ndarray | None = None
    share: np.ndarray | None = None

    @classmethod
    def of(cls, signal: np.ndarray, lags: int) -> LaggedInput:
        """That of an input (N,) with its mean."""
        return cls(signal, float(signal.mean()), lags)

    def __len__(self) -> int:
        return len(self.signal)

    def __getitem__(self, rows: slice, /) -> np.ndarray:
        first, last, _ = rows.indices(len(self))
        before = np.zeros(max(self.lags - first, 0))
        reached = np.concatenate([before, self.signal[max(first - self.lags, 0) : last] - self.mean])
        delayed = sliding_window_view(reached, self.lags + 1)[:, ::-1] if last > first else np.zeros((0, self.lags + 1))
        if self.slopes is None or self.share is None:
            return np.ascontiguousarray(delayed)
        # U - J (J'J)^+ J'U, the rows of this block.
        return delayed - self.slopes[rows] @ self.share


@dataclass(frozen=True, eq=False)
class _WhereMeasured:
    """Regressors with zeros in the gaps of a residual: ``measured`` (N,)."""

    regressors: Columns
    measured: np.ndarray

    def __len__(self) -> int:
        return len(self.measured)

    def __getitem__(self, rows: slice, /) -> np.ndarray:
        return np.where(self.measured[rows, None], self.regressors[rows], 0.0)


def _blocks(rows: int) -> Iterator[slice]:
    return (slice(first, min(first + ROWS_AT_A_TIME, rows)) for first in range(0, rows, ROWS_AT_A_TIME))


def correlate_with_inputs(
    residuals: Sequence[np.ndarray], regressors: Sequence[Columns], colour: AutoRegression
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``c = sum U'r`` (m,) of the regressors U (N, m), its covariance ``P = sum U' R U`` (m, m) if unrelated, and ``G = sum U'U`` (m, m).

    R is the covariance of the residual as the autoregression ``colour`` has it: for coloured residuals the white-noise
    formula takes chance for dependence (Ljung, System identification, 2nd ed., section 16.6).
    """
    size = regressors[0][:0].shape[1]
    c, p, g = np.zeros(size), np.zeros((size, size)), np.zeros((size, size))
    variance, _ = measure_mean(residuals, 2)
    if variance == 0 or not np.isfinite(variance):
        return c, p, g
    for r, u in zip(residuals, regressors, strict=True):
        inside = _WhereMeasured(u, np.isfinite(r))
        for rows in _blocks(len(r)):
            block = inside[rows]
            c += block.T @ np.where(inside.measured[rows], r[rows], 0.0)
            g += block.T @ block
        # P = sum U'R U with R_ij = s^2 rho(i - j).
        p += variance * compute_toeplitz_form(inside, compute_correlations(colour, len(r)))
    return c, p, g


def input_independence_test(c: np.ndarray, p: np.ndarray) -> tuple[float, float]:
    """``c' P^+ c`` of what `correlate_with_inputs` gives, chi-square if residual and input are unrelated."""
    spread = decompose_symmetric(p, LAGGED_SIGNALS)
    if not spread.rank:
        return 0.0, 1.0
    statistic = float(c @ spread.solve(c))
    return statistic, float(chdtrc(spread.rank, statistic))


def same_row_test(c: np.ndarray, p: np.ndarray, g: np.ndarray) -> tuple[float, float]:
    """Whether the residual follows what the other regressors do not tell of the first; chi-square with one degree of freedom if not.

    A model that lacks part of what an input did before leaves a residual of the other regressors, which that part is orthogonal to.
    """
    # c0 - b' c1 with b = G11^+ G10, whose variance is [1, -b'] P [1, -b']'.
    row = eliminate(g, np.arange(1), np.arange(1, len(g)))[0]
    # A sweep or a sum of sines is told by its own past, and nothing is left but rounding.
    if float(row @ g[:, 0]) <= REDUNDANT_VARIANCE * g[0, 0]:
        return 0.0, 1.0
    statistic = float((row @ c) ** 2 / (row @ p @ row))
    return statistic, float(chdtrc(1, statistic))


# Fewest values of a test of normality: below, its statistic is nowhere near chi-square, and hardly ever large.
MIN_NORMALITY_VALUES = 8


def normality_test(*series: np.ndarray) -> tuple[float, float] | None:
    """Jarque and Bera's statistic of skewness and kurtosis, chi-square with two degrees of freedom for a normal sample.

    None of too few values.
    """
    mean, count = measure_mean(series)
    if count < MIN_NORMALITY_VALUES:
        return None
    # fmin and fmax pass over NaN.
    if min(np.fmin.reduce(part) for part in series) == max(np.fmax.reduce(part) for part in series):
        return 0.0, 1.0
    moments = np.zeros(3)
    for part in series:
        for rows in _blocks(len(part)):
            z = part[rows][np.isfinite(part[rows])] - mean
            moments += [float((z**power).sum()) / count for power in (2, 3, 4)]
    # S = m3 / m2^(3/2) and K = m4 / m2^2, with the moments about the mean.
    skewness, kurtosis = moments[1] / moments[0] ** 1.5, moments[2] / moments[0] ** 2
    # N / 6 (S^2 + (K - 3)^2 / 4).
    statistic = float(count / 6 * (skewness**2 + (kurtosis - 3) ** 2 / 4))
    return statistic, float(chdtrc(2, statistic))


def equal_variance_test(blocks: Sequence[np.ndarray]) -> tuple[float, float] | None:
    """Levene's statistic of equal variance over blocks, about the medians (Brown and Forsythe 1974): robust to heavy tails.

    None of a single block.
    """
    return _analyse_variance(blocks, lambda b: np.abs(b - np.median(b)))


def equal_mean_test(blocks: Sequence[np.ndarray]) -> tuple[float, float] | None:
    """The F statistic of equal means over blocks; None of a single block."""
    return _analyse_variance(blocks, lambda b: b)


def _analyse_variance(
    blocks: Sequence[np.ndarray], measure: Callable[[np.ndarray], np.ndarray]
) -> tuple[float, float] | None:
    """The F statistic of equal means of a ``measure``, and its tail probability: `scipy.stats` takes half a second to import."""
    if len(blocks) < 2:
        return None
    if all(np.ptp(b) == 0 for b in blocks):
        return 0.0, 1.0
    # One block after the other: all of them are a long record once more.
    measured = ((len(b), m.mean(), m.var()) for b in blocks for m in [measure(b)])
    counts, means, spreads = (np.array(of_blocks) for of_blocks in zip(*measured, strict=True))
    number, total = len(counts), int(counts.sum())
    # F = between / within, each over its degrees of freedom: k - 1 and N - k.
    between = float(counts @ (means - counts @ means / total) ** 2) / (number - 1)
    within = float(counts @ spreads) / (total - number)
    if within == 0:
        return (0.0, 1.0) if between == 0 else (np.inf, 0.0)
    return float(between / within), float(fdtrc(number - 1, total - number, between / within))


def split_into_blocks(residuals: Sequence[np.ndarray], count: int, least: int) -> list[np.ndarray]:
    """Usable values of consecutive parts, about ``count`` over all records in proportion to their rows, ``least`` values at least."""
    total = sum(len(r) for r in residuals)
    parts: list[np.ndarray] = []
    for r in residuals:
        pieces = np.array_split(r, max(1, round(count * len(r) / total)))
        parts += [p if np.isfinite(p).all() else p[np.isfinite(p)] for p in pieces]
    return [p for p in parts if len(p) >= least]


# What the residual of a fit says: is it white, free of the inputs, normal, and the same throughout?

Rows = Sequence[tuple[np.ndarray, np.ndarray]]


class ResidualTestKind(StrEnum):
    """What a residual is tested for."""

    WHITENESS = "whiteness"
    INPUT_INDEPENDENCE = "input_independence"
    SAME_ROW = "same_row"
    NORMALITY = "normality"
    EQUAL_VARIANCE = "equal_variance"
    EQUAL_MEAN = "equal_mean"


@dataclass(frozen=True)
class ResidualTest(Printable):
    """One test of one output.

    Parameters
    ----------
    output
        The output whose residual was tested.
    kind
        What it was tested for.
    statistic, p_value
        The figure of the test, and how often chance alone makes it as large.
    alarm
        Whether the p-value is below the level of the policy.
    lags
        Samples over which correlations were summed; 0 for tests without lags.
    input
        The input, for a test of independence.
    colour
        The autoregression of the residual.
    """

    output: str
    kind: ResidualTestKind
    statistic: float
    p_value: float
    alarm: bool
    lags: int = 0
    input: str = ""
    colour: AutoRegression = field(default_factory=AutoRegression, repr=False, compare=False)

    KEYS: ClassVar[str] = "output kind statistic p_value alarm lags input order=colour.order correlation"

    @property
    def correlation(self) -> float:
        """Of the residual from one sample to the next."""
        return float(self.colour.autocorrelation(2)[1]) if self.colour.order else 0.0


@dataclass(frozen=True, eq=False)
class ResidualSeries:
    """The residual of one output that the tests looked at, over its noise.

    Parameters
    ----------
    series
        For each record an array (N,), NaN in gaps.
    raw
        The same with the outliers that a robust fit keeps out of ``series``.
    inputs
        By name, for each record an array (N,).
    time
        For each record an array (N,) in seconds.
    colour
        The autoregression of ``series``.
    """

    series: tuple[np.ndarray, ...]
    raw: tuple[np.ndarray, ...]
    inputs: Mapping[str, tuple[np.ndarray, ...]]
    time: tuple[np.ndarray, ...]
    colour: AutoRegression


@dataclass(frozen=True)
class ResidualTests(Printable):
    """All tests of a fit.

    Parameters
    ----------
    tests
        Output by output.
    whitened
        Outputs whose residual was whitened with their known noise colour first.
    residuals
        What was tested, by output.
    """

    tests: tuple[ResidualTest, ...]
    whitened: tuple[str, ...] = ()
    residuals: Mapping[str, ResidualSeries] = field(default_factory=dict, repr=False, compare=False)

    @property
    def alarms(self) -> tuple[ResidualTest, ...]:
        """The tests that raise an alarm."""
        return tuple(t for t in self.tests if t.alarm)

    @property
    def not_made(self) -> Mapping[str, tuple[ResidualTestKind, ...]]:
        """By output what its residual has too few values to be tested for."""
        result = {}
        for output, series in self.residuals.items():
            made = {t.kind for t in self.tests if t.output == output}
            is_driven = any(np.ptp(u) > 0 for records in series.inputs.values() for u in records)
            # What is tested of the same row is so only where the input has no direct path to the output.
            wanted = [k for k in ResidualTestKind if k is not ResidualTestKind.SAME_ROW]
            wanted = [k for k in wanted if is_driven or k is not ResidualTestKind.INPUT_INDEPENDENCE]
            if missing := tuple(k for k in wanted if k not in made):
                result[output] = missing
        return result

    def of(
        self, output: str, kind: ResidualTestKind | str, *, lags: int | None = None, input: str = ""
    ) -> ResidualTest:
        """The first test of an output of this kind; ``lags`` and ``input`` choose among several.

        Raises KeyError where there is none.
        """
        for test in self.tests:
            if (test.output, test.kind) == (output, kind) and lags in (None, test.lags) and input in ("", test.input):
                return test
        raise KeyError(f"no test {str(kind)!r} of output {output!r}")


def residual_tests(fit: Fit) -> ResidualTests:
    """Test the free-run residual of each output over all records of a fit, or its innovations where the model has process noise.

    Whiteness over 5, 10 and 20 lags (Ljung and Box); independence of each input over 20 lags, with the covariance that the
    residual's colour gives and the fitted constants allowed for; of the input in the same row by itself where it cannot act on that
    reading; normality (Jarque and Bera); equal variance and equal mean over blocks. Normality and the block tests look at the residual
    whitened by an autoregression, because they need independent samples. After a robust fit all tests but normality look at the residual
    as its loss sees it, without the pull of outliers. Each test alone raises a false alarm in one fit of a hundred.

    Parameters
    ----------
    fit
        A fit that succeeded.

    Returns
    -------
    ResidualTests
        One `ResidualTest` for each output and question; ``alarms`` holds those that failed, ``not_made`` those for which there
        are too few values.

    Raises
    ------
    FitError
        For a fit that did not succeed, and for one whose run is not a free one (arcs, or the segments of an unstable plant): states
        that are set anew along the record take up what the model lacks, and the tests would not see it.

    Examples
    --------
    >>> tests = residual_tests(fit)  # doctest: +SKIP
    >>> [(t.output, t.kind) for t in tests.alarms]  # doctest: +SKIP
    [('x', 'whiteness')]
    """
    objective, restored = restore_residuals(fit)
    rows = raw = restored.rows
    # The same with the outliers that a robust fit leaves out.
    if isinstance(objective, SimulationErrorObjective) and objective.problem.loss is not None:
        raw = SimulationErrorObjective(replace(objective.problem, loss=None)).linearise().rows
    inputs = {i.name: [trace.inputs[i.name] for trace in fit.traces] for i in fit.model.inputs}
    noise_policy = FitOptions.from_data(fit.provenance.options).policy.noise
    tests: list[ResidualTest] = []
    tested: dict[str, ResidualSeries] = {}
    for j, output in enumerate(fit.model.outputs):
        if output.name not in fit.misfit:
            continue
        residuals, unbounded = [r[:, j] for r, _ in rows], [r[:, j] for r, _ in raw]
        # Sensitivities of each record laid out over all unknowns.
        slopes = []
        for e, (r, jacobian) in enumerate(rows):
            lanes = objective.variables.columns(e)
            if np.array_equal(lanes, np.arange(objective.variables.size)):
                slopes.append(jacobian[:, j])  # of one record there is nothing to lay out
                continue
            slopes.append(np.zeros((len(r), objective.variables.size)))
            slopes[e][:, lanes] = jacobian[:, j]
        unbound = None if raw is rows else unbounded
        tests += run_residual_tests(output.name, residuals, inputs, slopes, unbound, _find_later_inputs(fit, j))
        tested[output.name] = ResidualSeries(
            tuple(residuals),
            tuple(unbounded),
            {name: tuple(each) for name, each in inputs.items()},
            tuple(trace.time for trace in fit.traces),
            fit_autoregression(join_series(residuals), overwrite_input=True, policy=noise_policy),
        )
    whitened = tuple(name for name, reflection in fit.noise.colour.items() if len(reflection))
    return ResidualTests(tuple(tests), whitened, tested)


def _find_later_inputs(fit: Fit, output: int) -> list[str]:
    """The inputs that cannot act on an output in their own row: those held between rows, without a direct path to it."""
    model = fit.model
    if not model.has_equations:
        return []
    moving = np.any([to_record(model, trace.experiment).is_linear for trace in fit.traces], axis=0)
    direct = ca.jacobian(model.system.outputs[output], model.system.u).sparsity().get_col()
    return [name for k, name in enumerate(model.system.input_names) if k not in direct and not moving[k]]


# p-value below which a test raises an alarm: one false alarm in a hundred good fits for each test.
ALARM_LEVEL = 0.01
# Samples over which the residual must be uncorrelated: short, medium and long memory.
WHITENESS_LAGS: tuple[int, ...] = (5, 10, 20)
# The test over some lags needs more samples than this many for each of them; with fewer its statistic is not chi-square.
SAMPLES_PER_WHITENESS_LAG = 5
# Samples that an input may act before the residual.
RESIDUAL_TEST_INPUT_LAGS = 20
# The independence test needs more samples than this many for each lag.
SAMPLES_PER_INPUT_LAG = 10
# Parts of all records over which variance and mean must be equal: enough for drift, few enough to be sure of each.
RESIDUAL_TEST_BLOCKS = 8
# Fewest values of a part; smaller parts are left out.
MIN_BLOCK_VALUES = 10


def run_residual_tests(
    output: str,
    residuals: Sequence[np.ndarray],
    inputs: Mapping[str, list[np.ndarray]],
    slopes: Sequence[np.ndarray] | None = None,
    raw: Sequence[np.ndarray] | None = None,
    later: Collection[str] = (),
) -> list[ResidualTest]:
    """The tests of one output.

    Parameters
    ----------
    output
        Its name.
    residuals
        For each record an array (N,), NaN in gaps.
    inputs
        By name, for each record an array (N,).
    slopes
        For each record an array (N, m): sensitivities to what was fitted, which the residual cannot contain any more.
    raw
        The residuals with their outliers, if ``residuals`` are without.
    later
        The inputs that act on later rows only.
    """
    colour = fit_autoregression(join_series(residuals), overwrite_input=True)
    square, count = measure_mean(residuals, 2)
    rms = float(np.sqrt(square)) or 1.0

    def make_test(kind: ResidualTestKind, result: tuple[float, float], lags: int = 0, name: str = "") -> ResidualTest:
        statistic, p_value = result
        return ResidualTest(output, kind, statistic, p_value, bool(p_value < ALARM_LEVEL), lags, name, colour)

    series = residuals[0] if len(residuals) == 1 else join_series(residuals)
    tests = [
        make_test(ResidualTestKind.WHITENESS, ljung_box_test(series, lags), lags)
        for lags in WHITENESS_LAGS
        if count > SAMPLES_PER_WHITENESS_LAG * lags
    ]
    for name, records in inputs.items():
        if any(np.ptp(u) > 0 for u in records) and count > SAMPLES_PER_INPUT_LAG * RESIDUAL_TEST_INPUT_LAGS:
            regressors = [LaggedInput.of(signal, RESIDUAL_TEST_INPUT_LAGS) for signal in records]
            if slopes is not None and slopes[0].shape[1]:
                regressors = _take_off(regressors, slopes, [np.isfinite(r) for r in residuals])
            c, p, g = correlate_with_inputs(residuals, regressors, colour)
            # An input that cannot act on the reading of its own row may still answer it: that is a loop, and no lack of the model.
            first = int(name in later)
            result = input_independence_test(c[first:], p[first:, first:])
            tests.append(make_test(ResidualTestKind.INPUT_INDEPENDENCE, result, RESIDUAL_TEST_INPUT_LAGS, name))
            if first:
                tests.append(make_test(ResidualTestKind.SAME_ROW, same_row_test(c, p, g), 0, name))
    del series
    white = [colour.whiten(r / rms, overwrite_input=True) for r in residuals]
    unbounded = white if raw is None else [colour.whiten(r / rms, overwrite_input=True) for r in raw]
    blocks = split_into_blocks(white, RESIDUAL_TEST_BLOCKS, MIN_BLOCK_VALUES)
    others = {
        ResidualTestKind.NORMALITY: normality_test(*unbounded),
        ResidualTestKind.EQUAL_VARIANCE: equal_variance_test(blocks),
        ResidualTestKind.EQUAL_MEAN: equal_mean_test(blocks),
    }
    return tests + [make_test(kind, result) for kind, result in others.items() if result is not None]


def _take_off(
    regressors: Sequence[LaggedInput], slopes: Sequence[np.ndarray], measured: Sequence[np.ndarray]
) -> list[LaggedInput]:
    """Regressors less what the fitted constants could make of them, ``U - J (J'J)^+ J'U``: the residual cannot contain that any more."""
    size = slopes[0].shape[1]
    squares, products = np.zeros((size, size)), np.zeros((size, regressors[0].lags + 1))
    for u, slope, known in zip(regressors, slopes, measured, strict=True):
        for rows in _blocks(len(u)):
            j = np.where(known[rows, None], slope[rows], 0.0)
            squares += j.T @ j
            products += j.T @ u[rows]
    share = decompose_symmetric(squares).solve(products)
    return [replace(u, slopes=slope, share=share) for u, slope in zip(regressors, slopes, strict=True)]
