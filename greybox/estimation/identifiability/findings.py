"""What there is to say about identifiability, as codes; `greybox.show.sentences.identifiability` holds the sentences."""

from __future__ import annotations

from enum import StrEnum


class IdentifiabilityCode(StrEnum):
    """Findings about models, records and inputs, and what would determine more constants."""

    MEASURE_OUTPUT = "measure_output"
    ADD_SENSOR = "add_sensor"
    FIX_CONSTANTS = "fix_constants"
    RICHER_RECORD = "richer_record"

    NO_INPUT_MOVES = "no_input_moves"
    EXCITATION_ORDER_LOW = "excitation_order_low"
    EXCITATION_BAND_NARROW = "excitation_band_narrow"

    RECORDS_SHOW_FEWER = "records_show_fewer"
    AVERAGING_ONLY = "averaging_only"
    NO_FREE_CONSTANT = "no_free_constant"
    MODEL_OVERFLOWS = "model_overflows"
    SIMULATED_RECORD = "simulated_record"
