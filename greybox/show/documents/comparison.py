"""A comparison: grey and black boxes on the same rows of the same records."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from greybox.base import document as doc
from greybox.base import format_unit
from greybox.base.numerics import TINY
from greybox.base.values import Finding, with_code
from greybox.comparison.result import Comparison, ComparisonEntry, ComparisonFinding
from greybox.estimation.result import Fit
from greybox.show.documents.fit import OPEN_RECORDS, not_drawn
from greybox.show.documents.tables import parameters_table, provenance_section, typeset_equations, worst_first
from greybox.show.figures.comparison import judging_records, plot_model_errors, plot_model_residuals, plot_model_runs
from greybox.show.figures.figure import scale_to_prefix, stretches_on_page
from greybox.show.sentences import sentence, sentences, wording


def describe_comparison(
    comparison: Comparison,
    *,
    command: str = "",
    fits: Mapping[str, Fit] | None = None,
    data: Mapping[str, str] | None = None,
    known: Sequence[Finding | str] = (),
) -> doc.Document:
    """What is said of a comparison.

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
    records = "records that no model was fitted to" if comparison.validation else "the records that they were fitted to"
    question = (
        f"Which model of {wording.join_names(list(comparison.outputs))} is best? {wording.count_noun(len(comparison.entries), 'model')},"
        f" compared on the same rows of {records}."
    )
    return doc.Document(
        "Comparison of grey-box and black-box models",
        comparison_answer(comparison),
        comparison_tone(comparison),
        doc.Later(lambda: [summary_table(comparison)]),
        doc.Later(_notes, comparison),
        doc.Later(_details, comparison),
        question,
        doc.Later(lambda: [doc.FigureBlock(plot_model_errors(comparison))]),
        doc.Later(_sections, comparison, fits or {}, data or {}, known, command),
        "comparison",
    )


def _sections(
    comparison: Comparison,
    fits: Mapping[str, Fit],
    data: Mapping[str, str],
    known: Sequence[Finding | str],
    command: str,
) -> Iterator[doc.Section]:
    yield doc.Section("errors", "Errors", list(error_blocks(comparison)))
    yield doc.Section("runs", "Runs", list(_runs(comparison)))
    notes = [doc.BulletList(known_of_models)] if (known_of_models := _remarks(comparison)) else []
    yield doc.Section("models", "Models", [models_table(comparison), *structures(comparison), *notes])
    if fits:
        yield doc.Section("physics", "The physical models", list(_physics(fits)))
    yield _data(comparison, data, known)
    yield provenance_section(command)


# Letters of a name in a table on a terminal.
NAME_WIDTH = 42


def comparison_answer(comparison: Comparison) -> str:
    """The best model, its error and that of the best box of the other kind, in the output where the two are furthest apart."""
    pairs = {}
    for output in comparison.outputs:
        if ranking := _rank(comparison, output):
            rival = next((item for item in ranking if item[1].kind is not ranking[0][1].kind), None)
            pairs[output] = (ranking[0], rival, rival[0] / max(ranking[0][0], TINY) if rival else 0.0)
    if not pairs:
        return "No model of this comparison has an error on these records."
    output = max(pairs, key=lambda name: pairs[name][2])
    (error, best), other, times_worse = pairs[output]
    unit, records = format_unit(comparison.outputs[output]), "validation" if comparison.validation else "estimation"
    size = wording.quantity_text(error, unit, beside=other[0] if other else 0.0)
    text = f"{best.name} is best: its error in {output} on the {records} records is {size}"
    if other is None:
        return f"{text}; there is no box of another kind."
    times = f", {wording.plain_number(times_worse)} times as much" if error > 0 else ""
    return f"{text}; that of the best {other[1].kind} box, {other[1].name}, is {wording.quantity_text(other[0], unit)}{times}."


def best_model(comparison: Comparison) -> ComparisonEntry | None:
    """The best model of the first output that has one."""
    return next((e for output in comparison.outputs if (e := _best(comparison, output)) is not None), None)


def comparison_tone(comparison: Comparison) -> doc.Tone:
    """Green where a grey box has the smallest free-run error of every output."""
    best = [_best(comparison, output) for output in comparison.outputs]
    physics_is_best = bool(best) and all(e is not None and e.kind == "grey" for e in best)
    failed = with_code(comparison.verdict, ComparisonFinding.FAILED_FITS)
    return doc.Tone.GOOD if physics_is_best and not failed else doc.Tone.CAUTION


