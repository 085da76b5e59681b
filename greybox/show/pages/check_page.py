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
from greybox.show.pages.fit_page import OPEN_RECORDS, statements
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
from greybox.show.sentences.figures import FigureText
from greybox.show.sentences.identifiability import describe_verdict
from greybox.show.sentences.pages import PageText
from greybox.show.sentences.wording import format_number, phrase


def build_check_page(check: ModelCheck, *, command: str = "") -> Page:
    """The page of a check; ``command`` is what was typed."""
    sections = [
        Section("expected", list(_precision(check))),
        Section("structure", list(_structure(check))),
        Section("model", [_computation(check), typeset_equations(check.model)]),
        Section("data", list(_data(check))),
        provenance_section(command),
    ]
    question = phrase(PageText.CHECK_QUESTION, free=[q.name for q in check.model.free_parameters])
    title = phrase(PageText.CHECK_TITLE, check.model.title)
    return Page(title, question, _verdict(check), sections, "check")


def _verdict(check: ModelCheck) -> Paragraphs:
    findings = collect_record_findings(check.experiments)
    faults = [_about_record(finding) for finding in findings if is_sensor_fault(finding)]
    answer = _answer(check)
    tone = Tone.CAUTION if faults and answer.tone is Tone.GOOD else answer.tone
    return Paragraphs([*faults, *answer.items], tone)


def _answer(check: ModelCheck) -> Paragraphs:
    if check.doubt:
        return Paragraphs([phrase(PageText.CHECK_DOUBT, reason=check.doubt)], Tone.BAD)
    if check.failure:
        return Paragraphs(statements([check.failure]), Tone.CAUTION)
    assumed = bool(check.assumed)
    if check.complete:
        return Paragraphs([phrase(PageText.CHECK_COMPLETE, assumed=assumed)], Tone.GOOD)
    answer: list[Text] = []
    if check.structure is not None and not check.structure.complete:
        answer += statements([describe_verdict(check.structure)])
    undetermined = [name for name, c in check.constants.items() if not c.determined]
    if undetermined:
        answer.append(phrase(PageText.CHECK_OPEN, open=undetermined, assumed=assumed))
    if check.structure is not None and check.structure.recommendations:
        answer.append(phrase(PageText.CHECK_REMEDY, text=str(check.structure.recommendations[0])))
    return Paragraphs(answer, Tone.CAUTION)


def _precision(check: ModelCheck) -> Iterator[Block]:
    if check.failure:
        yield Paragraphs(statements([check.failure]), Tone.CAUTION)
        return
    head = ["parameter", "start value", "expected std", "of the value", "unit", "remark"]
    rows = [[name, *_expected(c)] for name, c in check.constants.items()]
    yield PageTable(phrase(PageText.CHECK_PRECISION), head, rows)
    percent = {name: 196 * c.std / abs(c.value) for name, c in check.constants.items() if c.std and c.value}
    figure = plot_intervals(percent, phrase(FigureText.EXPECTED_INTERVALS))
    if figure is not None:
        yield FigureBlock(figure)
    practical = check.practical
    if not check.complete and practical.combinations:
        rows = [[text, typeset_number(f"{100 * std:.2g} %")] for text, std in practical.combinations.items()]
        yield PageTable(phrase(PageText.CHECK_COMBINATIONS), ["combination", "expected std"], rows)
    if practical.findings:
        yield BulletList(statements(practical.findings))


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
        yield Paragraphs(statements([check.doubt]), Tone.BAD)
        return
    yield Paragraphs(statements([describe_verdict(structure)]), Tone.GOOD if structure.complete else Tone.CAUTION)
    if structure.complete:
        return
    if structure.determined:
        rows = [[text] for text in structure.determined]
        yield PageTable(phrase(PageText.CHECK_DETERMINED), ["combination"], rows)
    yield Subheading(phrase(PageText.CHECK_UNDETERMINED))
    yield BulletList(statements(map(str, structure.directions)))
    if structure.recommendations:
        yield Subheading(phrase(PageText.CHECK_REMEDIES))
        yield BulletList(statements(structure.recommendations))


def _computation(check: ModelCheck) -> PageTable:
    rows = [
        ["equations", "linear in states and inputs" if check.linear else "nonlinear"],
        ["units", "every term has the unit of its balance"],
        ["discretisation", check.discretisation],
        ["kernel", f"{check.kernel} ({check.kernel_reason})"],
    ]
    return PageTable(phrase(PageText.COMPUTATION), ["what", "how"], rows)


# The same of a check.
RECORDS_OF_CHECK = 10


def _data(check: ModelCheck) -> Iterator[Block]:
    if check.assumed:
        yield Paragraphs([phrase(PageText.CHECK_ASSUMED, text=str(check.assumed))])
    head = ["record", "rows", "duration", "sampling time", "fingerprint"]
    rows = [_record(e) for e in check.experiments]
    yield PageTable(phrase(PageText.RECORDS), head, rows, "" if check.assumed else _noise(check))
    # Sensor faults stand in the verdict.
    findings = [finding for finding in collect_record_findings(check.experiments) if not is_sensor_fault(finding)]
    if findings:
        yield BulletList(list(map(_about_record, findings)))
    if not check.assumed:
        lines = dict.fromkeys(line for e in check.practical.excitation for line in str(e).splitlines())
        yield BulletList(statements(lines))
    units = signal_units(check.model)
    drawn = check.experiments[:RECORDS_OF_CHECK]
    stretches = PAGE.stretches(sum(len(e.inputs) + len(e.outputs) for e in drawn))
    for k, e in enumerate(drawn):
        figures = plot_outputs(e, units, f"outputs-{k}"), plot_inputs(e, units, f"inputs-{k}")
        blocks = [FigureBlock(f, stretches, group=f"{k}") for f in figures if f is not None]
        yield from blocks if k < OPEN_RECORDS else [Details(phrase(PageText.RECORD, e.name), blocks)]


def _about_record(finding: Finding) -> Finding:
    return phrase(PageText.RECORD_FINDING, text=str(finding))


def _record(e: Experiment) -> list[str]:
    return [e.name, str(e.rows), f"{e.duration:.6g} s", format_sampling_time(e.time), e.fingerprint[:12]]


def _noise(check: ModelCheck) -> Text:
    units = {o.name: o.unit for o in check.model.outputs}
    sizes = [f"{n} {format_number(std, 3)} {typeset_unit(units[n])}".rstrip() for n, std in check.noise.items()]
    return phrase(PageText.CHECK_NOISE, sizes=sizes, source=describe_noise_source(check))
