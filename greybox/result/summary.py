"""A fit in plain text: what a person reads first."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from greybox.result.fit import Estimate, Fit, Misfit
from greybox.units import format_unit

MISFIT_HEADS = ("rmse", "best fit", "rmse / noise")


def format_fit(fit: Fit) -> str:
    """Status beside misfit over noise, the constants with intervals, the misfit by output, and what to know before trusting them."""
    lines = [f"{fit.model.title}: {fit.solver.status_message}", ""]
    lines += format_table(["constant", "value", "95 % interval", "unit", ""], to_constant_rows(fit))
    if fit.constraints.priors:
        lines += ["", *_priors(fit)]
    lines += ["", *_misfits("misfit (free run)", fit.misfit)]
    if fit.prediction:
        lines += ["", *_misfits("prediction (1 step ahead)", fit.prediction.one_step)]
    if fit.validation:
        lines += ["", *_misfits("on validation records (free run)", fit.validation.misfit)]
    if fit.prediction.process_noise and fit.uncertainty.kind != "sandwich":
        lines += ["", "intervals: information of the likelihood, the innovations are white"]
    elif fit.uncertainty.kind == "sandwich" and fit.uncertainty.inflation:
        lines += [
            "",
            f"intervals: allow for the residual's colour, widened up to {max(fit.uncertainty.inflation.values(), default=1.0):.3g} times",
        ]
    elif any(e.std is not None for e in fit.parameters.values()):
        lines += ["", "intervals: Gauss-Newton covariance, the residual is white"]
    lines += ["", f"noise: {fit.noise.source}", f"discretisation: {fit.discretisation}{_left(fit)}"]
    if fit.solver.statistics.get("strategy"):
        lines.append(f"search: {fit.solver.statistics['strategy']}")
    lines += [f"note: {note}" for note in fit.notes]
    return "\n".join(lines)


def _left(fit: Fit) -> str:
    """What is left of the integrator's error; nothing where the discretisation is exact."""
    error = max((e for e in fit.discretisation.error.values() if math.isfinite(e)), default=0.0)
    shift = max((m for m in fit.discretisation.shift.values() if math.isfinite(m)), default=0.0)
    if not error and not shift:
        return ""
    return f"; it leaves an error of {error:.2g} x noise, half the step moves no constant by more than {shift:.2g} std"


def format_number(value: float, digits: int = 5) -> str:
    """A number for people: ``digits`` significant digits, short."""
    return f"{value:.{digits}g}"


def format_with_std(value: float, std: float) -> str:
    """``value +- std`` with two digits of the uncertainty: ``0.26910 +- 0.00034``."""
    if not (std > 0 and math.isfinite(std)):
        return format_number(value)
    write = make_formatter(value, std)
    return f"{write(value)} +- {write(std)}"


def make_formatter(value: float, std: float) -> Callable[[float], str]:
    """How to write numbers beside ``value +- std``, such as the ends of its interval: to two digits of the uncertainty."""
    if not (std > 0 and math.isfinite(std)):
        return format_number
    exponent = math.floor(math.log10(std))
    digits = max(1 - exponent, 0)
    if not (abs(value) >= 1e6 or 0 < abs(value) < 1e-3 or digits > 8):
        return lambda v: f"{v:.{digits}f}"

    def scientific(v: float) -> str:
        leading = math.floor(math.log10(max(abs(v), std))) if math.isfinite(v) else 0
        return f"{v:.{min(max(leading - exponent + 1, 1), 9)}e}"

    return scientific


def to_constant_rows(fit: Fit) -> list[list[str]]:
    """Rows of the table of constants: each one, its values in experiments that have their own, then those that are tied."""
    rows = []
    for name, e in fit.parameters.items():
        rows.append(to_constant_cells(name, e))
        if name in fit.constraints.per_experiment:
            rows[-1][-1] = "mean"
            rows += [
                to_constant_cells(f"{name} ({title})", per_experiment)
                for title, per_experiment in fit.constraints.per_experiment[name].items()
            ]
    for name, e in fit.constraints.tied.items():
        rows.append(to_constant_cells(name, e))
        rows[-1][-1] = f"= {fit.constraints.ties[name]}"
    return rows


def _priors(fit: Fit) -> list[str]:
    rows = []
    for name, c in fit.constraints.priors.items():
        conflict = "" if c.conflict is None else f"{format_number(abs(c.conflict), 2)} std"
        rows.append(
            [
                name,
                format_with_std(c.mean, c.std),
                f"{format_number(c.shift, 2)} std",
                f"{100 * c.variance_reduction:.3g} %",
                conflict,
            ]
        )
    return format_table(["prior", "known before", "moved by", "told by the data", "disagreement"], rows)


def to_constant_cells(name: str, e: Estimate) -> list[str]:
    """Name, value, interval, unit and remark of one constant, as tables show them."""
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


def to_misfit_cells(m: Misfit) -> list[str]:
    """rmse, best fit and rmse over noise, as tables show them."""
    return [
        f"{format_number(m.rmse, 4)} {format_unit(m.unit)}".rstrip(),
        f"{m.best_fit_percent:.2f} %",
        f"{format_number(m.noise_ratio, 4)} x noise",
    ]


def _misfits(title: str, misfit: Mapping[str, Misfit]) -> list[str]:
    return format_table([title, *MISFIT_HEADS], [[name, *to_misfit_cells(m)] for name, m in misfit.items()])


def format_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table, indented by two; each column as wide as it must be."""
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    return [
        "  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in [head, *rows]
    ]
