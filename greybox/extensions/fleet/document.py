"""A fleet: how many records have a result, the population of the constants, the records that need a look."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from greybox.base import Finding, Severity
from greybox.base import document as doc
from greybox.base.figure import Axis, Bars, Figure, Panel, Reference, Role, Series
from greybox.extensions.fleet.result import ConstantDistribution, FleetCode, FleetResult, RecordEstimate
from greybox.show.documents.tables import provenance_section, worst_first
from greybox.show.figures.figure import typeset_unit
from greybox.show.sentences import register, sentence, wording, writes

# Records that a table of the page holds: those that need a look first; the file has all.
LISTED_RECORDS = 200


def describe_fleet(fleet: FleetResult, *, command: str = "") -> doc.Document:
    """What is said of a fleet; ``command`` is what was typed."""
    records = wording.count_noun(fleet.total, "record")
    summary = [f for f in fleet.findings if f.code in (FleetCode.RECORDS_FITTED, FleetCode.RECORDS_LEFT)]
    tone = doc.Tone.GOOD if all(f.severity is Severity.NOTE for f in summary) else doc.Tone.CAUTION
    title, tables, (fitted, *others) = fleet.model.title, list(_tables(fleet)), fleet.findings
    # The constant that differs most from record to record.
    spreads = {n: c.spread for n, c in fleet.population.items() if c.relative and c.spread}
    name = max(spreads, key=spreads.__getitem__, default="")
    spread_text = (
        f"; {name} differs most from record to record, by {wording.percent_text(spreads[name], 2)} (one standard deviation)"
        if name
        else ""
    )
    return doc.Document(
        f"{title}: {records}",
        f"{title}: {sentence(fitted)}{spread_text}.",
        tone,
        tables[:1],
        worst_first(others),
        tables[1:],
        f"What are the constants of {title} in each of {records}?",
        doc.Later(_evidence, fleet),
        doc.Later(_sections, fleet, command),
        "fleet",
    )


def _evidence(fleet: FleetResult) -> Iterator[doc.FigureBlock]:
    figure = plot_population_of_fleet(fleet)
    if figure is not None:
        yield doc.FigureBlock(figure)


def _sections(fleet: FleetResult, command: str) -> Iterator[doc.Section]:
    yield doc.Section("population", "The constants over the records", list(_tables(fleet)))
    if failed := fleet.without_result:
        rows = [[r.name, r.status.replace("_", " "), r.reason] for r in failed[:LISTED_RECORDS]]
        more = len(failed) - LISTED_RECORDS
        note = f"{more} more are in the table beside this page." if more > 0 else ""
        table = doc.TableBlock("They were left out, the others are done", ["record", "status", "reason"], rows, note)
        yield doc.Section("without", "Records without a result", [table])
    counts = [f for f in fleet.findings if f.code == FleetCode.FINDING_COUNT]
    if counts:
        yield doc.Section("findings", "Notes, and how many records each is about", [doc.BulletList(counts)])
    if fleet.usable:
        yield doc.Section("records", "Record by record", [_table_of_records(fleet)])
    yield provenance_section(command)


def _tables(fleet: FleetResult) -> Iterator[doc.TableBlock]:
    """The population of each constant, and of the misfit of each output."""
    if fleet.population:
        head = [
            "parameter",
            "median",
            "90 % of the records",
            "from record to record",
            "left open by a record",
            "records",
        ]
        rows = [_distribution_row(name, constant) for name, constant in fleet.population.items()]
        note = "From record to record: the standard deviation beyond what the records leave open. A share is one of the value."
        yield doc.TableBlock("The constants of the records that the model follows", head, rows, note)
    rows = [
        [name, wording.ratio_digits(median), f"{wording.ratio_digits(low)} to {wording.ratio_digits(high)}"]
        for name, (low, median, high) in fleet.noise_ratios.items()
    ]
    if rows:
        head = ["misfit over noise", "median", "90 % of the records"]
        yield doc.TableBlock("Misfit over noise; 1 is nothing but noise", head, rows)


def _distribution_row(name: str, constant: ConstantDistribution) -> list[str]:
    notes = [
        f"{count} {what}"
        for count, what in ((constant.undetermined, "open"), (constant.at_bound, "at a bound"))
        if count
    ]
    records = ", ".join([str(constant.count), *notes])
    if not constant.count:
        return [name, "", "", "", "", records]
    unit = "" if constant.unit == "1" else constant.unit
    write = wording.make_formatter(constant.median, (constant.high - constant.low) / 10)
    left_open = wording.percent_text(constant.std / constant.median, 2) if constant.relative else f"{constant.std:.2g}"
    return [
        name,
        wording.with_unit(write(constant.median), unit),
        f"{write(constant.low)} to {write(constant.high)}",
        wording.spread_text(constant.spread, unit, constant.relative),
        left_open,
        records,
    ]


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


def _table_of_records(fleet: FleetResult) -> doc.TableBlock:
    """The records with the largest misfit over noise first: those that need a look."""
    done = sorted((r for r in fleet.records if r.success), key=_worst_ratio, reverse=True)
    names = [q.name for q in fleet.model.free_parameters]
    units = {q.name: q.unit for q in fleet.model.free_parameters}
    rows = [
        [
            r.name,
            *(_cell(r, name) for name in names),
            wording.ratio_digits(_worst_ratio(r)),
            str(sum(f.severity is not Severity.NOTE for f in r.findings) or ""),
        ]
        for r in done[:LISTED_RECORDS]
    ]
    head = ["record", *(f"{n} [{units[n]}]" if units[n] else n for n in names), "misfit over noise", "warnings"]
    left = len(done) - LISTED_RECORDS
    note = "The largest misfit first." + (f" {left} more are in the table beside this page." if left > 0 else "")
    return doc.TableBlock("Each record with the standard deviation that it leaves", head, rows, note)


def _worst_ratio(record: RecordEstimate) -> float:
    return max((m.noise_ratio for m in record.misfit.values() if np.isfinite(m.noise_ratio)), default=0.0)


def _cell(record: RecordEstimate, name: str) -> str:
    estimate = record.parameters[name]
    return "open" if estimate.std is None else wording.format_with_std(estimate.value, estimate.std)


DOCUMENTS = {"FleetResult": describe_fleet}
"""Class of a result -> the function that describes it."""


@writes(FleetCode.RECORDS_FITTED)
def _fitted(finding: Finding) -> str:
    v = finding.values
    if v["fitted"] < v["records"]:
        text = f"{v['fitted']} of {wording.count_noun(v['records'], 'record')} were fitted"
    else:
        text = f"all {v['records']} records were fitted" if v["records"] > 1 else "the record was fitted"
    if v["followed"] == v["fitted"]:
        return text
    if v["fitted"] == 1:
        return f"{text}, and the model does not follow it"
    return f"{text}, and the model follows {'only ' + str(v['followed']) if v['followed'] else 'none'} of them"


register(
    {
        FleetCode.RECORDS_LEFT: "{left} of {records} records were not begun: the same call with the journal goes on from here",
        FleetCode.RECORD_WITHOUT_RESULT: "record {subject} has no result: {reason}",
        FleetCode.RECORDS_ALIKE: lambda f: (
            f"record {f.subject} is the same measurement as {f.values['first']}"
            + (f", and {wording.count_noun(f.values['pairs'] - 1, 'other record')} so" if f.values["pairs"] > 1 else "")
            + ": the fleet counts it twice; leave one out"
        ),
        FleetCode.FINDING_COUNT: "{records} of {of:noun record}, {subject} the first: {sentence}",
    }
)