def summary_table(comparison: Comparison) -> doc.TableBlock:
    """Error and best fit of each model on the judging records, the best first."""
    names = list(dict.fromkeys(e.name for output in comparison.outputs for _, e in _rank(comparison, output)))
    names += [e.name for e in comparison.standing if e.name not in names]
    # One prefix a column: numbers below one another are compared.
    largest = {
        output: max((error for error, _ in _rank(comparison, output)), default=0.0) for output in comparison.outputs
    }
    rows = []
    for name in names:
        scores = comparison.deciding_scores(comparison[name])
        cells = []
        for output, unit in comparison.outputs.items():
            s = scores.get(output)
            if s is None or not math.isfinite(s.rmse):
                cells += ["-", "-"]
            else:
                error = wording.quantity_text(s.rmse, format_unit(unit), beside=largest[output])
                cells += [error, f"{s.best_fit_percent:.1f} %"]
        rows.append(
            [wording.shorten(name, NAME_WIDTH), str(comparison[name].kind), str(comparison[name].parameters), *cells]
        )
    heads = [head for output in comparison.outputs for head in (f"error in {output}", "fit")]
    return doc.TableBlock("Free run on the judging records", ["model", "box", "parameters", *heads], rows)


def _notes(comparison: Comparison) -> list[doc.Text]:
    """What the answer and its table leave out, the worst first."""
    findings = [f for f in comparison.verdict if f.code != ComparisonFinding.BEST_MODEL]
    # How predictions are corrected belongs to their errors, which stand behind --details and on the page.
    return [*worst_first(findings), *_remarks(comparison, left_out=(ComparisonFinding.PREDICTION_FILTER,))]


def _details(comparison: Comparison) -> Iterator[doc.Block]:
    """Errors by output, best first, on validation and estimation records; what each model is; who is best at what."""
    tables = [*_error_tables(comparison, "validation"), *_error_tables(comparison, "training")]
    for table in [*tables, *_record_tables(comparison), models_table(comparison)]:
        yield replace(table, rows=[[wording.shorten(row[0], NAME_WIDTH), *row[1:]] for row in table.rows])
    yield from structures(comparison)
    yield doc.Paragraphs(with_code(comparison.verdict, ComparisonFinding.BEST_MODEL))


def _rank(comparison: Comparison, output: str) -> list[tuple[float, ComparisonEntry]]:
    """The models with a finite error of an output on the judging records, best first."""
    scores = [(comparison.deciding_scores(e).get(output), e) for e in comparison.entries]
    known = [(s.rmse, e) for s, e in scores if s is not None and math.isfinite(s.rmse)]
    return sorted(known, key=lambda item: item[0])


def _best(comparison: Comparison, output: str) -> ComparisonEntry | None:
    return next((e for _, e in _rank(comparison, output)), None)


def error_blocks(comparison: Comparison) -> Iterator[doc.Block]:
    """Tables of the errors on the judging records, and on the estimation records where there are others."""
    training = _error_tables(comparison, "training")
    if not comparison.validation:
        yield from training
        return
    yield from _error_tables(comparison, "validation")
    yield from _record_tables(comparison)
    if comparison.training:
        yield doc.Details("On the estimation records", list(training))


def _error_tables(comparison: Comparison, group: str) -> Iterator[doc.TableBlock]:
    """Errors on the validation or the training records, an output a table, the best model first."""
    if getattr(comparison, group):
        yield from (_error_table(comparison, group, output) for output in comparison.outputs)


def _error_table(comparison: Comparison, group: str, output: str) -> doc.TableBlock:
    scores = {e.name: s for e in comparison.standing if (s := e.score(output, group)) is not None}
    steps = sorted({k for s in scores.values() for k in s.ahead_rmse})
    sizes = [s.rmse for s in scores.values() if math.isfinite(s.rmse)]
    # The prefix of the middle one: a model that runs away does not choose it.
    factor, unit = scale_to_prefix(comparison.outputs[output], np.array([np.median(sizes)] if sizes else []))
    rows = [
        [
            name,
            str(comparison[name].kind),
            _error(factor * s.rmse),
            f"{s.best_fit_percent:.2f} %" if math.isfinite(s.best_fit_percent) else "-",
            _error(factor * s.one_step_rmse),
            *(_error(factor * s.ahead_rmse.get(k, math.nan)) for k in steps),
        ]
        for name, s in sorted(
            scores.items(), key=lambda item: item[1].rmse if math.isfinite(item[1].rmse) else math.inf
        )
    ]
    counts = [str(n) for n in sorted({s.samples for s in scores.values()})]
    unequal = ": not the same for every model" if len(counts) != 1 else ""
    return doc.TableBlock(
        f"{output}, {'estimation' if group == 'training' else group} records, {wording.join_names(counts)} rows{unequal}",
        ["model", "box", "free run", "best fit", "one step", *(f"{k} ahead" for k in steps)],
        rows,
        f"Free run and {'one or several steps' if steps else 'one step'} ahead: rms errors{f' in {unit}' if unit else ''}.",
        f"{group}: {output}" + (f" [{unit}]" if unit else ""),
    )


