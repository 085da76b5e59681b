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

    error_rows: int = 2000
    """Rows at the beginning of a record over which the integration error is measured by halving the step."""

    max_interval_lengths: int = 200
    """Distinct interval lengths for which the exact hold is taken: each needs a matrix exponential of its own."""

    max_delay_rows: int = 200
    """Longest delay of an input in sampling intervals: each interval adds a column to the input of the step."""

    max_implicit_states: int = 8
    """States for which the implicit methods are written out: their linear equations become scalar instructions."""

    newton_iterations: int = 4
    """Newton iterations of an implicit step, from the Jacobian at its start. Each gains one order in ``h``, and the methods
    are of order two and three."""


DEFAULT_POLICY = DiscretisationPolicy()
