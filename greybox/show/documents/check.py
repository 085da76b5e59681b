"""The page of a check: what can be learnt of a model's parameters, before anything is fitted."""

from __future__ import annotations

from collections.abc import Iterator

from greybox.base.findings import Finding
from greybox.data.experiment import Experiment, collect_record_findings
from greybox.data.findings import is_sensor_fault
from greybox.estimation.check import ModelCheck
from greybox.estimation.identifiability.practical import ExpectedPrecision
from greybox.show.figures.figure import typeset_unit
from greybox.show.figures.parameters import plot_intervals
from greybox.show.figures.records import plot_inputs, plot_outputs
from greybox.show.figures.sheet import PAGE
from greybox.show.pages.equations import typeset_equations
from greybox.show.pages.fit_page import OPEN_RECORDS
from greybox.show.pages.page import (
    Block,
    BulletList,
    Details,
    FigureBlock,
    Page,
    PageTable,
    Paragraphs,
    Section,
    Subheading,
    Text,
    Tone,
    typeset_number,
)
from greybox.show.pages.provenance import format_sampling_time, provenance_section, signal_units
from greybox.show.sentences.check import describe_noise_source
from greybox.show.sentences.identifiability import describe_verdict
from greybox.show.sentences.wording import capitalise, format_number, join_names, record_text


def build_check_page(check: ModelCheck, *, command: str = "") -> Page:
    """The page of a check; ``command`` is what was typed."""
    sections = [
        Section("expected", "What the records can determine", list(_precision(check))),
        Section("structure", "What any record could determine", list(_structure(check))),
        Section("model", "The model", [_computation(check), typeset_equations(check.model)]),
        Section("data", "Data", list(_data(check))),
        provenance_section(command),
    ]
    names = join_names([q.name for q in check.model.free_parameters]) or "the parameters"
    question = f"Can {names} be determined? This is checked before the fit."
    title = f"Check of {check.model.title}"
    return Page(title, question, _verdict(check), sections, "check")


def _verdict(check: ModelCheck) -> Paragraphs:
    findings = collect_record_findings(check.experiments)
    faults = [_about_record(finding) for finding in findings if is_sensor_fault(finding)]
    answer = _answer(check)
    tone = Tone.CAUTION if faults and answer.tone is Tone.GOOD else answer.tone
    return Paragraphs([*faults, *answer.items], tone)


def _answer(check: ModelCheck) -> Paragraphs:
    if check.doubt:
        return Paragraphs([f"The check has no answer: {check.doubt}"], Tone.BAD)
    if check.failure:
        return Paragraphs([check.failure], Tone.CAUTION)
    assumed = bool(check.assumed)
    if check.complete:
        return Paragraphs(
            [
                f"{'A record such as this one determines' if assumed else 'These records determine'} every free parameter, if the"
                " model is right."
            ],
            Tone.GOOD,
        )
    answer: list[Text] = []
    if check.structure is not None and not check.structure.complete:
        answer += [describe_verdict(check.structure)]
    undetermined = [name for name, c in check.constants.items() if not c.determined]
    if undetermined:
        answer.append(
            f"{'A record such as this one does' if assumed else 'These records do'} not determine {join_names(undetermined)}."
        )
    if check.structure is not None and check.structure.recommendations:
        answer.append(f"Remedy: {check.structure.recommendations[0]}")
    return Paragraphs(answer, Tone.CAUTION)


def _precision(check: ModelCheck) -> Iterator[Block]:
    if check.failure:
        yield Paragraphs([check.failure], Tone.CAUTION)
        return
    head = ["parameter", "start value", "expected std", "of the value", "unit", "remark"]
    rows = [[name, *_expected(c)] for name, c in check.constants.items()]
    yield PageTable("Expected standard deviations of a fit near the start values, if the model is right", head, rows)
    percent = {name: 196 * c.std / abs(c.value) for name, c in check.constants.items() if c.std and c.value}
    figure = plot_intervals(percent, "Expected half width of each 95 % interval: smaller is better.")
    if figure is not None:
        yield FigureBlock(figure)
    practical = check.practical
    if not check.complete and practical.combinations:
        rows = [[text, typeset_number(f"{100 * std:.2g} %")] for text, std in practical.combinations.items()]
        yield PageTable("Combinations that the records determine", ["combination", "expected std"], rows)
    if practical.findings:
        yield BulletList(practical.findings)


