"""A fit: what came out, whether to believe it, what it was made from, how to repeat it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from greybox.base import Finding, GreyboxError, Severity, format_unit
from greybox.base import document as doc
from greybox.base.values import with_code
from greybox.data.findings import UNITS_TAKEN
from greybox.data.noise import BoundDirection
from greybox.estimation import Fit, errors, optimum, result_parts
from greybox.estimation.findings import EstimationCode
from greybox.estimation.identifiability.practical import recommend_after_fit
from greybox.estimation.options import Transcription
from greybox.estimation.residuals import ALARM_LEVEL, ResidualTests, residual_tests
from greybox.estimation.result import GOOD_MISFIT
from greybox.show.documents import tables
from greybox.show.figures import fit as figures
from greybox.show.figures.figure import stretches_on_page
from greybox.show.figures.records import (
    SIGNAL_ON_PAGE,
    plot_inputs,
    plot_residual,
    plot_run,
    plot_runs_before_after,
    plot_spectrum,
)
from greybox.show.sentences import sentences, wording
from greybox.show.sentences.estimation import WIDER, list_tests_not_made, residual_tests_tables
from greybox.simulation.simulate import simulate

if TYPE_CHECKING:
    from greybox.shell.answers import FitAnswer


def describe_fit(
    fit: Fit,
    *,
    command: str = "",
    tests: ResidualTests | None = None,
    skip: int = 0,
    intervals: Iterable[tuple[str, doc.Block]] = (),
) -> doc.Document:
    """What is said of a fit.

    Parameters
    ----------
    fit
        The result of `greybox.fit`.
    command
        What was typed, for repeating it.
    tests
        Those of the residual; made here where left out.
    skip
        Rows at the start of validation records that do not count.
    intervals
        Further intervals of the parameters, by profile likelihood or a bootstrap, each kind with its title.
    """
    return doc.Document(
        f"Fit of {fit.model.title}",
        fit_answer(fit),
        fit_tone(fit),
        doc.Later(lambda: [tables.parameters_table(fit, fitted=True)]),
        doc.Later(fit_notes, fit),
        doc.Later(_details, fit),
        _question(fit),
        doc.Later(_evidence, fit),
        doc.Later(_sections, fit, command, tests, skip, intervals),
        "fit",
    )


def _details(fit: Fit) -> Iterator[doc.Block]:
    """All parameters, the priors, the misfit by output, where the noise is known from, how it was computed, and the equations."""
    yield tables.parameters_table(fit)
    yield from _priors(fit)
    yield from _misfits(fit)
    kind = _interval_kind(fit)
    facts = [("intervals", kind)] if kind else []
    yield doc.Facts([*facts, ("noise", str(fit.noise)), *tables.computation_facts(fit)])
    yield doc.EquationList([], fit.provenance.equations)


def _sections(
    fit: Fit, command: str, tests: ResidualTests | None, skip: int, intervals: Iterable[tuple[str, doc.Block]]
) -> Iterator[doc.Section]:
    yield doc.Section("parameters", "Parameters", list(_parameters(fit, intervals)))
    yield doc.Section("misfit", "Measured and simulated", list(_misfit(fit, skip)))
    yield doc.Section("residual", "Tests of the residual", list(_residual(fit, tests)))
    if fit.starts:
        yield doc.Section("starts", "The starts", list(_starts(fit)))
    yield doc.Section("model", "The model", [tables.typeset_equations(fit.model)])
    yield tables.records_section(fit)
    yield tables.fit_provenance_section(fit, command)


UNDETERMINED = (EstimationCode.PARAMETER_UNDETERMINED, EstimationCode.DIRECTION_UNDETERMINED)
# What the answer of a fit says already.
ANSWERED = (
    EstimationCode.MISFIT_ABOVE_NOISE,
    EstimationCode.MISFIT_ABOVE_DIFFERENCE_NOISE,
    EstimationCode.NO_FREEDOM,
)


def fit_answer(fit: Fit) -> str:
    """Whether the model explains its records: the worst error, the noise that it is divided by, and the same on other records."""
    title, worst = fit.model.title, _worst(fit.judged_misfit)
    if not fit.success:
        return (
            f"The fit of {title} did not succeed: {fit.solver.status_message}. Use its numbers only for diagnosis: they are those of the"
            " last point of the search."
        )
    if worst is None:
        return (
            f"{title}: the noise is not known, so nothing says whether the error of the model is noise{_judged(fit)}."
        )
    output, m = worst
    if free := with_code(fit.findings, EstimationCode.NO_FREEDOM):
        readings, unknowns = (free[0].values[key] for key in ("readings", "unknowns"))
        return (
            f"{title} is not tested by its records: {readings} readings for {unknowns} constants and first states leave nothing that"
            " could contradict it. Record more rows, or tell the noise (--noise)."
        )
    if lost := fit.worse_than_constant:
        return (
            f"{title} does not explain its records: their own mean follows {wording.join_names(lost)} better than the model, and its"
            f" constants mean nothing; {error_text(output, m)}."
        )
    if fit.is_above_noise(m):
        says = "does not explain its records"
    elif _open_outputs(fit):
        says = "may explain its records, whose noise has no more than a ceiling"
    else:
        says = "explains its records"
    ahead = " one sample ahead" if fit.prediction.process_noise else ""
    return f"{title} {says}{ahead}: {error_text(output, m)}{_judged(fit)}."


def error_text(output: str, m: result_parts.Misfit) -> str:
    """``the error in x, 14.7 µm, is at least 35.3 times the noise (at most 0.415 µm)``: the ratio and what it comes from."""
    outliers = " without outliers" * m.without_outliers
    size = m.rmse if m.error is None else m.error
    error = wording.quantity_text(size, m.unit, beside=m.noise or 0.0)
    noise = wording.noise_text(m, beside=size)
    of = (
        ""
        if not noise
        else f" ({noise})"
        if m.direction in (BoundDirection.AT_MOST, BoundDirection.AT_LEAST)
        else f" of {noise}"
    )
    return f"the error in {output}{outliers}, {error}, is {wording.ratio_text(m)} times the noise{of}"


def _judged(fit: Fit) -> str:
    """What records say that were not fitted."""
    worst = _worst(fit.validation.misfit)
    records = wording.count_noun(len(fit.validation.traces), "validation record")
    if not all(math.isfinite(m.rmse) for m in fit.validation.misfit.values()):
        return f"; it cannot be run over {records}"
    if worst is None:
        return ""
    judges = "" if fit.judges_validation else ", which judges nothing"
    output, m = worst
    free = " in a free run" if fit.prediction.process_noise else ""
    return f"; on {records}{judges}, {wording.ratio_text(m)} times in {output}{free}"


def fit_tone(fit: Fit) -> doc.Tone:
    """Green where the model explains its records and those that judge it, and every constant is determined."""
    if not fit.success or fit.worse_than_constant:
        return doc.Tone.BAD
    is_tested = not with_code(fit.findings, EstimationCode.NO_FREEDOM)
    is_open = _worst(fit.judged_misfit) is None or _undetermined(fit) or _open_outputs(fit)
    if not (fit.explains_records and is_tested) or is_open:
        return doc.Tone.CAUTION
    return doc.Tone.GOOD if fit.judges_validation else doc.Tone.PLAIN


def fit_notes(fit: Fit) -> list[doc.Text]:
    """What to know before trusting a fit that its answer does not say, the worst first."""
    known = {*ANSWERED, *UNDETERMINED}
    if fit.uncertainty.kind == "sandwich" and fit.uncertainty.inflation:
        known.add(EstimationCode.RESIDUAL_CORRELATED)  # said below the parameters
    units = units_in_doubt(fit)
    findings = [f for f in tables.worst_first(fit.findings) if f.code not in known and f not in units]
    notes: list[doc.Text] = [f for f in findings if f.severity is not Severity.NOTE]
    directions = [f for f in fit.findings if f.code == EstimationCode.DIRECTION_UNDETERMINED]
    # Constants that can change together have no interval, and a sentence of their own.
    if wide := [name for name in _undetermined(fit) if not any(name in f.values["direction"] for f in directions)]:
        notes.insert(0, f"not determined, the 95 % interval exceeds half the value: {wording.join_names(wide)}")
    notes += directions
    if fit.success and fit.uncertainty.free and not fit.validation:
        notes.append("not validated: give a second record")
    return [*units, *notes, *(f for f in findings if f.severity is Severity.NOTE)]


def units_in_doubt(fit: Fit) -> list[Finding]:
    """Units that no header states, where the model does not explain its records: a wrong one looks like a wrong model."""
    return [] if fit.success and fit.explains_records else [f for f in fit.findings if f.code in UNITS_TAKEN]


def _undetermined(fit: Fit) -> list[str]:
    return [name for name in fit.uncertainty.free if name in fit.parameters and not fit.parameters[name].determined]


def _worst(misfit: Mapping[str, result_parts.Misfit]) -> tuple[str, result_parts.Misfit] | None:
    """The output with the largest misfit over noise; None where no noise is known."""
    known = [(name, m) for name, m in misfit.items() if math.isfinite(m.noise_ratio)]
    return max(known, key=lambda item: item[1].noise_ratio, default=None)


def _open_outputs(fit: Fit) -> list[str]:
    """Outputs above the level that they are weighed with and below the ceiling of their noise: that may be noise, and may be none."""
    bounded = [n for n, m in fit.judged_misfit.items() if m.direction is BoundDirection.AT_MOST]
    return [n for n in bounded if (fit.judged_misfit[n].error or 0.0) > GOOD_MISFIT * fit.noise.std[n]]


@dataclass(frozen=True)
class RecordRun:
    """A model's run over one record, for validation or fitted; the first ``skip`` rows do not count."""

    trace: result_parts.Trace
    validation: bool
    skip: int = 0

    @property
    def title(self) -> str:
        """``Validation record b``."""
        return f"{('Validation' if self.validation else 'Estimation')} {wording.record_text(self.trace.name)}"


