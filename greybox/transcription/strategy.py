"""How a fit searched, as a finding: the transcription, what it was made of, and why it was chosen."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum

from greybox.findings import Finding, Severity
from greybox.transcription.findings import SolutionCode


class Completion(StrEnum):
    """How a fit by segments or collocation points was completed where the cost is more than plain squares."""

    NONE = ""
    FREE_RUN = "free_run"
    """By a free run from the optimum of the segments."""

    WHITE_NOISE = "white_noise"
    """With the noise taken as white, as a free run does not follow this plant."""


def make_strategy(transcription: str, **values: object) -> Finding:
    """A strategy finding; ``values`` depend on the transcription, see `greybox.rendering.estimation`."""
    return Finding(SolutionCode.SEARCH_STRATEGY, Severity.NOTE, transcription, values)


def extend_strategy(strategy: Finding, completion: Completion) -> Finding:
    """``strategy`` with how it was completed."""
    return replace(strategy, values={**strategy.values, "completion": str(completion)})
