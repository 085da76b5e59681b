"""A fit in plain text: what a person reads first."""

from __future__ import annotations

import math
from collections.abc import Mapping

from greybox.result.values import Estimate, Fit, Misfit


def summary(fit: Fit) -> str:
    """Status beside misfit over noise, the constants with intervals, the misfit by output, and what to know before trusting them."""
    lines = [f"{fit.model.title}: {fit.meaning}", ""]
    lines += _table(["constant", "value", "95 % interval", "unit", ""], [_constant(n, e) for n, e in fit.parameters.items()])
    lines += ["", *_misfits("misfit (free run)", fit.misfit)]
    if fit.validation:
        lines += ["", *_misfits("on validation records (free run)", fit.validation)]
    lines += ["", f"noise: {fit.noise_source}", f"discretisation: {fit.discretisation}"]
    lines += [f"note: {note}" for note in fit.notes]
    return "\n".join(lines)


def number(value: float, digits: int = 5) -> str:
    """A number for people: ``digits`` significant digits, short."""
    return f"{value:.{digits}g}"


def with_std(value: float, std: float) -> str:
    """``value +- std`` with two digits of the uncertainty: ``0.26910 +- 0.00034``."""
    if not (std > 0 and math.isfinite(std)):
        return number(value)
    exponent = math.floor(math.log10(std))
    digits = max(1 - exponent, 0)
    if abs(value) >= 1e6 or 0 < abs(value) < 1e-3 or digits > 8:
        significant = min(max(math.floor(math.log10(max(abs(value), std))) - exponent + 1, 1), 9)
        return f"{value:.{significant}e} +- {std:.1e}"
    return f"{value:.{digits}f} +- {std:.{digits}f}"


def _constant(name: str, e: Estimate) -> list[str]:
    if e.fixed:
        return [name, number(e.value, 7), "", e.unit, "fixed"]
    remark = "at its bound" if e.at_bound else ""
    if e.std is None or e.interval is None:
        return [name, number(e.value), "", e.unit, remark or "not determined by these data"]
    if e.std > 0.5 * abs(e.value) and not remark:
        remark = "poorly determined"
    return [name, with_std(e.value, e.std), f"[{number(e.interval[0])}, {number(e.interval[1])}]", e.unit, remark]


def _misfits(title: str, misfit: Mapping[str, Misfit]) -> list[str]:
    rows = [
        [name, f"{number(m.rmse, 4)} {m.unit}".rstrip(), f"{m.best_fit_percent:.2f} %", f"{number(m.noise_ratio, 4)} x noise"] for name, m in misfit.items()
    ]
    return _table([title, "rmse", "best fit", "rmse / noise"], rows)


def _table(head: list[str], rows: list[list[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    return ["  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in [head, *rows]]
