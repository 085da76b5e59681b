"""What the outputs do when constants change: a matrix of slopes, whichever way it was computed, and its rank."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.linear_algebra import COLUMN_RANK, ColumnDecomposition, decompose_columns, range_basis


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Slopes of the outputs at one point, along the logarithm (or the scale) of each free constant.

    ``blocks``: output -> ``(states, constants)``, matrices (R, nx) along the initial states, which are unknown as well, and
    (R, np) along the constants. ``doubtful``: singular values below this may come from the integration.
    """

    blocks: dict[str, tuple[np.ndarray, np.ndarray]]
    doubtful: float = COLUMN_RANK.certain

    def compress(self) -> Sensitivity:
        """The same information in as few rows as there are columns."""
        small = {}
        for name, (states, constants) in self.blocks.items():
            r = np.asarray(np.linalg.qr(np.hstack([states, constants]), mode="r"))
            small[name] = r[:, : states.shape[1]], r[:, states.shape[1] :]
        return Sensitivity(small, self.doubtful)

    def decompose(self, outputs: Sequence[str]) -> ColumnDecomposition:
        """Slopes along the constants that no change of the initial states can undo, columns scaled to length one before that."""
        basis = range_basis(np.vstack([self.blocks[name][0] for name in outputs]))
        constants = np.vstack([self.blocks[name][1] for name in outputs])
        for _ in range(2):  # the second time for what rounding left
            constants = constants - basis @ (basis.T @ constants)
        return decompose_columns(constants, replace(COLUMN_RANK, certain=self.doubtful), self.lengths(outputs))

    def lengths(self, outputs: Sequence[str]) -> np.ndarray:
        """Length of each constant's column: how much it moves the outputs."""
        return np.linalg.norm(np.vstack([self.blocks[name][1] for name in outputs]), axis=0)


@dataclass(frozen=True, eq=False)
class SensitivityRank:
    """``rank`` of the sensitivities; ``null`` (np, k) and ``row`` (np, rank) span what is open and what is determined.

    ``values`` are the singular values, ``gap`` the ratio of the last that counts to the first that does not. ``certain``
    is false where one lies between rounding and information. ``point`` numbers the point.
    """

    rank: int
    null: np.ndarray
    row: np.ndarray
    values: np.ndarray
    gap: float
    certain: bool
    point: int = 0


def compute_rank(point: Sensitivity, outputs: Sequence[str]) -> SensitivityRank:
    """Rank at one point, with only ``outputs`` measured."""
    columns = point.decompose(outputs)
    certain = columns.without_doubtful()
    return SensitivityRank(
        certain.rank, certain.null_basis, certain.row_basis, columns.values, certain.gap, columns.is_certain
    )


def highest_ranks(points: Sequence[Sensitivity], outputs: Sequence[str]) -> list[SensitivityRank]:
    """The ranks at the generic points: where it is highest, among those that are certain if there are any."""
    ranks = [replace(compute_rank(point, outputs), point=k) for k, point in enumerate(points)]
    ranks = [r for r in ranks if r.certain] or ranks
    highest = max(r.rank for r in ranks)
    return [r for r in ranks if r.rank == highest]