def _expected(c: ExpectedPrecision) -> list[str]:
    unit = typeset_unit(c.unit)
    if c.std is None:
        return [typeset_number(format_number(c.value)), "", "", unit, "not determined"]
    share = f"{100 * c.std / abs(c.value):.2g} %" if c.value else ""
    remark = "not determined" if not c.determined else "only by averaging" if c.averaged else ""
    cells = (format_number(c.value), format_number(c.std, 2), share)
    return [*map(typeset_number, cells), unit, remark]


def _structure(check: ModelCheck) -> Iterator[Block]:
    structure = check.structure
    if structure is None:
        yield Paragraphs([check.doubt], Tone.BAD)
        return
    yield Paragraphs([describe_verdict(structure)], Tone.GOOD if structure.complete else Tone.CAUTION)
    if structure.complete:
        return
    if structure.determined:
        rows = [[text] for text in structure.determined]
        yield PageTable("Determined by any record", ["combination"], rows)
    yield Subheading("Not determined by any record")
    yield BulletList([*map(str, structure.directions)])
    if structure.recommendations:
        yield Subheading("Remedies")
        yield BulletList(structure.recommendations)


def _computation(check: ModelCheck) -> PageTable:
    rows = [
        ["equations", "linear in states and inputs" if check.linear else "nonlinear"],
        ["units", "every term has the unit of its balance"],
        ["discretisation", check.discretisation],
        ["kernel", f"{check.kernel} ({check.kernel_reason})"],
    ]
    return PageTable("How it was computed", ["what", "how"], rows)


# The same of a check.
RECORDS_OF_CHECK = 10


def _data(check: ModelCheck) -> Iterator[Block]:
    if check.assumed:
        yield Paragraphs([f"No records were given. The check uses a simulated one: {check.assumed}"])
    head = ["record", "rows", "duration", "sampling time", "fingerprint"]
    rows = [_record(e) for e in check.experiments]
    yield PageTable("Records", head, rows, "" if check.assumed else _noise(check))
    # Sensor faults stand in the verdict.
    findings = [finding for finding in collect_record_findings(check.experiments) if not is_sensor_fault(finding)]
    if findings:
        yield BulletList(list(map(_about_record, findings)))
    if not check.assumed:
        lines = dict.fromkeys(line for e in check.practical.excitation for line in str(e).splitlines())
        yield BulletList(list(lines))
    units = signal_units(check.model)
    drawn = check.experiments[:RECORDS_OF_CHECK]
    stretches = PAGE.stretches(sum(len(e.inputs) + len(e.outputs) for e in drawn))
    for k, e in enumerate(drawn):
        figures = plot_outputs(e, units, f"outputs-{k}"), plot_inputs(e, units, f"inputs-{k}")
        blocks = [FigureBlock(f, stretches, group=f"{k}") for f in figures if f is not None]
        yield from blocks if k < OPEN_RECORDS else [Details(capitalise(record_text(e.name)), blocks)]


def _about_record(finding: Finding) -> str:
    return f"Record {finding}"


def _record(e: Experiment) -> list[str]:
    return [e.name, str(e.rows), f"{e.duration:.6g} s", format_sampling_time(e.time), e.fingerprint[:12]]


def _noise(check: ModelCheck) -> Text:
    units = {o.name: o.unit for o in check.model.outputs}
    sizes = [f"{n} {format_number(std, 3)} {typeset_unit(units[n])}".rstrip() for n, std in check.noise.items()]
    return f"Noise: {join_names(sizes)}; {describe_noise_source(check)}"