def _question(fit: Fit) -> str:
    free, fixed = fit.uncertainty.free, [name for name, e in fit.parameters.items() if e.fixed]
    rows = sum(len(t.time) for t in fit.traces)
    records = f"{wording.count_noun(len(fit.traces), 'record')} ({wording.count_noun(rows, 'row')})"
    known = f" {wording.join_names(fixed)} {'is' if len(fixed) == 1 else 'are'} fixed." if fixed else ""
    if not free:
        return f"How well does the model follow {records}?{known}"
    return f"Which values of {wording.join_names(free)} make the model follow {records}?{known}"


def _evidence(fit: Fit) -> Iterator[doc.FigureBlock]:
    """What convinces of a fit: its run over a record that it has not seen, else over one that it has."""
    traces = [*fit.validation.traces, *fit.traces]
    if fit.success and traces:
        stretches = stretches_on_page(2 * len(traces[0].measured))
        yield doc.FigureBlock(plot_run(traces[0], tables.signal_units(fit.model), "evidence"), stretches)


def _parameters(fit: Fit, further: Iterable[tuple[str, doc.Block]]) -> Iterator[doc.Block]:
    kind = _interval_kind(fit)
    yield tables.parameters_table(fit, kind and f"Intervals: {kind}")
    yield from _priors(fit)
    for title, block in further:
        yield doc.Subheading(f"{title[0].upper()}{title[1:]}")
        yield block
    if recommendations := recommend_after_fit(fit):
        yield doc.Subheading("How to determine the other parameters")
        yield doc.BulletList(list(dict.fromkeys(sentences(recommendations))))
    several = [d for f in fit.findings if len(d := f.values.get("directions", ())) > 1]
    if several:
        lines = [
            ", ".join(f"{name} by {wording.format_number(weight, 3)}" for name, weight in direction.items())
            for directions in several
            for direction in directions
        ]
        yield doc.Details("Relative changes that leave the outputs as they are", [doc.BulletList(lines)])
    intervals = figures.plot_intervals(
        figures.relative_half_widths(fit), "Half width of each 95 % interval: smaller is better."
    )
    if intervals is not None:
        yield doc.FigureBlock(intervals)
    correlation = figures.plot_correlation(fit)
    if correlation is not None:
        pairs = figures.strongly_correlated_pairs(fit)
        if pairs:
            yield doc.BulletList(pairs)
        yield doc.Details("Correlation of the fitted parameters", [doc.FigureBlock(correlation)])


