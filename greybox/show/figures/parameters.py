"""Fitted parameters in figures: how well each is known, and which ones the records cannot tell apart."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from greybox.base.figure import Axis, Figure, Heatmap, Height, Panel, Points, Role, Scale
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Estimate


def plot_intervals(percent: Mapping[str, float], caption: str) -> Figure | None:
    """A mark for each parameter at half the width of its 95 % interval, in ``percent`` of the value; None for fewer than two."""
    if len(percent) < 2:
        return None
    ranked = dict(sorted(percent.items(), key=lambda item: item[1]))
    sizes = np.array(list(ranked.values()))
    marks = Points(sizes, list(ranked), Role.RESIDUAL, size=11, texts=[f"{p:.2g} %" for p in sizes])
    limits = 10 ** (math.log10(sizes[0]) - 0.3), 10 ** (math.log10(sizes[-1]) + 0.7)
    x = Axis("half width of the 95 % interval", "% of the value", Scale.LOG, limits)
    panel = Panel("intervals", (marks,), x, Axis(scale=Scale.CATEGORY, reversed=True), height=Height.PER_CATEGORY)
    return Figure(
        "intervals", (panel,), caption, ("; ".join(f"{name} {width:.3g} %" for name, width in ranked.items()),)
    )


def relative_half_widths(fit: Fit) -> dict[str, float]:
    """Half the 95 % interval of each parameter that has one, in percent of the value."""
    return {name: half for name, e in fit.parameters.items() if (half := relative_half_width(e)) is not None}


def relative_half_width(e: Estimate) -> float | None:
    """Half the 95 % interval in percent of the value; None where there is no interval."""
    if e.interval is None or not e.value or not all(map(math.isfinite, e.interval)):
        return None
    return 100 * (e.interval[1] - e.interval[0]) / 2 / abs(e.value) or None


# Parameters correlated more than this are called out: the records tell their ratio or product better than each.
DRAWING_CORRELATED = 0.95


def plot_correlation(fit: Fit) -> Figure | None:
    """Which parameters the records move together; None for fewer than two."""
    names = list(fit.uncertainty.free)
    if len(names) < 2 or not np.isfinite(fit.uncertainty.covariance).any():
        return None
    category = Axis(scale=Scale.CATEGORY)
    heatmap = Heatmap(parameter_correlation(fit), names)
    panel = Panel(
        "correlation", (heatmap,), category, Axis(scale=Scale.CATEGORY, reversed=True), height=Height.PER_CATEGORY
    )
    description = strongly_correlated_pairs(fit) or (f"No correlation exceeds {DRAWING_CORRELATED}",)
    return Figure(
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
