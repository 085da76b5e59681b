"""What failed during a search, and why. A candidate or a stage that fails is out; the search goes on and the reason is kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeVar

from greybox.errors import GreyboxError

Result = TypeVar("Result")
Fallback = TypeVar("Fallback")

# The reason of a model that runs to infinity from every starting point: no error states it.
NOT_SIMULATED = ""


class SearchStage(StrEnum):
    """Where something failed."""

    PREPARATION = "preparation"
    """An effect has no place in the model, or its starting points cannot be computed."""
    SCREENING = "screening"
    """The cost of a model cannot be predicted."""
    REFIT = "refit"
    """A model cannot be fitted."""
    SHAPE_CORRECTION = "shape_correction"
    """The shape of an effect cannot be corrected."""
    HOLDOUT = "holdout"
    """A model cannot be simulated on the validation records."""
    LOCALISATION = "localisation"
    """Where and when a model falls short cannot be estimated."""
    SURROGATE = "surrogate"
    """No curve or tone can be fitted."""
    REFINEMENT = "refinement"
    """Further effects cannot be looked for."""
    EVIDENCE = "evidence"
    """The evidence for an effect cannot be gathered."""
    LAWS = "laws"
    """No equation can be looked for."""
    PROPOSAL = "proposal"
    """No experiment can be proposed."""


@dataclass(frozen=True)
class SearchFailure:
    """One failure: ``stage``, the ``effects`` of the model that failed, and the ``reason`` as the error states it."""

    stage: SearchStage
    effects: tuple[str, ...]
    reason: str


@dataclass
class FailureLog:
    """Failures of a search in the order in which they happened, each model once a stage."""

    entries: dict[tuple[SearchStage, frozenset[str]], SearchFailure] = field(default_factory=dict)

    def add(self, stage: SearchStage, effects: tuple[str, ...], reason: str) -> None:
        """Keep one, unless the same model failed in the same stage before."""
        self.entries.setdefault((stage, frozenset(effects)), SearchFailure(stage, effects, reason))

    def attempt(
        self, stage: SearchStage, effects: tuple[str, ...], run: Callable[[], Result], fallback: Fallback
    ) -> Result | Fallback:
        """``run()``, or ``fallback`` where it fails: whatever is wrong with one candidate must not end the search."""
        try:
            return run()
        except Exception as error:  # of an effect that a user wrote, of the solver, of the compiler: the reason is kept
            self.add(stage, effects, reason_of(error))
            return fallback

    def of_single_effects(self) -> Mapping[str, str]:
        """The reason by effect for every effect that could not be prepared or fitted alone."""
        return {
            failure.effects[0]: failure.reason
            for failure in self.entries.values()
            if len(failure.effects) == 1 and failure.stage in (SearchStage.PREPARATION, SearchStage.REFIT)
        }


def reason_of(error: Exception) -> str:
    """What an error states in one line; with its kind where the library did not raise it on purpose."""
    text = " ".join(str(error).split())
    return text if isinstance(error, GreyboxError) else f"{type(error).__name__}: {text}"
