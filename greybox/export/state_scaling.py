"""Coordinates in which a state-space model is of one size (pascals and micrometres side by side lose digits), and poles in them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from greybox.numerics import BALANCING_SWEEPS, INTEGRATING_POLE, LARGEST_SCALING_EXPONENT, REAL_PART_ONLY, TINY


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
    for _ in range(BALANCING_SWEEPS):
        before = exponents.copy()
        for k in range(len(a)):
            t = np.ldexp(1.0, exponents)
            column, row = size[:, k] @ (1 / t) * t[k], size[k] @ t / t[k]
            if column and row:
                exponents[k] = np.clip(
                    exponents[k] + round(np.log2(row / column) / 2), -LARGEST_SCALING_EXPONENT, LARGEST_SCALING_EXPONENT
                )
        if np.array_equal(before, exponents):
            break
    return np.ldexp(1.0, exponents)


def _lengths(matrix: np.ndarray, axis: int) -> np.ndarray:
    lengths = np.linalg.norm(matrix, axis=axis)
    return np.where(lengths > 0, lengths, 1.0)


def compute_poles(a: np.ndarray, dt: float) -> np.ndarray:
    """Eigenvalues (n,) of ``a``, slowest first; a pole that integrates is 0 (or 1 in the z-plane) to the last digit."""
    values = np.linalg.eigvals(balance_matrix(a)[0]).astype(complex) if len(a) else np.empty(0, complex)
    values = np.where(is_at_rest(values, dt), 1.0 if dt else 0.0, values)
    values.imag[np.abs(values.imag) <= REAL_PART_ONLY * np.abs(values)] = 0.0
    speed = np.abs(values - 1.0) if dt else np.abs(values)
    return values[np.lexsort((values.imag, np.round(speed / max(speed.max(initial=0.0), TINY), 9)))]


def is_at_rest(roots: np.ndarray, dt: float, size: float | None = None) -> np.ndarray:
    """Which of some poles or zeros are at rest: 0, or 1 in the z-plane; ``size`` is that of the fastest (None: among these)."""
    distance = np.abs(roots - 1.0) if dt else np.abs(roots)
    return distance <= INTEGRATING_POLE * max(np.abs(roots).max(initial=0.0) if size is None else size, TINY)
