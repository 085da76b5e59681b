"""What the residual of a fit says: is it white, free of the inputs, normal, and the same throughout?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from greybox.estimation.restore import restore_problem
from greybox.estimation.restore_likelihood import compute_innovation_rows
from greybox.estimation.sandwich import ColumnLayout
from greybox.noise import AutoRegression, fit_autoregression, join_series
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
from greybox.transcription.robust_shooting import RobustShooting

Rows = Sequence[tuple[np.ndarray, np.ndarray]]

# A test speaks up below this p-value.
ALARM = 0.01
WHITENESS_LAGS = (5, 10, 20)
INPUT_LAGS = 20
# Blocks of the stationarity tests, and the least values of one.
BLOCKS, LEAST_OF_BLOCK = 8, 10


@dataclass(frozen=True)
class ResidualTest:
    """One test of one output: its figure, its p-value, whether that raises an alarm (below 1 %), and a sentence."""

    output: str
    test: str
    statistic: float
    p_value: float
    alarm: bool
    sentence: str


@dataclass(frozen=True, eq=False)
class ResidualSeries:
    """The residual of one output that the tests looked at, over its noise: for each record ``series`` (N,), NaN in gaps.

    ``raw`` (N,) has the outliers that a robust fit keeps out of ``series``; ``inputs`` by name, for each record (N,); ``time`` (N,) of each
    record in seconds; ``colour`` the autoregression of ``series``.
    """

    series: tuple[np.ndarray, ...]
    raw: tuple[np.ndarray, ...]
    inputs: Mapping[str, tuple[np.ndarray, ...]]
    time: tuple[np.ndarray, ...]
    colour: AutoRegression


@dataclass(frozen=True)
class ResidualTests:
    """All tests of a fit; ``whitened``: outputs whose residual was whitened with their known noise colour first.

    ``residuals``: what was tested, by output.
    """

    tests: tuple[ResidualTest, ...]
    whitened: tuple[str, ...] = ()
    residuals: Mapping[str, ResidualSeries] = field(default_factory=dict, repr=False, compare=False)

    @property
    def alarms(self) -> tuple[ResidualTest, ...]:
        """The tests that speak up."""
        return tuple(t for t in self.tests if t.alarm)

    def of(self, output: str, test: str) -> ResidualTest:
        """One test by output and name."""
        return next(t for t in self.tests if (t.output, t.test) == (output, test))

    def __str__(self) -> str:
        rows = [
            ("output", "test", "figure", "p", ""),
            *((t.output, t.test, f"{t.statistic:.4g}", f"{t.p_value:.2g}", t.sentence) for t in self.tests),
        ]
        widths = [max(len(row[k]) for row in rows) for k in range(4)]
        lines = [
            "  ".join([*(cell.ljust(w) for cell, w in zip(row, widths, strict=False)), row[4]]).rstrip() for row in rows
        ]
        if self.whitened:
            lines.append(
                f"residual of {', '.join(self.whitened)} whitened with the colour of its noise before the tests"
            )
        return "\n".join(lines)


def residual_tests(fit: Fit) -> ResidualTests:
    """Tests of each output's free-run residual over all records of ``fit``; of its innovations, where the model has process noise.

    Whiteness over 5, 10 and 20 lags (Ljung and Box); independence of each input over 20 lags, with the covariance that the
    residual's colour gives and the fitted constants allowed for; normality (Jarque and Bera); equal variance and equal mean over
    blocks. Normality and the block tests look at the residual whitened by an autoregression, because they need independent samples.
    After a robust fit all tests but normality look at the residual as its loss sees it, without the pull of outliers. Each test
    alone raises a false alarm in one fit of a hundred.

    Raises FitError for a fit that did not succeed, and for one whose run is not a free one (arcs, or the segments of an unstable
    plant): states that are set anew along the record take up what the model lacks, and the tests would not see it.
    """
    rows, raw, variables = _innovations(fit) if fit.prediction.process_noise else _free_run(fit)
    inputs = [[trace.inputs[i.name] for trace in fit.traces] for i in fit.model.inputs]
    tests: list[ResidualTest] = []
    looked_at: dict[str, ResidualSeries] = {}
    for j, output in enumerate(fit.model.outputs):
        if output.name in fit.misfit:
            residuals = [r[:, j] for r, _ in rows]
            slopes = _separate(
                [jacobian[:, j] for _, jacobian in rows],
                [variables.columns(e) for e in range(len(rows))],
                variables.size,
            )
            tests += run_residual_tests(
                output.name, residuals, dict(zip((i.name for i in fit.model.inputs), inputs, strict=True)), slopes,
                [r[:, j] for r, _ in raw],
            )  # fmt: skip
            looked_at[output.name] = ResidualSeries(
                tuple(residuals), tuple(r[:, j] for r, _ in raw),
                {i.name: tuple(given) for i, given in zip(fit.model.inputs, inputs, strict=True)},
                tuple(trace.time for trace in fit.traces), fit_autoregression(join_series(residuals)),
            )  # fmt: skip
    whitened = tuple(n for n, k in fit.noise.colour.items() if len(k))
    return ResidualTests(tuple(tests), whitened, looked_at)


def _free_run(fit: Fit) -> tuple[Rows, Rows, ColumnLayout]:
    """Residual and slopes of each record, the same with the outliers that a robust fit leaves out, and where its slopes belong."""
    problem = restore_problem(fit)
    variables = problem.variables
    shooting, zero = problem.shooting(variables), np.zeros(variables.size)
    rows = shooting.residuals(zero)
    return rows, shooting.whitened(zero) if isinstance(shooting, RobustShooting) else rows, variables


def _innovations(fit: Fit) -> tuple[Rows, Rows, ColumnLayout]:
    rows, cost = compute_innovation_rows(fit)
    return rows, rows, cost.unknowns


def run_residual_tests(
    output: str,
    residuals: Sequence[np.ndarray],
    inputs: dict[str, list[np.ndarray]],
    slopes: Sequence[np.ndarray] | None = None,
    raw: Sequence[np.ndarray] | None = None,
) -> list[ResidualTest]:
    """The tests of one output: its residuals (N,) and the ``inputs`` (N,) of each record, NaN in gaps.

    ``slopes`` (N, m) of each record: sensitivities to what was fitted, which the residual cannot contain any more. ``raw``: the
    residuals with their outliers, if ``residuals`` are without.
    """
    series = join_series(residuals)
    colour = fit_autoregression(series)
    rms = float(np.sqrt(np.nanmean(series**2))) or 1.0
    white = [colour.whiten(r / rms) for r in residuals]
    count = int(np.isfinite(series).sum())
    tests = []
    for lags in WHITENESS_LAGS:
        if count > 5 * lags:
            figure, p = ljung_box_test(series, lags)
            says = f"correlated over {lags} samples ({colour})" if p < ALARM else f"no correlation over {lags} samples"
            tests.append(_test(output, f"whiteness, {lags} lags", figure, p, says))
    for name, records in inputs.items():
        if any(np.ptp(u) > 0 for u in records) and count > 10 * INPUT_LAGS:
            figure, p = input_independence_test(
                residuals, _free_of(slopes, [lagged_matrix(u, INPUT_LAGS) for u in records], residuals), colour
            )
            says = (
                f"follows the input {name}: the model misses part of its effect"
                if p < ALARM
                else f"no trace of the input {name}"
            )
            tests.append(_test(output, f"independence of {name}", figure, p, says))
    figure, p = normality_test(np.concatenate(white if raw is None else [colour.whiten(r / rms) for r in raw]))
    says = (
        "not normal: look for outliers, quantisation or two regimes"
        if p < ALARM
        else "consistent with a normal distribution"
    )
    tests.append(_test(output, "normality", figure, p, says))
    blocks = split_into_blocks(white, BLOCKS, LEAST_OF_BLOCK)
    figure, p = equal_variance_test(blocks)
    says = "larger in some parts of the record than in others" if p < ALARM else "equally large throughout"
    tests.append(_test(output, "equal variance", figure, p, says))
    figure, p = equal_mean_test(blocks)
    says = "its mean wanders: drift, or an offset that changes" if p < ALARM else "no drift"
    tests.append(_test(output, "equal mean", figure, p, says))
    return tests


def _test(output: str, test: str, figure: float, p: float, sentence: str) -> ResidualTest:
    return ResidualTest(output, test, figure, p, bool(p < ALARM), sentence)


def _separate(slopes: Sequence[np.ndarray], columns: Sequence[np.ndarray], size: int) -> list[np.ndarray]:
    """Sensitivities of each record (N, L) laid out over all unknowns (N, size)."""
    result = []
    for slope, where in zip(slopes, columns, strict=True):
        wide = np.zeros((len(slope), size))
        wide[:, where] = slope
        result.append(wide)
    return result


def _free_of(
    slopes: Sequence[np.ndarray] | None, regressors: list[np.ndarray], residuals: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """The regressors less what the fitted constants could make of them."""
    there = np.concatenate([np.isfinite(r) for r in residuals])
    u = np.where(there[:, None], np.concatenate(regressors), 0.0)
    if slopes is not None and slopes[0].shape[1]:
        j = np.where(there[:, None], np.concatenate(slopes), 0.0)
        norm = np.linalg.norm(j, axis=0)
        j = j[:, norm > 0] / norm[norm > 0]
        u = u - j @ (np.linalg.pinv(j.T @ j, rcond=1e-12, hermitian=True) @ (j.T @ u))
    return np.split(u, np.cumsum([len(r) for r in residuals])[:-1])