def _record_tables(comparison: Comparison) -> Iterator[doc.TableBlock]:
    """Best fit of each validation record, where there are several."""
    shown = comparison.validation[:5]
    left_out = len(comparison.validation) - len(shown)
    for output in comparison.outputs if len(comparison.validation) > 1 else ():
        scores = {e.name: [e.score(output, record=record) for record in shown] for e in comparison.standing}
        rows = [[n, *("-" if s is None else f"{s.best_fit_percent:.2f}" for s in each)] for n, each in scores.items()]
        title = f"best fit [%], {output}" + (f" ({left_out} more records in the file)" if left_out else "")
        yield doc.TableBlock(
            wording.capitalise(title), ["model", *(wording.shorten(name, 14) for name in shown)], rows, corner=title
        )


def _error(value: float) -> str:
    if math.isnan(value):
        return "-"
    return wording.format_number(value, 4) if math.isfinite(value) else "diverges"


# Records of a comparison whose curves are drawn.
RECORDS_OF_COMPARISON = 8


def _runs(comparison: Comparison) -> Iterator[doc.Block]:
    """The curves of every model over each judging record."""
    records = judging_records(comparison)
    drawn = records[:RECORDS_OF_COMPARISON]
    curves = 2 * sum(len(comparison.deciding_scores(e)) for e in comparison.standing) + len(comparison.outputs)
    stretches = stretches_on_page(len(drawn) * curves)
    yield doc.Paragraphs(["Click a name in the legend to hide that model; double-click to show it alone."])
    for k, record in enumerate(drawn):
        figures: list[doc.Block] = [
            doc.FigureBlock(plot(comparison, record, f"{name}-{k}"), stretches, group=f"{k}", switch=f"{k}")
            for name, plot in (("runs", plot_model_runs), ("errors-over-time", plot_model_residuals))
        ]
        title = wording.capitalise(wording.record_text(record))
        yield from [doc.Subheading(title), *figures] if k < OPEN_RECORDS else [doc.Details(title, figures)]
    if len(records) > len(drawn):
        yield doc.Paragraphs([not_drawn(len(records) - len(drawn))])


def models_table(comparison: Comparison) -> doc.TableBlock:
    """Numbers, BIC, stability, feed-through and time of each model."""
    rows = [
        [
            e.name,
            str(e.kind),
            str(e.parameters),
            f"{e.bic:.0f}" if math.isfinite(e.bic) else "-",
            "yes" if e.stable else "no",
            ", ".join(wording.format_number(v, 3) for v in e.feedthrough.values()) or "none",
            f"{e.seconds:.1f} s" if e.seconds else "-",
        ]
        for e in comparison.standing
    ]
    return doc.TableBlock(
        "Models",
        ["model", "box", "parameters", "BIC", "stable", "feed-through", "time"],
        rows,
        "Parameters: fitted ones, or coefficients. BIC: of the free run on the estimation records; lower is better.",
    )


def structures(comparison: Comparison) -> Iterator[doc.Facts]:
    """What each model is, where its name does not say that already."""
    known = {e.name: ", ".join(dict.fromkeys(e.structure.values())) for e in comparison.standing}
    entries = [(name, text) for name, text in known.items() if text != name]
    if entries:
        yield doc.Facts(entries, "Structures")


def _remarks(comparison: Comparison, left_out: Collection[str] = ()) -> list[str]:
    """What is to be known of the comparison and of its models."""
    findings = [(e.name, f) for e in comparison.entries for f in e.findings if f.code not in left_out]
    of_models = [f"{name}: {sentence(finding)}" for name, finding in findings]
    return [*sentences(comparison.findings), *of_models]


def _physics(fits: Mapping[str, Fit]) -> Iterator[doc.Block]:
    for k, (name, fit) in enumerate(fits.items()):
        blocks: list[doc.Block] = [parameters_table(fit), typeset_equations(fit.model)]
        yield from [doc.Subheading(name), *blocks] if k == 0 else [doc.Details(name, blocks)]


def _data(comparison: Comparison, fingerprints: Mapping[str, str], known: Sequence[Finding | str]) -> doc.Section:
    rows = []
    for use, records in (("fitted", comparison.training), ("validation", comparison.validation)):
        for record in records:
            runs = (r for e in comparison.standing for r in (*e.training_runs, *e.validation_runs))
            run = next((r for r in runs if r.record == record), None)
            length = [str(len(run.time)), f"{run.time[-1] - run.time[0]:.6g} s"] if run is not None else ["", ""]
            rows.append([record, use, *length, fingerprints.get(record, "")[:12]])
    note = f"The comparison omits the first {comparison.skip} rows of each record." if comparison.skip else ""
    table = doc.TableBlock("Records", ["record", "use", "rows", "duration", "fingerprint"], rows, note)
    return doc.Section(
        "data", "Data", [table, *([doc.BulletList([f"Record {text}" for text in known])] if known else [])]
    )
