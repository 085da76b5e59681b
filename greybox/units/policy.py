"""How long the text of a unit may be."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class UnitPolicy:
    """Limits of a unit's text."""

    longest_unit: int = 100
    """Characters of a unit; no rig has a longer one, and so brackets in brackets stay few."""


UNIT_POLICY = UnitPolicy()
