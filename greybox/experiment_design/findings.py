"""What a design has to say beside their numbers."""

from __future__ import annotations

from enum import StrEnum


class DesignCode(StrEnum):
    """Codes of the findings of a design."""

    CONSTANT_NOT_DETERMINED = "design_constant_not_determined"
    WOULD_NOT_DECIDE = "design_would_not_decide"
    NO_EARLIER_RECORD = "design_no_earlier_record"
    LIMIT_RULES = "design_limit_rules"
    RANGE_FROM_RECORDS = "design_range_from_records"
