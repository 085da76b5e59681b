"""Coordinates in which a state-space model is of one size: pascals and micrometres side by side lose digits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

SWEEPS = 50
FARTHEST = 200  # powers of two


class ScaledStateSpace(NamedTuple):
    """A model in the coordinates ``x = t * z``; ``b`` and ``c`` are besides scaled by a number for each input and output."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    t: np.ndarray


def scale_states(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> ScaledStateSpace:
    """``a, b, c`` with states balanced by powers of two (exact in floating point), columns of ``b`` and rows of ``c`` of length one."""
    n = len(a)
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n], whole[n, :n] = a, np.abs(b).sum(axis=1), np.abs(c).sum(axis=0)
    factors = _factors(whole)
    t = factors[:n] / factors[n]
    b1, c1 = b / t[:, None], c * t
    b1 = b1 / _lengths(b1, axis=0)
    return ScaledStateSpace(a / t[:, None] * t, b1, c1 / _lengths(c1, axis=1)[:, None], t)


def balance_matrix(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``a`` in balanced coordinates and the scaling ``t`` (n,) with ``x = t * z``."""
    t = _factors(a)
    return a / t[:, None] * t, t


def _factors(a: np.ndarray) -> np.ndarray:
    """Powers of two (n,) that make rows and columns of ``a`` equally long (Osborne 1960; Parlett, Reinsch 1969)."""
    size = np.abs(a - np.diag(np.diag(a)))
    exponents = np.zeros(len(a), int)
    for _ in range(SWEEPS):
        before = exponents.copy()
        for k in range(len(a)):
            t = np.ldexp(1.0, exponents)
            column, row = size[:, k] @ (1 / t) * t[k], size[k] @ t / t[k]
            if column and row:
                exponents[k] = np.clip(exponents[k] + round(np.log2(row / column) / 2), -FARTHEST, FARTHEST)
        if np.array_equal(before, exponents):
            break
    return np.ldexp(1.0, exponents)


def _lengths(matrix: np.ndarray, axis: int) -> np.ndarray:
    lengths = np.linalg.norm(matrix, axis=axis)
    return np.where(lengths > 0, lengths, 1.0)
