"""Rules of the checks and codes of the findings of a discovery; their sentences are in ``greybox.rendering.discovery``."""

from __future__ import annotations

from enum import StrEnum


class DiscoveryRule(StrEnum):
    """Rules that decide in a discovery, as `Check.rule` names them."""

    BASELINE_ABOVE_NOISE = "baseline_above_noise"
    VALIDATION_ABOVE_NOISE = "validation_above_noise"
    VALIDATION_ONLY = "validation_only"
    CRITERION_GAIN = "criterion_gain"
    EXPLAINED_EXCESS = "explained_excess"
    ONLY_NOISE_LEFT = "only_noise_left"
    SIMPLER_MEMBER = "simpler_member"
    SHAPE_CORRECTION = "shape_correction"
    SWAP = "swap"
    TIE = "tie"
    CLEAN_RESIDUAL = "clean_residual"
    SMALL_REMAINDER = "small_remainder"
    WHITE_RESIDUAL = "white_residual"
    HOLDOUT_GAP = "holdout_gap"
    HOLDOUT_EXPLAINED = "holdout_explained"
    HOLDOUT_PARTLY_EXPLAINED = "holdout_partly_explained"
    HOLDOUT_NOISE = "holdout_noise"
    ESTIMATION_DECREASE = "estimation_decrease"
    VALIDATION_DECREASE = "validation_decrease"
    REFINED_ERROR = "refined_error"
    ESTABLISHED = "established"


class DiscoveryCode(StrEnum):
    """Codes of the findings of a discovery."""

    # The answer.
    NOTHING_MISSING = "nothing_missing"
    EFFECT_NAMED = "effect_named"
    EFFECTS_TIED = "effects_tied"
    EFFECTS_ESTABLISHED = "effects_established"
    ERROR_REDUCED = "error_reduced"
    ERROR_LEFT = "error_left"
    UNKNOWN_EFFECT = "unknown_effect"
    NO_LOOK_ALIKE = "no_look_alike"
    NEAREST_LOOK_ALIKE = "nearest_look_alike"
    HARDLY_VISIBLE = "hardly_visible"
    MISSING_SIGNAL = "missing_signal"
    SURROGATE_FITTED = "surrogate_fitted"
    # What a reader should know.
    LEARNT_FROM_VALIDATION = "learnt_from_validation"
    SHAPE_CORRECTED = "shape_corrected"
    DISCRIMINATING_EXPERIMENT = "discriminating_experiment"
    NO_DISCRIMINATING_EXPERIMENT = "no_discriminating_experiment"
    DETECTION_LIMIT = "detection_limit"
    # Why an effect was not tried.
    NO_PLACE = "no_place"
    EFFECT_PRESENT = "effect_present"
    NOT_A_CANDIDATE = "not_a_candidate"
    EFFECT_LEFT_OUT = "effect_left_out"
    CANDIDATE_FAILED = "candidate_failed"
    CANDIDATE_NOT_SIMULATED = "candidate_not_simulated"
    # What to do next.
    SEPARATE_FROM_RIVAL = "separate_from_rival"
    QUOTE_THIRD_RECORD = "quote_third_record"
    CONFIRM_ON_ANOTHER_RECORD = "confirm_on_another_record"
    CONTINUE_WITH_LOOK_ALIKE = "continue_with_look_alike"
    STATE_NOISE = "state_noise"
    CHECK_NOISE = "check_noise"
    EXTEND_ESTIMATION_RECORDS = "extend_estimation_records"
    COVER_VALIDATION_RANGE = "cover_validation_range"
    SUSPECT_MAINS = "suspect_mains"
    SUSPECT_MACHINE = "suspect_machine"
    USE_TONE_MODEL = "use_tone_model"
    SUSPECT_MEMORY = "suspect_memory"
    SUSPECT_PERIODIC_PART = "suspect_periodic_part"
    SUSPECT_CONTACT = "suspect_contact"
    USE_CURVE_MODEL = "use_curve_model"
    VARY_SPEED_AND_AMPLITUDE = "vary_speed_and_amplitude"
    MEASURE_MORE = "measure_more"
    # Steps of the search, as they are reported while it runs.
    BASELINE_FITTED = "baseline_fitted"
    NOISE_WHITE = "noise_white"
    NOISE_FROM_RESIDUAL = "noise_from_residual"
    FIRST_EFFECT = "first_effect"
    FURTHER_EFFECT = "further_effect"
    SHAPE_CORRECTION_SUFFICES = "shape_correction_suffices"
    LEARNING_FROM_VALIDATION = "learning_from_validation"
    REFINEMENT_STARTED = "refinement_started"
