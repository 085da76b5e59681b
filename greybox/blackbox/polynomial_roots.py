"""Polynomials in ``q^-1`` made stable: their roots brought inside the unit circle."""

from __future__ import annotations

import numpy as np

from greybox.numerics import CONFINED_ROOT_MARGIN, REFLECTED_ROOT_MARGIN, TINY


def reflect_roots(polynomial: np.ndarray) -> np.ndarray:
    """A polynomial in ``q^-1`` that begins with 1, its roots outside the unit circle mirrored into it.

    The magnitude of its frequency response keeps its shape; a root on the circle goes just inside.
    """
    roots = np.roots(polynomial)
    size = np.abs(roots)
    if np.all(size < 1 - REFLECTED_ROOT_MARGIN):
        return polynomial
    size = np.where(size > 1, 1 / np.maximum(size, 1), size)
    inside = np.minimum(size, 1 - REFLECTED_ROOT_MARGIN) * np.exp(1j * np.angle(roots))
    mirrored = np.real(np.poly(inside))
    return np.append(mirrored, np.zeros(len(polynomial) - len(mirrored)))


def confine_roots(polynomial: np.ndarray) -> np.ndarray:
    """A polynomial in ``q^-1`` that begins with 1, its roots on or outside the unit circle moved radially to just inside it."""
    roots = np.roots(polynomial)
    size = np.abs(roots)
    if np.all(size <= 1 - CONFINED_ROOT_MARGIN):
        return polynomial
    confined = np.real(np.poly(roots * np.minimum(1.0, (1 - CONFINED_ROOT_MARGIN) / np.maximum(size, TINY))))
    return np.append(confined, np.zeros(len(polynomial) - len(confined)))
