"""What there is to know about a record, as codes; `greybox.show.sentences.data` holds the sentences."""

from __future__ import annotations

from enum import StrEnum

from greybox.base import Finding


class RecordCode(StrEnum):
    """What can be found in a record."""

    FEW_ROWS = "few_rows"
    INPUT_CONSTANT = "input_constant"
    INPUT_FOLLOWS_OUTPUT = "input_follows_output"
    OUTPUT_CONSTANT = "output_constant"
    OUTPUT_GAPS = "output_gaps"
    OUTPUT_UNWRAPPED = "output_unwrapped"
    TURNS_UNCERTAIN = "turns_uncertain"
    SENSOR_FROZEN = "sensor_frozen"
    SENSOR_DEAD = "sensor_dead"
    SENSOR_SPIKES = "sensor_spikes"
    SPIKES_LEFT_OUT = "spikes_left_out"
    SENSOR_SATURATED = "sensor_saturated"
    CODE_FOR_MISSING = "code_for_missing"
    READING_COARSE = "reading_coarse"
    SENT_ON_CHANGE = "sent_on_change"
    ROWS_ON_CHANGE = "rows_on_change"
    INPUT_TAKEN_STRAIGHT = "input_taken_straight"
    INPUT_COURSE_SHARED = "input_course_shared"
    INPUT_COURSES_DIFFER = "input_courses_differ"
    TIME_ROUNDED = "time_rounded"
    TIME_GAP = "time_gap"
    TIME_ROWS_MISSING = "time_rows_missing"
    TIME_IRREGULAR = "time_irregular"
    TIME_JITTER = "time_jitter"
    INPUT_HELD_THROUGH_GAP = "input_held_through_gap"
    PIECES_LEFT_OUT = "pieces_left_out"
    OUTPUT_NOT_MEASURED = "output_not_measured"
    UNITS_ASSUMED = "units_assumed"
    MAY_BE_PER_CENT = "may_be_per_cent"
    UNITS_READ = "units_read"
    COLUMNS_IGNORED = "columns_ignored"
    CONDITION_READ = "condition_read"
    ONE_OF_RUNS = "one_of_runs"
    ROWS_TWICE = "rows_twice"
    RESAMPLED = "record_resampled"
    ROWS_OF_PAST = "rows_of_past"
    NO_TIME = "no_time"
    TIME_UNUSABLE = "time_unusable"
    COLUMN_WITH_TEXT = "column_with_text"
    POINTS_OPEN = "points_open"
    BROUGHT_TO_ONE_TIME = "brought_to_one_time"
    CLOCK_OFFSET = "clock_offset"
    CLOCK_OFFSET_BY_RECORDER = "clock_offset_by_recorder"
    CLOCK_START = "clock_start"
    DATES_READ = "dates_read"
    MIDNIGHT_PASSED = "midnight_passed"
    SUMMER_TIME = "summer_time"
    ORIGINS_APART = "origins_apart"
    ROWS_BELOW_TABLE = "rows_below_table"
    SHEET_NOT_READ = "sheet_not_read"
    CLOCKS_NOT_COMPARED = "clocks_not_compared"
    ALSO_FITTED = "record_also_fitted"


SENSOR_FAULTS = frozenset(
    {
        RecordCode.SENSOR_FROZEN,
        RecordCode.SENSOR_DEAD,
        RecordCode.SENSOR_SPIKES,
        RecordCode.SENSOR_SATURATED,
        RecordCode.CODE_FOR_MISSING,
    }
)
# The record states no unit, and the model's was taken.
UNITS_TAKEN = frozenset({RecordCode.UNITS_ASSUMED, RecordCode.MAY_BE_PER_CENT})
TIMING = frozenset(
    {
        RecordCode.TIME_ROUNDED,
        RecordCode.TIME_GAP,
        RecordCode.TIME_ROWS_MISSING,
        RecordCode.TIME_IRREGULAR,
        RecordCode.TIME_JITTER,
    }
)


def is_sensor_fault(finding: Finding) -> bool:
    """Whether a finding casts doubt on the measurement itself: then nothing else explains a bad fit better."""
    return finding.code in SENSOR_FAULTS
