"""The page of a comparison: does the physics pay? Grey and black boxes on the same rows of the same records."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from greybox.comparison import Comparison, ComparisonEntry, ComparisonFinding, ComparisonScore
from greybox.estimation.versions import read_versions
from greybox.findings import with_code
from greybox.plots.comparison import judging_records, plot_model_errors, plot_model_residuals, plot_model_runs
from greybox.plots.style import PAGE
from greybox.rendering import sentences
from greybox.reports.equations import typeset_equations
from greybox.reports.fit_parts import constants_table
from greybox.reports.page import Block, FigureBlock, Folded, Heading, Listing, Page, Section, Table, Text
from greybox.reports.provenance import command_block, name_value_table
from greybox.reports.typography import (
    as_sentence,
    count_noun,
    format_number,
    join_names,
    typeset_number,
    typeset_unit,
)
from greybox.result import Fit

MOST_DRAWN = 8  # records with curves; the tables have all


def report_of_comparison(
    comparison: Comparison, *, command: str = "", fits: Mapping[str, Fit] | None = None, data: Mapping[str, str] | None = None,
    known: Sequence[str] = (),
) -> Page:  # fmt: skip
    """The page of a comparison.

    ``fits``: the grey boxes' fits by the name of their entry, for their equations and constants; ``data``: fingerprint of each record,
    ``known``: what is to be known of them.
    """
    sections = [
        Section("errors", "Who is how good", list(errors(comparison))),
        Section("runs", "The runs", list(runs(comparison))),
        Section("models", "What they are", [models(comparison), *_notes(comparison)]),
    ]
    if fits:
        sections.append(Section("physics", "The physical models", list(_physics(fits))))
    sections.append(_data(comparison, data or {}, known))
    sections.append(
        Section("repeat", "How to repeat it", [*command_block(command), name_value_table("Versions", read_versions())])
    )
    outputs = join_names(list(comparison.outputs))
    where = "records that none of them was fitted to" if comparison.validation else "the records they were fitted to"
    question = f"Does the physics pay? {count_noun(len(comparison.entries), 'model')} of {outputs}, judged on the same rows of {where}."
    return Page("Grey boxes and black boxes side by side", question, verdict(comparison), sections, "comparison")


def verdict(comparison: Comparison) -> Text:
    """What the comparison says of itself: good where a grey box is best, or as good, in the free run of every output."""
    best = [_best(comparison, output) for output in comparison.outputs]
    failed = with_code(comparison.verdict, ComparisonFinding.FAILED_FITS)
    won = all(e is not None and e.kind == "grey" for e in best) and bool(best)
    return Text(
        [as_sentence(typeset_number(s)) for s in sentences(comparison.verdict)],
        "good" if won and not failed else "caution",
    )


def _best(comparison: Comparison, output: str) -> ComparisonEntry | None:
    judged = [
        (comparison.deciding_scores(e)[output].rmse, k)
        for k, e in enumerate(comparison.entries)
        if output in comparison.deciding_scores(e)
    ]
    finite = [pair for pair in judged if math.isfinite(pair[0])]
    return comparison.entries[min(finite)[1]] if finite else None


def errors(comparison: Comparison) -> Iterator[Block]:
    """Bars and tables of the errors on the judging records, and on the training records where there are others."""
    yield FigureBlock(plot_model_errors(comparison))
    groups = (("validation", comparison.validation, "On records that no model was fitted to"),
              ("training", comparison.training, "On the fitted records"))  # fmt: skip
    for group, records, title in groups:
        if records:
            tables = [_table(comparison, group, output, title) for output in comparison.outputs]
            yield from tables if group == "validation" or not comparison.validation else [Folded(title, tables)]


def _table(comparison: Comparison, group: str, output: str, title: str) -> Table:
    found: dict[str, ComparisonScore] = {}
    for e in comparison.entries:
        scores: Mapping[str, ComparisonScore] = getattr(e, group)
        if output in scores:
            found[e.name] = scores[output]
    ranked = sorted(found.items(), key=lambda item: item[1].rmse if math.isfinite(item[1].rmse) else math.inf)
    unit = typeset_unit(comparison.outputs[output])
    further = sorted({k for s in found.values() for k in s.ahead_rmse})
    rows = [
        [
            name, comparison[name].kind, _error(s.rmse, unit), _percent(s.best_fit_percent), _error(s.one_step_rmse, unit),
            *(_error(s.ahead_rmse.get(k, math.nan), unit) for k in further),
        ]
        for name, s in ranked
    ]  # fmt: skip
    ahead = ["one sample ahead (rms)", *(f"{k} samples ahead (rms)" for k in further)]
    return Table(f"{title}: {output}", ["model", "box", "free run (rms)", "best fit", *ahead], rows)


def _error(value: float, unit: str) -> str:
    if math.isnan(value):
        return "–"
    return typeset_number(f"{format_number(value, 4)} {unit}".rstrip()) if math.isfinite(value) else "grows away"


def _percent(value: float) -> str:
    return f"{value:.2f} %" if math.isfinite(value) else "–"


def runs(comparison: Comparison) -> Iterator[Block]:
    """The curves of every model over each judging record."""
    records = judging_records(comparison)
    drawn = records[:MOST_DRAWN]
    curves = 2 * sum(len(comparison.deciding_scores(e)) for e in comparison.entries) + len(comparison.outputs)
    stretches = PAGE.stretches(len(drawn) * curves)
    yield Text(["A click on a name in the legend hides that model; a double click shows it alone."])
    for k, record in enumerate(drawn):
        figures = [
            FigureBlock(plot(comparison, record, f"{name}-{k}"), stretches, group=f"{k}", switch=f"{k}")
            for name, plot in (("runs", plot_model_runs), ("errors-over-time", plot_model_residuals))
        ]
        if k == 0:
            yield Heading(f"Record {record}")
        yield from figures if k == 0 else [Folded(f"Record {record}", figures)]
    if len(records) > MOST_DRAWN:
        yield Text([f"{count_noun(len(records) - MOST_DRAWN, 'more record')} in the tables, but not drawn."])


def models(comparison: Comparison) -> Table:
    """Structure, numbers, BIC, stability, feed-through and time of each model."""
    rows = [
        [
            e.name, e.kind, ", ".join(dict.fromkeys(e.structure.values())), str(e.parameters),
            f"{e.bic:.0f}".replace("-", "−") if math.isfinite(e.bic) else "–", "yes" if e.stable else "no",
            typeset_number(", ".join(format_number(v, 3) for v in e.feedthrough.values())) or "none",
            f"{e.seconds:.1f} s" if e.seconds else "–",
        ]
        for e in comparison.entries
    ]  # fmt: skip
    head = ["model", "box", "structure", "numbers", "BIC", "stable", "feed-through", "time"]
    note = "Numbers: fitted constants or coefficients. BIC: of the free run on the fitted records, lower is better."
    return Table("The models", head, rows, note)


def _notes(comparison: Comparison) -> Iterator[Block]:
    said = [
        *sentences(comparison.findings),
        *(f"{e.name}: {n}" for e in comparison.entries for n in sentences(e.findings)),
    ]
    if said:
        yield Listing([as_sentence(s) for s in said])


def _physics(fits: Mapping[str, Fit]) -> Iterator[Block]:
    for k, (name, fit) in enumerate(fits.items()):
        blocks: list[Block] = [constants_table(fit), typeset_equations(fit.model)]
        if k == 0:
            yield Heading(name)
        yield from blocks if k == 0 else [Folded(name, blocks)]


def _data(comparison: Comparison, prints: Mapping[str, str], known: Sequence[str]) -> Section:
    rows = []
    for use, records in (("fitted", comparison.training), ("judged by", comparison.validation)):
        for record in records:
            every = (r for e in comparison.entries for r in (*e.training_runs, *e.validation_runs))
            run = next((r for r in every if r.record == record), None)
            length = [str(len(run.time)), f"{run.time[-1] - run.time[0]:.6g} s"] if run is not None else ["", ""]
            rows.append([record, use, *length, prints.get(record, "")[:12]])
    left = f"The first {comparison.skip} rows of each judging record do not count." if comparison.skip else ""
    said = [Listing([as_sentence(f"record {note}") for note in known])] if known else []
    table = Table("Records", ["record", "use", "rows", "duration", "fingerprint"], rows, left)
    return Section("data", "The data", [table, *said])
