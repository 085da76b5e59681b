"""Exponentials of the generator of an exact hold over several interval lengths at once, with their slopes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm


class HoldExponentials(NamedTuple):
    """Exponentials of the generator over some lengths: ``values`` (nh, size, size), ``slopes`` (nh, n, size, size) along n
    parameters."""

    values: np.ndarray
    slopes: np.ndarray
    nx: int

    def flat(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The entries of `index_hold_entries`: (nh, nq) and their slopes (nh, nq, n)."""
        nh, n, size, _ = self.slopes.shape
        slopes = self.slopes.reshape(nh, n, size * size)[:, :, places]
        return self.values.reshape(nh, size * size)[:, places], slopes.transpose(0, 2, 1)

    def of(self, k: int) -> HoldBlocks:
        """The blocks of length number ``k``."""
        return HoldBlocks(_cut_blocks(self.values[k], self.nx), _cut_blocks(self.slopes[k], self.nx))


class HoldBlocks(NamedTuple):
    """``Phi`` (nx, nx), ``G1`` (nx, nu + 1), ``G2`` (nx, nu) of one length, and their slopes along n parameters (n, ...)."""

    values: tuple[np.ndarray, ...]
    slopes: tuple[np.ndarray, ...]


def compute_exponentials(generator: np.ndarray, slopes: np.ndarray, lengths: np.ndarray, nx: int) -> HoldExponentials:
    """Exponentials over each of ``lengths``, and their slopes along ``slopes`` (n, size, size) of the generator: the upper right
    block of that of ``[[M, dM], [0, M]]`` (Najfeld, Havel 1995)."""
    size, n, nh = len(generator), len(slopes), len(lengths)
    inputs = (size - nx) // 2
    scaled = generator * lengths[:, None, None]
    scaled[:, nx : nx + inputs, nx + inputs :] = np.eye(inputs)
    if not (np.isfinite(scaled).all() and np.isfinite(slopes).all()):
        return HoldExponentials(np.full(scaled.shape, np.nan), np.full((nh, n, size, size), np.nan), nx)
    if n == 0:
        return HoldExponentials(expm(scaled), np.empty((nh, 0, size, size)), nx)
    pairs = np.zeros((nh, n, 2 * size, 2 * size))
    pairs[:, :, :size, :size] = pairs[:, :, size:, size:] = scaled[:, None]
    pairs[:, :, :size, size:] = slopes * lengths[:, None, None, None]
    exponential_pairs = expm(pairs)
    return HoldExponentials(exponential_pairs[:, 0, :size, :size], exponential_pairs[:, :, :size, size:], nx)


def index_hold_entries(nx: int, nu: int) -> np.ndarray:
    """Where the entries of ``Phi, G1, G2``, each column by column, stand in a flattened exponential."""
    size = nx + 2 * (nu + 1)
    return np.concatenate(
        [block.ravel(order="F") for block in _cut_blocks(np.arange(size * size).reshape(size, size), nx)]
    )


def _cut_blocks(e: np.ndarray, nx: int) -> tuple[np.ndarray, ...]:
    """``Phi, G1, G2``; the constant's column has no ramp."""
    inputs = (e.shape[-1] - nx) // 2
    return e[..., :nx, :nx], e[..., :nx, nx : nx + inputs], e[..., :nx, nx + inputs : nx + 2 * inputs - 1]
