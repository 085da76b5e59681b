"""Numbers that steer the discretisation: how fine a step has to be, and what the methods can take."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DiscretisationPolicy:
    """How a model is divided in steps."""

    eigenvalue_step: float = 0.5
    """Largest ``|h lambda|`` of an explicit substep. RK4 is stable up to 2.785; at 0.5 it follows a fast mode to a few parts in ten
    thousand."""

    max_substeps: int = 1000
    """Substeps in one sampling interval; a model that asks for more is stiff and wants an implicit method."""


DEFAULT_POLICY = DiscretisationPolicy()
