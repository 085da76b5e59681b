"""The page of a fit: what came out, whether to believe it, what it was made from, how to repeat it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from greybox.diagnose import diagnose_residuals
from greybox.reports.equations import typeset
from greybox.reports.page import Block, Code, Figure, Folded, Listing, Page, Section, Table, Text, Tone
from greybox.reports.plots import (
    correlation_figure,
    intervals_figure,
    residual_figure,
    run_figure,
    spectrum_figure,
)
from greybox.result import Fit, Misfit, Trace
from greybox.result.summary import MISFIT_HEADS, constant_cells, misfit_cells
from greybox.uncertainty.again import runs_freely
from greybox.units import tidy

# A misfit up to this many times the noise is called good.
GOOD = 1.2
# Records whose curves stand open on the page; the others unfold.
OPEN = 2


def fit_page(fit: Fit, *, command: str = "") -> Page:
    """The report of a fit; ``command`` is what was typed, for repeating it."""
    sections = [
        Section("constants", "Constants", list(_constants(fit))),
        Section("misfit", "Misfit", list(_misfit(fit))),
        Section("residual", "What the residual says", list(_residual(fit))),
        Section("model", "The model", [typeset(fit.model)]),
        Section("data", "The data", [_data(fit)]),
        Section("repeat", "How to repeat it", list(repeat(fit, command))),
    ]
    return Page(f"Fit of {fit.model.title}", _question(fit), verdict(fit), sections, "fit")


def _question(fit: Fit) -> str:
    rows = sum(len(t.time) for t in fit.traces)
    known = [n for n, e in fit.parameters.items() if e.fixed]
    told = f"; {', '.join(known)} given" if known else ""
    return f"Which constants make the model follow {len(fit.traces)} record(s), {rows} rows, in free run{told}?"


def verdict(fit: Fit) -> Text:
    """In plain words whether the fit succeeded and what to know before trusting it."""
    worst = max((m.noise_ratio for m in fit.misfit.values()), default=math.nan)
    tone: Tone = "bad" if not fit.success else ("good" if worst <= GOOD else "caution")
    return Text([fit.meaning[:1].upper() + fit.meaning[1:] + ".", *fit.notes[:3]], tone)


def _constants(fit: Fit) -> Iterator[Block]:
    yield Table(
        "Constants with 95 % intervals", ["constant", "value", "95 % interval", "unit", "remark"],
        [constant_cells(n, e) for n, e in fit.parameters.items()], _interval_words(fit),
    )  # fmt: skip
    rows = [
        (n, e.value, (e.interval[1] - e.interval[0]) / 2)
        for n, e in fit.parameters.items()
        if e.interval is not None and all(map(math.isfinite, e.interval)) and e.value
    ]
    if len(rows) > 1:
        yield intervals_figure("intervals", rows)


def _interval_words(fit: Fit) -> str:
    if fit.interval_kind == "sandwich" and fit.inflation:
        return f"The intervals allow for the residual's colour; that widened them up to {max(fit.inflation.values()):.3g} times."
    return "The intervals are those of a white residual (Gauss-Newton covariance)." if fit.free else ""


def _misfit(fit: Fit) -> Iterator[Block]:
    yield _misfit_table("Free run on the fitted records", fit.misfit)
    if fit.validation:
        yield _misfit_table("Free run on records not used for the fit", fit.validation)
    for kind, traces in (("fit", fit.traces), ("validation", fit.validation_traces)):
        for k, trace in enumerate(traces):
            blocks = list(_curves(fit, trace, f"{kind}-{k}"))
            title = ("fitted record " if kind == "fit" else "validation record ") + trace.name
            yield from blocks if k < OPEN else [Folded(title, blocks)]


def _misfit_table(title: str, misfit: Mapping[str, Misfit]) -> Table:
    return Table(title, ["output", *MISFIT_HEADS], [[name, *misfit_cells(m)] for name, m in misfit.items()])


def _curves(fit: Fit, trace: Trace, name: str) -> Iterator[Figure]:
    units = {o.name: o.unit for o in fit.model.outputs}
    for output in trace.measured:
        noise, unit, own = fit.noise.get(output, 0.0), units[output], f"{name}-{output}"
        yield run_figure(trace, output, unit, f"run-{own}")
        yield residual_figure(trace, output, unit, noise, f"residual-{own}", f"spectrum-{own}")
        yield spectrum_figure(trace, output, unit, noise, f"spectrum-{own}")


def _residual(fit: Fit) -> Iterator[Block]:
    if fit.notes:
        yield Listing(fit.notes)
    if not fit.success:
        yield Text(["The fit did not succeed: tests of its residual would say nothing about the model."], "caution")
        return
    if runs_freely(fit) or fit.process_noise:
        tests = diagnose_residuals(fit)
        rows = [[f"{t.output}: {t.test}", f"{t.statistic:.4g}", f"{t.p_value:.2g}", t.sentence] for t in tests.tests]
        yield Table(
            "Tests of the residual; below p = 0.01 one speaks up", ["test", "figure", "p", "what it says"], rows
        )
    else:
        yield Text(
            ["No tests of the residual: states that are set anew along the record take up what the model lacks."]
        )
    for output in fit.misfit:
        residuals = [t.residual(output) for t in fit.traces if output in t.measured]
        yield correlation_figure(f"correlation-{output}", output, residuals)


def _data(fit: Fit) -> Table:
    return Table(
        "Records", ["record", "use", "rows", "duration", "sampling time", "missing values", "fingerprint"],
        [*(_record(t, "fitted") for t in fit.traces), *(_record(t, "judged") for t in fit.validation_traces)],
        f"Noise: {fit.noise_source}.",
    )  # fmt: skip


def _record(trace: Trace, use: str) -> list[str]:
    steps = trace.time[1:] - trace.time[:-1]
    regular = len(steps) and float(steps.max() - steps.min()) < 1e-6 * float(steps.mean())
    missing = sum(int((v != v).sum()) for v in trace.measured.values())
    return [
        trace.name, use, str(len(trace.time)), f"{trace.time[-1] - trace.time[0]:.6g} s",
        f"{float(steps.mean()):.6g} s" if regular else f"{float(steps.min()):.4g} to {float(steps.max()):.4g} s",
        str(missing) if missing else "none", trace.fingerprint[:12],
    ]  # fmt: skip


def repeat(fit: Fit, command: str) -> Iterator[Block]:
    """What is needed to get the same numbers again."""
    if command:
        yield Code(command, "In the shell")
    yield Table("Discretisation and search", ["what", "how"], [
        ["discretisation", fit.discretisation],
        ["integration error", ", ".join(f"{o}: {e:.2g} of the noise" for o, e in fit.integration_error.items())],
        ["search", str(fit.solver.get("strategy", ""))],
        ["ended", f"{fit.status} ({fit.solver.get('ipopt_status', '')}, {fit.solver.get('iterations', '')} iterations)"],
    ])  # fmt: skip
    options = ", ".join(f"{k} = {v}" for k, v in fit.options.items())
    versions = ", ".join(f"{k} {v}" for k, v in fit.versions.items())
    yield Folded("Options and versions", [Listing([options, versions])])


def units_of(fit: Fit) -> Mapping[str, str]:
    """Unit of each output, as people write it."""
    return {o.name: tidy(o.unit) for o in fit.model.outputs}


def names_of(traces: Sequence[Trace]) -> str:
    """Records in one line."""
    return ", ".join(t.name for t in traces)
