"""The page of a check: what can be learnt of a model's constants, before anything is fitted."""

from __future__ import annotations

from collections.abc import Iterator

from greybox.check import ModelCheck
from greybox.estimation.versions import read_versions
from greybox.experiment import Experiment, collect_record_findings
from greybox.experiment.findings import is_sensor_fault
from greybox.identifiability import ExpectedPrecision
from greybox.plots.parameters import plot_intervals
from greybox.plots.records import plot_inputs, plot_outputs
from greybox.plots.style import PAGE
from greybox.rendering.plots import FigureText, phrase
from greybox.reports.equations import typeset_equations
from greybox.reports.page import Block, FigureBlock, Folded, Heading, Listing, Page, Section, Table, Text
from greybox.reports.provenance import command_block, name_value_table
from greybox.reports.records import format_sampling_time, signal_units
from greybox.reports.typography import as_sentence, format_number, join_names, typeset_number, typeset_unit

MOST_DRAWN = 10


def report_of_check(check: ModelCheck, *, command: str = "") -> Page:
    """The page of a check; ``command`` is what was typed."""
    sections = [
        Section("constants", "What the records can tell", list(_constants(check))),
        Section("structure", "What any record could tell", list(_structure(check))),
        Section("model", "The model", [_integration(check), typeset_equations(check.model)]),
        Section("data", "The data", list(_data(check))),
        Section("repeat", "How to repeat it", [*command_block(command), name_value_table("Versions", read_versions())]),
    ]
    names = [q.name for q in check.model.free_parameters]
    question = f"Can {join_names(names) or 'the constants'} be determined, before anything is fitted?"
    return Page(f"Check of {check.model.title}", question, _verdict(check), sections, "check")


def _verdict(check: ModelCheck) -> Text:
    faults = filter(is_sensor_fault, collect_record_findings(check.experiments))
    told, doubts = _told(check), [as_sentence(f"record {finding}") for finding in faults]
    return Text([*doubts, *told.paragraphs], "caution" if doubts and told.tone == "good" else told.tone)


def _told(check: ModelCheck) -> Text:
    of = "such a record" if check.assumed else "these records"
    if check.doubt:
        return Text([f"Nothing can be said: {as_sentence(check.doubt)}"], "bad")
    if check.failure:
        return Text([as_sentence(check.failure)], "caution")
    if check.complete:
        return Text([f"Every free constant can be determined from {of}, if the model is right."], "good")
    said = (
        [as_sentence(check.structure.verdict)] if check.structure is not None and not check.structure.complete else []
    )
    weak = [name for name, c in check.constants.items() if not c.determined]
    if weak:
        said.append(f"{join_names(weak)} cannot be determined from {of}.")
    if check.structure is not None and check.structure.remedies:
        said.append(f"What would help: {check.structure.remedies[0].rstrip('.')}.")
    return Text(said, "caution")


def _constants(check: ModelCheck) -> Iterator[Block]:
    if check.failure:
        yield Text([as_sentence(check.failure)], "caution")
        return
    rows = [[name, *_expected(c)] for name, c in check.constants.items()]
    yield Table(
        "Standard deviations to expect of a fit, near the start values and if the model is right",
        ["constant", "start value", "expected std", "of the value", "unit", "remark"], rows,
    )  # fmt: skip
    percent = {n: 196 * c.std / abs(c.value) for n, c in check.constants.items() if c.std and c.value}
    figure = plot_intervals(percent, phrase(FigureText.EXPECTED_INTERVALS))
    if figure is not None:
        yield FigureBlock(figure)
    found = check.practical
    if not check.complete and found.combinations:
        rows = [[text, typeset_number(f"{100 * std:.2g} %")] for text, std in found.combinations.items()]
        yield Table("Combinations that show above the noise", ["combination", "expected std"], rows)
    if found.remarks:
        yield Listing([as_sentence(r) for r in found.remarks])


def _expected(c: ExpectedPrecision) -> list[str]:
    unit = typeset_unit(c.unit)
    if c.std is None:
        return [typeset_number(format_number(c.value)), "", "", unit, "not determined"]
    share = f"{100 * c.std / abs(c.value):.2g} %" if c.value else ""
    remark = "not determined" if not c.determined else "by averaging the noise alone" if c.averaged else ""
    return [
        typeset_number(format_number(c.value)),
        typeset_number(format_number(c.std, 2)),
        typeset_number(share),
        unit,
        remark,
    ]


def _structure(check: ModelCheck) -> Iterator[Block]:
    structure = check.structure
    if structure is None:
        yield Text([as_sentence(check.doubt)], "bad")
        return
    yield Text([as_sentence(structure.verdict)], "good" if structure.complete else "caution")
    if structure.complete:
        return
    if structure.determined:
        yield Table("Determined whatever the record", ["combination"], [[text] for text in structure.determined])
    yield Heading("What stays open")
    yield Listing([as_sentence(str(d)) for d in structure.directions])
    if structure.remedies:
        yield Heading("What would close it")
        yield Listing([as_sentence(r) for r in structure.remedies])


def _integration(check: ModelCheck) -> Table:
    rows = [
        ["equations", "linear in states and inputs" if check.linear else "nonlinear"],
        ["units", "every term has the unit of its balance"],
        ["integrated by", check.discretisation],
        ["runs as", f"{check.kernel} ({check.kernel_reason})"],
    ]
    return Table("How it is computed", ["what", "how"], rows)


def _data(check: ModelCheck) -> Iterator[Block]:
    if check.assumed:
        yield Text([f"No records were given; a simulated one stands in: {as_sentence(check.assumed)}"])
    head = ["record", "rows", "duration", "sampling time", "fingerprint"]
    yield Table("Records", head, [_record(e) for e in check.experiments], "" if check.assumed else _noise(check))
    # Sensor faults stand above, with the verdict.
    known = [finding for finding in collect_record_findings(check.experiments) if not is_sensor_fault(finding)]
    if known:
        yield Listing([as_sentence(f"record {finding}") for finding in known])
    if not check.assumed:
        lines = dict.fromkeys(line for e in check.practical.excitation for line in str(e).splitlines())
        yield Listing([as_sentence(line) for line in lines])
    units = signal_units(check.model)
    drawn = check.experiments[:MOST_DRAWN]
    stretches = PAGE.stretches(sum(len(e.inputs) + len(e.outputs) for e in drawn))
    for k, e in enumerate(drawn):
        figures = plot_outputs(e, units, f"outputs-{k}"), plot_inputs(e, units, f"inputs-{k}")
        shown = [FigureBlock(f, stretches, group=f"{k}") for f in figures if f is not None]
        yield from shown if k == 0 else [Folded(f"Record {e.name}", shown)]


def _record(e: Experiment) -> list[str]:
    return [e.name, str(e.rows), f"{e.duration:.6g} s", format_sampling_time(e.time), e.fingerprint[:12]]


def _noise(check: ModelCheck) -> str:
    units = {o.name: o.unit for o in check.model.outputs}
    sizes = [
        typeset_number(f"{n} {format_number(std, 3)} {typeset_unit(units[n])}".rstrip())
        for n, std in check.noise.items()
    ]
    return f"Noise: {join_names(sizes)}; {check.noise_source}."
