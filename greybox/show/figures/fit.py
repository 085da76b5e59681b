"""How well a fit is known, as figures: its residual (one figure for each output, one panel for each kind of test) and its parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.special import ndtri

from greybox.base import ROWS_AT_A_TIME
from greybox.base import figure as fig
from greybox.data.noise.noise_model import AutoRegression
from greybox.estimation import Estimate, Fit
from greybox.estimation.residuals import ResidualSeries, ResidualTest, ResidualTestKind, ResidualTests, measure_mean
from greybox.estimation.result_parts import StartResult
from greybox.show.figures.figure import choose_evenly, draw_over_time
from greybox.show.sentences.estimation import name_test
from greybox.show.sentences.wording import percent_text


def plot_residual_tests(tests: ResidualTests, output: str, name: str) -> fig.Figure:
    """The tests of one output.

    Panels: the autocorrelation with the 95 % band of white noise; the correlation with each input that moves, later and earlier, with a
    band that the residual's own colour widens; the residual against a normal one; its mean and spread along the records. Above each
    stands what its tests say.
    """
    series = tests.residuals[output]
    of_output = [t for t in tests.tests if t.output == output]
    moving = [u for u, records in series.inputs.items() if any(np.ptp(record) > 0 for record in records)]
    panels = (
        _autocorrelation(series, _of_kind(of_output, ResidualTestKind.WHITENESS)),
        *(_input_correlation(series, u, [t for t in of_output if t.input == u]) for u in moving),
        _normal_plot(series, _of_kind(of_output, ResidualTestKind.NORMALITY)),
        _along_records(series, _of_kind(of_output, ResidualTestKind.EQUAL_VARIANCE, ResidualTestKind.EQUAL_MEAN)),
    )
    return fig.Figure(
        name, panels, f"Tests of the residual of {output}.", tuple(title for panel in panels for title in panel.titles)
    )


def cross_correlation(first: Sequence[np.ndarray], second: Sequence[np.ndarray], lags: int) -> tuple[np.ndarray, int]:
    """Correlation of ``second`` with what ``first`` was some samples before, over all records.

    Parameters
    ----------
    first, second
        Of each record (N,), NaN in gaps; pairs that touch a gap are left out, means are taken off.
    lags
        The largest number of samples.

    Returns
    -------
    correlation, count
        (lags + 1,) from lag 0 on, and the samples of ``second``.
    """
    products, pairs = np.zeros((2, lags + 1))
    squares, counts = np.zeros((2, 2))
    for a, b in zip(first, second, strict=True):
        means = measure_mean([a])[0], measure_mean([b])[0]
        for begin in range(0, len(b), ROWS_AT_A_TIME):  # a long record is not copied
            # A block of ``second``, and what ``first`` was before it.
            before, end = max(begin - lags, 0), begin + ROWS_AT_A_TIME
            r = [each[before:end] - mean for each, mean in zip((a, b), means, strict=True)]
            known = [np.isfinite(each) for each in r]
            for k in (0, 1):
                r[k][~known[k]] = 0.0
                squares[k] += r[k][begin - before :] @ r[k][begin - before :]
                counts[k] += known[k][begin - before :].sum()
            for k in range(min(lags, len(b) - 1) + 1):  # further apart than it is long there are no pairs
                late, early = (slice(max(begin, k) - before - n, len(r[1]) - n) for n in (0, k))
                products[k] += r[0][early] @ r[1][late]
                pairs[k] += (known[0][early] & known[1][late]).sum()
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = np.sqrt(squares / counts)
        correlation = products / pairs / np.prod(np.where(sizes > 0, sizes, 1.0))
    return np.where(pairs > 0, correlation, 0.0), int(counts[1])


def _of_kind(tests: Sequence[ResidualTest], *kinds: ResidualTestKind) -> list[ResidualTest]:
    return [t for t in tests if t.kind in kinds]


# Lags of an autocorrelation.
DRAWING_LAGS = 40


def _autocorrelation(series: ResidualSeries, tests: Sequence[ResidualTest]) -> fig.Panel:
    rho, count = cross_correlation(series.series, series.series, DRAWING_LAGS)
    band = float(_quantile() / np.sqrt(max(count, 1)))
    lags = np.arange(1, DRAWING_LAGS + 1)
    return _correlation_panel("autocorrelation", lags, rho[1:], band, fig.Axis("lag", "samples"), tests)


# Lags of a correlation with an input, to both sides.
DRAWING_INPUT_LAGS = 20


def _input_correlation(series: ResidualSeries, name: str, tests: Sequence[ResidualTest]) -> fig.Panel:
    inputs = series.inputs[name]
    after, count = cross_correlation(inputs, series.series, DRAWING_INPUT_LAGS)
    before, _ = cross_correlation(series.series, inputs, DRAWING_INPUT_LAGS)
    lags = np.arange(-DRAWING_INPUT_LAGS, DRAWING_INPUT_LAGS + 1)
    values = np.concatenate([before[:0:-1], after])
    axis = fig.Axis(f"lag of the residual behind {name}", "samples")
    return _correlation_panel(
        f"correlation with {name}", lags, values, _band(inputs, series.colour, count), axis, tests
    )


def _correlation_panel(
    name: str, lags: np.ndarray, values: np.ndarray, band: float, x: fig.Axis, tests: Sequence[ResidualTest]
) -> fig.Panel:
    reach = 1.15 * max(float(np.abs(values).max(initial=0.0)), 2 * band)
    bars = fig.Bars(lags, values, [fig.Role.RESIDUAL] * len(lags), name, width=0.3)
    series = (fig.Band(-band, band, label="95 % of white noise"), fig.Reference(0.0, width=0.6), bars)
    return fig.Panel(
        name, series, x, fig.Axis(name, limits=(-reach, reach)), _titles(tests), any(t.alarm for t in tests)
    )


# Points of a plot against the normal distribution.
NORMAL_POINTS = 2000


def _normal_plot(series: ResidualSeries, tests: Sequence[ResidualTest]) -> fig.Panel:
    values = np.concatenate([part[np.isfinite(part)] for part in series.raw])
    values.sort()
    shown = choose_evenly(len(values), NORMAL_POINTS)
    expected = expect_normal_order(len(values), shown)
    # The line of least squares through all points: slope = sum e v / sum e^2, as the expected ones are symmetric about zero.
    middle, moments = float(values.mean()), np.zeros(2)
    for begin in range(0, len(values), ROWS_AT_A_TIME):
        rows = np.arange(begin, min(begin + ROWS_AT_A_TIME, len(values)))
        of_rows = expect_normal_order(len(values), rows)
        moments += of_rows @ values[rows], of_rows @ of_rows
    slope, ends = moments[0] / moments[1], expected[[0, -1]]
    drawn = (
        fig.Points(expected, values[shown], fig.Role.RESIDUAL, size=4.0),
        fig.Curve(ends, middle + slope * ends, fig.Role.SIMULATED, "normal distribution"),
    )
    axes = fig.Axis("quantile of a normal distribution"), fig.Axis("residual / noise")
    return fig.Panel("normal distribution", drawn, *axes, _titles(tests), any(t.alarm for t in tests))


# Stretches of all records whose mean and spread are drawn.
DRAWING_PARTS = 20
# Share of a normalised residual within the limits of its axis.
DRAWING_RESIDUAL_SHARE = 0.998


def _along_records(series: ResidualSeries, tests: Sequence[ResidualTest]) -> fig.Panel:
    """The residual along all records, and mean and spread of its stretches."""
    rows_of_all = sum(map(len, series.series))
    total = float(np.sqrt(measure_mean(series.series, 2)[0])) or 1.0
    behind: list[fig.Series] = []
    front: list[fig.Series] = []
    start = 0.0
    for time, residual in zip(series.time, series.series, strict=True):
        shift = start - float(time[0])
        curve = draw_over_time(time, residual, fig.Role.BAND, width=0.9)
        behind.append(replace(curve, x=curve.x + shift))
        count = max(2, round(DRAWING_PARTS * len(residual) / rows_of_all))
        edges = np.linspace(0, len(residual), count + 1).astype(int)
        stretches = [np.flatnonzero(np.isfinite(residual[a:b])) + a for a, b in pairwise(edges)]
        stretches = [rows for rows in stretches if len(rows) > 1]
        middle = np.array([time[rows].mean() + shift for rows in stretches])
        mean, spread = (np.array([f(residual[rows]) for rows in stretches]) for f in (np.mean, np.std))
        first = start == 0.0
        front += [
            fig.Points(middle, mean, fig.Role.SIMULATED, "mean" if first else "", joined=True),
            fig.Points(
                middle, spread, fig.Role.RESIDUAL, "spread" if first else "", symbol=fig.Symbol.SQUARE, joined=True
            ),
        ]
        start = float(time[-1]) + shift
    lines = (fig.Reference(0.0, width=0.6), fig.Reference(total, width=0.6, dash=fig.Dash.DASHED))
    sizes = np.abs(np.concatenate([part[np.isfinite(part)] for part in series.series]))
    reach = 1.15 * max(float(np.quantile(sizes, DRAWING_RESIDUAL_SHARE, overwrite_input=True)), total)
    time_axis = fig.Axis("time of all records" if len(series.time) > 1 else "time", "s")
    axis = fig.Axis("residual / noise", limits=(-reach, reach))
    return fig.Panel(
        "mean and spread", (*behind, *lines, *front), time_axis, axis, _titles(tests), any(t.alarm for t in tests)
    )


def _titles(tests: Sequence[ResidualTest]) -> tuple[str, ...]:
    """What the tests say: of those that raise an alarm the clearest of each kind, else the least comfortable one."""
    ordered = sorted(tests, key=lambda t: t.p_value)
    alarms = list({(t.kind, t.input): t for t in reversed(ordered) if t.alarm}.values())
    return tuple(f"{name_test(t)} (p = {t.p_value:.2g}): {t}" for t in alarms or ordered[:1])


# Lags that the band of a correlation with an input allows for.
BAND_LAGS = 400


def _band(inputs: Sequence[np.ndarray], colour: AutoRegression, count: int) -> float:
    """95 % band of the correlation with an input: ``1.96 sqrt(sum rho_r rho_u / N)``, both colours allowed for (Bartlett)."""
    lags = min(max(len(u) for u in inputs) - 1, BAND_LAGS)
    of_input, _ = cross_correlation(inputs, inputs, lags)
    of_residual = colour.autocorrelation(lags + 1)
    both = max(1.0 + 2 * float(of_input[1:] @ of_residual[1:]), 1.0 / max(count, 1))
    return float(_quantile() * np.sqrt(both / max(count, 1)))


# Of the band around the correlations of a residual that is white.
DRAWING_CONFIDENCE = 0.95


def _quantile() -> float:
    return float(ndtri((1 + DRAWING_CONFIDENCE) / 2))


def expect_normal_order(count: int, places: np.ndarray) -> np.ndarray:
    """Medians of the values at some ``places`` of an ordered normal sample of ``count`` (Filliben 1975).

    `scipy.stats` has them, and takes half a second to load.
    """
    medians = (places + 1 - 0.3175) / (count + 0.365)
    largest = 0.5 ** (1 / count)
    medians = np.where(places == count - 1, largest, np.where(places == 0, 1 - largest, medians))
    return ndtri(medians)


# Fitted parameters in figures: how well each is known, and which ones the records cannot tell apart.


def plot_intervals(percent: Mapping[str, float], caption: str) -> fig.Figure | None:
    """A mark for each parameter at half the width of its 95 % interval, in ``percent`` of the value; None for fewer than two."""
    if len(percent) < 2:
        return None
    ranked = dict(sorted(percent.items(), key=lambda item: item[1]))
    sizes = np.array(list(ranked.values()))
    marks = fig.Points(sizes, list(ranked), fig.Role.RESIDUAL, size=11, texts=[percent_text(p / 100, 2) for p in sizes])
    limits = 10 ** (math.log10(sizes[0]) - 0.3), 10 ** (math.log10(sizes[-1]) + 0.7)
    x = fig.Axis("half width of the 95 % interval", "% of the value", fig.Scale.LOG, limits)
    panel = fig.Panel(
        "intervals", (marks,), x, fig.Axis(scale=fig.Scale.CATEGORY, reversed=True), height=fig.Height.PER_CATEGORY
    )
    return fig.Figure(
        "intervals",
        (panel,),
        caption,
        ("; ".join(f"{name} {percent_text(width / 100)}" for name, width in ranked.items()),),
    )


def relative_half_widths(fit: Fit) -> dict[str, float]:
    """Half the 95 % interval of each parameter that has one, in percent of the value."""
    return {name: half for name, e in fit.parameters.items() if (half := relative_half_width(e)) is not None}


def relative_half_width(e: Estimate) -> float | None:
    """Half the 95 % interval in percent of the value; None where there is no interval, or a limit alone."""
    if e.std is None or e.interval is None or not e.value or not all(map(math.isfinite, e.interval)):
        return None
    return 100 * (e.interval[1] - e.interval[0]) / 2 / abs(e.value) or None


def misfits_over_best(starts: Sequence[StartResult]) -> list[float]:
    """Misfit of each start over the least of all; that over the noise stands in the answer, output by output."""
    least = min((s.noise_ratio for s in starts if math.isfinite(s.noise_ratio)), default=math.nan)
    return [s.noise_ratio / least if least else s.noise_ratio for s in starts]


# Starts with a number below them.
MOST_NUMBERED_STARTS = 12


def plot_starts(starts: Sequence[StartResult]) -> fig.Figure:
    """The waterfall: misfit at the end of each start over that of the best one, best first."""
    known = [ratio for ratio in misfits_over_best(starts) if math.isfinite(ratio)]
    y = fig.Axis("misfit / best misfit", scale=fig.Scale.LOG if known and max(known) > 10 else fig.Scale.LINEAR)
    marks = fig.Points(np.arange(1, len(known) + 1), np.array(known), fig.Role.RESIDUAL, joined=True)
    # Starts are counted: no number between two of them.
    x = fig.Axis("start, best first", spacing=float(math.ceil(len(known) / MOST_NUMBERED_STARTS) or 1))
    panel = fig.Panel("starts", (marks,), x, y)
    text = f"{len(known)} of {len(starts)} starts ended with a run; the worst misfit is {max(known, default=math.nan):.3g} times the best"
    return fig.Figure(
        "starts",
        (panel,),
        "Misfit where each start ended, over that of the best one: a level that several reach is no chance.",
        (text,),
    )


# Parameters correlated more than this are called out: the records tell their ratio or product better than each.
DRAWING_CORRELATED = 0.95


def plot_correlation(fit: Fit) -> fig.Figure | None:
    """Which parameters the records move together; None for fewer than two."""
    names = list(fit.uncertainty.free)
    if len(names) < 2 or not np.isfinite(fit.uncertainty.covariance).any():
        return None
    category = fig.Axis(scale=fig.Scale.CATEGORY)
    heatmap = fig.Heatmap(parameter_correlation(fit), names)
    panel = fig.Panel(
        "correlation",
        (heatmap,),
        category,
        fig.Axis(scale=fig.Scale.CATEGORY, reversed=True),
        height=fig.Height.PER_CATEGORY,
    )
    description = strongly_correlated_pairs(fit) or (f"No correlation exceeds {DRAWING_CORRELATED}",)
    return fig.Figure(
        "correlation",
        (panel,),
        "Correlation of the fitted parameters. Near 1 or -1 the records determine a combination of two parameters, not each of them.",
        tuple(description),
    )


def parameter_correlation(fit: Fit) -> np.ndarray:
    """Correlation (nf, nf) of the free parameters; NaN where one is not determined."""
    std = np.sqrt(np.maximum(np.diag(fit.uncertainty.covariance), 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(fit.uncertainty.covariance / np.outer(std, std))


def strongly_correlated_pairs(fit: Fit) -> tuple[str, ...]:
    """Pairs of parameters that the records hardly tell apart, the closest first."""
    rho, names = parameter_correlation(fit), fit.uncertainty.free
    pairs = [
        (abs(rho[i, j]), i, j)
        for i in range(len(names))
        for j in range(i)
        if np.isfinite(rho[i, j]) and abs(rho[i, j]) > DRAWING_CORRELATED
    ]
    return tuple(
        f"{names[j]} and {names[i]} have a correlation of {rho[i, j]:.3f}: the records determine their"
        f" {'ratio' if rho[i, j] > 0 else 'product'} better than either"
        for _, i, j in sorted(pairs, reverse=True)
    )
