"""Numbers that the catalogue decides with: where a search for an effect begins, and at which values an effect is absent."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FlowLimits:
    """What keeps the equations of a valve and two chambers finite where a trial step of a fit leaves the physical range."""

    laminar: float = 0.01
    """Square of the flow function below which the flow is laminar: the root has no slope where both pressures are equal."""
    least_volume: float = 0.01
    """Smallest volume of a chamber, as a share of half the total volume."""
    least_pressure: float = 0.01
    """Smallest pressure of a chamber, as a share of the ambient pressure."""


FLOW_LIMITS = FlowLimits()
UNTAILORED_DELAY = (0.0, 5e-3)
"""Bounds of a delay (s) before a record says how it is sampled."""
