"""The page of a campaign: how it stands, and its experiments in their order."""

from __future__ import annotations

from math import isinf

from greybox.effects import effect
from greybox.experiment_design import Campaign, CampaignStatus
from greybox.experiment_design.campaign import CampaignStep
from greybox.rendering.english import phrase
from greybox.rendering.experiment_design import CAMPAIGN_HEAD, step_row
from greybox.rendering.reports import PageText
from greybox.reports.equations import typeset_equations
from greybox.reports.page import Page, PageTable, Paragraphs, Section, Tone
from greybox.reports.provenance import provenance_section
from greybox.reports.typography import format_number, typeset_number
from greybox.schemas import ResultKind, read_json

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
    tables = [PageTable(phrase(PageText.CAMPAIGN_STEPS), CAMPAIGN_HEAD, rows), _widths(campaign), _files(campaign)]
    sections = [
        Section("steps", [table for table in tables if table is not None]),
        Section("model", [typeset_equations(model)]),
        provenance_section(command),
    ]
    verdict = Paragraphs(list(campaign.findings), TONES[campaign.status])
    title, question = (
        phrase(text, campaign.plan.model.title) for text in (PageText.CAMPAIGN_TITLE, PageText.CAMPAIGN_QUESTION)
    )
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
    head = ["parameter", *(str(phrase(PageText.CAMPAIGN_STEP, str(step.number))) for step in measured), "value"]
    return PageTable(phrase(PageText.CAMPAIGN_WIDTHS), head, rows) if rows else None


def _last_values(campaign: Campaign, step: CampaignStep) -> dict[str, str]:
    """The value of each parameter after ``step``, with its unit: of the explanation that is left, else of the fit."""
    kind, name = (ResultKind.DISCOVERY, "discovery.json") if step.effects else (ResultKind.FIT, "fit.json")
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
    return PageTable(phrase(PageText.CAMPAIGN_FILES), ["folder", "files"], rows)
