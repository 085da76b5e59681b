"""Sentences of the transcriptions: why one was proposed. Each goes on after "chosen because"."""

from __future__ import annotations

from collections.abc import Callable

from greybox.findings import Finding
from greybox.rendering.registry import register
from greybox.transcription.findings import TranscriptionReason

_STIFF = "the model is stiff: its fastest mode has a time constant of {fastest:.2g} s and needs {substeps:.0f} explicit steps a sample"


def _write_integrating(ending: str) -> Callable[[Finding], str]:
    def write(finding: Finding) -> str:
        duration, number = finding.values["duration"], finding.values["time_constants"]
        length = f"{duration:.4g} s"
        if number is not None:
            length = f"{length} are {number:.2g} time constants of its slowest other mode"
        return f"the model integrates ({length}); {ending}"

    return write


register(
    {
        TranscriptionReason.STABLE: "the model is stable and not stiff",
        TranscriptionReason.UNSTABLE: (
            "the model is unstable: errors grow at {rate:.3g} 1/s, by e^{exponent:.3g} over the record of {duration:.4g} s, too far for"
            " a free run"
        ),
        TranscriptionReason.STIFF_IMPLICIT: f"{_STIFF}; a few implicit steps suffice",
        TranscriptionReason.STIFF_NOT_SMOOTH: (
            f"{_STIFF}; collocation does not handle sticking, switching or delays, so the fit takes these steps"
        ),
        TranscriptionReason.STIFF_LONG: (
            f"{_STIFF}; {{samples}} samples are too many for collocation, so the fit takes these steps"
        ),
        TranscriptionReason.STIFF_COLLOCATION: f"{_STIFF}; collocation at Radau points needs one",
        TranscriptionReason.INTEGRATING_SHORT: _write_integrating(
            "a free run stays near the data over this short time"
        ),
        TranscriptionReason.INTEGRATING_GROWING: _write_integrating(
            "a growing part of the record keeps the free run near the data"
        ),
        TranscriptionReason.INTEGRATING_SEGMENTS: _write_integrating(
            "errors accumulate along the record and do not decay"
        ),
    }
)