def _priors(fit: Fit) -> Iterator[doc.TableBlock]:
    """What the prior knowledge was, and what the records added to it."""
    rows = []
    for name, c in fit.constraints.priors.items():
        conflict = "" if c.conflict is None else f"{wording.format_number(abs(c.conflict), 2)} std"
        factor = "" if c.factor is None or c.factor_std is None else wording.format_with_std(c.factor, c.factor_std)
        reduction = wording.percent_text(c.variance_reduction, 3)
        rows.append(
            [
                name,
                wording.format_with_std(c.mean, c.std),
                f"{wording.format_number(c.shift, 2)} std",
                reduction,
                conflict,
                factor,
            ]
        )
    if rows:
        heads = ["prior", "prior value", "shift", "variance reduction", "conflict", "data over prior"]
        yield doc.TableBlock("Priors", heads, rows)


def _starts(fit: Fit) -> Iterator[doc.Block]:
    """Where each start ended, best first: the waterfall, and its numbers."""
    yield doc.FigureBlock(figures.plot_starts(fit.starts))
    names, rows = list(fit.starts[0].start), []
    for k, (s, ratio) in enumerate(zip(fit.starts, figures.misfits_over_best(fit.starts), strict=True)):
        ends = (f" -> {s.values[name]:.3g}" if name in s.values else "" for name in names)
        moves = [f"{s.start[name]:.3g}{end}" for name, end in zip(names, ends, strict=True)]
        rows.append([str(k + 1), wording.plain_number(ratio), s.status.replace("_", " "), *moves])
    yield doc.TableBlock("Start and end of each search", ["start", "misfit / best misfit", "ended", *names], rows)


