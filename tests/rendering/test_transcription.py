"""The sentence of each reason for a transcription."""

import pytest

from greybox.findings import Finding
from greybox.transcription.findings import TranscriptionReason

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
        (
            TranscriptionReason.INTEGRATING_SEGMENTS,
            INTEGRATING,
            f"{INTEGRATING_TEXT}; errors accumulate along the record and do not decay",
        ),
    ],
)
def test_a_reason_reads_as_written(code, values, expected):
    assert str(Finding(code, values=values)) == expected
