"""Open directions in words: which constants can change together without any change of the outputs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.identifiability.sensitivity import SensitivityRank

SAME = 1e-5  # agreement of exponents between points, and with a rational number
MOST_SUBSETS = 20000
LARGEST_EXPONENT = 6


@dataclass(frozen=True)
class OpenDirection:
    """Constants that can change together: ``weights`` are their relative changes, the largest at most some units.

    ``scaling``: the weights are exponents, valid everywhere: each constant times ``c^weight`` leaves the outputs as they
    are, for every ``c``. Otherwise they hold near one point only. ``seen_by`` are the outputs, not among the measured
    ones, that would show the change.
    """

    weights: Mapping[str, float]
    scaling: bool
    seen_by: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The constants that take part."""
        return tuple(self.weights)

    def __str__(self) -> str:
        names = list(self.weights)
        if len(names) == 1:
            return f"{names[0]} has no influence on the measured outputs"
        listed = ", ".join(names)
        if not self.scaling:
            return f"{listed} can be traded against one another"
        if set(self.weights.values()) == {1.0}:
            return f"{listed} scale together"
        up, down = ([n + _power(w * sign) for n, w in self.weights.items() if w * sign > 0] for sign in (1, -1))
        divided = f" and dividing {_and(down)}" if down else ""
        return f"multiplying {_and(up)}{divided} changes nothing, whatever c"


def find_open_directions(ranks: Sequence[SensitivityRank], names: Sequence[str]) -> list[OpenDirection]:
    """The open directions, as many as there are, each with as few constants as possible; scalings first."""
    size = ranks[0].null.shape[1]
    chosen: list[np.ndarray] = []
    found = []
    # At one point alone every direction is the same everywhere: whole exponents tell a scaling there.
    powers = map(to_small_integers, find_sparsest_vectors(common_null_space([r.row for r in ranks], size)))
    scalings = (OpenDirection(_named(v, names), True) for v in powers if len(ranks) > 1 or is_integer(v))
    trades = (OpenDirection(_named(v / np.abs(v).max(), names), False) for v in find_sparsest_vectors(ranks[0].null))
    for direction in itertools.chain(scalings, trades):
        if len(chosen) == size:
            break
        v = np.array([direction.weights.get(name, 0.0) for name in names])
        if _independent(chosen, v):
            chosen.append(v)
            found.append(direction)
    return found


def common_null_space(spans: Sequence[np.ndarray], most: int) -> np.ndarray:
    """Basis (n, k) of the vectors that are orthogonal to every one of ``spans`` (n, r): the same at every point."""
    stacked = np.hstack(spans).T
    if not stacked.size:
        return np.eye(stacked.shape[1])[:, :most]
    _, s, vt = np.linalg.svd(stacked)
    count = int((s > 1e-7 * math.sqrt(len(spans))).sum())
    return vt[count:].T


def find_sparsest_vectors(basis: np.ndarray) -> Iterator[np.ndarray]:
    """Vectors of a subspace (n, k) with the fewest entries, fewest first: those of which no entry can be made zero."""
    n, k = basis.shape
    if not k:
        return
    touched = np.flatnonzero(np.abs(basis).max(axis=1) > 1e-9)
    tried, seen = 0, list[set[int]]()
    for size in range(1, n - k + 2):
        for subset in itertools.combinations(touched.tolist(), size):
            tried += 1
            if tried > MOST_SUBSETS:
                yield from _echelon(basis)
                return
            if any(s <= set(subset) for s in seen):
                continue
            others = np.setdiff1d(np.arange(n), subset)
            _, s, vt = np.linalg.svd(basis[others]) if len(others) else (None, np.zeros(0), np.eye(k))
            if k - int((s > 1e-8).sum()) == 1:
                v = basis @ vt[-1]
                v[others] = 0.0
                seen.append(set(subset))
                yield v


def to_small_integers(v: np.ndarray) -> np.ndarray:
    """``v`` times a number that makes its entries small integers, if there is one; the first entry positive."""
    there = v[np.abs(v) > 1e-9]
    v = v / there[np.argmin(np.abs(there))]
    v = v * (1.0 if v[np.flatnonzero(np.abs(v) > 1e-9)[0]] > 0 else -1.0)
    for times in range(1, LARGEST_EXPONENT + 1):
        if np.abs(v * times - np.round(v * times)).max() < SAME * LARGEST_EXPONENT:
            return np.round(v * times)
    return v


def is_integer(v: np.ndarray) -> bool:
    """Whether all entries are small integers."""
    return bool(np.all(v == np.round(v)) and np.abs(v).max() <= LARGEST_EXPONENT)


def _independent(chosen: list[np.ndarray], v: np.ndarray) -> bool:
    matrix = np.array([w / np.linalg.norm(w) for w in [*chosen, v]])
    return bool(np.linalg.svd(matrix, compute_uv=False)[-1] > 1e-6)


def _echelon(basis: np.ndarray) -> Iterator[np.ndarray]:
    """A basis with zeros where an elimination with pivoting puts them, for a subspace too large to search."""
    rows = basis.T.copy()
    for k in range(len(rows)):
        row, column = divmod(int(np.argmax(np.abs(rows[k:]))), rows.shape[1])
        rows[[k, k + row]] = rows[[k + row, k]]
        rows[k] /= rows[k, column]
        for j in range(len(rows)):
            if j != k:
                rows[j] -= rows[j, column] * rows[k]
    rows[np.abs(rows) < 1e-9] = 0.0
    yield from rows[np.argsort((rows != 0).sum(axis=1), kind="stable")]


def _named(v: np.ndarray, names: Sequence[str]) -> dict[str, float]:
    return {name: float(w) for name, w in zip(names, v, strict=True) if abs(w) > 1e-9}


def _power(exponent: float) -> str:
    return " by c" if exponent == 1 else f" by c^{exponent:g}"


def _and(words: list[str]) -> str:
    return f"{', '.join(words[:-1])} and {words[-1]}" if len(words) > 1 else words[0]
