"""Sentences of the transcriptions: how a solution was searched for, and why so (goes on after "chosen because")."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from greybox.findings import Finding
from greybox.rendering.registry import register, sentence
from greybox.transcription.findings import SolutionCode, TranscriptionReason

_STIFF = "the model is stiff: its fastest mode has a time constant of {fastest:.2g} s and needs {substeps:.0f} explicit steps a sample"


def _write_integrating(ending: str) -> Callable[[Finding], str]:
    def write(finding: Finding) -> str:
        duration, number = finding.values["duration"], finding.values["time_constants"]
        length = f"{duration:.4g} s"
        if number is not None:
            length = f"{length} are {number:.2g} time constants of its slowest other mode"
        return f"the model integrates ({length}); {ending}"

    return write


def _write_strategy(finding: Finding) -> str:
    """What was searched, how it was completed, and why it was chosen."""
    v = finding.values
    text = _write_transcription(finding.subject, v) + (", as requested" if v.get("reason") == "" else "")
    if v.get("held_samples"):
        text += f"; {v['held_samples']} samples lie at a bound of a state"
    text += {
        "free_run": "; then a free run from that result, as the noise model or the cost requires",
        "white_noise": (
            "; the noise is assumed to be white, because a free run does not follow this plant; the intervals allow for its colour"
        ),
    }.get(v.get("completion", ""), "")
    if not v.get("reason"):
        return text
    return f"{text}; chosen because {sentence(Finding(v['reason'], values=v.get('reason_values', {})))}"


def _write_transcription(name: str, v: Mapping[str, Any]) -> str:
    if name == "single":
        parts = ", ".join(f"{100 * share:.3g} %" for share in (*(s for s in v["shares"] if s < 1), 1.0))
        growing = any(share < 1 for share in v["shares"])
        return f"single shooting on a growing record ({parts})" if growing else "single shooting on the whole record"
    if name == "multiple":
        segments = "one segment" if v["segments"] == 1 else f"{v['segments']} segments"
        return f"multiple shooting over {segments}"
    if name == "arcs":
        if v["whole"]:
            return (
                f"arcs of {v['arc_length']:g} s; no record is divided (a second arc would be shorter than half an arc)"
            )
        return f"{v['arcs']} arcs of {v['arc_length']:g} s, each with its own initial state"
    if name == "prediction":
        kind = "exact" if v["exact"] else "extended"
        return f"prediction error with the {kind} Kalman filter, started from the free-run fit or the start values"
    return "direct collocation"


register(
    {
        SolutionCode.SEARCH_STRATEGY: _write_strategy,
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
    }
)
