"""Errors of models in blocks of the validation records: by how much one model does worse than another, and whether that is chance."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from greybox.numerics import SAME_ERROR, TINY

BlockErrors = Mapping[str, np.ndarray]
"""Mean square errors (B,) of a model by output, in blocks of the validation records."""


def compare_errors(errors: BlockErrors, others: BlockErrors) -> tuple[float, float]:
    """How much larger the mean square errors of another model are, and how many standard errors of the blocks that is.

    Each output counts relative to the error that the first model leaves in it. The standard errors are those of the logarithm, so that
    blocks of large motion do not hide the others, or those of the errors themselves where these tell more: an effect that acts in a
    few blocks only (a stop, an overflow). Infinitely larger for a model that cannot be run.
    """
    shared = [o for o in errors if o in others and len(others[o]) == len(errors[o])]
    if not shared or not all(np.isfinite(others[o]).all() for o in shared):
        return 1 / TINY, np.inf
    blocks = min(len(errors[o]) for o in shared)
    loss = float(np.mean([mean_error(others[o]) / max(mean_error(errors[o]), TINY) for o in shared])) - 1
    relative = [[each[o][:blocks] / max(mean_error(errors[o]), TINY) for o in shared] for each in (errors, others)]
    first, second = (np.maximum(np.mean(each, axis=0), TINY) for each in relative)
    return loss, max((_count_standard_errors(each) for each in (np.log(second / first), second - first)), key=abs)


def _count_standard_errors(values: np.ndarray) -> float:
    """The mean of ``values`` (B,) in standard errors; two runs of the same model differ by rounding, and not by many of these."""
    spread = float(values.std(ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.inf
    return float(values.mean()) / max(spread, SAME_ERROR)


def mean_error(values: np.ndarray | None) -> float:
    """The mean over the blocks; NaN without any."""
    return np.nan if values is None else float(np.mean(values))