# Standard deviations to the end of an interval from which it is said how many: at 2.1 some twenty independent readings tell the noise.
FAR_REACH = 2.1


def _interval_kind(fit: Fit) -> str:
    kind, reach = _covariance_kind(fit), fit.uncertainty.reach
    if kind and reach is not None and reach > FAR_REACH:
        return (
            f"{kind}; 95 % is {reach:.3g} standard deviations to each side, as few independent readings tell the noise"
        )
    return kind


def _covariance_kind(fit: Fit) -> str:
    sandwich = fit.uncertainty.kind == "sandwich"
    if fit.prediction.process_noise and not sandwich:
        which = "observed" if fit.uncertainty.kind == "observed_information" else "expected"
        return f"{which} information of the likelihood; the innovations are white"
    if sandwich and fit.uncertainty.inflation:
        widest = fit.uncertainty.largest_inflation
        how_wide = f" (up to {widest:.3g} times as wide)" if widest >= WIDER else ""
        return f"sandwich covariance, which allows for the colour of the residual{how_wide}"
    if any(e.std is not None for e in fit.parameters.values()):
        return "Gauss-Newton covariance (expected information); the residual is white"
    return ""


# Values of all residuals of a page together up to which its spectra follow the part that is zoomed into.
ALL_SIGNALS_ON_PAGE = 100000
# Records whose figures stand open at first; those of the others open on request.
OPEN_RECORDS = 1
# Records of a fit whose curves are drawn; the tables have all.
RECORDS_OF_FIT = 20


def _misfits(fit: Fit) -> Iterator[doc.TableBlock]:
    """The misfit by output: of the run that was fitted, of a prediction, and on the validation records.

    The states of segments that meet, in which an unstable model is run, and those of arcs are fitted to the record: that is no free run.
    """
    estimation, how = "on the estimation records", fit.solver.statistics
    in_arcs = how.get("transcription") == Transcription.ARCS
    in_segments = not (how.get("free_run", True) or in_arcs or fit.prediction.process_noise)
    run = "run in segments" if in_segments else "run in arcs" if in_arcs else "free run"
    yield tables.misfit_table(f"{run.capitalize()} {estimation}", fit.misfit, f"misfit ({run})")
    if ahead := fit.prediction.one_step:
        yield tables.misfit_table(f"Prediction one sample ahead {estimation}", ahead, "prediction (1 step ahead)")
    if fit.validation:
        run = "run in segments" if in_segments else "free run"  # arcs are of the estimation alone
        corner = f"on validation records ({run})"
        yield tables.misfit_table(f"{run.capitalize()} on the validation records", fit.validation.misfit, corner)


