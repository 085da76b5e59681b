"""Parameters of the catalogue: amplitudes, absent until fitted, and the constants that give an effect its shape."""

from __future__ import annotations

import math

import numpy as np

from greybox.model.signals import Parameter

ABSENT = "amplitude, absent until fitted"
ROUGH = "rough, until the data say better"


def amplitude_parameter(
    name: str, unit: str, description: str, low: float = -math.inf, high: float = math.inf
) -> Parameter:
    """A parameter that is zero where the effect is absent, of either sign unless ``low`` says otherwise."""
    return Parameter(name, unit, 0.0, (low, high), source=ABSENT, description=description)


def shape_parameter(
    name: str, unit: str, value: float, bounds: tuple[float, float], description: str, source: str = ROUGH
) -> Parameter:
    """A parameter that gives an effect its shape, or an amplitude whose neutral value is not zero."""
    return Parameter(name, unit, value, bounds, source=source, description=description)


def geometric_grid(low: float, high: float, count: int) -> list[float]:
    """``count`` values from ``low`` to ``high`` with equal ratios."""
    return [float(value) for value in np.geomspace(low, high, count)]


# Bounds of a delay (s) before a record says how it is sampled.
UNTAILORED_DELAY = (0.0, 5e-3)
