"""The best linear approximation of a system from periodic records, with its noise and its nonlinear distortion told apart.

Pintelon and Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., section 4.3: the spread from period to period is
noise, as the input repeats and so does every answer to it. The spread from realisation to realisation, with other phases of the same
spectrum, is noise and what a nonlinear system adds. With one realisation, lines that are not excited show the distortion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.stats import f as f_distribution

from greybox.base.errors import DataError, nearest
from greybox.base.values import Check, Printable
from greybox.comparison.frequency.response import FrequencyResponse
from greybox.data.experiment import Experiment, as_records

# Codes of the tests of linearity; their sentences are in `greybox.show.sentences.comparison`.


class LinearityCheck(StrEnum):
    """Tests of a best linear approximation: each compares a variance with that of the noise."""

    REALISATIONS_AGREE = "realisations_agree"
    """The response is the same for other phases of the input."""
    EVEN_LINES_ARE_NOISE = "even_lines_are_noise"
    """Even lines that are not excited hold noise alone."""
    ODD_LINES_ARE_NOISE = "odd_lines_are_noise"
    """Odd lines that are not excited hold noise alone."""


@dataclass(frozen=True, eq=False)
class BestLinearApproximation(Printable):
    """A best linear approximation at the excited lines, averaged over realisations and periods.

    Attributes
    ----------
    input, output
        Names of the signals.
    frequency : array (nf,)
        Excited lines in Hz.
    response : array (nf,)
        Complex response.
    noise_variance : array (nf,)
        Variance of the response by noise alone.
    total_variance : array (nf,) or None
        Variance by noise and nonlinear distortion, from realisation to realisation; None with one realisation.
    realisations, periods
        How many were averaged.
    even, odd : float or None
        Power of the output at even and odd lines that are not excited, over that of the noise there; about 1 for a linear system. None
        where there are no such lines.
    checks
        The tests of linearity; one that failed says that the system is nonlinear.
    """

    input: str
    output: str
    frequency: np.ndarray
    response: np.ndarray
    noise_variance: np.ndarray
    total_variance: np.ndarray | None
    realisations: int
    periods: int
    even: float | None
    odd: float | None
    checks: tuple[Check, ...]

    @property
    def is_linear(self) -> bool | None:
        """Whether nothing but noise disturbs the response; None where nothing was tested."""
        return all(check.passed for check in self.checks) if self.checks else None

    @property
    def distortion_variance(self) -> np.ndarray | None:
        """Variance (nf,) of one realisation's response by nonlinear distortion alone, zero where noise explains the spread."""
        if self.total_variance is None:
            return None
        return np.maximum(self.total_variance - self.noise_variance, 0.0) * self.realisations

    def to_frequency_response(self, sampling_time: float = 0.0) -> FrequencyResponse:
        """The response as a record to be fitted, weighted by its total variance where that is known, else by its noise."""
        variance = (
            self.noise_variance if self.total_variance is None else np.maximum(self.total_variance, self.noise_variance)
        )
        return FrequencyResponse(
            self.frequency,
            self.response[:, None, None],
            (self.input,),
            (self.output,),
            variance[:, None, None],
            sampling_time,
            "best linear approximation",
        )


# Amplitude of a line of the input, over the largest, from which it is excited.
EXCITED_SHARE = 0.0001


def estimate_best_linear_approximation(
    experiments: Experiment | Sequence[Experiment],
    *,
    period: int | None = None,
    input: str | None = None,
    output: str | None = None,
    transient_periods: int = 1,
) -> BestLinearApproximation:
    """Estimate the best linear approximation from records with a periodic input.

    Parameters
    ----------
    experiments
        One record a realisation: the same lines with other random phases, the same period. One record is enough to see noise; two
        or more tell nonlinear distortion from it.
    period
        Rows of a period; None finds it from the input.
    input, output
        Names of the signals; needed where there are several.
    transient_periods
        Periods at the beginning of each record that are left out.

    Returns
    -------
    BestLinearApproximation
        The response with its variances, and the tests of linearity.

    Raises
    ------
    DataError
        For records that are not periodic, too short, irregular, or not excited alike.
    """
    group = as_records(experiments)
    if not group:
        raise DataError("no experiment; give at least one record")
    source = _choose(input, list(group[0].inputs), "input")
    sink = _choose(output, list(group[0].outputs), "output")
    step = group[0].sampling_time
    if step is None or any(e.sampling_time is None or not np.isclose(e.sampling_time, step) for e in group):
        raise DataError("a best linear approximation needs uniform time, the same in all records; resample them")
    rows = period or find_rows_of_period(group[0], source)
    spectra = [_take_periods(e, source, sink, rows, transient_periods) for e in group]
    count = min(len(u) for u, _ in spectra)
    U, Y = (np.stack([part[k][:count] for part in spectra]) for k in (0, 1))  # (realisations, periods, lines)
    size = np.abs(U.mean(axis=1))
    excited = np.flatnonzero(np.all(size > EXCITED_SHARE * size.max(axis=1, keepdims=True), axis=0))
    excited = excited[(excited > 0) & (excited < rows / 2)]
    if not len(excited):
        raise DataError("the records have no excited line in common; give realisations of one spectrum")
    # Each period of the output over the mean of the input, which is free of noise as far as averaging goes.
    ratio = Y[:, :, excited] / U.mean(axis=1)[:, None, excited]
    each = ratio.mean(axis=1)
    # s_n^2 / P: variance of a mean over P periods.
    noise_each = ratio.var(axis=1, ddof=1) / count
    # s_BLA^2 / M over realisations: noise and stochastic nonlinear distortion (Pintelon and Schoukens, section 4.3).
    total = each.var(axis=0, ddof=1) / len(group) if len(group) > 1 else None
    noise = noise_each.mean(axis=0) / len(group)
    checks = []
    if total is not None:
        checks.append(
            _compare_variances(
                LinearityCheck.REALISATIONS_AGREE, total, noise, 2 * (len(group) - 1), 2 * len(group) * (count - 1)
            )
        )
    levels: dict[str, float | None] = {}
    fundamental = excited[excited > 0].min()
    rules = (LinearityCheck.EVEN_LINES_ARE_NOISE, LinearityCheck.ODD_LINES_ARE_NOISE)
    for name, parity, rule in zip(("even", "odd"), (0, 1), rules, strict=True):
        lines = np.arange(fundamental, excited.max() + 1)
        # Even orders of a nonlinearity show at even lines, odd ones at odd lines, of an odd multisine.
        lines = lines[(lines % 2 == parity) & ~np.isin(lines, excited)]
        levels[name] = None
        if len(lines):
            power = np.abs(Y[:, :, lines].mean(axis=1)) ** 2
            spread = Y[:, :, lines].var(axis=1, ddof=1) / count
            levels[name] = float(power.sum() / spread.sum())
            degrees = 2 * len(group), 2 * len(group) * (count - 1)
            # A complex number has two degrees of freedom: 2 M above, 2 M (P - 1) below.
            checks.append(_compare_variances(rule, power.mean(axis=0), spread.mean(axis=0), *degrees))
    return BestLinearApproximation(
        source,
        sink,
        excited / (rows * step),
        each.mean(axis=0),
        noise,
        total,
        len(group),
        count,
        levels["even"],
        levels["odd"],
        tuple(checks),
    )


