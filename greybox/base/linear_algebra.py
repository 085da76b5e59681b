"""Rank, null space and pseudo-inverse: one decision of what counts in a matrix whose columns differ in size.

Parameters differ in size by many orders of magnitude, and so do the columns of everything that is differentiated along them. Every
decision is therefore taken after scaling: columns to length one, or the diagonal of a symmetric matrix to one. The largest singular
value, which the others are compared with, is then between one and the root of the number of columns (the number, if symmetric).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from greybox.base import numerics


@dataclass(frozen=True)
class RankTolerance:
    """What counts of a scaled matrix.

    Parameters
    ----------
    rounding
        Singular values (eigenvalues of a symmetric matrix) at and below this share of the largest, or of one if that is more, are
        rounding errors.
    certain
        Above this share they are information. Between the two lies doubt: they count, but may come from an inexact computation.
    """

    rounding: float
    certain: float


@dataclass(eq=False)
class RowTriangle:
    """``R`` of a QR factorisation of rows that come block by block: all that least squares needs of them.

    Each block is stacked under the triangle of those before and reduced again by reflections (Golub and Van Loan, Matrix computations,
    section 5.2): as exact as one factorisation of all rows, where sums of products would square the condition number.

    Parameters
    ----------
    values
        The triangle so far (at most n, n); None before the first block.
    rows
        How many rows it stands for.
    """

    values: np.ndarray | None = None
    rows: int = 0

    def add(self, block: np.ndarray) -> None:
        """Take in further rows (m, n)."""
        if len(block):
            stacked = block if self.values is None else np.vstack([self.values, block])
            self.values = np.asarray(np.linalg.qr(stacked, mode="r"))
            self.rows += len(block)


INFORMATION_RANK = RankTolerance(numerics.RANK_CUTOFF, numerics.CERTAIN_INFORMATION)
COLUMN_RANK = RankTolerance(numerics.COLUMN_CUTOFF, numerics.CERTAIN_COLUMN)
DIRECTION_RANK = RankTolerance(numerics.DIRECTION_CUTOFF, numerics.DIRECTION_CUTOFF)
REACHABILITY = RankTolerance(numerics.REACHABILITY_RANK, numerics.REACHABILITY_RANK)


@dataclass(frozen=True, eq=False)
class ScaledDecomposition:
    """Right singular vectors of a matrix with scaled columns, and how many of them count.

    Parameters
    ----------
    scale
        By what each column was divided (n,); one where it is zero.
    values
        Singular values or eigenvalues of the scaled matrix (n,), largest first.
    vectors
        Right singular vectors or eigenvectors of the scaled matrix (n, n), in the same order.
    tolerance
        Which of the values count.
    rank
        How many do.
    """

    scale: np.ndarray
    values: np.ndarray
    vectors: np.ndarray
    tolerance: RankTolerance
    rank: int

    @property
    def is_certain(self) -> bool:
        """Whether no value lies between rounding and information."""
        return _count_above(self.values, self.tolerance.certain) == _count_above(self.values, self.tolerance.rounding)

    @property
    def gap(self) -> float:
        """The last value that counts over the first that does not."""
        # A wide gap says that the rank does not hang on the tolerance.
        last = self.values[self.rank - 1] if self.rank else 1.0
        following = self.values[self.rank] if self.rank < len(self.values) else 0.0
        return float(last / max(following, np.finfo(float).eps))

    def without_doubtful(self) -> Self:
        """The same where only what is certain counts."""
        return replace(self, rank=_count_above(self.values, self.tolerance.certain))

    @property
    def strong(self) -> np.ndarray:
        """Directions (n, rank) of the scaled unknowns that count."""
        return self.vectors[:, : self.rank]

    @property
    def weak(self) -> np.ndarray:
        """Directions (n, n - rank) of the scaled unknowns that do not; over ``scale`` they are directions of the unknowns."""
        return self.vectors[:, self.rank :]

    @property
    def is_open(self) -> np.ndarray:
        """Which unknowns (n,) a direction that does not count touches."""
        return np.any(np.abs(self.weak) > numerics.OPEN_DIRECTION_ENTRY, axis=1)

    @property
    def null_basis(self) -> np.ndarray:
        """Orthonormal basis (n, n - rank) of the directions of the unknowns that do not count: one that was shortened moves further."""
        return orthonormalise(self.weak / self.scale[:, None])

    @property
    def row_basis(self) -> np.ndarray:
        """Orthonormal basis (n, rank) of the directions that count: the complement of ``null_basis``."""
        return orthonormalise(self.strong * self.scale[:, None])


@dataclass(frozen=True, eq=False)
class SymmetricDecomposition(ScaledDecomposition):
    """Eigenvectors of a positive semidefinite matrix with a diagonal of one."""

    @cached_property
    def pseudo_inverse(self) -> np.ndarray:
        """Inverse (n, n) along the directions that count, zero along the others."""
        # A = D V L V' D: the pseudo-inverse is D^-1 V L^-1 V' D^-1, as a product of one matrix with itself symmetric to the last digit.
        half = self.strong / np.sqrt(self.values[: self.rank]) / self.scale[:, None]
        return np.asarray(half @ half.T)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """``pseudo_inverse @ right`` without squaring the scale."""
        scaled = (right.T / self.scale).T
        # D^-1 V L^-1 V' D^-1 b, from the right.
        along = self.strong.T @ scaled
        return np.asarray(((self.strong @ (along.T / self.values[: self.rank]).T).T / self.scale).T)

    @property
    def root(self) -> np.ndarray:
        """``F`` (n, rank) with ``F F'`` the matrix, but for what does not count."""
        # D V L^(1/2) of the matrix D V L V' D.
        return self.scale[:, None] * self.strong * np.sqrt(self.values[: self.rank])


