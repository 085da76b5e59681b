"""A fit: what came out, whether to believe it, what it was made from, how to repeat it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from greybox.base import Finding
from greybox.base import document as doc
from greybox.estimation import Fit, errors, optimum, result_parts
from greybox.estimation.findings import EstimationCode
from greybox.estimation.identifiability.practical import recommend_after_fit
from greybox.estimation.options import Transcription
from greybox.estimation.residuals import ALARM_LEVEL, ResidualTests, residual_tests
from greybox.show.documents import tables
from greybox.show.figures import fit as figures
from greybox.show.figures.figure import stretches_on_page
from greybox.show.figures.records import SIGNAL_ON_PAGE, plot_inputs, plot_residual, plot_run, plot_spectrum
from greybox.show.sentences.estimation import list_tests_not_made, residual_tests_tables
from greybox.show.sentences.registry import sentences
from greybox.show.sentences.wording import (
    count_noun,
    format_number,
    format_with_std,
    join_names,
    percent_text,
    record_text,
)


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
        doc.Later(_brief, fit),
        _question(fit),
        fit_verdict(fit),
        doc.Later(_sections, fit, command, tests, skip, intervals),
        "fit",
        doc.Later(_evidence, fit),
    )


def _brief(fit: Fit) -> Iterator[doc.Block]:
    """Status beside misfit over noise, the parameters with intervals, the misfit by output, and what to know before trusting them."""
    yield doc.Paragraphs([f"{fit.model.title}: {fit.solver}"])
    yield tables.parameters_table(fit)
    yield from _priors(fit)
    yield from _misfits(fit)
    if kind := _interval_kind(fit):
        yield doc.Facts([("intervals", kind)])
    notes = (("note", text) for text in sentences(fit.findings))
    yield doc.Facts([("noise", str(fit.noise)), *tables.computation_facts(fit), *notes])


def _sections(
    fit: Fit, command: str, tests: ResidualTests | None, skip: int, intervals: Iterable[tuple[str, doc.Block]]
) -> Iterator[doc.Section]:
    yield doc.Section("parameters", "Parameters", list(_parameters(fit, intervals)))
    yield doc.Section("misfit", "Measured and simulated", list(_misfit(fit, skip)))
    yield doc.Section("residual", "Tests of the residual", list(_residual(fit, tests)))
    yield doc.Section("model", "The model", [tables.typeset_equations(fit.model)])
    yield tables.records_section(fit)
    yield tables.fit_provenance_section(fit, command)


UNDETERMINED = (EstimationCode.PARAMETER_UNDETERMINED, EstimationCode.DIRECTION_UNDETERMINED)


# Up to so many times the noise a fit is said to explain its records: noise is known to about a tenth.
GOOD_MISFIT = 1.2
# Findings of a fit that stand with its verdict.
LEADING_FINDINGS = 3


def fit_verdict(fit: Fit) -> doc.Paragraphs:
    """Whether the fit succeeded, and what to know before trusting it."""
    leading = LEADING_FINDINGS
    if not fit.success:
        failure = (
            f"The fit did not succeed: {fit.solver.status_message}.",
            "The numbers below are those of the last point of the search. Use them only for diagnosis.",
        )
        return doc.Paragraphs([*failure, *fit.findings[:leading]], doc.Tone.BAD)
    free = [name for name in fit.uncertainty.free if name in fit.parameters]
    undetermined = [name for name in free if not fit.parameters[name].determined]
    known = [m.noise_ratio for m in fit.misfit.values() if math.isfinite(m.noise_ratio)]
    is_good = bool(known) and max(known) <= GOOD_MISFIT and not undetermined
    return doc.Paragraphs(
        [_misfit_note(fit), _determined(fit, undetermined), _validated(fit), *_further(fit)[:leading]],
        doc.Tone.GOOD if is_good else doc.Tone.CAUTION,
    )


def findings_below(fit: Fit) -> list[Finding]:
    """What the page says of a fit beside its residual: findings that neither the verdict nor the parameters say already."""
    # The verdict of a fit that failed has the first ones already, of any kind.
    return [*(_further(fit) if fit.success else fit.findings)[LEADING_FINDINGS:]]


def _further(fit: Fit) -> list[Finding]:
    """Findings that say something else than sentences of the page: what is above the noise, open, or widened stands there once."""
    worst = _worst_misfit(fit)
    known = {EstimationCode.MISFIT_ABOVE_NOISE} if worst is not None and worst > GOOD_MISFIT else set()
    if fit.uncertainty.kind == "sandwich" and fit.uncertainty.inflation:
        known.add(EstimationCode.RESIDUAL_CORRELATED)  # the note below the parameters
    return [f for f in fit.findings if f.code not in known.union(UNDETERMINED)]


def _ratios(misfit: Mapping[str, result_parts.Misfit], at_least: Mapping[str, float]) -> dict[str, float]:
    """How many times the noise each output's error is; ``at_least`` so many where the noise has no more than a ceiling."""
    return {name: at_least.get(name, m.noise_ratio) for name, m in misfit.items()}


