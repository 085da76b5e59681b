"""A change detection: the answer, what convinces of it, the constants, how to repeat it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from greybox.base import document as doc
from greybox.base.values import Finding, Severity
from greybox.extensions.changes import result
from greybox.extensions.changes.constants import Yardstick
from greybox.extensions.changes.figures import is_determined, plot_changes, plot_course, plot_population
from greybox.show.documents.tables import provenance_section, records_section, signal_units, worst_first
from greybox.show.figures.records import plot_residual, plot_run
from greybox.show.sentences import register, sentence, writes
from greybox.show.sentences.wording import (
    CHANGE_REACH,
    as_sentence,
    count_noun,
    format_with_std,
    join_names,
    make_formatter,
    percent_text,
    record_text,
    spread_text,
    value_with_unit,
    with_unit,
)

if TYPE_CHECKING:
    from greybox.base.values import Check

TONES = {
    result.ChangeVerdict.UNCHANGED: doc.Tone.GOOD,
    result.ChangeVerdict.CHANGED: doc.Tone.BAD,
    result.ChangeVerdict.CANNOT_TELL: doc.Tone.CAUTION,
}


def describe_changed(change: result.ChangeDetection, *, command: str = "") -> doc.Document:
    """What is said of a change detection; ``command`` is what was typed."""
    answer, *more = map(sentence, change.conclusion)
    tables = list(change_tables(change))
    return doc.Document(
        f"{change.reference.model.title}: {change.verdict}",
        as_sentence(answer),
        TONES[change.verdict],
        tables[:1],
        [*more, *worst_first(merge_not_seen(change.findings))],
        tables[1:],
        _ask(change),
        doc.Later(_evidence, change),
        doc.Later(_sections, change, command),
        "changed",
    )


def _evidence(change: result.ChangeDetection) -> Iterator[doc.FigureBlock]:
    figures = (plot_changes(change), plot_population(change), plot_course(change))
    yield from (doc.FigureBlock(figure) for figure in figures if figure is not None)


def _sections(change: result.ChangeDetection, command: str) -> Iterator[doc.Section]:
    """The numbers behind the figures, the checks, today's records."""
    if tables := list(change_tables(change)):
        yield doc.Section("changes", "What changed", tables)
    if change.checks:
        yield doc.Section("checks", "Checks", [doc.BulletList([str(check) for check in change.checks])])
    if change.today is not None:
        yield doc.Section("today", "Records and model of today", list(_today(change)))
        yield records_section(change.today)
    yield provenance_section(command)


def _ask(change: result.ChangeDetection) -> str:
    title = change.reference.model.title
    if change.machines:
        return f"Which of {len(change.machines)} machines of the kind {title} falls out?"
    if change.records:
        return f"When in {len(change.records) - 1} records has {title} changed?"
    return f"Is {title} what it was when it was fitted to {count_noun(len(change.reference.traces), 'record')}?"


def change_tables(change: result.ChangeDetection) -> Iterator[doc.TableBlock]:
    """Each constant before and after; what machines have in common and each of them; where constants jump."""
    if change.constants:
        head = ["parameter", "before", "today", "change", "95 % interval", "p", doc.REMARK]
        note = "The intervals are those of the change and hold together; p is corrected for looking at all constants."
        rows = [constant_row(name, c) for name, c in change.constants.items()]
        yield doc.TableBlock("The constants in the fit and today", head, rows, note)
    if change.population:
        head, rows = ["parameter", "mean", "95 % interval", "from machine to machine"], []
        for name, p in change.population.items():
            # to as many digits as the interval tells
            write = make_formatter(p.mean, (p.interval[1] - p.interval[0]) / 4)
            interval = " to ".join(map(write, p.interval))
            rows.append([name, with_unit(write(p.mean), p.unit), interval, spread_text(p.spread, p.unit, p.relative)])
        yield doc.TableBlock("What the machines have in common", head, rows)
    if change.machines:
        units = [f"{name} [{c.unit}]" if c.unit else name for name, c in change.population.items()]
        rows = [
            [m.name, *(_machine_cell(m.constants.get(name)) for name in change.population), ", ".join(m.outlying)]
            for m in change.machines
        ]
        caption = "The machines, each with the standard deviation that its records leave"
        yield doc.TableBlock(caption, ["machine", *units, "falls out in"], rows)
    if change.change_points:
        head = ["parameter", "number", "first record after it", "before", "after", "p"]
        rows = []
        for c in change.change_points:
            levels = (value_with_unit(v, c.unit, 4) for v in (c.before, c.after))
            rows.append([c.constant, str(c.number), c.record, *levels, p_text(c.p)])
        yield doc.TableBlock("Where constants jump; p is corrected for all constants", head, rows)


