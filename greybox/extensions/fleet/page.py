"""The page of a fleet: how many records have a result, the population of the constants, the records that need a look."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from greybox.base.findings import Severity
from greybox.extensions.fleet.result import FleetCode, FleetResult, RecordEstimate
from greybox.extensions.fleet.sentences import MISFIT_HEAD, POPULATION_HEAD, distribution_row, misfit_rows
from greybox.show.figures.figure import Axis, Bars, Figure, Panel, Reference, Role, Series, typeset_unit
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
from greybox.show.pages.provenance import provenance_section
from greybox.show.sentences.wording import count_noun, format_number, format_with_std

# Records that a table of the page holds: those that need a look first; the file has all.
LISTED_RECORDS = 200


def build_fleet_page(fleet: FleetResult, *, command: str = "") -> Page:
    """The page of a fleet; ``command`` is what was typed."""
    total = fleet.total
    summary = [f for f in fleet.findings if f.code in (FleetCode.RECORDS_FITTED, FleetCode.RECORDS_LEFT)]
    counts = [f for f in fleet.findings if f.code == FleetCode.FINDING_COUNT]
    tone = Tone.GOOD if all(f.severity is Severity.NOTE for f in summary) else Tone.CAUTION
    sections = [Section("population", "The constants over the records", list(_population(fleet)))]
    if fleet.without_result:
        sections.append(Section("without", "Records without a result", [_table_without_result(fleet)]))
    if counts:
        sections.append(Section("findings", "What is counts of how many records", [BulletList(counts)]))
    if fleet.usable:
        sections.append(Section("records", "Record by record", [_table_of_records(fleet)]))
    sections.append(provenance_section(command))
    title = f"{fleet.model.title}: {count_noun(total, 'record')}"
    question = f"What are the constants of {fleet.model.title} in each of {count_noun(total, 'record')}?"
    return Page(title, question, Paragraphs(summary, tone), sections, "fleet")


def _population(fleet: FleetResult) -> Iterator[Block]:
    figure = plot_population_of_fleet(fleet)
    if figure is not None:
        yield FigureBlock(figure)
    if fleet.population:
        rows = [_unbroken(distribution_row(name, constant)) for name, constant in fleet.population.items()]
        note = "From record to record: the standard deviation beyond what the records leave open. A share is one of the value."
        yield PageTable("The constants of the records that the model follows", POPULATION_HEAD, rows, note)
    if rows := misfit_rows(fleet):
        yield PageTable("Misfit over noise; 1 is nothing but noise", MISFIT_HEAD, rows)


def plot_population_of_fleet(fleet: FleetResult) -> Figure | None:
    """How often each value of a constant was found, and each misfit over noise; None where nothing was fitted."""
    panels = []
    for q in fleet.model.free_parameters:
        constant = fleet.population.get(q.name)
        if constant is None or not constant.count:
            continue
        estimates = [r.parameters[q.name] for r in fleet.usable]
        values = [e.value for e in estimates if e.std is not None and e.determined and not e.at_bound]
        panels.append(_histogram(q.name, Axis(q.name, typeset_unit(q.unit)), values, constant.median))
    for name, (_, median, _) in fleet.noise_ratios.items():
        ratios = [r.misfit[name].noise_ratio for r in fleet.records if r.success and name in r.misfit]
        panels.append(_histogram(f"misfit of {name}", Axis(f"misfit of {name} over noise"), ratios, median))
    caption = "How many records have each value. The line is the median; what lies beyond is in the outermost bars."
    return Figure("population", tuple(panels), caption) if panels else None


# A histogram shows the range of this share of the records on either side in full; a few wild ones would squeeze the others into one bar.
TAIL_SHARE = 0.005
# The range is wider than these records by this share.
MARGIN = 0.05


def _histogram(name: str, axis: Axis, values: Sequence[float], median: float) -> Panel:
    finite = np.array([v for v in values if np.isfinite(v)])
    low, high = np.quantile(finite, (TAIL_SHARE, 1 - TAIL_SHARE)).tolist()
    margin = MARGIN * (high - low) or MARGIN * abs(low) or MARGIN
    # Sturges: log2(N) + 1 bars show the shape of N values.
    edges = np.linspace(low - margin, high + margin, int(np.ceil(np.log2(max(len(finite), 2)))) + 2)
    counts, _ = np.histogram(np.clip(finite, edges[0], edges[-1]), edges)
    bars = Bars((edges[:-1] + edges[1:]) / 2, counts.astype(float), [Role.RESIDUAL] * len(counts), width=np.diff(edges))
    series: tuple[Series, ...] = (bars, Reference(median, upright=True))
    return Panel(name, series, axis, Axis("records"))


def _table_without_result(fleet: FleetResult) -> PageTable:
    records = fleet.without_result
    rows = [[r.name, r.status.replace("_", " "), r.reason] for r in records[:LISTED_RECORDS]]
    note = (
        f"{len(records) - LISTED_RECORDS} more are in the table beside this page."
        if len(records) > LISTED_RECORDS
        else ""
    )
    return PageTable("They were left out, the others are done", ["record", "status", "reason"], rows, note)


def _table_of_records(fleet: FleetResult) -> PageTable:
    """The records with the largest misfit over noise first: those that need a look."""
    done = sorted((r for r in fleet.records if r.success), key=_worst_ratio, reverse=True)
    names = [q.name for q in fleet.model.free_parameters]
    units = {q.name: q.unit for q in fleet.model.free_parameters}
    rows = [
        [
            r.name,
            *_unbroken(["", *(_cell(r, name) for name in names)])[1:],
            format_number(_worst_ratio(r), 3),
            str(sum(f.severity is not Severity.NOTE for f in r.findings) or ""),
        ]
        for r in done[:LISTED_RECORDS]
    ]
    head = ["record", *(f"{n} [{units[n]}]" if units[n] else n for n in names), "misfit over noise", "warnings"]
    left = len(done) - LISTED_RECORDS
    note = "The largest misfit first." + (f" {left} more are in the table beside this page." if left > 0 else "")
    return PageTable("Each record with the standard deviation that it leaves", head, rows, note)


def _worst_ratio(record: RecordEstimate) -> float:
    return max((m.noise_ratio for m in record.misfit.values() if np.isfinite(m.noise_ratio)), default=0.0)


def _cell(record: RecordEstimate, name: str) -> str:
    estimate = record.parameters[name]
    return "open" if estimate.std is None else format_with_std(estimate.value, estimate.std)


def _unbroken(cells: list[str]) -> list[str]:
    """The numbers of a row as print has them; a value is not torn from its unit or its uncertainty."""
    return [cells[0], *(typeset_number(cell).replace(" ", "\N{NO-BREAK SPACE}") for cell in cells[1:])]


PAGES = {"FleetResult": build_fleet_page}
"""Class of a result -> the function that builds its page."""
