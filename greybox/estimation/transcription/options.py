"""What can be chosen about the solution of a problem."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from greybox.base.errors import ModelError, nearest
from greybox.estimation.transcription.policy import DEFAULT_SOLVER_POLICY, SolverPolicy


class Transcription(StrEnum):
    """How records become an optimisation problem."""

    AUTOMATIC = "automatic"
    SINGLE = "single"
    MULTIPLE = "multiple"
    COLLOCATION_RADAU = "collocation-radau"
    COLLOCATION_LEGENDRE = "collocation-legendre"
    ARCS = "arcs"


class Hessian(StrEnum):
    """Curvature that a fit by collocation uses."""

    GAUSS_NEWTON = "gauss-newton"
    EXACT = "exact"


@dataclass(frozen=True)
class SolverOptions:
    """How a problem is solved; `FitOptions` describes each field.

    Raises
    ------
    ModelError
        For a choice that does not exist, or one that contradicts another.
    """

    method: str = "automatic"
    substeps: int = 0
    progressive: bool = True
    iterations: int = 200
    tolerance: float = 1e-12
    thorough: bool = True
    transcription: str = "automatic"
    arc_length: float = 0.0
    hessian: str = "gauss-newton"
    policy: SolverPolicy = DEFAULT_SOLVER_POLICY

    def __post_init__(self) -> None:
        if self.transcription not in list(Transcription):
            raise ModelError(
                f"unknown transcription {self.transcription!r}; {nearest(self.transcription, list(map(str, Transcription)))}"
            )
        if self.hessian not in list(Hessian):
            raise ModelError(f"unknown Hessian {self.hessian!r}; {nearest(self.hessian, list(map(str, Hessian)))}")
        if not (math.isfinite(self.arc_length) and self.arc_length >= 0):
            raise ModelError(f"arc_length {self.arc_length} s: give a positive number of seconds, or 0 for no arcs")
        if self.arc_length and self.transcription not in ("automatic", "arcs"):
            raise ModelError(
                f"arc_length {self.arc_length:g} s: transcription {self.transcription!r} has no arcs; leave out one of the two"
            )
        if self.transcription == "arcs" and not self.arc_length:
            raise ModelError("transcription 'arcs' needs their length: give arc_length, in seconds")
        if self.hessian == "exact" and not self.transcription.startswith("collocation"):
            raise ModelError(
                f"hessian 'exact': transcription {self.transcription!r} has none; take 'collocation-radau' or"
                " 'collocation-legendre', or 'gauss-newton'"
            )
