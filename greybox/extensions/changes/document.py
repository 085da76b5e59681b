"""A change detection: the answer, what convinces of it, the constants, how to repeat it."""

from __future__ import annotations

from collections.abc import Iterator

from greybox.base import document as doc
from greybox.extensions.changes.figures import plot_changes, plot_course, plot_population
from greybox.extensions.changes.result import ChangeDetection, ChangeVerdict, ConstantChange, MachineConstant
from greybox.extensions.changes.sentences import is_determined, merge_not_seen, p_text, share_of
from greybox.show.documents.tables import provenance_section, records_section, signal_units, worst_first
from greybox.show.figures.records import plot_residual, plot_run
from greybox.show.sentences.registry import sentence
from greybox.show.sentences.wording import (
    as_sentence,
    count_noun,
    format_with_std,
    make_formatter,
    spread_text,
    value_with_unit,
    with_unit,
)

TONES = {
    ChangeVerdict.UNCHANGED: doc.Tone.GOOD,
    ChangeVerdict.CHANGED: doc.Tone.BAD,
    ChangeVerdict.CANNOT_TELL: doc.Tone.CAUTION,
}


def describe_changed(change: ChangeDetection, *, command: str = "") -> doc.Document:
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


def _evidence(change: ChangeDetection) -> Iterator[doc.FigureBlock]:
    figures = (plot_changes(change), plot_population(change), plot_course(change))
    yield from (doc.FigureBlock(figure) for figure in figures if figure is not None)


def _sections(change: ChangeDetection, command: str) -> Iterator[doc.Section]:
    """The numbers behind the figures, the checks, today's records."""
    if tables := list(change_tables(change)):
        yield doc.Section("changes", "What changed", tables)
    if change.checks:
        yield doc.Section("checks", "Checks", [doc.BulletList([str(check) for check in change.checks])])
    if change.today is not None:
        yield doc.Section("today", "Records and model of today", list(_today(change)))
        yield records_section(change.today)
    yield provenance_section(command)


def _ask(change: ChangeDetection) -> str:
    title = change.reference.model.title
    if change.machines:
        return f"Which of {len(change.machines)} machines of the kind {title} falls out?"
    if change.records:
        return f"When in {len(change.records) - 1} records has {title} changed?"
    return f"Is {title} what it was when it was fitted to {count_noun(len(change.reference.traces), 'record')}?"


def change_tables(change: ChangeDetection) -> Iterator[doc.TableBlock]:
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
        rows = [
            [
                c.constant,
                str(c.number),
                c.record,
                *(value_with_unit(v, c.unit, 4) for v in (c.before, c.after)),
                p_text(c.p),
            ]
            for c in change.change_points
        ]
        yield doc.TableBlock("Where constants jump; p is corrected for all constants", head, rows)


def constant_row(name: str, change: ConstantChange) -> list[str]:
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


def _machine_cell(constant: MachineConstant | None) -> str:
    if constant is None or constant["std"] is None or constant["value"] is None:
        return "open"
    return format_with_std(constant["value"], constant["std"])


def _signed(change: float, before: float, unit: str, width: float) -> str:
    if not before:
        return with_unit(f"{change:+.3g}", unit)
    return ("+" if change > 0 else "-") + share_of(change, before, unit, width)


def _today(change: ChangeDetection) -> Iterator[doc.Block]:
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
