"""The page of a change detection: the answer, what convinces of it, the constants, how to repeat it."""

from __future__ import annotations

from collections.abc import Iterator

from greybox.base.findings import Finding, Severity
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
from greybox.show.sentences.pages import PageText
from greybox.show.sentences.wording import phrase

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
    sections = [Section("changes", [*_evidence(change), *([BulletList(notes)] if notes else [])])]
    if change.checks:
        sections.append(
            Section("checks", [BulletList([phrase(PageText.STATEMENT, text=str(check)) for check in change.checks])])
        )
    if change.today is not None:
        sections.append(Section("today", list(_today(change))))
        sections.append(records_section([*change.today.traces], [], change.today))
    sections.append(provenance_section(command))
    question = _ask(change)
    verdict = Paragraphs([*change.conclusion, *first], TONES[change.verdict])
    return Page(
        phrase(PageText.CHANGED_TITLE, title, verdict=str(change.verdict)), question, verdict, sections, "changed"
    )


def _ask(change: ChangeDetection) -> Finding:
    title = change.reference.model.title
    if change.machines:
        return phrase(PageText.CHANGED_KIND, title, machines=len(change.machines))
    if change.records:
        return phrase(PageText.CHANGED_COURSE, title, records=len(change.records) - 1)
    return phrase(PageText.CHANGED_QUESTION, title, records=len(change.reference.traces))


def _evidence(change: ChangeDetection) -> Iterator[Block]:
    """The figure that convinces, then its numbers."""
    for figure in (plot_changes(change), plot_population(change), plot_course(change)):
        if figure is not None:
            yield FigureBlock(figure)
    if change.constants:
        rows = [_unbroken(constant_row(name, c)) for name, c in change.constants.items()]
        yield PageTable(
            phrase(PageText.CHANGED_CONSTANTS), [*CONSTANT_HEAD[:-1], "verdict"], rows, phrase(PageText.CHANGED_NOTE)
        )
    if change.population:
        yield PageTable(
            phrase(PageText.CHANGED_POPULATION), POPULATION_HEAD, [_unbroken(row) for row in population_rows(change)]
        )
        names = list(change.population)
        rows = [_unbroken(machine_row(m, names)) for m in change.machines]
        yield PageTable(phrase(PageText.CHANGED_MACHINES), machine_head(change), rows)
    if change.change_points:
        rows = [
            [c.constant, str(c.number), c.record, *_unbroken(_before_and_after(c)), p_text(c.p)]
            for c in change.change_points
        ]
        head = ["parameter", "number", "first record after it", "before", "after", "p"]
        yield PageTable(phrase(PageText.CHANGED_POINTS), head, rows)


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
