"""The page of a design: the input to play, what it should bring, the limits, and what would bring more."""

from __future__ import annotations

from collections.abc import Iterator

from greybox.experiment_design import Design
from greybox.findings import Finding, Severity
from greybox.plots.figure import Role
from greybox.plots.records import plot_signals
from greybox.plots.style import PAGE
from greybox.rendering.english import phrase
from greybox.rendering.experiment_design import constant_rows, detection_rows, gain_text, limit_rows, name_alternative
from greybox.rendering.plots import FigureText
from greybox.rendering.reports import PageText
from greybox.reports.equations import typeset_equations
from greybox.reports.page import Block, FigureBlock, Page, PageTable, Paragraphs, Section, Tone
from greybox.reports.provenance import provenance_section
from greybox.reports.records import hidden_states, signal_units
from greybox.reports.typography import typeset_number
from greybox.simulation import simulate


def build_design_page(design: Design, *, command: str = "") -> Page:
    """The page of a design; ``command`` is what was typed."""
    model = design.model
    sections = [
        Section("input", list(_figures(design))),
        Section("brings", list(_gains(design))),
        Section(
            "limits", [PageTable(phrase(PageText.DESIGN_LIMITS), ["signal", "limits", "predicted"], limit_rows(design))]
        ),
        Section("alternatives", [_alternatives(design)]),
        Section("model", [typeset_equations(model)]),
        provenance_section(command),
    ]
    title, question = phrase(PageText.DESIGN_TITLE, model.title), phrase(PageText.DESIGN_QUESTION, model.title)
    return Page(title, question, _verdict(design), sections, "design")


def _verdict(design: Design) -> Paragraphs:
    record = design.experiment
    step = record.sampling_time or 0.0
    play = phrase(PageText.DESIGN_RECORD, kind=design.kind, duration=step * record.rows, sampling_time=step)
    doubtful = any(f.severity is not Severity.NOTE for f in design.findings)
    return Paragraphs([play, *_brings(design), *design.findings], Tone.CAUTION if doubtful else Tone.GOOD)


def _brings(design: Design) -> Iterator[Finding]:
    """The one number that convinces: how far the explanations come apart, or how narrow the intervals become."""
    pair = min(design.separation, key=design.separation.__getitem__, default="")
    cost = design.separation.get(pair)
    known = {name: c for name, c in design.predicted.items() if c.std_after is not None}
    shares = {name: c.std_after / c.std_before for name, c in known.items() if c.std_after and c.std_before}
    relative = {name: c.std_after / abs(c.value) for name, c in known.items() if c.std_after and c.value}
    if len(relative) < len(design.predicted) and not shares:  # one of them stays open, as a finding says
        relative = {}
    least = max(relative, key=relative.__getitem__, default="")
    if pair or shares or least:
        yield phrase(PageText.DESIGN_BRINGS, least, pair=pair, cost=cost, shares=shares, largest=relative.get(least))


def _figures(design: Design) -> Iterator[Block]:
    """The input, and what the best explanation does under it."""
    model, record = design.model, design.experiment
    run = simulate(model, record)
    units = signal_units(model) | {s.name: s.unit for s in model.all_states}
    groups = (
        ("inputs", run.inputs, FigureText.SIMULATED_INPUTS, Role.INPUT),
        ("outputs", run.outputs, FigureText.SIMULATED_OUTPUTS, Role.OUTPUT),
        ("states", hidden_states(run), FigureText.SIMULATED_STATES, Role.STATE),
    )
    stretches = PAGE.stretches(sum(len(signals) for _, signals, _, _ in groups))
    for name, signals, caption, role in groups:
        if signals:
            held = role is Role.INPUT and record.hold == "zero"
            figure = plot_signals(name, run.time, signals, units, role, phrase(caption), held=held)
            yield FigureBlock(figure, stretches, group="designed")


def _gains(design: Design) -> Iterator[Block]:
    if design.separation:
        rows = [[pair, f"{cost:.3g}"] for pair, cost in design.separation.items()]
        yield PageTable(phrase(PageText.DESIGN_SEPARATION), ["explanations", "cost"], rows)
    if design.detection:
        head = ["effect", "amount", "now", "then"]
        yield PageTable(phrase(PageText.DESIGN_DETECTION), head, detection_rows(design.detection))
    head = ["parameter", "value", "now", "then"]
    rows = [[name, *map(typeset_number, cells)] for name, *cells in constant_rows(design.predicted)]
    yield PageTable(phrase(PageText.DESIGN_CONSTANTS), head, rows)


def _alternatives(design: Design) -> PageTable:
    rows = [[name_alternative(a), gain_text(a)] for a in design.alternatives]
    return PageTable(phrase(PageText.DESIGN_ALTERNATIVES), ["instead", "brings"], rows, phrase(PageText.DESIGN_SCALE))
