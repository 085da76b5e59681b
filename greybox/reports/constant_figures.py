"""Constants as figures: how well each is known, and which ones the data cannot move one by one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from greybox.reports.axes import axes
from greybox.reports.page import Figure
from greybox.reports.typography import typeset_number
from greybox.result import Estimate, Fit

TOGETHER = 0.95  # constants that are correlated more than this are called tied


def intervals_figure(fit: Fit) -> Figure | None:
    """Half width of each 95 % interval in percent of the value; None where fewer than two constants have one."""
    percent = {name: half for name, e in fit.parameters.items() if (half := relative_half_width(e)) is not None}
    return spread_figure(percent, "How well each constant is known: further to the left is better.")


def spread_figure(percent: Mapping[str, float], caption: str) -> Figure | None:
    """A mark for each constant at half the width of its 95 % interval, in percent of the value; None for fewer than two."""
    if len(percent) < 2:
        return None
    rows = sorted(percent.items(), key=lambda row: -row[1])
    names, sizes = [r[0] for r in rows], [r[1] for r in rows]
    data = [{
        "type": "scatter", "mode": "markers+text", "x": sizes, "y": names, "marker": {"color": "--residual", "size": 11},
        "text": [typeset_number(f"± {p:.2g} %") for p in sizes], "textposition": "middle right", "cliponaxis": False,
        "hovertemplate": "%{y}: ± %{x:.3g} %<extra></extra>",
    }]  # fmt: skip
    layout = axes("half width of the 95 % interval [% of the value]", "", logarithmic="x")
    layout |= {"showlegend": False, "hovermode": "closest"}
    layout["xaxis"] |= {"range": [math.log10(min(sizes)) - 0.3, math.log10(max(sizes)) + 0.7], "dtick": 1}
    layout["yaxis"] |= {"type": "category"}
    words = "; ".join(typeset_number(f"{n} ± {p:.3g} %") for n, p in reversed(rows))
    return Figure("intervals", caption, words + ".", data, layout, height=90 + 28 * len(names))


def relative_half_width(e: Estimate) -> float | None:
    """Half the 95 % interval in percent of the value; None where there is no interval."""
    if e.interval is None or not e.value or not all(map(math.isfinite, e.interval)):
        return None
    return 100 * (e.interval[1] - e.interval[0]) / 2 / abs(e.value) or None


def correlations(fit: Fit) -> np.ndarray:
    """Correlation (nf, nf) of the free constants; NaN where one is not determined."""
    std = np.sqrt(np.maximum(np.diag(fit.uncertainty.covariance), 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(fit.uncertainty.covariance / np.outer(std, std))


def strongly_correlated_pairs(fit: Fit) -> list[str]:
    """Pairs of constants that the data hardly tell apart, in words."""
    rho = correlations(fit)
    pairs = [
        (abs(rho[i, j]), i, j)
        for i in range(len(fit.uncertainty.free))
        for j in range(i)
        if np.isfinite(rho[i, j]) and abs(rho[i, j]) > TOGETHER
    ]
    return [
        f"{fit.uncertainty.free[j]} and {fit.uncertainty.free[i]} are correlated {signed(rho[i, j])}: the data tell their "
        f"{'ratio' if rho[i, j] > 0 else 'product'} better than either"
        for _, i, j in sorted(pairs, reverse=True)
    ]


def signed(value: float) -> str:
    """A correlation with a proper minus."""
    return f"{value:.3f}".replace("-", "−")


def correlation_figure(fit: Fit) -> Figure | None:
    """Which constants the data move together; None for fewer than two."""
    if len(fit.uncertainty.free) < 2 or not np.isfinite(fit.uncertainty.covariance).any():
        return None
    rho, names = correlations(fit), list(fit.uncertainty.free)
    layout = axes("", "") | {"showlegend": False, "hovermode": "closest"}
    layout["yaxis"] |= {"autorange": "reversed", "type": "category"}
    layout["xaxis"] |= {"type": "category", "side": "bottom"}
    cells: Sequence[Sequence[str]] = [[f"{v:.2f}" if np.isfinite(v) else "" for v in row] for row in rho]
    data = [{
        "type": "heatmap", "z": rho.tolist(), "x": names, "y": names, "zmin": -1, "zmax": 1, "text": cells, "texttemplate": "%{text}",
        "colorscale": [[0, "--residual"], [0.5, "--paper"], [1, "--model"]], "showscale": False, "xgap": 2, "ygap": 2,
        "hovertemplate": "%{x} and %{y}: %{z:.3f}<extra></extra>",
    }]  # fmt: skip
    words = "; ".join(strongly_correlated_pairs(fit)) or f"no two constants are correlated more than {TOGETHER}"
    return Figure(
        "together", "Correlation of the fitted constants: near 1 or −1 the data tell the pair, not each.", words + ".", data, layout,
        height=110 + 34 * len(names),
    )  # fmt: skip
