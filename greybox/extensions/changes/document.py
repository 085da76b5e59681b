"""The page of a change detection: the answer, what convinces of it, the constants, how to repeat it."""

from __future__ import annotations

from collections.abc import Iterator

from greybox.base.findings import Severity
from greybox.extensions.changes.figures import plot_changes, plot_course, plot_population
from greybox.extensions.changes.result import ChangeDetection, ChangePoint, ChangeVerdict
from greybox.extensions.changes.sentences import (
    CONSTANT_HEAD,
    POPULATION_HEAD,
    constant_row,
    machine_head,
    machine_row,
    merge_not_seen,
    p_text,
    population_rows,
)
from greybox.show.figures.records import plot_residual, plot_run
from greybox.show.pages.page import (
    Block,
    BulletList,
    FigureBlock,
    Page,
    PageTable,
    Paragraphs,
    Section,
    Tone,
    typeset_number,
)
from greybox.show.pages.provenance import provenance_section, records_section, signal_units
from greybox.show.sentences.wording import count_noun

TONES = {
    ChangeVerdict.UNCHANGED: Tone.GOOD,
    ChangeVerdict.CHANGED: Tone.BAD,
    ChangeVerdict.CANNOT_TELL: Tone.CAUTION,
}


def build_changed_page(change: ChangeDetection, *, command: str = "") -> Page:
    """The page of a change detection; ``command`` is what was typed."""
    title = change.reference.model.title
    findings = merge_not_seen(change.findings)
    first = [f for f in findings if f.severity is not Severity.NOTE]
    notes = [f for f in findings if f.severity is Severity.NOTE]
    sections = [Section("changes", "What changed", [*_evidence(change), *([BulletList(notes)] if notes else [])])]
    if change.checks:
        sections.append(Section("checks", "Checks", [BulletList([str(check) for check in change.checks])]))
    if change.today is not None:
        sections.append(Section("today", "Records and model of today", list(_today(change))))
        sections.append(records_section([*change.today.traces], [], change.today))
    sections.append(provenance_section(command))
    question = _ask(change)
    verdict = Paragraphs([*change.conclusion, *first], TONES[change.verdict])
    return Page(f"{title}: {change.verdict}", question, verdict, sections, "changed")


def _ask(change: ChangeDetection) -> str:
    title = change.reference.model.title
    if change.machines:
        return f"Which of {len(change.machines)} machines of the kind {title} falls out?"
    if change.records:
        return f"When in {len(change.records) - 1} records has {title} changed?"
    return f"Is {title} what it was when it was fitted to {count_noun(len(change.reference.traces), 'record')}?"


def _evidence(change: ChangeDetection) -> Iterator[Block]:
    """The figure that convinces, then its numbers."""
    for figure in (plot_changes(change), plot_population(change), plot_course(change)):
        if figure is not None:
            yield FigureBlock(figure)
    if change.constants:
        rows = [_unbroken(constant_row(name, c)) for name, c in change.constants.items()]
        yield PageTable(
            "The constants in the fit and today",
            [*CONSTANT_HEAD[:-1], "verdict"],
            rows,
            "The intervals are those of the change and hold together; p is corrected for looking at all constants.",
        )
    if change.population:
        yield PageTable(
            "What the machines have in common", POPULATION_HEAD, [_unbroken(row) for row in population_rows(change)]
        )
        names = list(change.population)
        rows = [_unbroken(machine_row(m, names)) for m in change.machines]
        yield PageTable(
            "The machines, each with the standard deviation that its records leave", machine_head(change), rows
        )
    if change.change_points:
        rows = [
            [c.constant, str(c.number), c.record, *_unbroken(_before_and_after(c)), p_text(c.p)]
            for c in change.change_points
        ]
        head = ["parameter", "number", "first record after it", "before", "after", "p"]
        yield PageTable("Where constants jump; p is corrected for all constants", head, rows)


def _before_and_after(point: ChangePoint) -> list[str]:
    return [f"{value:.4g} {point.unit}".rstrip() for value in (point.before, point.after)]


def _unbroken(cells: list[str]) -> list[str]:
    """The numbers of a row as print has them; a value is not torn from its unit or its uncertainty."""
    return [cells[0], *(typeset_number(cell).replace(" ", "\N{NO-BREAK SPACE}") for cell in cells[1:])]


def _today(change: ChangeDetection) -> Iterator[Block]:
    """Today's records and the model that was fitted to them."""
    fit = change.today
    if fit is None:
        return
    units = signal_units(fit.model)
    for k, trace in enumerate(fit.traces):
        yield FigureBlock(plot_run(trace, units, f"run{k}"), group=f"record{k}")
        yield FigureBlock(plot_residual(trace, units, fit.noise.levels, f"residual{k}"), group=f"record{k}")


PAGES = {"ChangeDetection": build_changed_page}
"""Class of a result -> the function that builds its page."""
