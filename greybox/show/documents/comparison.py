"""The page of a comparison: grey and black boxes on the same rows of the same records."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from greybox.base.findings import Finding, with_code
from greybox.comparison.findings import ComparisonFinding
from greybox.comparison.result import Comparison, ComparisonEntry, ComparisonScore
from greybox.estimation.result import Fit
from greybox.show.figures.comparison import judging_records, plot_model_errors, plot_model_residuals, plot_model_runs
from greybox.show.figures.figure import typeset_unit
from greybox.show.figures.sheet import PAGE
from greybox.show.pages.equations import typeset_equations
from greybox.show.pages.fit_page import OPEN_RECORDS, not_drawn, parameters_table
from greybox.show.pages.page import (
    Block,
    BulletList,
    Details,
    FigureBlock,
    Page,
    PageTable,
    Paragraphs,
    Section,
    Subheading,
    Text,
    Tone,
    typeset_number,
)
from greybox.show.pages.provenance import provenance_section
from greybox.show.sentences.registry import sentence
from greybox.show.sentences.wording import capitalise, count_noun, format_number, join_names, record_text


def build_comparison_page(
    comparison: Comparison,
    *,
    command: str = "",
    fits: Mapping[str, Fit] | None = None,
    data: Mapping[str, str] | None = None,
    known: Sequence[Finding | str] = (),
) -> Page:
    """The page of a comparison.

    Parameters
    ----------
    comparison
        The result of `greybox.compare`.
    command
        What was typed, for repeating it.
    fits
        The grey boxes' fits by the name of their entry, for their equations and parameters.
    data
        Fingerprint of each record.
    known
        What is to be known of the records.
    """
    sections = [
        Section("errors", "Errors", list(_error_tables(comparison))),
        Section("runs", "Runs", list(_runs(comparison))),
        Section("models", "Models", [models_table(comparison), *_findings(comparison)]),
    ]
    if fits:
        sections.append(Section("physics", "The physical models", list(_physics(fits))))
    sections += [_data(comparison, data or {}, known), provenance_section(command)]
    records = "records that no model was fitted to" if comparison.validation else "the records that they were fitted to"
    question = (
        f"Which model of {join_names(list(comparison.outputs))} is best? {count_noun(len(comparison.entries), 'model')},"
        f" compared on the same rows of {records}."
    )
    title = "Comparison of grey-box and black-box models"
    evidence = FigureBlock(plot_model_errors(comparison))
    return Page(title, question, comparison_verdict(comparison), sections, "comparison", evidence)


def comparison_verdict(comparison: Comparison) -> Paragraphs:
    """The verdict: good where a grey box has the smallest free-run error of every output."""
    best = [_best(comparison, output) for output in comparison.outputs]
    physics_is_best = bool(best) and all(e is not None and e.kind == "grey" for e in best)
    failed = with_code(comparison.verdict, ComparisonFinding.FAILED_FITS)
    return Paragraphs(comparison.verdict, Tone.GOOD if physics_is_best and not failed else Tone.CAUTION)


def _best(comparison: Comparison, output: str) -> ComparisonEntry | None:
    scores = [
        (comparison.deciding_scores(e)[output].rmse, k)
        for k, e in enumerate(comparison.entries)
        if output in comparison.deciding_scores(e)
    ]
    finite = [pair for pair in scores if math.isfinite(pair[0])]
    return comparison.entries[min(finite)[1]] if finite else None


def error_blocks(comparison: Comparison) -> Iterator[Block]:
    """Figure and tables of the errors on the judging records, and on the training records where there are others."""
    yield FigureBlock(plot_model_errors(comparison))
    yield from _error_tables(comparison)


def _error_tables(comparison: Comparison) -> Iterator[Block]:
    if comparison.validation:
        yield from (_error_table(comparison, output, validation=True) for output in comparison.outputs)
    if comparison.training:
        tables = [_error_table(comparison, output, validation=False) for output in comparison.outputs]
        yield from [Details("On the estimation records", tables)] if comparison.validation else tables


def _error_table(comparison: Comparison, output: str, *, validation: bool) -> PageTable:
    scores: dict[str, ComparisonScore] = {}
    for e in comparison.entries:
        of_entry = e.validation if validation else e.training
        if output in of_entry:
            scores[e.name] = of_entry[output]
    ranked = sorted(scores.items(), key=lambda item: item[1].rmse if math.isfinite(item[1].rmse) else math.inf)
    unit = typeset_unit(comparison.outputs[output])
    steps = sorted({k for s in scores.values() for k in s.ahead_rmse})
    rows = [
        [
            name,
            str(comparison[name].kind),
            _error(s.rmse, unit),
            f"{s.best_fit_percent:.2f} %" if math.isfinite(s.best_fit_percent) else "–",
            _error(s.one_step_rmse, unit),
            *(_error(s.ahead_rmse.get(k, math.nan), unit) for k in steps),
        ]
        for name, s in ranked
    ]
    ahead = ["one sample ahead (rms)", *(f"{k} samples ahead (rms)" for k in steps)]
    counts = [str(n) for n in sorted({s.samples for s in scores.values()})]
    unequal = ": not the same for every model" if len(counts) != 1 else ""
    title = f"{output}, {'validation' if validation else 'estimation'} records, {join_names(counts)} rows{unequal}"
    return PageTable(title, ["model", "box", "free run (rms)", "best fit", *ahead], rows)


def _error(value: float, unit: str) -> str:
    if math.isnan(value):
        return "–"
    return typeset_number(f"{format_number(value, 4)} {unit}".rstrip()) if math.isfinite(value) else "diverges"


# The same of a comparison.
RECORDS_OF_COMPARISON = 8


def _runs(comparison: Comparison) -> Iterator[Block]:
    """The curves of every model over each judging record."""
    records = judging_records(comparison)
    drawn = records[:RECORDS_OF_COMPARISON]
    curves = 2 * sum(len(comparison.deciding_scores(e)) for e in comparison.entries) + len(comparison.outputs)
    stretches = PAGE.stretches(len(drawn) * curves)
    yield Paragraphs(["Click a name in the legend to hide that model; double-click to show it alone."])
    for k, record in enumerate(drawn):
        figures: list[Block] = [
            FigureBlock(plot(comparison, record, f"{name}-{k}"), stretches, group=f"{k}", switch=f"{k}")
            for name, plot in (("runs", plot_model_runs), ("errors-over-time", plot_model_residuals))
        ]
        title = capitalise(record_text(record))
        yield from [Subheading(title), *figures] if k < OPEN_RECORDS else [Details(title, figures)]
    if len(records) > len(drawn):
        yield Paragraphs([not_drawn(len(records) - len(drawn))])


def models_table(comparison: Comparison) -> PageTable:
    """Structure, numbers, BIC, stability, feed-through and time of each model."""
    rows = [
        [
            e.name,
            str(e.kind),
            ", ".join(dict.fromkeys(e.structure.values())),
            str(e.parameters),
            f"{e.bic:.0f}".replace("-", "−") if math.isfinite(e.bic) else "–",
            "yes" if e.stable else "no",
            typeset_number(", ".join(format_number(v, 3) for v in e.feedthrough.values())) or "none",
            f"{e.seconds:.1f} s" if e.seconds else "–",
        ]
        for e in comparison.entries
    ]
    head = ["model", "box", "structure", "numbers", "BIC", "stable", "feed-through", "time"]
    return PageTable(
        "Models",
        head,
        rows,
        "Numbers: fitted parameters or coefficients. BIC: of the free run on the estimation records; lower is better.",
    )


def _findings(comparison: Comparison) -> Iterator[Block]:
    of_models = [f"{e.name}: {sentence(finding)}" for e in comparison.entries for finding in e.findings]
    items: list[Text] = [*comparison.findings, *of_models]
    if items:
        yield BulletList(items)


def _physics(fits: Mapping[str, Fit]) -> Iterator[Block]:
    for k, (name, fit) in enumerate(fits.items()):
        blocks: list[Block] = [parameters_table(fit), typeset_equations(fit.model)]
        yield from [Subheading(name), *blocks] if k == 0 else [Details(name, blocks)]


def _data(comparison: Comparison, fingerprints: Mapping[str, str], known: Sequence[Finding | str]) -> Section:
    rows = []
    for use, records in (("fitted", comparison.training), ("validation", comparison.validation)):
        for record in records:
            runs = (r for e in comparison.entries for r in (*e.training_runs, *e.validation_runs))
            run = next((r for r in runs if r.record == record), None)
            length = [str(len(run.time)), f"{run.time[-1] - run.time[0]:.6g} s"] if run is not None else ["", ""]
            rows.append([record, use, *length, fingerprints.get(record, "")[:12]])
    note = f"The comparison omits the first {comparison.skip} rows of each record." if comparison.skip else ""
    table = PageTable("Records", ["record", "use", "rows", "duration", "fingerprint"], rows, note)
    return Section(
        "data",
        "Data",
        [table, *([BulletList([f"Record {text}" for text in known])] if known else [])],
    )