def _worst_misfit(fit: Fit) -> float | None:
    """The largest residual over noise of an output, at least; None where no noise is known."""
    return max((r for r in _ratios(fit.misfit, fit.misfit_at_least).values() if math.isfinite(r)), default=None)


def _misfit_note(fit: Fit) -> str:
    worst = _worst_misfit(fit)
    if worst is None:
        return "The noise is not known, so the misfit cannot be judged."
    size = _over_noise(fit.misfit, fit.misfit_at_least)
    if worst > GOOD_MISFIT:
        return (
            f"The model does not explain the estimation records: the residual is {size}. Either the model lacks an effect, which"
            " greybox discover searches for, or the noise is larger than assumed. Its parameters may be biased."
        )
    # Above the level that is weighed with and below the ceiling it may be noise, and may be none.
    if any(m.noise_ratio > GOOD_MISFIT for m in fit.misfit.values()):
        return (
            f"The estimation records do not show whether the model lacks an effect: the residual is {size}, of which they show no more"
            " than a ceiling. A quiet record shows its level."
        )
    return f"The model explains the estimation records: the residual is {size}."


def _over_noise(misfit: Mapping[str, result_parts.Misfit], at_least: Mapping[str, float]) -> str:
    """``1.02 times the noise in x and 0.98 times the noise in i``; ``at least`` where the noise is only bounded."""
    ratios = _ratios(misfit, at_least).items()
    return join_names([f"{'at least ' * (name in at_least)}{r:.3g} times the noise in {name}" for name, r in ratios])


def _determined(fit: Fit, undetermined: list[str]) -> str:
    free = list(fit.uncertainty.free)
    if not free:
        return "No parameter was fitted."
    if undetermined:
        return f"The records do not determine {join_names(undetermined)}: the 95 % interval exceeds half the value."
    widths = [half for name in free if (half := figures.relative_half_width(fit.parameters[name])) is not None]
    reaches = f" 95 % interval reaches {percent_text(max(widths) / 100, 2)} to either side" if widths else ""
    if len(free) == 1:
        return f"{free[0]} is determined{reaches and f'; its{reaches}'}."
    return f"All {len(free)} fitted parameters are determined{reaches and f'; the widest{reaches}'}."


def _validated(fit: Fit) -> str:
    if not fit.validation:
        return "The fit was not validated. Give a second record to validate the parameters."
    records = count_noun(len(fit.validation.traces), "validation record")
    return f"On {records} the residual is {_over_noise(fit.validation.misfit, fit.validation_at_least)}."


@dataclass(frozen=True)
class RecordRun:
    """A model's run over one record, for validation or fitted; the first ``skip`` rows do not count."""

    trace: result_parts.Trace
    validation: bool
    skip: int = 0

    @property
    def title(self) -> str:
        """``Validation record b``."""
        return f"{('Validation' if self.validation else 'Estimation')} {record_text(self.trace.name)}"


def _question(fit: Fit) -> str:
    free, fixed = fit.uncertainty.free, [name for name, e in fit.parameters.items() if e.fixed]
    rows = sum(len(t.time) for t in fit.traces)
    records = f"{count_noun(len(fit.traces), 'record')} ({count_noun(rows, 'row')})"
    known = f" {join_names(fixed)} {'is' if len(fixed) == 1 else 'are'} fixed." if fixed else ""
    if not free:
        return f"How well does the model follow {records}?{known}"
    return f"Which values of {join_names(free)} make the model follow {records}?{known}"


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
    # What would determine them says which they are; where nothing is known that would, it is said here that they are open.
    recommendations = recommend_after_fit(fit) or [f for f in fit.findings if f.code in UNDETERMINED]
    if recommendations:
        yield doc.Subheading("How to determine the other parameters")
        yield doc.BulletList(list(dict.fromkeys(sentences(recommendations))))
    several = [d for f in fit.findings if len(d := f.values.get("directions", ())) > 1]
    if several:
        lines = [_list_weights(direction) for directions in several for direction in directions]
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


