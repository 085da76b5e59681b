"""Codes of what a transcription and a solution say about themselves."""

from __future__ import annotations

from enum import StrEnum


class TranscriptionReason(StrEnum):
    """Why a transcription suits a model and its record."""

    STABLE = "transcription_stable"
    """Neither unstable, nor stiff, nor integrating."""

    UNSTABLE = "transcription_unstable"
    """Errors grow along the record. Values: ``rate`` (1/s), ``exponent`` (over the record), ``duration`` (s)."""

    STIFF_IMPLICIT = "transcription_stiff_implicit"
    """A fast mode, which implicit steps follow. Values: ``fastest`` (s), ``substeps`` (explicit ones in a sample)."""

    STIFF_NOT_SMOOTH = "transcription_stiff_not_smooth"
    """A fast mode, too many states for implicit steps, and equations that collocation cannot take. Values as before."""

    STIFF_LONG = "transcription_stiff_long"
    """A fast mode, too many states for implicit steps, and a record too long for collocation. Values as before, and ``samples``."""

    STIFF_COLLOCATION = "transcription_stiff_collocation"
    """A fast mode and too many states for implicit steps: collocation takes it. Values as before."""

    INTEGRATING_SHORT = "transcription_integrating_short"
    """An integrator whose drift stays near the data. Values: ``duration`` (s), ``time_constants`` (of the slowest other mode, or None)."""

    INTEGRATING_GROWING = "transcription_integrating_growing"
    """An integrator; a growing part of the record keeps the run near the data. Values as before."""


class SolutionCode(StrEnum):
    """What a solution says about itself."""

    SEARCH_STRATEGY = "search_strategy"
    """How it was searched for: the transcription, what it was made of, and why it was chosen."""
