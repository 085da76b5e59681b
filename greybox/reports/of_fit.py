"""The page of a fit: what came out, whether to believe it, what it was made from, how to repeat it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from greybox.estimation.restore import has_free_run
from greybox.identifiability import recommend_after_fit
from greybox.plots.limits import LIMITS
from greybox.plots.parameters import plot_correlation, plot_intervals, relative_half_widths, strongly_correlated_pairs
from greybox.plots.records import plot_inputs, plot_residual, plot_run, plot_spectrum, record_misfits
from greybox.plots.residual_tests import plot_residual_tests
from greybox.plots.style import PAGE
from greybox.rendering import sentences
from greybox.rendering.plots import FigureText, phrase
from greybox.rendering.residuals import name_test
from greybox.rendering.result import MISFIT_HEADS, to_misfit_cells
from greybox.reports.equations import typeset_equations
from greybox.reports.fit_parts import LEADING, constants_table, verdict
from greybox.reports.page import Block, FigureBlock, Folded, Heading, Listing, Page, Section, Table, Text
from greybox.reports.provenance import provenance_section
from greybox.reports.records import records_section, signal_units
from greybox.reports.typography import as_sentence, count_noun, join_names, typeset_number
from greybox.residuals import ResidualTests, residual_tests
from greybox.result import Fit, Misfit, Trace

# Records whose curves stand open on the page, and those that are drawn at all; all are in the tables.
OPEN, MOST_DRAWN = 2, 20


def report_of_fit(fit: Fit, *, command: str = "", tests: ResidualTests | None = None, skip: int = 0) -> Page:
    """The page of a fit.

    ``command`` is what was typed, for repeating it; ``tests`` those of the residual, made here if left out; ``skip`` rows at the
    start of validation records do not count.
    """
    sections = [
        Section("constants", "Constants", list(_constants(fit))),
        Section("misfit", "Measured and simulated", list(_misfit(fit, skip))),
        Section("residual", "What the residual says", list(_residual(fit, tests))),
        Section("model", "The model", [typeset_equations(fit.model)]),
        records_section([*fit.traces], [*fit.validation.traces], fit),
        provenance_section(fit, command),
    ]
    return Page(f"Fit of {fit.model.title}", _question(fit), verdict(fit), sections, "fit")


def _question(fit: Fit) -> str:
    rows = sum(len(t.time) for t in fit.traces)
    known = [n for n, e in fit.parameters.items() if e.fixed]
    told = f"; {join_names(known)} {'is' if len(known) == 1 else 'are'} given" if known else ""
    return (
        f"Which values of {join_names(fit.uncertainty.free) or 'its constants'} make the model"
        f" follow {count_noun(len(fit.traces), 'record')}"
        f" ({count_noun(rows, 'row')}){told}?"
    )


def _constants(fit: Fit) -> Iterator[Block]:
    yield constants_table(fit, _interval_words(fit))
    missing = recommend_after_fit(fit)
    if missing:
        yield Heading("What would determine the rest")
        yield Listing([as_sentence(m) for m in missing])
    known = plot_intervals(relative_half_widths(fit), phrase(FigureText.INTERVALS))
    if known is not None:
        yield FigureBlock(known)
    together = plot_correlation(fit)
    if together is not None:
        pairs = strongly_correlated_pairs(fit)
        if pairs:
            yield Listing([as_sentence(p) for p in sentences(pairs)])
        yield Folded("Which constants the data move together", [FigureBlock(together)])


def _interval_words(fit: Fit) -> str:
    if not fit.uncertainty.free:
        return ""
    if fit.uncertainty.kind == "sandwich" and fit.uncertainty.inflation:
        return (
            "The residual is not white: the intervals allow for its colour, which widened them up to "
            f"{max(fit.uncertainty.inflation.values()):.3g} times."
        )
    if fit.prediction.process_noise:
        return "The intervals are from the information of the likelihood; the innovations are white."
    return "The residual is white: the intervals are from the Gauss-Newton covariance."


def _misfit(fit: Fit, skip: int) -> Iterator[Block]:
    yield _misfit_table("Free run on the fitted records", fit.misfit)
    if fit.prediction:
        yield _misfit_table("Prediction one sample ahead", fit.prediction.one_step)
    if fit.validation:
        yield _misfit_table("Free run on records that the fit has not seen", fit.validation.misfit)
    runs = [("fitted record", t, 0) for t in fit.traces] + [
        ("validation record", t, skip) for t in fit.validation.traces
    ]
    if len(runs) > 2:
        yield _by_record(fit, runs)
    units = signal_units(fit.model)
    drawn = runs[:MOST_DRAWN]
    stretches = PAGE.stretches(sum(3 * len(t.measured) + len(t.inputs) for _, t, _ in drawn))
    whole = sum(len(t.measured) * min(len(t.time), LIMITS.signal_on_page) for _, t, _ in drawn)
    follow = whole <= LIMITS.all_signals_on_page
    for k, (kind, trace, _) in enumerate(drawn):
        residual = f"residual-{k}"
        figures = [
            FigureBlock(plot_run(trace, units, f"run-{k}"), stretches, group=f"{k}", switch=f"{k}"),
            FigureBlock(plot_residual(trace, units, fit.noise.std, residual), stretches, group=f"{k}", switch=f"{k}"),
            FigureBlock(
                plot_spectrum(trace, units, fit.noise.std, f"spectrum-{k}", follows=residual if follow else ""),
                stretches, switch=f"{k}",
            ),
        ]  # fmt: skip
        inputs = plot_inputs(trace, units, f"inputs-{k}")
        blocks: list[Block] = [
            *figures,
            *([FigureBlock(inputs, stretches, group=f"{k}")] if inputs is not None else []),
        ]
        opened = k == 0 or (kind == "validation record" and runs[k - 1][0] == "fitted record")
        if opened:
            yield Heading(f"{kind.capitalize()} {trace.name}")
        yield from blocks if opened else [Folded(f"{kind} {trace.name}", blocks)]
    if len(runs) > MOST_DRAWN:
        yield Text([f"{len(runs) - MOST_DRAWN} more records are in the tables, but not drawn."])


def _by_record(fit: Fit, runs: list[tuple[str, Trace, int]]) -> Table:
    rows = [
        [trace.name, kind, output, *map(typeset_number, to_misfit_cells(m))]
        for kind, trace, left_out in runs
        for output, m in record_misfits(fit, trace, left_out).items()
    ]
    return Table("Record by record", ["record", "use", "output", *MISFIT_HEADS], rows)


def _misfit_table(title: str, misfit: Mapping[str, Misfit]) -> Table:
    rows = [[name, *map(typeset_number, to_misfit_cells(m))] for name, m in misfit.items()]
    return Table(title, ["output", *MISFIT_HEADS], rows)


def _residual(fit: Fit, tests: ResidualTests | None) -> Iterator[Block]:
    notes = fit.notes if fit.success else fit.notes[LEADING:]  # of a failure the first stand above, with the verdict
    if notes:
        yield Listing([as_sentence(typeset_number(n)) for n in notes])
    if not fit.success:
        yield Text(["The fit did not succeed: tests of its residual would say nothing about the model."], "caution")
        return
    if not (has_free_run(fit) or fit.prediction.process_noise):
        yield Text(
            ["No tests of the residual: states that are set anew along the record take up what the model lacks."],
            "caution",
        )
        return
    tests = tests or residual_tests(fit)
    loud, count = len(tests.alarms), len(tests.tests)
    if loud:
        yield Text(
            [f"{loud} of {count} tests {'raises' if loud == 1 else 'raise'} an alarm: the residual is not only noise."],
            "caution",
        )
    else:
        yield Text([f"None of {count} tests raises an alarm: the residual looks like noise."], "good")
    rows = [
        [
            f"{t.output}: {name_test(t)}", f"{'alarm: ' if t.alarm else ''}{t}", typeset_number(f"{t.p_value:.2g}"),
            typeset_number(f"{t.statistic:.4g}"),
        ]
        for t in tests.tests
    ]  # fmt: skip
    yield Table(
        "Tests of the residual",
        ["test", "what it says", "p", "statistic"],
        rows,
        "Each test alone raises a false alarm (p below 0.01) in one good fit of a hundred.",
    )
    for output in tests.residuals:
        yield FigureBlock(plot_residual_tests(tests, output, f"tests-{output}"))
