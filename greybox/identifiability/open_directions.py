"""Open directions in words: which constants can change together without any change of the outputs."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.identifiability.policy import IDENTIFIABILITY_POLICY, IdentifiabilityPolicy
from greybox.identifiability.sensitivity import SensitivityRank
from greybox.linear_algebra import DIRECTION_RANK, are_independent, decompose_columns
from greybox.numerics import DIRECTION_CUTOFF, EXPONENT_AGREEMENT
from greybox.values import Printable


@dataclass(frozen=True)
class OpenDirection(Printable):
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


def find_open_directions(
    ranks: Sequence[SensitivityRank], names: Sequence[str], policy: IdentifiabilityPolicy = IDENTIFIABILITY_POLICY
) -> list[OpenDirection]:
    """The open directions, as many as there are, each with as few constants as possible; scalings first."""
    size = ranks[0].null.shape[1]
    chosen: list[np.ndarray] = []
    directions = []
    # At one point alone every direction is the same everywhere: whole exponents show a scaling there.
    common = common_null_space([r.row for r in ranks], size)
    powers = (to_small_integers(v, policy) for v in find_sparsest_vectors(common, policy))
    scalings = (OpenDirection(_name_weights(v, names), True) for v in powers if len(ranks) > 1 or is_integer(v, policy))
    trades = (
        OpenDirection(_name_weights(v / np.abs(v).max(), names), False)
        for v in find_sparsest_vectors(ranks[0].null, policy)
    )
    for direction in itertools.chain(scalings, trades):
        if len(chosen) == size:
            break
        v = np.array([direction.weights.get(name, 0.0) for name in names])
        if are_independent([*chosen, v]):
            chosen.append(v)
            directions.append(direction)
    return directions


def common_null_space(spans: Sequence[np.ndarray], most: int) -> np.ndarray:
    """Basis (n, k) of the vectors that are orthogonal to every one of ``spans`` (n, r): the same at every point."""
    stacked = np.hstack(spans).T
    if not stacked.size:
        return np.eye(stacked.shape[1])[:, :most]
    return decompose_columns(stacked, DIRECTION_RANK, np.ones(stacked.shape[1])).weak


def find_sparsest_vectors(
    basis: np.ndarray, policy: IdentifiabilityPolicy = IDENTIFIABILITY_POLICY
) -> Iterator[np.ndarray]:
    """Vectors of a subspace (n, k) with the fewest entries, fewest first: those of which no entry can be made zero."""
    n, k = basis.shape
    if not k:
        return
    touched = np.flatnonzero(np.abs(basis).max(axis=1) > DIRECTION_CUTOFF)
    tried, seen = 0, list[set[int]]()
    for size in range(1, n - k + 2):
        for subset in itertools.combinations(touched.tolist(), size):
            tried += 1
            if tried > policy.max_subsets:
                yield from _echelon(basis)
                return
            if any(s <= set(subset) for s in seen):
                continue
            others = np.setdiff1d(np.arange(n), subset)
            vanishing = decompose_columns(basis[others], DIRECTION_RANK, np.ones(k)).weak
            if vanishing.shape[1] == 1:
                v = basis @ vanishing[:, 0]
                v[others] = 0.0
                seen.append(set(subset))
                yield v


def to_small_integers(v: np.ndarray, policy: IdentifiabilityPolicy = IDENTIFIABILITY_POLICY) -> np.ndarray:
    """``v`` times a number that makes its entries small integers, if there is one; the first entry positive."""
    entries = v[np.abs(v) > DIRECTION_CUTOFF]
    v = v / entries[np.argmin(np.abs(entries))]
    v = v * (1.0 if v[np.flatnonzero(np.abs(v) > DIRECTION_CUTOFF)[0]] > 0 else -1.0)
    for times in range(1, policy.largest_exponent + 1):
        if np.abs(v * times - np.round(v * times)).max() < EXPONENT_AGREEMENT * policy.largest_exponent:
            return np.round(v * times)
    return v


def is_integer(v: np.ndarray, policy: IdentifiabilityPolicy = IDENTIFIABILITY_POLICY) -> bool:
    """Whether all entries are small integers."""
    return bool(np.all(v == np.round(v)) and np.abs(v).max() <= policy.largest_exponent)


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
    rows[np.abs(rows) < DIRECTION_CUTOFF] = 0.0
    yield from rows[np.argsort((rows != 0).sum(axis=1), kind="stable")]


def _name_weights(v: np.ndarray, names: Sequence[str]) -> dict[str, float]:
    return {name: float(w) for name, w in zip(names, v, strict=True) if abs(w) > DIRECTION_CUTOFF}