def constant_row(name: str, change: result.ConstantChange) -> list[str]:
    """One constant in the fit and today."""
    difference = change.after - change.before
    unit = change.unit
    if change.interval is None:
        return [name, value_with_unit(change.before, unit, 4), "not determined", "", "", "", ""]
    if not is_determined(change):
        values = (value_with_unit(value, unit, 4) for value in (change.before, change.after))
        return [name, *values, "not determined", "", p_text(change.p), "changed" if change.moved else ""]
    width = change.interval[1] - change.interval[0]
    write = make_formatter(change.before, width / 4)
    return [
        name,
        *(with_unit(write(value), unit) for value in (change.before, change.after)),
        _signed(difference, change.before, change.unit, width),
        " to ".join(_signed(e, change.before, change.unit, width) for e in change.interval),
        p_text(change.p),
        "changed" if change.moved else "",
    ]


def _machine_cell(constant: result.MachineConstant | None) -> str:
    if constant is None or constant["std"] is None or constant["value"] is None:
        return "open"
    return format_with_std(constant["value"], constant["std"])


def _signed(change: float, before: float, unit: str, width: float) -> str:
    if not before:
        return with_unit(f"{change:+.3g}", unit)
    return ("+" if change > 0 else "-") + share_of(change, before, unit, width)


def _today(change: result.ChangeDetection) -> Iterator[doc.Block]:
    """Today's records and the model that was fitted to them."""
    fit = change.today
    if fit is None:
        return
    units = signal_units(fit.model)
    for k, trace in enumerate(fit.traces):
        yield doc.FigureBlock(plot_run(trace, units, f"run{k}"), group=f"record{k}")
        yield doc.FigureBlock(plot_residual(trace, units, fit.noise.levels, f"residual{k}"), group=f"record{k}")


DOCUMENTS = {"ChangeDetection": describe_changed}
"""Class of a result -> the function that describes it."""


def share_of(change: float, before: float, unit: str, beside: float = math.inf) -> str:
    """``12 %`` of the value before; in its unit where that is zero. Shares that differ by ``beside`` can be told apart."""
    if not before:
        return value_with_unit(abs(change), unit, 2)
    percent, apart = 100 * abs(change / before), 100 * abs(beside / before)
    return f"{make_formatter(percent, apart)(percent)} %" if 0 < apart < percent else percent_text(percent / 100, 2)


@writes(result.ChangeCode.NOTHING_CHANGED)
def _nothing_changed(finding: Finding) -> str:
    v = finding.values
    seen = share_of(v["smallest"], v["before"], v["unit"])
    each = "each constant is" if len(v["constants"]) > 1 else f"{v['constants'][0]} is"
    return (
        f"nothing has changed: {each} what it was, within what the records can tell; a change of {seen} in {v['widest']}, the least"
        f" certain, would have been seen. One healthy machine in {1 / v['rate']:.0f} is called changed"
    )


@writes(result.ChangeCode.CONSTANT_MOVED)
def _constant_moved(finding: Finding) -> str:
    v = finding.values
    way = "risen" if v["after"] > v["before"] else "fallen"
    between = sorted((v["low"], v["high"]), key=abs)
    width = v["high"] - v["low"]
    by = share_of(v["after"] - v["before"], v["before"], v["unit"], width)
    ends = " to ".join(share_of(e, v["before"], v["unit"], width) for e in between)
    return (
        f"{finding.subject} has {way} by {by}, from {value_with_unit(v['before'], '', 4)} to {value_with_unit(v['after'], v['unit'], 4)}"
        f" (95 % interval of the change: {ends})"
    )


