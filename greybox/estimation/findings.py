"""Codes of what a fit finds about itself, its records and its options; `greybox.show.sentences.estimation` has their sentences."""

from __future__ import annotations

from enum import StrEnum


class EstimationCode(StrEnum):
    """Codes of what a fit finds about itself, its records and its options."""

    # What the status says beside its name.
    MISFIT_RATIO = "misfit_ratio"
    PREDICTION_RATIO = "prediction_ratio"
    FILTER_NOT_FINITE = "filter_not_finite"
    TERM_NOT_FINITE = "term_not_finite"
    STATES_DIVERGE = "states_diverge"
    SENSITIVITY_NOT_FINITE = "sensitivity_not_finite"
    # What the constants and the residual say.
    MODEL_DOES_NOT_FOLLOW = "model_does_not_follow"
    DIRECTION_UNDETERMINED = "direction_undetermined"
    STOPPED_BY_BOUND = "stopped_by_bound"
    NARROWED_BY_BOUND = "narrowed_by_bound"
    PARAMETER_UNDETERMINED = "parameter_undetermined"
    NOTHING_TO_EXPLAIN = "nothing_to_explain"
    MISFIT_ABOVE_NOISE = "misfit_above_noise"
    MISFIT_ABOVE_DIFFERENCE_NOISE = "misfit_above_difference_noise"
    PARAMETER_NOT_CONSTANT = "parameter_not_constant"
    RESIDUAL_CORRELATED = "residual_correlated"
    INNOVATIONS_CORRELATED = "innovations_correlated"
    INTEGRATION_TOO_COARSE = "integration_too_coarse"
    RELATION_NOT_MET = "relation_not_met"
    STEP_MOVES_PARAMETERS = "step_moves_parameters"
    VALIDATION_ERROR_LARGER = "validation_error_larger"
    # What was asked for.
    PRIOR_CONFLICT = "prior_conflict"
    HELD_BY_PRIOR = "held_by_prior"
    TIED_OUTSIDE_BOUNDS = "tied_outside_bounds"
    MEAN_OF_EXPERIMENTS = "mean_of_experiments"
    ROBUST_LOSS_OUTLIERS = "robust_loss_outliers"
    TOO_MANY_OUTLIERS = "too_many_outliers"
    CONSTANT_OUTPUT_EXCLUDED = "constant_output_excluded"
    # Process noise.
    PROCESS_NOISE_ZERO = "process_noise_zero"
    PROCESS_NOISE_NOT_SIGNIFICANT = "process_noise_not_significant"
    PROCESS_NOISE_SIGNIFICANT = "process_noise_significant"
    NOISE_COLOUR_IGNORED = "noise_colour_ignored"
    # Several starts.
    STARTS = "starts"
    STARTS_NOT_BEGUN = "starts_not_begun"
    OTHER_START_TAKEN = "other_start_taken"
    NO_START_HELPS = "no_start_helps"
