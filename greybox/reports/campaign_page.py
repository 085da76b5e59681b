"""The page of a campaign: how it stands, and its experiments in their order."""

from __future__ import annotations

from collections.abc import Iterator

from greybox.experiment_design import Campaign, CampaignStatus
from greybox.rendering.english import phrase
from greybox.rendering.experiment_design import CAMPAIGN_HEAD, step_row
from greybox.rendering.reports import PageText
from greybox.reports.equations import typeset_equations
from greybox.reports.page import Block, Page, PageTable, Paragraphs, Section, Subheading, Tone
from greybox.reports.provenance import provenance_section

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
    sections = [
        Section("steps", [PageTable(phrase(PageText.CAMPAIGN_STEPS), CAMPAIGN_HEAD, rows), *_constants(campaign)]),
        Section("model", [typeset_equations(model)]),
        provenance_section(command),
    ]
    verdict = Paragraphs(list(campaign.findings), TONES[campaign.status])
    title, question = phrase(PageText.CAMPAIGN_TITLE, model.title), phrase(PageText.CAMPAIGN_QUESTION, model.title)
    return Page(title, question, verdict, sections, "campaign")


def _constants(campaign: Campaign) -> Iterator[Block]:
    """What each experiment made of the intervals."""
    for step in campaign.steps:
        yield Subheading(phrase(PageText.CAMPAIGN_STEP, str(step.number)))
        yield Paragraphs([phrase(PageText.CAMPAIGN_FILES, f"{step.number:02d}")])
        if step.widths:
            head = ["parameter", "95 % interval to each side"]
            rows = [
                [name, "open" if width == float("inf") else f"{100 * width:.2g} %"]
                for name, width in step.widths.items()
            ]
            yield PageTable("", head, rows)
