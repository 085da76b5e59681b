"""A fit in plain text: what a person reads first."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from greybox.noise import AutoRegression, BoundDirection
from greybox.rendering.noise import describe_source
from greybox.rendering.policy import TEXT_LIMITS
from greybox.rendering.registry import register, renders, sentences
from greybox.rendering.tables import format_number, format_table, format_with_std, make_formatter
from greybox.result.findings import ResultCode
from greybox.units import format_unit

if TYPE_CHECKING:
    from greybox.noise import NoiseBound
    from greybox.result import Estimate, Fit, FitNoise, Misfit

MISFIT_HEADS = ("rmse", "best fit", "rmse / noise")


@renders("Fit")
def write_fit(fit: Fit) -> str:
    """Status beside misfit over noise, the parameters with intervals, the misfit by output, and what to know before trusting them."""
    lines = [f"{fit.model.title}: {fit.solver}", ""]
    lines += format_table(["parameter", "value", "95 % interval", "unit", ""], to_constant_rows(fit))
    if fit.constraints.priors:
        lines += ["", *_write_priors(fit)]
    lines += ["", *_write_misfits("misfit (free run)", fit.misfit, fit.noise)]
    if fit.prediction.one_step:
        lines += ["", *_write_misfits("prediction (1 step ahead)", fit.prediction.one_step, fit.noise)]
    if fit.validation:
        lines += ["", *_write_misfits("on validation records (free run)", fit.validation.misfit, fit.noise)]
    intervals = _write_interval_kind(fit)
    if intervals:
        lines += ["", f"intervals: {intervals}"]
    lines += ["", f"noise: {fit.noise}", f"discretisation: {fit.discretisation.label}{_write_step_error(fit)}"]
    if fit.solver.strategy is not None:
        lines.append(f"search: {fit.solver.strategy}")
    lines += [f"note: {note}" for note in sentences(fit.findings)]
    return "\n".join(lines)


def _write_interval_kind(fit: Fit) -> str:
    sandwich = fit.uncertainty.kind == "sandwich"
    if fit.prediction.process_noise and not sandwich:
        return "information matrix of the likelihood; the innovations are white"
    if sandwich and fit.uncertainty.inflation:
        widest = fit.uncertainty.largest_inflation
        return f"sandwich covariance, which allows for the colour of the residual (up to {widest:.3g} times as wide)"
    if any(e.std is not None for e in fit.parameters.values()):
        return "Gauss-Newton covariance; the residual is white"
    return ""


def _write_step_error(fit: Fit) -> str:
    """What is left of the integrator's error; nothing where the discretisation is exact."""
    error = max((e for e in fit.discretisation.error.values() if math.isfinite(e)), default=0.0)
    shift = max((s for s in fit.discretisation.shift.values() if math.isfinite(s)), default=0.0)
    if not error and not shift:
        return ""
    return f"; error {error:.2g} x noise, half the step changes no parameter by more than {shift:.2g} std"


register(
    {
        ResultCode.FOREIGN_FINDING: lambda f: (
            f"{f.subject + ': ' if f.subject else ''}the file holds a finding that this version has no sentence for"
            f" ({f.values['code']})"
        ),
    }
)


def to_constant_rows(fit: Fit) -> list[list[str]]:
    """Rows of the table of parameters: each one, its values in experiments that have their own, then those that are tied."""
    rows = []
    for name, e in fit.parameters.items():
        rows.append(to_constant_cells(name, e))
        if name in fit.constraints.per_experiment:
            rows[-1][-1] = "mean"
            each = fit.constraints.per_experiment[name].items()
            rows += [to_constant_cells(f"{name} ({title})", estimate) for title, estimate in each]
    for name, e in fit.constraints.tied.items():
        rows.append(to_constant_cells(name, e))
        rows[-1][-1] = f"= {fit.constraints.ties[name]}"
    return rows


def to_constant_cells(name: str, e: Estimate) -> list[str]:
    """Name, value, interval, unit and remark of one parameter, as tables show them."""
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


def to_misfit_cells(m: Misfit, bound: NoiseBound | None = None) -> list[str]:
    """rmse, best fit and rmse over noise, as tables show them; over noise that is only bounded it is at least that."""
    ratio = f"{format_number(m.noise_ratio, 4)} x noise"
    if bound is not None and bound.direction is BoundDirection.AT_MOST and bound.level > 0:
        ratio = f"at least {format_number(m.rmse / bound.level, 4)} x noise"
    return [
        f"{format_number(m.rmse, 4)} {format_unit(m.unit)}".rstrip(),
        f"{m.best_fit_percent:.2f} %",
        ratio,
    ]


def _write_priors(fit: Fit) -> list[str]:
    rows = []
    for name, c in fit.constraints.priors.items():
        conflict = "" if c.conflict is None else f"{format_number(abs(c.conflict), 2)} std"
        reduction = f"{100 * c.variance_reduction:.3g} %"
        rows.append([name, format_with_std(c.mean, c.std), f"{format_number(c.shift, 2)} std", reduction, conflict])
    return format_table(["prior", "prior value", "shift", "variance reduction", "conflict"], rows)


def _write_misfits(title: str, misfit: Mapping[str, Misfit], noise: FitNoise) -> list[str]:
    rows = [[name, *to_misfit_cells(m, noise.bound(name))] for name, m in misfit.items()]
    return format_table([title, *MISFIT_HEADS], rows)


@renders("FitNoise")
def write_noise(noise: FitNoise) -> str:
    """Where the noise of each output is known from; levels that a likelihood estimated with their 95 % interval."""
    groups: dict[str, list[str]] = {}
    for name, source in noise.sources.items():
        if name in noise.log_std:
            text = _write_estimated_level(noise, name)
        else:
            bound = noise.bound(name)
            direction = source.direction if bound is None else bound.direction
            text = describe_source(source, AutoRegression(tuple(noise.colour.get(name, ()))), direction)
        groups.setdefault(text, []).append(name)
    if len(groups) == 1 and not noise.log_std:
        return next(iter(groups))
    return "; ".join(f"{', '.join(names)}: {text}" for text, names in groups.items())


def _write_estimated_level(noise: FitNoise, output: str) -> str:
    low, high = noise.interval(output)
    known = math.log(high / noise.std[output]) < TEXT_LIMITS.noise_reach
    ends = f" [{low:.3g}, {high:.3g}]" if known else " (poorly determined)"
    return f"{noise.std[output]:.3g}{ends} {noise.units[output]} from the innovations"