def _first_states(fit: Fit) -> Iterator[doc.TableBlock]:
    """Where each run began."""
    states = {s.name: format_unit(s.unit) for s in fit.model.all_states}
    traces = [*fit.traces, *fit.validation.traces][:RECORDS_OF_FIT]
    names = [n for n in states if all(n in t.initial_state for t in traces)]
    rows = [
        [t.name, *(wording.with_unit(wording.format_number(t.initial_state[n], 4), states[n]) for n in names)]
        for t in traces
    ]
    if rows and names:
        yield doc.TableBlock("First state of each run", ["record", *names], rows)


def _run_at_start(fit: Fit) -> Iterator[doc.Details]:
    """The run at the start values beside that of the fit, over the first record; none where it overflows."""
    begun = fit.provenance.start
    if fit.starts or not (begun and fit.traces and fit.model.has_equations):
        return
    trace = fit.traces[0]
    try:
        run = simulate(fit.model.start(**begun), trace.experiment, initial=trace.initial_state)
    except GreyboxError:  # a model that cannot be run from there
        return
    if run.overflow is None and len(run.time) == len(trace.time):
        before = replace(trace, simulated={name: run.outputs[name] for name in trace.measured})
        figure = plot_runs_before_after(
            before, trace, tables.signal_units(fit.model), "at-start", ("at the start", "fitted")
        )
        yield doc.Details("The run at the start values beside that of the fit", [doc.FigureBlock(figure)])


def _misfit(fit: Fit, skip: int) -> Iterator[doc.Block]:
    yield from _misfits(fit)
    yield from _first_states(fit)
    yield from _run_at_start(fit)
    runs = [RecordRun(t, False) for t in fit.traces] + [RecordRun(t, True, skip) for t in fit.validation.traces]
    if len(runs) > 2:
        yield _by_record(fit, runs)
    drawn = runs[:RECORDS_OF_FIT]
    stretches = stretches_on_page(sum(3 * len(r.trace.measured) + len(r.trace.inputs) for r in drawn))
    signals = sum(len(r.trace.measured) * min(len(r.trace.time), SIGNAL_ON_PAGE) for r in drawn)
    for k, run in enumerate(drawn):
        blocks = _record_figures(fit, run.trace, k, stretches, follow=signals <= ALL_SIGNALS_ON_PAGE)
        first_for_validation = run.validation and not runs[k - 1].validation
        if k < OPEN_RECORDS or first_for_validation:
            yield doc.Subheading(run.title)
            yield from blocks
        else:
            yield doc.Details(run.title, blocks)
    if len(runs) > len(drawn):
        yield doc.Paragraphs([not_drawn(len(runs) - len(drawn))])


def not_drawn(records: int) -> str:
    """Why there are tables of so many records more than figures."""
    return f"The tables include {wording.count_noun(records, 'more record')} that {'is' if records == 1 else 'are'} not drawn."


def _record_figures(fit: Fit, trace: result_parts.Trace, k: int, stretches: int, *, follow: bool) -> list[doc.Block]:
    """Run, residual, spectrum and inputs of one record, which zoom together and switch their outputs together."""
    units, noise, together = tables.signal_units(fit.model), fit.noise.levels, f"{k}"
    residual = plot_residual(trace, units, noise, f"residual-{k}")
    spectrum = plot_spectrum(trace, units, noise, f"spectrum-{k}", follows=residual.name if follow else "")
    inputs = plot_inputs(trace, units, f"inputs-{k}")
    blocks: list[doc.Block] = [
        doc.FigureBlock(plot_run(trace, units, f"run-{k}"), stretches, group=together, switch=together),
        doc.FigureBlock(residual, stretches, group=together, switch=together),
        doc.FigureBlock(spectrum, stretches, switch=together),
    ]
    return blocks if inputs is None else [*blocks, doc.FigureBlock(inputs, stretches, group=together)]


def _by_record(fit: Fit, runs: Sequence[RecordRun]) -> doc.TableBlock:
    rows = [
        [run.trace.name, "validation" if run.validation else "fitted", output, *tables.misfit_cells(m)]
        for run in runs
        for output, m in errors.compute_record_misfits(fit, run.trace, run.skip).items()
    ]
    return doc.TableBlock("Record by record", ["record", "use", "output", *tables.MISFIT_HEADS], rows)


