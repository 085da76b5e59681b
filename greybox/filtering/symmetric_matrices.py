"""Symmetric matrices as the column of their lower triangle, column by column."""

from __future__ import annotations

import casadi as ca
import numpy as np


def to_symmetric(lower: ca.SX, n: int) -> ca.SX:
    """The symmetric matrix (n, n) of a lower triangle (n (n + 1) / 2,)."""
    index = _triangle_index(n)
    return ca.horzcat(*[ca.vertcat(*[lower[int(index[i, j])] for i in range(n)]) for j in range(n)])


def to_lower_triangle(matrix: ca.SX) -> ca.SX:
    """The lower triangle (n (n + 1) / 2,) of a matrix that is symmetric."""
    n = matrix.size1()
    return ca.vertcat(*[matrix[i, j] for j in range(n) for i in range(j, n)])


def to_symmetric_arrays(lower: np.ndarray, n: int) -> np.ndarray:
    """Symmetric matrices (..., n, n) of lower triangles (..., n (n + 1) / 2)."""
    return lower[..., _triangle_index(n)]


def to_lower_triangle_array(matrix: np.ndarray) -> np.ndarray:
    """The lower triangle (n (n + 1) / 2,) of a symmetric matrix (n, n)."""
    n = len(matrix)
    return np.array([matrix[i, j] for j in range(n) for i in range(j, n)])


def _triangle_index(n: int) -> np.ndarray:
    """Position of each entry (n, n) in the lower triangle."""
    index = np.zeros((n, n), int)
    columns, rows = np.triu_indices(n)
    index[rows, columns] = index[columns, rows] = np.arange(len(rows))
    return index
