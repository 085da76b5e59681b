"""What the command line has to say about a study beside the result itself."""

from __future__ import annotations

from enum import StrEnum


class CommandCode(StrEnum):
    """Codes of the findings of the command line."""

    SPLIT_WITHOUT_EFFECT = "split_without_effect"
    RECORD_SPLIT = "record_split"
    PIECES_AT_REST = "pieces_at_rest"
    SUBSTEPS_WITHOUT_EFFECT = "substeps_without_effect"
    FILE_OVERWRITTEN = "file_overwritten"
    STUDY_FIELDS_UNUSED = "study_fields_unused"
    UNUSED_PARAMETER = "unused_parameter"
