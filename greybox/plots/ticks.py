"""Which numbers stand on an axis, and how they are written: ``0.00  0.25  0.50``, or ``0.1  0.2  0.5  1`` on a logarithmic one."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from greybox.plots.units import typeset_exponents

STEPS = (1, 2, 2.5, 5, 10)  # between numbers, but for the power of ten
# Multiples of the powers of ten that have numbers on a logarithmic axis, and the decades that it spans at least.
MULTIPLES = ((3.0, (1,)), (1.0, (1, 2, 5)), (0.5, (1, 2, 3, 5)))


def linear_ticks(low: float, high: float, most: int) -> tuple[np.ndarray, list[str]]:
    """Round numbers from ``low`` to ``high``, ``most`` of them or fewer, and how they are written."""
    for bins in range(most + 1, 0, -1):  # of which those at the ends may lie partly outside
        ticks = _inside(np.array(MaxNLocator(bins, steps=list(STEPS)).tick_values(low, high)), low, high)
        if len(ticks) <= most:
            break
    formatter = ScalarFormatter(useOffset=False, useMathText=False)
    formatter.create_dummy_axis()
    formatter.axis.set_view_interval(low, high)  # type: ignore[union-attr]
    written = formatter.format_ticks(ticks.tolist())
    return ticks, _short(ticks) if formatter.get_offset() else written


def log_ticks(low: float, high: float, most: int) -> tuple[np.ndarray, list[str]]:
    """Numbers for a logarithmic axis from ``low`` to ``high``, ``most`` or fewer: powers of ten, with 2 and 5 where there is room."""
    span = math.log10(high / low)
    for least, multiples in MULTIPLES:
        ticks = log_lines(low, high, multiples)
        if span >= least and len(ticks) <= most:
            return ticks, _short(ticks)
    if span < 1:
        return linear_ticks(low, high, most)
    decades = log_lines(low, high, (1,))
    ticks = decades[:: math.ceil(len(decades) / most)]
    return ticks, _short(ticks)


def log_lines(low: float, high: float, multiples: Sequence[int] = range(1, 10)) -> np.ndarray:
    """These ``multiples`` of powers of ten from ``low`` to ``high``."""
    powers = 10.0 ** np.arange(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    return _inside(np.outer(powers, list(multiples)).ravel(), low, high)


def _short(values: np.ndarray) -> list[str]:
    return [typeset_exponents(f"{v:g}").replace("-", "−") for v in values]


def _inside(values: np.ndarray, low: float, high: float) -> np.ndarray:
    hair = 1e-9 * (high - low)
    return values[(values >= low - hair) & (values <= high + hair)]