@dataclass(frozen=True, eq=False)
class ColumnDecomposition(ScaledDecomposition):
    """Singular vectors of a matrix (m, n) with columns of length one; ``left`` (m, n) belong to ``vectors``."""

    left: np.ndarray

    @property
    def range_basis(self) -> np.ndarray:
        """Orthonormal basis (m, rank) of what the columns span."""
        return self.left[:, : self.rank]

    def solve(self, right: np.ndarray) -> np.ndarray:
        """The least-squares solution (n,) for ``right`` (m,), the shortest in scaled unknowns where the columns depend on one another."""
        # A = U S V' D: the solution is D^-1 V S^-1 U' b.
        return np.asarray(self.strong @ ((self.range_basis.T @ right) / self.values[: self.rank]) / self.scale)


def decompose_symmetric(matrix: np.ndarray, tolerance: RankTolerance = INFORMATION_RANK) -> SymmetricDecomposition:
    """Eigenvectors of a positive semidefinite matrix (n, n) after scaling its diagonal to one.

    Rows and columns whose diagonal is zero, or negative by rounding, hold no information and are taken to be zero.
    """
    diagonal = np.diag(matrix)
    informed = diagonal > numerics.TINY
    scale = np.sqrt(np.where(informed, diagonal, 1.0))
    # A unit diagonal: then the size of an eigenvalue does not depend on the units of the unknowns.
    scaled = np.where(informed[:, None] & informed, matrix / scale / scale[:, None], 0.0)
    values, vectors = np.linalg.eigh(scaled)
    values, vectors = values[::-1], vectors[:, ::-1]
    return SymmetricDecomposition(scale, values, vectors, tolerance, _count_above(values, tolerance.rounding))


def decompose_columns(
    matrix: np.ndarray, tolerance: RankTolerance = COLUMN_RANK, scale: np.ndarray | None = None
) -> ColumnDecomposition:
    """Singular vectors of a matrix (m, n) after scaling its columns to length one, or by ``scale`` (n,)."""
    rows, columns = matrix.shape
    length = np.linalg.norm(matrix, axis=0) if scale is None else scale
    scale = np.where(length > 0, length, 1.0)
    scaled = matrix / scale
    if rows < columns:  # as many values as there are columns
        scaled = np.concatenate([scaled, np.zeros((columns - rows, columns))])
    left, values, right = np.linalg.svd(scaled, full_matrices=False)
    rank = _count_above(values, tolerance.rounding)
    return ColumnDecomposition(scale, values, right.T, tolerance, rank, left[:rows])


def pseudo_inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a positive semidefinite matrix (n, n), zero along directions that hold no information."""
    return decompose_symmetric(matrix).pseudo_inverse


def eliminate(information: np.ndarray, kept: np.ndarray, others: np.ndarray) -> np.ndarray:
    """``[I, -B C^+]`` (k, n): takes scores (n,) to those of the unknowns numbered ``kept``, with the ``others`` estimated as well.

    Applied to the information it leaves the Schur complement ``A - B C^+ B'``.
    """
    result = np.zeros((len(kept), len(information)))
    result[np.arange(len(kept)), kept] = 1.0
    if len(others):
        # -B C^+, with C the block of the others and B that between them.
        result[:, others] = -information[np.ix_(kept, others)] @ pseudo_inverse(information[np.ix_(others, others)])
    return result


def range_basis(
    matrix: np.ndarray, tolerance: RankTolerance = COLUMN_RANK, scale: np.ndarray | None = None
) -> np.ndarray:
    """Orthonormal basis (m, rank) of what the columns of ``matrix`` (m, n) span; ``scale`` as in `decompose_columns`."""
    return decompose_columns(matrix, tolerance, scale).range_basis


def are_independent(directions: Sequence[np.ndarray], cutoff: float = numerics.DIRECTION_CUTOFF) -> bool:
    """Whether the rows (k, n), taken to length one, are linearly independent."""
    return decompose_columns(np.asarray(directions).T, RankTolerance(cutoff, cutoff)).rank == len(directions)


def orthonormalise(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis (n, k) of the span of independent ``columns`` (n, k)."""
    return np.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0] if columns.shape[1] else columns


def _count_above(values: np.ndarray, share: float) -> int:
    return int(np.count_nonzero(values > share * max(values.max(initial=0.0), 1.0)))
