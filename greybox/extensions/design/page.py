"""The page of a design: the input to play, what it should bring, the limits, and what would bring more."""

from __future__ import annotations

from collections.abc import Iterator
from math import isinf

from greybox.base.findings import Severity
from greybox.base.json_file import ResultKind, read_json
from greybox.estimation.result import Fit
from greybox.extensions.design.campaign import Campaign, CampaignStatus, CampaignStep
from greybox.extensions.design.result import Design
from greybox.extensions.design.sentences import (
    CAMPAIGN_HEAD,
    constant_rows,
    detection_rows,
    gain_text,
    limit_rows,
    name_alternative,
    step_row,
)
from greybox.model.effects.catalogue import effect
from greybox.show.figures.figure import Role
from greybox.show.figures.records import plot_signals
from greybox.show.figures.sheet import PAGE
from greybox.show.pages.equations import typeset_equations
from greybox.show.pages.page import Block, FigureBlock, Page, PageTable, Paragraphs, Section, Tone, typeset_number
from greybox.show.pages.provenance import hidden_states, provenance_section, signal_units
from greybox.show.sentences.wording import format_number, join_names
from greybox.simulation.simulate import simulate


def build_design_page(design: Design, *, command: str = "") -> Page:
    """The page of a design; ``command`` is what was typed."""
    model = design.model
    sections = [
        Section("input", "The input", list(_figures(design))),
        Section("brings", "What it brings", list(_gains(design))),
        Section(
            "limits",
            "Limits",
            [
                PageTable(
                    "Limits, and what is predicted under every explanation with a margin for what is not known",
                    ["signal", "limits", "predicted"],
                    limit_rows(design),
                )
            ],
        ),
        Section("alternatives", "Alternatives", [_alternatives(design)]),
        Section("model", "The model", [typeset_equations(model)]),
        provenance_section(command),
    ]
    title, question = (
        f"The next record of {model.title}",
        f"Which record of {model.title} should be taken next, within what the rig allows?",
    )
    return Page(title, question, _verdict(design), sections, "design")


def _verdict(design: Design) -> Paragraphs:
    record = design.experiment
    step = record.sampling_time or 0.0
    play = f"Play the {design.kind} input of input.csv: {step * record.rows:g} s, a row every {step:g} s. It begins and ends at rest."
    doubtful = any(f.severity is not Severity.NOTE for f in design.findings)
    return Paragraphs([play, *_brings(design), *design.findings], Tone.CAUTION if doubtful else Tone.GOOD)


def _brings(design: Design) -> Iterator[str]:
    """The one number that convinces: how far the explanations come apart, or how narrow the intervals become."""
    pair = min(design.separation, key=design.separation.__getitem__, default="")
    cost = design.separation.get(pair)
    known = {name: c for name, c in design.predicted.items() if c.std_after is not None}
    shares = {name: c.std_after / c.std_before for name, c in known.items() if c.std_after and c.std_before}
    relative = {name: c.std_after / abs(c.value) for name, c in known.items() if c.std_after and c.value}
    if len(relative) < len(design.predicted) and not shares:  # one of them stays open, as a finding says
        relative = {}
    least = max(relative, key=relative.__getitem__, default="")
    if pair:
        yield f"With it, the wrong explanation of the pair hardest to tell apart, {pair}, loses by {cost:.3g} in the cost."
    elif shares:
        sizes = sorted(shares.values())
        size = f"{sizes[0]:.2g}" if len(sizes) == 1 else f"{sizes[0]:.2g} to {sizes[-1]:.2g}"
        yield f"With it, the intervals of {join_names(list(shares))} shrink to {size} of what they are."
    elif least:
        known_to = f"With it, every constant is known to {100 * relative[least]:.2g} % or better"
        yield f"{known_to} (standard deviation); {least} is the least certain."


def _figures(design: Design) -> Iterator[Block]:
    """The input, and what the best explanation does under it."""
    model, record = design.model, design.experiment
    run = simulate(model, record)
    units = signal_units(model) | {s.name: s.unit for s in model.all_states}
    groups = (
        ("inputs", run.inputs, "Inputs.", Role.INPUT),
        ("outputs", run.outputs, "Simulated outputs, without sensor noise.", Role.OUTPUT),
        ("states", hidden_states(run), "States.", Role.STATE),
    )
    stretches = PAGE.stretches(sum(len(signals) for _, signals, _, _ in groups))
    for name, signals, caption, role in groups:
        if signals:
            held = role is Role.INPUT and record.hold == "zero"
            figure = plot_signals(name, run.time, signals, units, role, caption, held=held)
            yield FigureBlock(figure, stretches, group="designed")