# Change of the input from one period to the next (rms, over its standard deviation), up to which it repeats; a measured input has noise.
PERIOD_ERROR = 0.01


def find_rows_of_period(experiment: Experiment, input: str) -> int:
    """Find the rows after which an input repeats.

    Parameters
    ----------
    experiment
        The record.
    input
        Name of the input.

    Returns
    -------
    int
        The shortest period.

    Raises
    ------
    DataError
        Where the input does not repeat.
    """
    u = experiment.inputs[input] - experiment.inputs[input].mean()
    n = len(u)
    spread = float(np.std(u))
    if spread:
        # Padded to twice the length: products at a lag, not around the circle.
        transform = np.fft.rfft(u, 2 * n)
        products = np.fft.irfft(np.abs(transform) ** 2)[:n]
        square = np.concatenate(([0.0], np.cumsum(u**2)))
        lags = np.arange(1, n // 2 + 1)
        # Mean square of u[k + lag] - u[k] by its three sums.
        change = (square[n] - square[lags] + square[n - lags] - 2 * products[lags]) / (n - lags)
        repeats = lags[change <= (PERIOD_ERROR * spread) ** 2]
        # A slow input hardly changes over one row: the period is the first repetition after it has changed.
        moved = np.flatnonzero(change > spread**2)
        later = repeats[repeats > (moved[0] + 1 if len(moved) else n)]
        if len(later):
            # Neighbouring lags repeat nearly as well: the best of the first run of them.
            run = later[: 1 + int(np.argmax(np.append(np.diff(later) > 1, True)))]
            return int(run[np.argmin(change[run - 1])])
    raise DataError(
        f"experiment {experiment.name!r}: input {input!r} does not repeat within the record; a periodic one is needed"
        " (greybox.signals.multisine), or give the rows of a period"
    )


# Periods of a record that are needed after the transient: fewer show no noise.
LEAST_PERIODS = 2


def _take_periods(
    experiment: Experiment, source: str, sink: str, rows: int, transient: int
) -> tuple[np.ndarray, np.ndarray]:
    """Spectra (periods, lines) of input and output, amplitude for amplitude."""
    if source not in experiment.inputs or sink not in experiment.outputs:
        raise DataError(f"experiment {experiment.name!r} has no {source!r} or no {sink!r}")
    count = experiment.rows // rows - transient
    if count < LEAST_PERIODS:
        raise DataError(
            f"experiment {experiment.name!r}: {count} whole periods of {rows} rows after the transient, at least"
            f" {LEAST_PERIODS} are needed"
        )
    window = slice(transient * rows, (transient + count) * rows)
    u, y = experiment.inputs[source][window], experiment.outputs[sink][window]
    if not np.isfinite(y).all():
        raise DataError(f"experiment {experiment.name!r}: output {sink!r} has gaps; a spectrum needs every row")
    return tuple(np.fft.rfft(v.reshape(count, rows), axis=1) * 2 / rows for v in (u, y))  # type: ignore[return-value]


# Probability that a linear system is called nonlinear.
FALSE_ALARM = 0.001


def _compare_variances(
    rule: str, upper: np.ndarray, lower: np.ndarray, upper_freedom: int, lower_freedom: int
) -> Check:
    """Whether the first variance (nf,) is no larger than the second: an F test over all lines."""
    lines = len(upper)
    ratio = float(np.mean(upper / np.where(lower > 0, lower, np.finfo(float).tiny)))
    limit = float(f_distribution.ppf(1 - FALSE_ALARM, lines * upper_freedom, lines * lower_freedom))
    # A mean of ratios is larger than a ratio of means by d / (d - 2), of few periods.
    bias = lower_freedom / max(lower_freedom - 2, 1)
    return Check(rule, ratio / bias, limit, ratio / bias <= limit)


def _choose(name: str | None, known: list[str], kind: str) -> str:
    if name is None and len(known) == 1:
        return known[0]
    if name not in known:
        what = "several" if name is None else f"no {name!r}"
        raise DataError(f"{kind}: the record has {what}; {nearest(name or '', known)}")
    return str(name)
