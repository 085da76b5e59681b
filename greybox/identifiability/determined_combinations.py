"""Which combinations of the constants are determined, as formulas."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from greybox.identifiability.open_directions import (
    common_null_space,
    find_sparsest_vectors,
    is_integer,
    to_small_integers,
)
from greybox.identifiability.policy import IDENTIFIABILITY_POLICY, IdentifiabilityPolicy
from greybox.identifiability.sensitivity import SensitivityRank
from greybox.identifiability.symbolic_polynomial import (
    Polynomial,
    divide,
    format_polynomial,
    logarithmic_gradient,
    remove_known_factors,
    transfer_function_coefficients,
)
from greybox.linear_algebra import are_independent
from greybox.model import Model
from greybox.numerics import DIRECTION_CUTOFF


@dataclass(frozen=True, eq=False)
class ParameterCombination:
    """A formula in the constants, up to a known factor, and what it depends on: ``poly`` has one exponent a parameter.

    ``is_coefficient``: it is a coefficient of a transfer function, not a ratio of two.
    """

    text: str
    poly: Polynomial
    is_coefficient: bool = False

    def slope(self, p: np.ndarray, which: np.ndarray) -> np.ndarray:
        """``d log / d log p`` of the free constants (nf,) at the parameters ``p`` (np,)."""
        return logarithmic_gradient(self.poly, p)[which]


def find_determined_combinations(
    model: Model,
    ranks: Sequence[SensitivityRank],
    points: Sequence[np.ndarray],
    policy: IdentifiabilityPolicy = IDENTIFIABILITY_POLICY,
) -> list[ParameterCombination]:
    """Independent combinations that every point determines, the plainest first; at most as many as the rank.

    ``points`` (np,): the parameters at which ``ranks`` were found. Products of powers are found for every model, sums
    for linear ones, among the coefficients of their transfer functions.
    """
    which = free_parameter_indices(model)
    chosen: list[ParameterCombination] = []
    slopes: list[np.ndarray] = []
    candidates = [*find_product_combinations(model, ranks, policy), *find_transfer_function_combinations(model)]
    for plain in sorted(candidates, key=simplicity_key):
        if len(chosen) == ranks[0].rank:
            break
        candidate = _bare(plain, chosen, model)
        at = [candidate.slope(p, which) for p in points]
        if not all(is_determined(s, r) for s, r in zip(at, ranks, strict=True)):
            continue
        if are_independent([*slopes, at[0]]):
            chosen.append(candidate)
            slopes.append(at[0])
    return chosen


def free_parameter_indices(model: Model) -> np.ndarray:
    """Positions of the free constants among all parameters."""
    return np.array([k for k, q in enumerate(model.all_parameters) if not q.fixed], int)


def find_product_combinations(
    model: Model, ranks: Sequence[SensitivityRank], policy: IdentifiabilityPolicy = IDENTIFIABILITY_POLICY
) -> Iterator[ParameterCombination]:
    """Products of powers that do not change along any open direction, at any point."""
    which, names = free_parameter_indices(model), list(model.values)
    for v in find_sparsest_vectors(common_null_space([r.null for r in ranks], len(which)), policy):
        powers = to_small_integers(v, policy)
        if is_integer(powers, policy):
            whole = np.zeros(len(names), int)
            # A quotient with the positive powers in front is what people call it.
            whole[which] = powers if (powers > 0).sum() * 2 >= (powers != 0).sum() else -powers
            poly = {tuple(whole.tolist()): Fraction(1)}
            yield ParameterCombination(format_polynomial(poly, names), poly)


def find_transfer_function_combinations(model: Model) -> list[ParameterCombination]:
    """The coefficients of a linear model's transfer functions, and their ratios where these are formulas: gains, lags."""
    if not model.system.linear:
        return []
    which, names = free_parameter_indices(model), list(model.values)
    known = np.setdiff1d(np.arange(len(names)), which).tolist()
    base = list({_key(poly): poly for poly in transfer_function_coefficients(model.system)}.values())
    ratios = [divide(one, other) for one in base for other in base if one is not other]
    combinations: dict[tuple, ParameterCombination] = {}
    for is_coefficient, poly in [*((True, poly) for poly in base), *((False, ratio) for ratio in ratios if ratio)]:
        bare = remove_known_factors(poly, known)
        if len(bare) == 1 and max(*next(iter(bare)), 0) == 0:  # 1/Ra: the constant itself
            bare = {tuple(-k for k in e): f for e, f in bare.items()}
        if any(e[k] for e in bare for k in which):
            combinations.setdefault(
                _key(bare), ParameterCombination(format_polynomial(bare, names), bare, is_coefficient)
            )
    return list(combinations.values())


def is_determined(slope: np.ndarray, rank: SensitivityRank) -> bool:
    """Whether a formula with this slope (nf,) does not change along any open direction."""
    size = np.linalg.norm(slope)
    return bool(
        np.isfinite(size) and size > DIRECTION_CUTOFF and np.linalg.norm(rank.null.T @ slope) < DIRECTION_CUTOFF * size
    )


def _bare(
    candidate: ParameterCombination, chosen: Sequence[ParameterCombination], model: Model
) -> ParameterCombination:
    """A sum without the factors that are determined by themselves: ``K + Ks`` for ``(K + Ks)/La``."""
    if len(candidate.poly) == 1:
        return candidate
    names = list(model.values)
    poly = remove_known_factors(candidate.poly, [names.index(c.text) for c in chosen if c.text in names])
    return ParameterCombination(format_polynomial(poly, names), poly, candidate.is_coefficient)


def _key(poly: Polynomial) -> tuple:
    return tuple(sorted(poly.items()))


def simplicity_key(candidate: ParameterCombination) -> tuple[int, int, bool, int]:
    """Products before sums, short ones first; of the sums first those that the transfer function has itself."""
    powers = np.array(list(candidate.poly))
    size, terms = int(np.abs(powers).sum()), len(powers)
    return terms, size if terms == 1 else 0, not candidate.is_coefficient, size