@writes(result.ChangeCode.EFFECT_APPEARED)
def _effect_appeared(finding: Finding) -> str:
    parameters = ", ".join(
        f"{name} = {value_with_unit(p['value'], p['unit'])}" for name, p in finding.values["parameters"].items()
    )
    described = f" ({parameters})" if parameters else ""
    return (
        f"an effect has appeared: {finding.subject} in {finding.values['site']}{described}, {finding.values['grade']}; what is said of"
        " the constants holds with it"
    )


@writes(result.ChangeCode.CONSTANT_NOT_SEEN)
def _not_seen(finding: Finding) -> str:
    share, limit = finding.values["share"], 100 * finding.values["limit"]
    if "names" in finding.values:
        return (
            f"the records do not determine {finding.subject} (limit {limit:.0f} %); take a record that excites them, greybox design says"
            " which"
        )
    how = (
        "the records do not determine it"
        if _says_nothing(share)
        else f"only a change of {100 * share:.0f} % or more would show"
    )
    return f"{finding.subject}: {how} (limit {limit:.0f} %); take a record that excites it, greybox design says which"


def _says_nothing(share: float | None) -> bool:
    return share is None or not share < CHANGE_REACH


def merge_not_seen(findings: Sequence[Finding]) -> list[Finding]:
    """The ``findings``, all constants that the records do not determine in one of them, at the place of the first."""
    merged: list[Finding] = []
    alike: dict[Severity, list[Finding]] = {}
    for finding in findings:
        if finding.code != result.ChangeCode.CONSTANT_NOT_SEEN or not _says_nothing(finding.values["share"]):
            merged.append(finding)
            continue
        group = alike.setdefault(finding.severity, [])
        if not group:
            merged.append(finding)
        group.append(finding)
    for group in alike.values():
        if len(group) > 1:
            names = [f.subject for f in group]
            one = replace(group[0], subject=join_names(names), values={**group[0].values, "names": names})
            merged[merged.index(group[0])] = one
    return merged


SCATTERED_OVER = {
    Yardstick.RECORDS: "from record to record, where nothing has changed,",
    Yardstick.PAIRED_PIECES: "in their change from piece to piece of the records",
    Yardstick.PIECES: "from piece to piece of the records",
}


@writes(result.ChangeCode.MACHINE_FALLS_OUT)
def _machine_falls_out(finding: Finding) -> str:
    v = finding.values
    value, mean = (value_with_unit(v[key], v["unit"], 4) for key in ("value", "mean"))
    spread = spread_text(v["spread"], v["unit"], v["relative"])
    return (
        f"{finding.subject} falls out: {v['constant']} is {value}, and {mean} in the others, which differ by {spread}"
        f" (standard deviation; {p_statement(v['p'])})"
    )


@writes(result.ChangeCode.MACHINES_ALIKE)
def _machines_alike(finding: Finding) -> str:
    v = finding.values
    seen = [f"{name} by {spread_text(*spread)}" for name, spread in v["spreads"].items() if spread[0] > 0]
    differ = f"they differ in {join_names(seen)} (standard deviation)" if seen else "they do not differ visibly"
    which = "all" if not v["outside"] else "the other"
    return f"{which} {v['machines']} machines belong together; from one to the next {differ}"


@writes(result.ChangeCode.CHANGE_POINT)
def _change_point(finding: Finding) -> str:
    v = finding.values
    way = "rises" if v["after"] > v["before"] else "falls"
    numbered = v["record"].startswith("record ")
    record = v["record"] if numbered else f"record {v['number']} ({v['record']})"
    return (
        f"{finding.subject} {way} with {record} by"
        f" {share_of(v['after'] - v['before'], v['before'], v['unit'])}, from {value_with_unit(v['before'], '', 4)} to"
        f" {value_with_unit(v['after'], v['unit'], 4)} ({p_statement(v['p'])})"
    )


def _check_text(meaning: str) -> Callable[[Check], str]:
    def write(check: Check) -> str:
        stated, outcome = meaning.format(subject=check.subject), "passed" if check.passed else "failed"
        return f"{stated}: {p_statement(check.value)}, limit {check.limit:.2g}, {outcome}"

    return write


