"""What the residual of a fit says, in pictures: one file for each output, one panel for each kind of test."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.stats import norm, probplot

from greybox.noise import AutoRegression
from greybox.plots.files import save_figure
from greybox.plots.of_fit import BAND, RESIDUAL, SIMULATED
from greybox.plots.thinning import min_max_envelope
from greybox.plots.units import typeset_unit
from greybox.residuals import ResidualSeries, ResidualTest, ResidualTests

LAGS, INPUT_LAGS = 40, 20
LOOKED_AT = 20  # stretches of all records in which spread and mean are looked at
MOST_POINTS = 2000  # of the normal plot
SMALL = 8
TITLE_WIDTH = 85  # characters of a title above one panel


def residual_figure(tests: ResidualTests, directory: str | Path, *, title: str = "") -> list[Path]:
    """Draw the tests of each output into ``directory`` as PNG, ``residual-<output>.png``, with an SVG beside it; returns the PNG files.

    Panels: the autocorrelation with the band that white noise stays in (95 %); the correlation with each input that moves, later
    and earlier, with a band that the residual's own colour widens; the residual against a normal one; and its mean and spread along
    the records. Above each stands the test with its p-value and what it says, in red where it speaks up.
    """
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for output, series in tests.residuals.items():
        file = folder / f"residual-{re.sub(r'[^A-Za-z0-9_.-]+', '_', output)}.png"
        own = [t for t in tests.tests if t.output == output]
        save_figure(_draw(output, series, own, title), file)
        files.append(file)
    return files


def _draw(output: str, series: ResidualSeries, tests: Sequence[ResidualTest], title: str) -> Figure:
    moving = [name for name, records in series.inputs.items() if any(np.ptp(u) > 0 for u in records)]
    rows = 2 + (len(moving) > 1) * ((len(moving) + 2) // 2 - 1)
    figure = Figure(figsize=(11, 3.4 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(figure.subplots(rows, 2, squeeze=False).ravel())
    figure.suptitle(f"{title}: residual of {output}" if title else f"residual of {output}", fontsize=11)
    _autocorrelation(axes[0], series, _named(tests, "whiteness"))
    for axis, name in zip(axes[1:], moving, strict=False):
        _with_input(axis, series, name, _named(tests, f"independence of {name}"))
    left = axes[1 + len(moving) :] if moving else axes[1:]
    _normal(left[0], series, _named(tests, "normality"))
    _along(left[1], series, _named(tests, "equal"))
    for axis in left[2:]:
        axis.remove()
    return figure


def _named(tests: Sequence[ResidualTest], beginning: str) -> list[ResidualTest]:
    return [t for t in tests if t.test.startswith(beginning)]


def _autocorrelation(axis: Axes, series: ResidualSeries, tests: Sequence[ResidualTest]) -> None:
    rho, count = cross_correlation(series.series, series.series, LAGS)
    _stems(axis, np.arange(1, LAGS + 1), rho[1:], norm.ppf(0.975) / np.sqrt(max(count, 1)))
    axis.set_xlabel("lag [samples]", fontsize=SMALL)
    axis.set_ylabel("autocorrelation", fontsize=SMALL)
    _say(axis, tests)


def _with_input(axis: Axes, series: ResidualSeries, name: str, tests: Sequence[ResidualTest]) -> None:
    inputs = series.inputs[name]
    after, count = cross_correlation(inputs, series.series, INPUT_LAGS)
    before, _ = cross_correlation(series.series, inputs, INPUT_LAGS)
    lags = np.arange(-INPUT_LAGS, INPUT_LAGS + 1)
    band = _band(inputs, series.colour, count)
    _stems(axis, lags, np.concatenate([before[:0:-1], after]), band)
    axis.set_xlabel(f"lag of the residual behind {name} [samples]", fontsize=SMALL)
    axis.set_ylabel(f"correlation with {name}", fontsize=SMALL)
    _say(axis, tests)


def _normal(axis: Axes, series: ResidualSeries, tests: Sequence[ResidualTest]) -> None:
    values = np.concatenate(series.raw)
    values = np.sort(values[np.isfinite(values)])
    (expected, ordered), (slope, middle, _) = probplot(values)
    shown = np.unique(np.linspace(0, len(values) - 1, MOST_POINTS).astype(int))
    axis.plot(expected[shown], ordered[shown], ".", color=RESIDUAL, ms=3)
    axis.plot(expected[[0, -1]], middle + slope * expected[[0, -1]], color=SIMULATED, lw=0.9)
    axis.set_xlabel("quantile of a normal distribution", fontsize=SMALL)
    axis.set_ylabel("residual / noise", fontsize=SMALL)
    _say(axis, tests)


def _along(axis: Axes, series: ResidualSeries, tests: Sequence[ResidualTest]) -> None:
    start = 0.0
    every = np.concatenate(series.series)
    total = float(np.sqrt(np.nanmean(every**2))) or 1.0
    for time, r in zip(series.time, series.series, strict=True):
        since = start + time - time[0]
        axis.plot(*min_max_envelope(since, r), color=BAND, lw=0.6)
        count = max(2, round(LOOKED_AT * len(r) / len(every)))
        parts = [np.flatnonzero(np.isfinite(r[a:b])) + a for a, b in _stretches(len(r), count)]
        parts = [p for p in parts if len(p) > 1]
        middle = [since[p].mean() for p in parts]
        mean, spread = (np.array([f(r[p]) for p in parts]) for f in (np.mean, np.std))
        axis.plot(middle, mean, "o-", color=SIMULATED, ms=3, lw=0.9, label="mean" if start == 0 else None)
        axis.plot(middle, spread, "s-", color=RESIDUAL, ms=3, lw=0.9, label="spread" if start == 0 else None)
        start = float(since[-1])
    axis.axhline(0.0, color="0.6", lw=0.6)
    axis.axhline(total, color="0.6", lw=0.6, ls="--")
    axis.set_xlabel(f"time{' of all records' if len(series.time) > 1 else ''} [{typeset_unit('s')}]", fontsize=SMALL)
    axis.set_ylabel("residual / noise", fontsize=SMALL)
    reach = 1.15 * max(float(np.nanquantile(np.abs(every), 0.998)), total)
    axis.set_ylim(-reach, reach)
    axis.legend(loc="upper right", fontsize=7, frameon=False, ncols=2)
    _say(axis, tests)


def _stems(axis: Axes, lags: np.ndarray, values: np.ndarray, band: float) -> None:
    axis.axhspan(-band, band, color=BAND, lw=0)
    axis.vlines(lags, 0, values, color=RESIDUAL, lw=1.4)
    axis.axhline(0.0, color="0.4", lw=0.6)
    reach = 1.15 * max(float(np.abs(values).max(initial=0.0)), 2 * band)
    axis.set_ylim(-reach, reach)
    axis.margins(x=0.02)


def _say(axis: Axes, tests: Sequence[ResidualTest]) -> None:
    """The tests as the title: those that speak up in red, the clearest of each kind, else the least comfortable one."""
    ordered = sorted(tests, key=lambda t: t.p_value)
    loud = list({t.test.partition(",")[0]: t for t in reversed(ordered) if t.alarm}.values())
    told = loud or ordered[:1]
    lines = [fill(f"{t.test} (p = {t.p_value:.2g}): {t.sentence}", TITLE_WIDTH) for t in told]
    axis.set_title("\n".join(lines), loc="left", fontsize=8, color=SIMULATED if loud else "0.2")
    axis.tick_params(labelsize=SMALL)
    axis.grid(alpha=0.25, lw=0.5)


def cross_correlation(first: Sequence[np.ndarray], second: Sequence[np.ndarray], lags: int) -> tuple[np.ndarray, int]:
    """Correlation (lags + 1,) of ``second`` with what ``first`` was 0 ... ``lags`` samples before, over all records; and the samples.

    Series (N,) of each record with NaN in gaps, each less its mean; pairs that touch a gap are left out.
    """
    pairs = [(a - np.nanmean(a), b - np.nanmean(b)) for a, b in zip(first, second, strict=True)]
    sizes = [np.sqrt(np.nanmean(np.concatenate([p[k] for p in pairs]) ** 2)) or 1.0 for k in (0, 1)]
    found = np.zeros(lags + 1)
    for k in range(lags + 1):
        products = np.concatenate([a[: max(len(a) - k, 0)] * b[k:] for a, b in pairs])
        there = np.isfinite(products)
        found[k] = products[there].mean() / (sizes[0] * sizes[1]) if there.any() else 0.0
    return found, int(sum(np.isfinite(b).sum() for _, b in pairs))


def _band(inputs: Sequence[np.ndarray], colour: AutoRegression, count: int) -> float:
    """95 % band of the correlation with an input: ``1.96 sqrt(sum rho_r rho_u / N)``, both colours allowed for (Bartlett)."""
    longest = max(len(u) for u in inputs)
    lags = min(longest - 1, 400)
    of_input, _ = cross_correlation(inputs, inputs, lags)
    of_residual = colour.autocorrelation(lags + 1)
    both = max(1.0 + 2 * float(of_input[1:] @ of_residual[1:]), 1.0 / max(count, 1))
    return float(norm.ppf(0.975) * np.sqrt(both / max(count, 1)))


def _stretches(rows: int, count: int) -> list[tuple[int, int]]:
    edges = np.linspace(0, rows, count + 1).astype(int)
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
