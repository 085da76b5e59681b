"""Results as data frames of pandas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def make_frame(
    index: str, labels: Sequence[Any] | np.ndarray, columns: Mapping[str, Sequence[Any] | np.ndarray]
) -> Any:
    """A pandas data frame.

    Parameters
    ----------
    index
        What its rows are.
    labels
        One for each row (N,).
    columns
        Header -> values (N,).

    Returns
    -------
    pandas.DataFrame
        The frame.

    Raises
    ------
    ModuleNotFoundError
        Without pandas (``pip install 'greybox-sysid[frames]'``).
    """
    import pandas

    return pandas.DataFrame(dict(columns), pandas.Index(labels, name=index))