register(
    {
        result.ChangeCode.COMBINATION_MOVED: lambda f: (
            f"the constants have changed, and the records do not tell which: {join_names(list(f.values['combination']))} together, none of"
            f" them clearly by itself ({p_statement(f.values['p'])}); a record that moves the machine more, or differently, will tell"
        ),
        result.ChangeCode.NOISE_GREW: "the noise of output {subject} has grown to {ratio:.2f} times what it was, and is as random as"
        " before: look at the sensor and its wiring",
        result.ChangeCode.UNEXPLAINED: "the model no longer describes output {subject}: its residual is {ratio:.2f} times what the fit"
        " left, or no longer random, and no change of constants explains it. No effect of the catalogue is established; greybox discover"
        " with more records of today goes on from here",
        result.ChangeCode.DIFFERENT_INPUT: lambda f: (
            f"the records cannot tell: {join_names(f.values['constants']) or 'the constants'} would differ ({p_statement(f.values['p'])}),"
            " but the model lacks something already in the fit, and these records do not show by how much its constants vary where nothing"
            " has changed. Repeat the input of the fit, give three records or more, or find what the model lacks with greybox discover"
        ),
        result.ChangeCode.CANNOT_TELL: lambda f: (
            f"the records cannot tell: {join_names(f.values['constants']) or 'the constants'} could have changed by half unnoticed. Nothing"
            " else has changed"
        ),
        result.ChangeCode.FIT_FAILED: "the records cannot tell: the model could not be fitted to them ({status}). Look at the record"
        " first, with greybox check",
        result.ChangeCode.CONSTANT_AT_BOUND: "{subject} was stopped by its bound at {value:.4g}: it is not compared; widen its bounds in"
        " the model and fit again",
        result.ChangeCode.MODEL_LACKS_SOMETHING: "the fit left more than noise: its constants depend on what the input does, and the size"
        " of the residual was not compared; greybox discover looks for what the model lacks",
        result.ChangeCode.SCATTER_ALLOWED: lambda f: (
            f"the constants scatter {SCATTERED_OVER[f.values.get('over', Yardstick.PIECES)]} by {f.values['factor']:.2g} times what their"
            f" intervals say ({f.subject}, {f.values['degrees']} degrees of freedom); the comparison allows for that"
        ),
        result.ChangeCode.BEYOND_MISSING_PART: "{subject} has changed by {ratio:.2g} times the most that what the model lacks could do to"
        " it, by what the fits leave and how the two motions differ in size; a smaller change could not be told from that under another"
        " motion",
        result.ChangeCode.SPLIT_FOR_VALIDATION: "{subject} is the only record of today: an effect was looked for in its first half and"
        " judged on its second; a further record, with --validate, is the better judge",
        result.ChangeCode.SAME_RECORD: "{subject} is one of the records of the fit itself: it is no record of today",
        result.ChangeCode.MACHINE_NOT_FITTED: "{subject} is left out: the model could not be fitted to its records ({status})",
        result.ChangeCode.RECORD_NOT_FITTED: lambda f: (
            f"{record_text(f.subject)} is left out: the model could not be fitted to it ({f.values['status']})"
        ),
        result.ChangeCode.NO_CHANGE_POINT: "no change point in {records:noun record}: what differs between them is chance",
        result.ChangeRule.CONSTANTS_AS_BEFORE: _check_text("the constants are as before"),
        result.ChangeRule.RESIDUAL_AS_LARGE: _check_text("the residual of {subject} is as large as before"),
        result.ChangeRule.RESIDUAL_AS_WHITE: _check_text("the residual of {subject} is as white as before"),
    }
)


def p_text(p: float | None) -> str:
    """A p-value with two digits; what lies below 1e-4 is only that."""
    return "" if p is None else f"{p:.2g}" if p >= 1e-4 else "< 0.0001"


def p_statement(p: float | None) -> str:
    """``p = 0.031``, ``p < 0.0001``."""
    text = p_text(p)
    return f"p {text}" if text.startswith("<") else f"p = {text}"
