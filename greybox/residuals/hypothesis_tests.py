"""What the residual of a fit says: is it white, free of the inputs, normal, and the same throughout?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from greybox.estimation.objective import SimulationErrorObjective
from greybox.estimation.options import FitOptions
from greybox.estimation.restore import restore_residuals
from greybox.estimation.sandwich import ColumnLayout
from greybox.linear_algebra import decompose_symmetric
from greybox.noise import NOISE_POLICY, AutoRegression, NoisePolicy, fit_autoregression, join_series
from greybox.residuals.policy import RESIDUAL_TEST_POLICY, ResidualTestPolicy
from greybox.residuals.statistics import (
    equal_mean_test,
    equal_variance_test,
    input_independence_test,
    lagged_matrix,
    ljung_box_test,
    normality_test,
    split_into_blocks,
)
from greybox.result import Fit
from greybox.values import Printable

Rows = Sequence[tuple[np.ndarray, np.ndarray]]


class ResidualTestKind(StrEnum):
    """What a residual is tested for."""

    WHITENESS = "whiteness"
    INPUT_INDEPENDENCE = "input_independence"
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
    policy
        The numbers that the tests were made under.
    """

    tests: tuple[ResidualTest, ...]
    whitened: tuple[str, ...] = ()
    residuals: Mapping[str, ResidualSeries] = field(default_factory=dict, repr=False, compare=False)
    policy: ResidualTestPolicy = RESIDUAL_TEST_POLICY

    @property
    def alarms(self) -> tuple[ResidualTest, ...]:
        """The tests that raise an alarm."""
        return tuple(t for t in self.tests if t.alarm)

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


def residual_tests(fit: Fit, *, policy: ResidualTestPolicy = RESIDUAL_TEST_POLICY) -> ResidualTests:
    """Test the free-run residual of each output over all records of a fit, or its innovations where the model has process noise.

    Whiteness over 5, 10 and 20 lags (Ljung and Box); independence of each input over 20 lags, with the covariance that the
    residual's colour gives and the fitted constants allowed for; normality (Jarque and Bera); equal variance and equal mean over
    blocks. Normality and the block tests look at the residual whitened by an autoregression, because they need independent samples.
    After a robust fit all tests but normality look at the residual as its loss sees it, without the pull of outliers. Each test
    alone raises a false alarm in one fit of a hundred.

    Parameters
    ----------
    fit
        A fit that succeeded.
    policy
        Alarm level, lags and blocks.

    Returns
    -------
    ResidualTests
        One `ResidualTest` for each output and question; ``alarms`` holds those that failed.

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
    rows, raw, layout = _restore_rows(fit)
    inputs = {i.name: [trace.inputs[i.name] for trace in fit.traces] for i in fit.model.inputs}
    noise_policy = FitOptions.from_data(fit.provenance.options).policy.noise
    tests: list[ResidualTest] = []
    tested: dict[str, ResidualSeries] = {}
    for j, output in enumerate(fit.model.outputs):
        if output.name not in fit.misfit:
            continue
        residuals, unbounded = [r[:, j] for r, _ in rows], [r[:, j] for r, _ in raw]
        columns = [layout.columns(e) for e in range(len(rows))]
        slopes = _spread_columns([jacobian[:, j] for _, jacobian in rows], columns, layout.size)
        tests += run_residual_tests(output.name, residuals, inputs, slopes, unbounded, policy, noise_policy)
        tested[output.name] = ResidualSeries(
            tuple(residuals),
            tuple(unbounded),
            {name: tuple(each) for name, each in inputs.items()},
            tuple(trace.time for trace in fit.traces),
            fit_autoregression(join_series(residuals), policy=noise_policy),
        )
    whitened = tuple(name for name, reflection in fit.noise.colour.items() if len(reflection))
    return ResidualTests(tuple(tests), whitened, tested, policy)


def run_residual_tests(
    output: str,
    residuals: Sequence[np.ndarray],
    inputs: Mapping[str, list[np.ndarray]],
    slopes: Sequence[np.ndarray] | None = None,
    raw: Sequence[np.ndarray] | None = None,
    policy: ResidualTestPolicy = RESIDUAL_TEST_POLICY,
    noise_policy: NoisePolicy = NOISE_POLICY,
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
    policy
        Alarm level, lags and blocks.
    noise_policy
        How the autoregression of the residual is chosen.
    """
    series = join_series(residuals)
    colour = fit_autoregression(series, policy=noise_policy)
    rms = float(np.sqrt(np.nanmean(series**2))) or 1.0
    white = [colour.whiten(r / rms) for r in residuals]
    count = int(np.isfinite(series).sum())

    def make_test(kind: ResidualTestKind, result: tuple[float, float], lags: int = 0, name: str = "") -> ResidualTest:
        statistic, p_value = result
        return ResidualTest(output, kind, statistic, p_value, bool(p_value < policy.alarm_level), lags, name, colour)

    tests = [
        make_test(ResidualTestKind.WHITENESS, ljung_box_test(series, lags), lags)
        for lags in policy.whiteness_lags
        if count > policy.samples_per_whiteness_lag * lags
    ]
    for name, records in inputs.items():
        if any(np.ptp(u) > 0 for u in records) and count > policy.samples_per_input_lag * policy.input_lags:
            regressors = [lagged_matrix(u, policy.input_lags) for u in records]
            result = input_independence_test(residuals, _remove_fitted(slopes, regressors, residuals), colour)
            tests.append(make_test(ResidualTestKind.INPUT_INDEPENDENCE, result, policy.input_lags, name))
    whitened = np.concatenate(white if raw is None else [colour.whiten(r / rms) for r in raw])
    blocks = split_into_blocks(white, policy.blocks, policy.min_block_values)
    return [
        *tests,
        make_test(ResidualTestKind.NORMALITY, normality_test(whitened)),
        make_test(ResidualTestKind.EQUAL_VARIANCE, equal_variance_test(blocks)),
        make_test(ResidualTestKind.EQUAL_MEAN, equal_mean_test(blocks)),
    ]


def _restore_rows(fit: Fit) -> tuple[Rows, Rows, ColumnLayout]:
    """Residual or innovations and slopes of each record, the same with the outliers that a robust fit leaves out, and where its slopes
    belong.
    """
    objective, residuals = restore_residuals(fit)
    raw = residuals.rows
    if isinstance(objective, SimulationErrorObjective) and objective.problem.loss is not None:
        raw = SimulationErrorObjective(replace(objective.problem, loss=None)).linearise().rows
    return residuals.rows, raw, objective.variables


def _spread_columns(slopes: Sequence[np.ndarray], columns: Sequence[np.ndarray], size: int) -> list[np.ndarray]:
    """Sensitivities of each record (N, L) laid out over all unknowns (N, size)."""
    result = []
    for slope, where in zip(slopes, columns, strict=True):
        wide = np.zeros((len(slope), size))
        wide[:, where] = slope
        result.append(wide)
    return result


def _remove_fitted(
    slopes: Sequence[np.ndarray] | None, regressors: list[np.ndarray], residuals: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """The regressors less what the fitted constants could make of them."""
    measured = np.concatenate([np.isfinite(r) for r in residuals])
    u = np.where(measured[:, None], np.concatenate(regressors), 0.0)
    if slopes is not None and slopes[0].shape[1]:
        j = np.where(measured[:, None], np.concatenate(slopes), 0.0)
        u = u - j @ decompose_symmetric(j.T @ j).solve(j.T @ u)
    return np.split(u, np.cumsum([len(r) for r in residuals])[:-1])
