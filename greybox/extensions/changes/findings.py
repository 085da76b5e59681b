"""What change detection has to say beside its numbers."""

from __future__ import annotations

from enum import StrEnum


class ChangeCode(StrEnum):
    """Codes of the findings."""

    # The answer.
    NOTHING_CHANGED = "change_nothing_changed"
    CONSTANT_MOVED = "change_constant_moved"
    COMBINATION_MOVED = "change_combination_moved"
    EFFECT_APPEARED = "change_effect_appeared"
    NOISE_GREW = "change_noise_grew"
    UNEXPLAINED = "change_unexplained"
    DIFFERENT_INPUT = "change_different_input"
    CANNOT_TELL = "change_cannot_tell"
    FIT_FAILED = "change_fit_failed"
    # What a reader should know.
    CONSTANT_NOT_SEEN = "change_constant_not_seen"
    CONSTANT_AT_BOUND = "change_constant_at_bound"
    MODEL_LACKS_SOMETHING = "change_model_lacks_something"
    SCATTER_ALLOWED = "change_scatter_allowed"
    BEYOND_MISSING_PART = "change_beyond_missing_part"
    SPLIT_FOR_VALIDATION = "change_split_for_validation"
    SAME_RECORD = "change_same_record"
    # Several machines.
    MACHINE_FALLS_OUT = "change_machine_falls_out"
    MACHINE_NOT_FITTED = "change_machine_not_fitted"
    MACHINES_ALIKE = "change_machines_alike"
    # Over time.
    CHANGE_POINT = "change_point"
    RECORD_NOT_FITTED = "change_record_not_fitted"
    NO_CHANGE_POINT = "change_no_change_point"


class ChangeRule(StrEnum):
    """Rules that decide, as `Check.rule` names them: each is a p-value that must not fall below its limit."""

    CONSTANTS_AS_BEFORE = "change_constants_as_before"
    RESIDUAL_AS_LARGE = "change_residual_as_large"
    RESIDUAL_AS_WHITE = "change_residual_as_white"
