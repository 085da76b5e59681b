"""Numbers and units as people read them on an axis: micrometres rather than 1e-6 m."""

from __future__ import annotations

import math
import re

import numpy as np

from greybox.plots.policy import DRAWING
from greybox.rendering.quantities import choose_prefix
from greybox.units import format_unit

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
EXPONENT = re.compile(r"(\d+(?:\.\d+)?)e([+-])0*(\d+)")


def scale_to_prefix(unit: str, *signals: np.ndarray) -> tuple[float, str]:
    """Factor and unit in which the largest value of ``signals`` has one to three digits: ``(1e6, "µm")``."""
    largest = max((float(np.nanmax(np.abs(s))) for s in signals if np.isfinite(s).any()), default=0.0)
    factor, prefix = choose_prefix(unit, largest)
    return factor, prefix + typeset_unit(unit)


def typeset_unit(unit: str) -> str:
    """A unit as print has it: ``N s/m²``, ``Ω``."""
    return format_unit(unit).replace("^2", "²").replace("^3", "³").replace("*", " ").replace("ohm", "Ω")


def typeset_exponents(text: str) -> str:
    """Numbers with their powers of ten as print has them: ``5e-04`` is 5·10⁻⁴, ``4e+01`` is 40."""
    return EXPONENT.sub(_typeset_exponent, text)


def write_cell(value: float) -> str:
    """A correlation in two digits: ``−0.25``, and ``0.00`` without a sign."""
    return f"{value:z.2f}".replace("-", "−")


def _typeset_exponent(match: re.Match[str]) -> str:
    digits, sign, exponent = match.groups()
    if sign == "+" and int(exponent) <= DRAWING.largest_power_written_out:
        return f"{float(match[0]):.15g}"
    return f"{digits}·10" + (sign.replace("+", "") + exponent).translate(RAISED)


def root_mean_square(values: np.ndarray) -> float:
    """Root mean square of the finite ``values`` (N,); NaN where there are none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan


def value_range(values: np.ndarray) -> tuple[float, float]:
    """Smallest and largest of the finite ``values`` (N,); NaN where there are none."""
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if len(known) else (math.nan, math.nan)
