"""The sentence of each reason for a transcription."""

import pytest

from greybox.base.values import Finding
from greybox.estimation.transcription.problem import SolutionCode, TranscriptionReason

STIFF = {"fastest": 2e-5, "substeps": 512.4}
STIFF_TEXT = "the model is stiff: its fastest mode has a time constant of 2e-05 s and needs 512 explicit steps a sample"
INTEGRATING = {"duration": 12.5, "time_constants": 83.4}
INTEGRATING_TEXT = "the model integrates (12.5 s are 83 time constants of its slowest other mode)"


@pytest.mark.parametrize(
    ("code", "values", "expected"),
    [
        (TranscriptionReason.STABLE, {}, "the model is stable and not stiff"),
        (
            TranscriptionReason.UNSTABLE,
            {"rate": 4.4295, "exponent": 88.59, "duration": 20.0},
            "the model is unstable: errors grow at 4.43 1/s, by e^88.6 over the record of 20 s, too far for a free run",
        ),
        (
            TranscriptionReason.FREE_RUN_FOLLOWS,
            {"rate": 4.4295, "exponent": 88.59, "duration": 20.0},
            "the model is stiff, and a free run follows the records although errors may grow at 4.43 1/s",
        ),
        (TranscriptionReason.STIFF_IMPLICIT, STIFF, f"{STIFF_TEXT}; a few implicit steps suffice"),
        (
            TranscriptionReason.STIFF_NOT_SMOOTH,
            STIFF,
            f"{STIFF_TEXT}; collocation does not handle sticking, switching or delays, so the fit takes these steps",
        ),
        (
            TranscriptionReason.STIFF_LONG,
            STIFF | {"samples": 40000},
            f"{STIFF_TEXT}; 40000 samples are too many for collocation, so the fit takes these steps",
        ),
        (TranscriptionReason.STIFF_COLLOCATION, STIFF, f"{STIFF_TEXT}; collocation at Radau points needs one"),
        (
            TranscriptionReason.INTEGRATING_SHORT,
            {"duration": 0.5, "time_constants": None},
            "the model integrates (0.5 s); a free run stays near the data over this short time",
        ),
        (
            TranscriptionReason.INTEGRATING_GROWING,
            INTEGRATING,
            f"{INTEGRATING_TEXT}; a growing part of the record keeps the free run near the data",
        ),
    ],
)
def test_a_reason_reads_as_written(code, values, expected):
    assert str(Finding(code, values=values)) == expected


STRATEGIES = [
    ("single", {"shares": [1.0], "reason": ""}, "single shooting on the whole record, as requested"),
    (
        "single",
        {"shares": [0.26, 1.0], "reason": "transcription_stable"},
        "single shooting on a growing record (26 %, 100 %); chosen because the model is stable and not stiff",
    ),
    ("multiple", {"segments": 1, "reason": ""}, "multiple shooting over one segment, as requested"),
    (
        "multiple",
        {"segments": 4, "reason": "", "completion": "white_noise"},
        "multiple shooting over 4 segments, as requested; the noise is assumed to be white, because a free run does not follow"
        " this plant; the intervals allow for its colour",
    ),
    (
        "multiple",
        {"segments": 4, "reason": "", "completion": "went_on"},
        "multiple shooting over 4 segments, as requested; that led no farther, and the search went on by free runs from the best"
        " point",
    ),
    (
        "collocation-radau",
        {"held_samples": 3, "reason": "", "completion": "free_run"},
        "direct collocation, as requested; 3 samples lie at a bound of a state; then a free run from that result, as the noise"
        " model, the cost or the steps require",
    ),
    (
        "arcs",
        {"arcs": 8, "arc_length": 0.1, "whole": False, "reason": ""},
        "8 arcs of 0.1 s, each with its own initial state, as requested",
    ),
    (
        "arcs",
        {"arcs": 1, "arc_length": 0.1, "whole": True, "reason": ""},
        "arcs of 0.1 s; no record is divided (a second arc would be shorter than half an arc), as requested",
    ),
    (
        "prediction",
        {"exact": True},
        "prediction error with the exact Kalman filter, started from the free-run fit or the start values",
    ),
]


@pytest.mark.parametrize(("transcription", "values", "expected"), STRATEGIES)
def test_a_strategy_reads_as_written(transcription, values, expected):
    assert str(Finding(SolutionCode.SEARCH_STRATEGY, subject=transcription, values=values)) == expected