def _list_weights(direction: Mapping[str, float]) -> str:
    """``a by 1, b by -0.5``."""
    return ", ".join(f"{name} by {format_number(weight, 3)}" for name, weight in direction.items())


def _priors(fit: Fit) -> Iterator[doc.TableBlock]:
    """What the prior knowledge was, and what the records added to it."""
    rows = []
    for name, c in fit.constraints.priors.items():
        conflict = "" if c.conflict is None else f"{format_number(abs(c.conflict), 2)} std"
        factor = "" if c.factor is None or c.factor_std is None else format_with_std(c.factor, c.factor_std)
        reduction = percent_text(c.variance_reduction, 3)
        rows.append(
            [name, format_with_std(c.mean, c.std), f"{format_number(c.shift, 2)} std", reduction, conflict, factor]
        )
    if rows:
        heads = ["prior", "prior value", "shift", "variance reduction", "conflict", "data over prior"]
        yield doc.TableBlock("Priors", heads, rows)


def _interval_kind(fit: Fit) -> str:
    sandwich = fit.uncertainty.kind == "sandwich"
    if fit.prediction.process_noise and not sandwich:
        which = "observed" if fit.uncertainty.kind == "observed_information" else "expected"
        return f"{which} information of the likelihood; the innovations are white"
    if sandwich and fit.uncertainty.inflation:
        widest = fit.uncertainty.largest_inflation
        return f"sandwich covariance, which allows for the colour of the residual (up to {widest:.3g} times as wide)"
    if any(e.std is not None for e in fit.parameters.values()):
        return "Gauss-Newton covariance (expected information); the residual is white"
    return ""


# The same for all residuals of a page together.
ALL_SIGNALS_ON_PAGE = 100000
# Records whose figures stand open at first; those of the others open on request.
OPEN_RECORDS = 1
# Records of a fit whose curves are drawn; the tables have all.
RECORDS_OF_FIT = 20


def _misfits(fit: Fit) -> Iterator[doc.TableBlock]:
    """The misfit by output: of the run that was fitted, of a prediction, and on the validation records.

    The states of segments that meet, in which an unstable model is run, and those of arcs are fitted to the record: that is no free run.
    """
    estimation, noise, how = "on the estimation records", fit.noise, fit.solver.statistics
    in_arcs = how.get("transcription") == Transcription.ARCS
    in_segments = not (how.get("free_run", True) or in_arcs or fit.prediction.process_noise)
    run = "run in segments" if in_segments else "run in arcs" if in_arcs else "free run"
    yield tables.misfit_table(f"{run.capitalize()} {estimation}", fit.misfit, noise, f"misfit ({run})")
    if ahead := fit.prediction.one_step:
        yield tables.misfit_table(
            f"Prediction one sample ahead {estimation}", ahead, noise, "prediction (1 step ahead)"
        )
    if fit.validation:
        run = "run in segments" if in_segments else "free run"  # arcs are of the estimation alone
        corner = f"on validation records ({run})"
        yield tables.misfit_table(f"{run.capitalize()} on the validation records", fit.validation.misfit, noise, corner)


def _misfit(fit: Fit, skip: int) -> Iterator[doc.Block]:
    yield from _misfits(fit)
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
    return f"The tables include {count_noun(records, 'more record')} that {'is' if records == 1 else 'are'} not drawn."


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
        [
            run.trace.name,
            "validation" if run.validation else "fitted",
            output,
            *tables.misfit_cells(m, fit.noise.bound(output)),
        ]
        for run in runs
        for output, m in errors.compute_record_misfits(fit, run.trace, run.skip).items()
    ]
    return doc.TableBlock("Record by record", ["record", "use", "output", *tables.MISFIT_HEADS], rows)


def _residual(fit: Fit, tests: ResidualTests | None) -> Iterator[doc.Block]:
    findings = findings_below(fit)
    if findings:
        yield doc.BulletList(findings)
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
