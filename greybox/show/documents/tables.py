"""Tables that several documents have: parameters with their intervals, misfits, names with values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from greybox.base.document import REMARK, Facts, TableBlock, Text
from greybox.base.units import format_unit
from greybox.show.sentences.wording import format_number, format_with_std, make_formatter

if TYPE_CHECKING:
    from greybox.data.noise.noise_model import NoiseBound
    from greybox.estimation.result import Fit
    from greybox.estimation.result_parts import Estimate, FitNoise, Misfit

MISFIT_HEADS = ("rmse", "best fit", "rmse / noise")


def parameters_table(fit: Fit, note: Text = "") -> TableBlock:
    """The parameters of a fit: each one, its values in experiments that have their own, then those that are tied."""
    rows = []
    for name, e in fit.parameters.items():
        rows.append(estimate_cells(name, e))
        if name in fit.constraints.per_experiment:
            rows[-1][-1] = "mean"
            each = fit.constraints.per_experiment[name].items()
            rows += [estimate_cells(f"{name} ({title})", estimate) for title, estimate in each]
    for name, e in fit.constraints.tied.items():
        rows.append(estimate_cells(name, e))
        rows[-1][-1] = f"= {fit.constraints.ties[name]}"
    return _estimates(rows, note)


def estimates_table(estimates: Mapping[str, Estimate]) -> TableBlock:
    """Parameters that stand for themselves."""
    return _estimates([estimate_cells(name, e) for name, e in estimates.items()])


def _estimates(rows: list[list[str]], note: Text = "") -> TableBlock:
    caption = "Parameters with standard deviations and 95 % intervals"
    return TableBlock(caption, ["parameter", "value", "95 % interval", "unit", REMARK], rows, note)


def estimate_cells(name: str, e: Estimate) -> list[str]:
    """Name, value, interval, unit and remark of one parameter."""
    if e.fixed:
        return [name, format_number(e.value, 7), "", format_unit(e.unit), "fixed"]
    remark = "at its bound" if e.at_bound else ""
    if e.std is None or e.interval is None:
        limits = "" if e.interval is None else f"[{format_number(e.interval[0], 3)}, {format_number(e.interval[1], 3)}]"
        return [name, format_number(e.value), limits, format_unit(e.unit), remark or "not determined by these data"]
    if not remark and not e.determined:
        remark = "not determined: interval over 50 %"
    low, high = map(make_formatter(e.value, e.std), e.interval)
    return [name, format_with_std(e.value, e.std), f"[{low}, {high}]", format_unit(e.unit), remark]


def misfit_table(
    caption: Text, misfit: Mapping[str, Misfit], noise: FitNoise | None = None, corner: str = ""
) -> TableBlock:
    """Misfits by output; over a noise that is only bounded they are at least so large."""
    rows = [[name, *misfit_cells(m, None if noise is None else noise.bound(name))] for name, m in misfit.items()]
    return TableBlock(caption, ["output", *MISFIT_HEADS], rows, corner=corner)


def misfit_cells(m: Misfit, bound: NoiseBound | None = None) -> list[str]:
    """rmse, best fit and rmse over noise; over noise that is only bounded it is at least that."""
    least = None if bound is None else bound.least_ratio(m.rmse)
    ratio = (
        f"{format_number(m.noise_ratio, 4)} x noise" if least is None else f"at least {format_number(least, 4)} x noise"
    )
    return [f"{format_number(m.rmse, 4)} {format_unit(m.unit)}".rstrip(), f"{m.best_fit_percent:.2f} %", ratio]


def named_values(title: str, values: Mapping[str, Any]) -> Facts:
    """Names and values; a name within a group is ``group.name``."""
    return Facts(list(flatten(values).items()), title)


def flatten(values: Mapping[str, Any], group: str = "") -> dict[str, str]:
    """The values of nested mappings as text, by their names."""
    flat: dict[str, str] = {}
    for name, value in values.items():
        nested = isinstance(value, Mapping)
        flat |= flatten(value, f"{group}{name}.") if nested else {f"{group}{name}": "" if value is None else str(value)}
    return flat
