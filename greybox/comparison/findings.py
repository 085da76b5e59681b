"""Codes of what a comparison of models has to say."""

from __future__ import annotations

from enum import StrEnum


class ComparisonFinding(StrEnum):
    """Verdict and findings of a comparison; their sentences are in `greybox.show.sentences.comparison`."""

    BEST_MODEL = "best_model"
    """The model with the smallest error of one output, and the best model of the other kind."""
    UNSTABLE_MODELS = "compared_unstable"
    """Models that are unstable."""
    FEEDTHROUGH_MODELS = "compared_feedthrough"
    """Models whose output depends on the input of the same row."""
    BIC_OF_DIFFERENT_OUTPUTS = "compared_bic_outputs"
    """Models whose BIC sums over different outputs."""
    FAILED_FITS = "compared_fits_failed"
    """Models whose fit did not succeed."""
    FIT_FAILED = "compared_fit_failed"
    """The fit of this model did not succeed."""
    PREDICTION_FILTER = "compared_prediction_filter"
    """What the one-step predictions of this model are made with."""
    NO_BLACK_BOX = "compared_no_black_box"
    """No black box could be fitted to an output."""
    NO_STATE_SPACE = "compared_no_state_space"
    """No state-space model of all inputs and outputs could be identified."""
    RECORD_RESAMPLED = "compared_record_resampled"
    """A record was resampled for the black boxes."""
    MEASURED_ROWS_ONLY = "compared_measured_rows_only"
    """Black boxes use the rows at which a slow sensor was read."""
    NO_SMOOTHING = "compared_no_smoothing"
    """Monte-Carlo smoothing was not possible."""
