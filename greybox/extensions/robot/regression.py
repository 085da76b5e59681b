"""Least squares over blocks of a record: everything that is decided is read from sums of products, block by block.

A block is longer than the noise remembers, so blocks are independent however coloured it is. What an estimate varies by when one block is
left out is its standard error (the jackknife over groups; Miller, Biometrika 61, 1974; Bell, McCaffrey, Survey Methodology 28, 2002), and
what a fit errs by in the block that it has not seen is how well it predicts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import t as student

from greybox.base.values import ReadOnly

# Directions of the scaled normal matrix below this share of its largest are not in the record at all.
NOT_THERE = 1e-11
# A constant with more than this share in such a direction is open.
OPEN_SHARE = 1e-3


@dataclass(frozen=True, eq=False)
class BlockProducts(ReadOnly):
    """Sums of products of columns, and of the torque as the last of them.

    Parameters
    ----------
    products
        Weighted sums over the rows of each block (K, P + 1, P + 1); of all joints together.
    rows
        Rows of each block (K,), those of all joints counted.
    """

    products: np.ndarray
    rows: np.ndarray

    @property
    def size(self) -> int:
        """Number of columns P."""
        return int(self.products.shape[1] - 1)

    @cached_property
    def total(self) -> np.ndarray:
        """Sums over all blocks (P + 1, P + 1)."""
        return np.asarray(self.products.sum(axis=0))

    def take(self, columns: Sequence[int] | np.ndarray) -> BlockProducts:
        """The same of some columns."""
        kept = [*columns, self.size]
        return replace(self, products=self.products[:, kept][:, :, kept])

    def substitute(self, mixing: np.ndarray, constant: np.ndarray) -> BlockProducts:
        """The same for unknowns z with ``x = constant + mixing @ z``, where ``mixing`` is (P, Z) and ``constant`` (P,)."""
        Q = np.zeros((self.size + 1, mixing.shape[1] + 1))
        Q[:-1, :-1], Q[:-1, -1], Q[-1, -1] = mixing, -constant, 1.0
        return replace(self, products=Q.T @ self.products @ Q)

    def merge(self, count: int) -> BlockProducts:
        """The same over fewer and longer blocks: neighbours join until ``count`` are left, or one more."""
        together = -(-len(self.rows) // max(count, 1))
        starts = np.arange(0, len(self.rows), together)
        return BlockProducts(np.add.reduceat(self.products, starts), np.add.reduceat(self.rows, starts))

    def fit(self) -> BlockSolution:
        """The least squares over all blocks, and over all but each of them."""
        A = self.total[:-1, :-1]
        scale = np.sqrt(np.diag(A))
        scale = 1 / np.where(scale > 0, scale, 1.0)
        values, vectors = np.linalg.eigh(scale[:, None] * A * scale)
        seen = values > NOT_THERE * max(values.max(initial=0.0), 1.0)
        # Only what the record shows is solved for: x = V z, with V' A V = 1.
        V = scale[:, None] * vectors[:, seen] / np.sqrt(values[seen])
        is_open = (vectors[:, ~seen] ** 2).sum(axis=1) > OPEN_SHARE**2
        return BlockSolution(self, V, is_open)


@dataclass(frozen=True, eq=False)
class BlockSolution(ReadOnly):
    """Least squares over blocks.

    Parameters
    ----------
    sums
        What was fitted.
    basis
        Directions (P, S) that the record shows, of unit length in the normal matrix.
    is_open
        Which constants (P,) the record leaves open altogether: their value stands for no more than a choice.
    """

    sums: BlockProducts
    basis: np.ndarray
    is_open: np.ndarray

    @cached_property
    def x(self) -> np.ndarray:
        """The estimates (P,)."""
        return np.asarray(self.basis @ (self.basis.T @ self.sums.total[:-1, -1]))

    @cached_property
    def inverse(self) -> np.ndarray:
        """Inverse of the normal matrix (P, P)."""
        return np.asarray(self.basis @ self.basis.T)

    @cached_property
    def _rest(self) -> np.ndarray:
        """Normal matrices (K, S, S) without each block, in the basis."""
        blocks = self.basis.T @ self.sums.products[:, :-1, :-1] @ self.basis
        # Leaving a block out may leave nothing to see of a direction: this much of the whole stays in, too little to weigh.
        return np.asarray((1 + 1e-9) * np.eye(self.basis.shape[1]) - blocks)

    @cached_property
    def without(self) -> np.ndarray:
        """The estimates (K, P) without each block."""
        rights = self.sums.products[:, :-1, -1] @ self.basis
        rest = (rights.sum(axis=0) - rights)[:, :, None]
        return np.asarray(np.linalg.solve(self._rest, rest)[:, :, 0] @ self.basis.T)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (P, P) of the estimates: ``(K - 1) / K sum (x_k - mean)(x_k - mean)'``."""
        K = len(self.without)
        deviations = self.without - self.without.mean(axis=0)
        return np.asarray((K - 1) / K * deviations.T @ deviations)

    @property
    def std(self) -> np.ndarray:
        """Standard errors (P,)."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def quantile(self) -> np.ndarray:
        """Standard errors (P,) to either end of a 95 % interval: Student's, with the degrees of freedom that the blocks leave.

        Where few blocks hold most of what tells a constant, its error is known from those alone (Bell, McCaffrey, 2002): were the noise
        white, the estimates without each block would have the covariance ``G`` (K, K), and ``tr(G)^2 / tr(G^2)`` degrees of freedom.
        """
        K, V = len(self.without), self.basis
        # The estimates without block k are V R_k V' h, so that G_kl = v' (R_k + R_l - R_k R_l) v, and v' R_k v on the diagonal.
        a = np.linalg.solve(self._rest, np.broadcast_to(V.T, (K, *V.T.shape)))
        diagonal = np.einsum("ksp,ps->pk", a, V)
        G = diagonal[:, :, None] + diagonal[:, None, :] - np.einsum("ksp,lsp->pkl", a, a)
        G[:, range(K), range(K)] = diagonal
        G = G - G.mean(axis=1, keepdims=True)
        G = G - G.mean(axis=2, keepdims=True)
        squares = (G**2).sum(axis=(1, 2))
        freedom = np.einsum("pkk->p", G) ** 2 / np.where(squares > 0, squares, np.inf)
        return np.asarray(student.ppf(0.975, np.maximum(freedom, 1.0)))

    @cached_property
    def errors(self) -> np.ndarray:
        """Sum of squares (K,) in each block of the fit that has not seen it."""
        A, h, y = self.sums.products[:, :-1, :-1], self.sums.products[:, :-1, -1], self.sums.products[:, -1, -1]
        x = self.without
        return np.asarray(y - 2 * np.einsum("kp,kp->k", x, h) + np.einsum("kp,kpq,kq->k", x, A, x))

    @property
    def residual(self) -> float:
        """Sum of squares that is left over all blocks."""
        A, h, y = self.sums.total[:-1, :-1], self.sums.total[:-1, -1], self.sums.total[-1, -1]
        return float(y - 2 * self.x @ h + self.x @ A @ self.x)

    def is_worse_than(self, other: BlockSolution, deviations: float) -> bool:
        """Whether it errs more in unseen blocks by more than so many standard errors of the difference."""
        difference = self.errors - other.errors
        spread = difference.std(ddof=1) * np.sqrt(len(difference))
        return bool(difference.sum() > deviations * spread)


@dataclass(frozen=True, eq=False)
class Promise(ReadOnly):
    """What each of further columns (C,) would do to a fit.

    ``value`` is the first estimate, ``ratio`` this over its standard error by blocks, ``decrease`` what it would take of the sum of
    squares, and ``share`` how much of the column the others cannot imitate.
    """

    value: np.ndarray
    ratio: np.ndarray
    decrease: np.ndarray
    share: np.ndarray


def promise(sums: BlockProducts, present: Sequence[int], further: Sequence[int]) -> Promise:
    """What ``further`` columns would do, each alone beside those ``present``: scores and Schur complements, nothing is fitted anew."""
    fit = sums.take(present).fit()
    A, y = sums.products[:, :-1, :-1], sums.products[:, :-1, -1]
    inside, outside = np.ix_(range(len(A)), present, further), np.array(further, int)
    # Columns less what the others imitate of them: D = I - B with B = inverse A_pf.
    B = fit.inverse @ A[inside].sum(axis=0)
    squares = A[:, outside, outside]
    # Score of each block: c'r less the part of it that the present columns answer for.
    scores = y[:, outside] - np.einsum("kpc,p->kc", A[inside], fit.x)
    of_present = y[:, present] - np.einsum("kpq,q->kp", A[np.ix_(range(len(A)), present, present)], fit.x)
    scores = scores - of_present @ B
    schur = squares.sum(axis=0) - np.einsum("pc,pc->c", B, A[inside].sum(axis=0))
    share = schur / np.where(squares.sum(axis=0) > 0, squares.sum(axis=0), np.inf)
    total, safe = scores.sum(axis=0), np.where(share > 0, schur, np.inf)
    spread = np.sqrt(((scores - scores.mean(axis=0)) ** 2).sum(axis=0))
    return Promise(total / safe, total / np.where(spread > 0, spread, np.inf), total**2 / safe, share)