def _gains(design: Design) -> Iterator[Block]:
    if design.separation:
        rows = [[pair, f"{cost:.3g}"] for pair, cost in design.separation.items()]
        yield PageTable(
            "Cost by which the wrong explanation of each pair would lose, after a refit", ["explanations", "cost"], rows
        )
    if design.detection:
        head = ["effect", "amount", "now", "then"]
        yield PageTable(
            "Smallest amount of each effect that is seen now, and with this record",
            head,
            detection_rows(design.detection),
        )
    head = ["parameter", "value", "now", "then"]
    rows = [[name, *map(typeset_number, cells)] for name, *cells in constant_rows(design.predicted)]
    yield PageTable("Standard deviation of each parameter now, and with this record", head, rows)


def _alternatives(design: Design) -> PageTable:
    rows = [[name_alternative(a), gain_text(a)] for a in design.alternatives]
    return PageTable(
        "What could be done instead",
        ["instead", "brings"],
        rows,
        "Twice as much means intervals half as wide, explanations twice as far apart, or half the amount seen.",
    )


# The page of a campaign: how it stands, and its experiments in their order.

FILES = ("input.csv", "report.html", "record.csv", "fit.html", "discovery.html")
"""What a folder of an experiment may hold for a reader, in the order in which it comes there."""
TONES = {
    CampaignStatus.MEASURING: Tone.PLAIN,
    CampaignStatus.DONE: Tone.GOOD,
    CampaignStatus.BUDGET_SPENT: Tone.CAUTION,
    CampaignStatus.LIMIT_BROKEN: Tone.BAD,
}


def build_campaign_page(campaign: Campaign, *, command: str = "") -> Page:
    """The page of a campaign; ``command`` is what was typed."""
    model = campaign.plan.model
    rows = [step_row(step) for step in campaign.steps]
    for name in campaign.steps[-1].effects if campaign.steps else ():
        model = model + effect(name)
    tables = [PageTable("The experiments, in their order", CAMPAIGN_HEAD, rows), _widths(campaign), _files(campaign)]
    sections = [
        Section("steps", "Experiments", [table for table in tables if table is not None]),
        Section("model", "The model", [typeset_equations(model)]),
        provenance_section(command),
    ]
    verdict = Paragraphs(list(campaign.findings), TONES[campaign.status])
    machine = campaign.plan.model.title
    title = f"Campaign on {machine}"
    question = f"Which effects does the rig of {machine} have, and how precisely are its parameters known?"
    return Page(title, question, verdict, sections, "campaign")


def _widths(campaign: Campaign) -> PageTable | None:
    """How the interval of each parameter became narrower; None before the first record."""
    measured = [step for step in campaign.steps if step.widths]
    names = list(dict.fromkeys(name for step in measured for name in step.widths))
    values = _last_values(campaign, measured[-1]) if measured else {}
    rows: list[list[str]] = []
    for name in names:
        widths = [step.widths.get(name) for step in measured]
        shares = ("-" if w is None else "open" if isinf(w) else f"{100 * w:.2g} %" for w in widths)
        rows.append([name, *shares, values.get(name, "")])
    head = ["parameter", *(f"experiment {step.number}" for step in measured), "value"]
    return (
        PageTable(
            "Half width of the 95 % interval of each parameter after each experiment, over its value, and the value now",
            head,
            rows,
        )
        if rows
        else None
    )


def _last_values(campaign: Campaign, step: CampaignStep) -> dict[str, str]:
    """The value of each parameter after ``step``, with its unit: of the explanation that is left, else of the fit."""
    kind, name = (ResultKind.DISCOVERY, "discovery.json") if step.effects else (Fit, "fit.json")
    path = campaign.folder / f"{step.number:02d}" / name
    if not path.exists():
        return {}
    parameters = read_json(path, kind)["parameters"]
    return {
        name: typeset_number(f"{format_number(entry['value'])} {entry.get('unit') or ''}".rstrip())
        for name, entry in parameters.items()
        if entry["value"] is not None
    }


def _files(campaign: Campaign) -> PageTable:
    """What each folder holds."""
    rows = []
    for step in campaign.steps:
        folder = f"{step.number:02d}"
        present = [name for name in FILES if (campaign.folder / folder / name).exists()]
        rows.append([folder, ", ".join(present)])
    return PageTable(
        "What the folder of each experiment holds: the input and why, the record, what was learnt from it",
        ["folder", "files"],
        rows,
    )


PAGES = {"Design": build_design_page, "Campaign": build_campaign_page}
"""Class of a result -> the function that builds its page."""
