"""What a design and a campaign have to say beside their numbers."""

from __future__ import annotations

from enum import StrEnum


class DesignCode(StrEnum):
    """Codes of the findings of a design."""

    CONSTANT_NOT_DETERMINED = "design_constant_not_determined"
    WOULD_NOT_DECIDE = "design_would_not_decide"
    NO_EARLIER_RECORD = "design_no_earlier_record"
    LIMIT_RULES = "design_limit_rules"
    RANGE_FROM_RECORDS = "design_range_from_records"


class CampaignCode(StrEnum):
    """How a campaign stands."""

    MEASURE = "campaign_measure"
    ONE_LEFT = "campaign_one_left"
    BUDGET_SPENT = "campaign_budget_spent"
    LIMIT_BROKEN = "campaign_limit_broken"