def _residual(fit: Fit, tests: ResidualTests | None) -> Iterator[doc.Block]:
    if not fit.success:
        yield doc.Paragraphs(["The fit did not succeed, so its residual was not tested."], doc.Tone.CAUTION)
        return
    if not (optimum.has_free_run(fit) or fit.prediction.process_noise):
        yield doc.Paragraphs(
            ["The residual was not tested: states that are estimated along the record absorb the missing effects."],
            doc.Tone.CAUTION,
        )
        return
    tests = tests or residual_tests(fit)
    if tests.alarms:
        count = len(tests.alarms)
        alarms = (
            f"{count} of {len(tests.tests)} tests {'raises' if count == 1 else 'raise'} an alarm: the residual contains more"
            " than noise."
        )
        yield doc.Paragraphs([alarms], doc.Tone.CAUTION)
    elif tests.tests:
        yield doc.Paragraphs(
            [f"None of {len(tests.tests)} tests raises an alarm: the residual shows nothing but noise."], doc.Tone.GOOD
        )
    if tests.not_made:
        yield doc.Paragraphs([f"Not tested: {line}." for line in list_tests_not_made(tests)], doc.Tone.CAUTION)
    note = f"Each test raises a false alarm (p below {ALARM_LEVEL:g}) in one of a hundred correct fits."
    yield from residual_tests_tables(tests, note)
    if not tests.tests:
        return
    for output in tests.residuals:
        yield doc.FigureBlock(figures.plot_residual_tests(tests, output, f"tests-{output}"))


# What the command prints: a fit, with what was asked for beside it.


def describe_fit_answer(answer: FitAnswer) -> doc.Document:
    """The fit; what would determine more, and on request further intervals, predictions, residual tests, the misfit of each record."""
    fit = answer.fit.describe()
    remedies = [f"remedy: {text}" for text in answer.remedies]
    notes = [*([answer.refusal] if answer.refusal else []), *remedies[:1], *fit.notes, *remedies[1:]]
    table = [*fit.table, *(doc.Details(title, [block]) for title, block in further_intervals(answer))]
    return replace(fit, table=table, notes=notes, details=doc.Later(_fit_details, answer, fit.details))


def _fit_details(answer: FitAnswer, details: Sequence[doc.Block]) -> Iterator[doc.Block]:
    yield from details
    shown: list[doc.Block] = []  # what corrects the predictions is often the same for both
    for title, scores in (("", answer.scores), (", validation records", answer.validation_scores)):
        if scores is not None:
            blocks = [block for block in scores.describe().details if block not in shown]
            shown += blocks
            yield doc.Details(f"free run and prediction{title}", blocks)
    if answer.tests is not None:
        title = "residual tests (an alarm: p below 0.01, as in 1 % of correct fits)"
        yield doc.Details(title, answer.tests.describe().details)
    for title, misfits in (("estimation record", answer.misfits), ("validation record", answer.validation_misfits)):
        if misfits:
            rows = [[m.record, m.output, *tables.misfit_cells(m.misfit)] for m in misfits]
            yield doc.TableBlock(f"Misfit of each {title}", [title, "output", *tables.MISFIT_HEADS], rows)


def further_intervals(answer: FitAnswer) -> Iterator[tuple[str, doc.Block]]:
    """The intervals that were asked for beside those of the covariance, each kind with its title."""
    if answer.profiles or answer.regions or answer.zero_noise:
        zeros = [f"{name}: zero; its limit is listed with the parameters" for name in answer.zero_noise]
        lines = "\n".join([*map(str, (*answer.profiles, *answer.regions)), *zeros]).splitlines()
        yield "profile likelihood", doc.Paragraphs(lines)
    if answer.bootstrap is not None:
        b = answer.bootstrap
        ends = {name: "[{:.5g}, {:.5g}]".format(*b.interval[name]) for name in b.names}
        facts = [(name, f"standard deviation {b.std[name]:.3g}, 95 % {ends[name]}") for name in b.names]
        yield f"block bootstrap, {len(b.samples)} replicates in blocks of {b.block} rows", doc.Facts(facts)
