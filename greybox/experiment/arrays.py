"""Arrays of a record: protected copies, their fingerprint and their range."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike


def to_read_only_array(what: str, values: ArrayLike, problems: list[str], rows: int | None = None) -> np.ndarray:
    """A read-only copy (N,) in float64; what is wrong with it is added to ``problems``."""
    given = np.asarray(values)
    try:
        # Text and complex numbers would be converted by numpy, the latter by dropping half of them.
        if given.dtype.kind not in "biufO":
            raise TypeError(f"its type is {given.dtype}")
        array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        problems.append(f"{what} does not hold real numbers: {error}")
        return np.zeros(0)
    if array.ndim != 1:
        problems.append(f"{what} has shape {array.shape}; give one number for each row, shape (N,)")
    elif rows is not None and len(array) != rows:
        problems.append(f"{what} has {len(array)} rows, time has {rows}; each signal needs one value for each time")
    array.setflags(write=False)
    return array


def compute_fingerprint(time: np.ndarray, inputs: Mapping[str, np.ndarray], outputs: Mapping[str, np.ndarray]) -> str:
    """16 hex digits of the SHA-256 over names and values, whatever the order of the signals."""
    digest = hashlib.sha256()
    for kind, signals in (("time", {"time": time}), ("input", inputs), ("output", outputs)):
        for name, values in sorted(signals.items()):
            digest.update(f"{kind} {name} {len(values)}\n".encode())
            # One bit pattern for every NaN and for both zeros, the same on every machine.
            digest.update((np.where(np.isnan(values), np.nan, values) + 0.0).astype("<f8").tobytes())
    return digest.hexdigest()[:16]


def describe_range(values: np.ndarray) -> str:
    """Smallest and largest value, and how many are missing."""
    known = values[~np.isnan(values)]
    return f"{known.min():.6g} to {known.max():.6g}, {len(values) - len(known)} gaps" if len(known) else "no value"
