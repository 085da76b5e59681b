"""Which combinations of the constants are determined, as formulas."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from greybox.base import Finding, Printable, parse_unit
from greybox.base.linear_algebra import DIRECTION_RANK, ScaledDecomposition, are_independent, decompose_columns
from greybox.base.numerics import DIRECTION_CUTOFF, EXPONENT_AGREEMENT
from greybox.estimation.identifiability import transfer_functions
from greybox.estimation.identifiability.sensitivity import IdentifiabilityCode, Sensitivity, highest_ranks
from greybox.model import Model

# Open directions in words: which constants can change together without any change of the outputs.


@dataclass(frozen=True)
class OpenDirection(Printable):
    """Constants that can change together.

    Attributes
    ----------
    weights
        Their relative changes, the largest at most some units.
    scaling
        Whether the weights are exponents, valid everywhere: each constant times ``c^weight`` leaves the outputs as they are, for every
        ``c``. Otherwise they hold near one point only.
    seen_by
        The outputs, not among the measured ones, that would show the change.
    """

    weights: Mapping[str, float]
    scaling: bool
    seen_by: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The constants that take part."""
        return tuple(self.weights)


def find_open_directions(ranks: Sequence[ScaledDecomposition], names: Sequence[str]) -> list[OpenDirection]:
    """The open directions, as many as there are, each with as few constants as possible; scalings first."""
    null = ranks[0].null_basis
    size = null.shape[1]
    chosen: list[np.ndarray] = []
    directions = []
    # At one point alone every direction is the same everywhere: whole exponents show a scaling there.
    common = common_null_space([r.row_basis for r in ranks], size)
    powers = (to_small_integers(v) for v in find_sparsest_vectors(common))
    scalings = (OpenDirection(_name_weights(v, names), True) for v in powers if len(ranks) > 1 or is_integer(v))
    trades = (OpenDirection(_name_weights(v / np.abs(v).max(), names), False) for v in find_sparsest_vectors(null))
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


# Sets of constants that are tried for the sparsest directions.
MAX_SUBSETS = 20000


def find_sparsest_vectors(basis: np.ndarray) -> Iterator[np.ndarray]:
    """Vectors of a subspace (n, k) with the fewest entries, fewest first: those of which no entry can be made zero."""
    n, k = basis.shape
    if not k:
        return
    touched = np.flatnonzero(np.abs(basis).max(axis=1) > DIRECTION_CUTOFF)
    tried, seen = 0, list[set[int]]()
    # Minimal supports have n - k + 1 entries at most: of a subspace of dimension k a vector can always be made with
    # k - 1 zeros.
    for size in range(1, n - k + 2):
        for subset in itertools.combinations(touched.tolist(), size):
            tried += 1
            if tried > MAX_SUBSETS:
                yield from _echelon(basis)
                return
            # Minimal supports alone: a set that holds a known one brings a sum of vectors.
            if any(s <= set(subset) for s in seen):
                continue
            others = np.setdiff1d(np.arange(n), subset)
            # Combinations of the basis that vanish outside of the set; exactly one means that the set is minimal.
            vanishing = decompose_columns(basis[others], DIRECTION_RANK, np.ones(k)).weak
            if vanishing.shape[1] == 1:
                v = basis @ vanishing[:, 0]
                v[others] = 0.0
                seen.append(set(subset))
                yield v


# Largest exponent of a combination that people would write.
LARGEST_EXPONENT = 6


def to_small_integers(v: np.ndarray) -> np.ndarray:
    """``v`` times a number that makes its entries small integers, if there is one; the first entry positive."""
    entries = v[np.abs(v) > DIRECTION_CUTOFF]
    v = v / entries[np.argmin(np.abs(entries))]
    v = v * (1.0 if v[np.flatnonzero(np.abs(v) > DIRECTION_CUTOFF)[0]] > 0 else -1.0)
    for times in range(1, LARGEST_EXPONENT + 1):
        if np.abs(v * times - np.round(v * times)).max() < EXPONENT_AGREEMENT * LARGEST_EXPONENT:
            return np.round(v * times)
    return v


def is_integer(v: np.ndarray) -> bool:
    """Whether all entries are small integers."""
    return bool(np.all(v == np.round(v)) and np.abs(v).max() <= LARGEST_EXPONENT)


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


@dataclass(frozen=True, eq=False)
class ParameterCombination:
    """A formula in the constants, up to a known factor, and what it depends on: ``poly`` has one exponent a parameter.

    ``is_coefficient``: it is a coefficient of a transfer function, not a ratio of two.
    """

    text: str
    poly: transfer_functions.Polynomial
    is_coefficient: bool = False

    def slope(self, p: np.ndarray, which: np.ndarray) -> np.ndarray:
        """``d log / d log p`` of the free constants (nf,) at the parameters ``p`` (np,)."""
        return transfer_functions.logarithmic_gradient(self.poly, p)[which]


def find_determined_combinations(
    model: Model, nulls: Sequence[np.ndarray], points: Sequence[np.ndarray]
) -> list[ParameterCombination]:
    """Independent combinations that every point determines, the plainest first; at most as many as the rank.

    ``nulls`` (nf, k): bases of the open directions at the parameters ``points`` (np,). Products of powers are found for every model, sums
    for linear ones, among the coefficients of their transfer functions.
    """
    which, names = free_parameter_indices(model), list(model.values)
    chosen: list[ParameterCombination] = []
    slopes: list[np.ndarray] = []
    candidates = [*find_product_combinations(model, nulls), *find_transfer_function_combinations(model)]
    for plain in sorted(candidates, key=simplicity_key):
        if len(chosen) == len(which) - nulls[0].shape[1]:
            break
        candidate, alone = plain, [names.index(c.text) for c in chosen if c.text in names]
        # A sum without the factors that are determined by themselves: K + Ks for (K + Ks)/La.
        if len(plain.poly) > 1:
            poly = transfer_functions.remove_known_factors(plain.poly, alone)
            candidate = ParameterCombination(
                transfer_functions.format_polynomial(poly, names), poly, plain.is_coefficient
            )
        at = [candidate.slope(p, which) for p in points]
        if not all(is_determined(slope, null) for slope, null in zip(at, nulls, strict=True)):
            continue
        if are_independent([*slopes, at[0]]):
            chosen.append(candidate)
            slopes.append(at[0])
    return chosen


def free_parameter_indices(model: Model) -> np.ndarray:
    """Positions of the free constants among all parameters."""
    return np.array([k for k, q in enumerate(model.all_parameters) if not q.fixed], int)


def find_product_combinations(model: Model, nulls: Sequence[np.ndarray]) -> Iterator[ParameterCombination]:
    """Products of powers that do not change along any open direction, of which ``nulls`` (nf, k) are bases at one or more points."""
    which, names = free_parameter_indices(model), list(model.values)
    for powers in _find_powers(nulls, len(which)):
        whole = np.zeros(len(names), int)
        whole[which] = powers
        poly = {tuple(whole.tolist()): Fraction(1)}
        yield ParameterCombination(transfer_functions.format_polynomial(poly, names), poly)


def _find_powers(nulls: Sequence[np.ndarray], size: int) -> Iterator[np.ndarray]:
    """Small whole exponents (size,) at right angles to all ``nulls`` (size, k)."""
    for v in find_sparsest_vectors(common_null_space(nulls, size)):
        powers = to_small_integers(v)
        if is_integer(powers):
            # A quotient with the positive powers in front is what people call it.
            yield (powers if (powers > 0).sum() * 2 >= (powers != 0).sum() else -powers).astype(int)


def find_transfer_function_combinations(model: Model) -> list[ParameterCombination]:
    """The coefficients of a linear model's transfer functions, and their ratios where these are formulas: gains, lags."""
    if not model.system.linear:
        return []
    which, names = free_parameter_indices(model), list(model.values)
    known = np.setdiff1d(np.arange(len(names)), which).tolist()
    base = list({_key(poly): poly for poly in transfer_functions.transfer_function_coefficients(model.system)}.values())
    # Gains and time constants are ratios of coefficients, and more familiar than they are.
    ratios = [transfer_functions.divide(one, other) for one in base for other in base if one is not other]
    combinations: dict[tuple, ParameterCombination] = {}
    for is_coefficient, poly in [*((True, poly) for poly in base), *((False, ratio) for ratio in ratios if ratio)]:
        bare = transfer_functions.remove_known_factors(poly, known)
        if len(bare) == 1 and max(*next(iter(bare)), 0) == 0:  # 1/Ra: the constant itself
            bare = {tuple(-k for k in e): f for e, f in bare.items()}
        if any(e[k] for e in bare for k in which):
            combinations.setdefault(
                _key(bare),
                ParameterCombination(transfer_functions.format_polynomial(bare, names), bare, is_coefficient),
            )
    return list(combinations.values())


# Constants of open directions up to which formulas for what is determined are looked for: of more nobody would read them.
FORMULA_CONSTANTS = 6


# Largest coefficient of a sum that people would write: a + 2 b.
LARGEST_COEFFICIENT = 3


def find_determined_formulas(
    names: Sequence[str], units: Sequence[str], p: np.ndarray, null: np.ndarray
) -> Iterator[transfer_functions.Polynomial]:
    """Products of powers, then sums and differences of constants of one dimension, that no open direction changes at ``p`` (n,).

    ``null`` (n, k): the open directions in the logarithms of the constants.
    """
    size = len(names)
    if not 0 < size <= FORMULA_CONSTANTS or not p.all():
        return
    # A product changes by the sum of its powers times relative changes, a sum by that of the changes: both at right angles to `null`.
    for powers in _find_powers([null], size):
        yield {tuple(powers.tolist()): Fraction(1)}
    dimensions = [parse_unit(unit) for unit in units]
    changes = null * p[:, None]
    for signs in _find_powers([changes / np.linalg.norm(changes, axis=0)], size):
        places = np.flatnonzero(signs)
        if (
            np.abs(signs).max() <= LARGEST_COEFFICIENT
            and len(places) > 1
            and all(dimensions[k] == dimensions[places[0]] for k in places)
        ):
            yield {tuple((np.arange(size) == k).astype(int).tolist()): Fraction(int(signs[k])) for k in places}


def is_determined(slope: np.ndarray, null: np.ndarray) -> bool:
    """Whether a formula with this slope (nf,) does not change along any open direction, of which ``null`` (nf, k) is a basis."""
    # Determined: the slope stands at right angles to every open direction.
    size = np.linalg.norm(slope)
    return bool(
        np.isfinite(size) and size > DIRECTION_CUTOFF and np.linalg.norm(null.T @ slope) < DIRECTION_CUTOFF * size
    )


def _key(poly: transfer_functions.Polynomial) -> tuple:
    return tuple(sorted(poly.items()))


def simplicity_key(candidate: ParameterCombination) -> tuple[int, int, bool, int]:
    """Products before sums, short ones first; of the sums first those that the transfer function has itself."""
    powers = np.array(list(candidate.poly))
    size, terms = int(np.abs(powers).sum()), len(powers)
    return terms, size if terms == 1 else 0, not candidate.is_coefficient, size


# What would close a gap in identifiability: another sensor, a constant that is known, or a relation between two of them.

EASILY_MEASURED = ("mass", "resistance", "inductance")  # roles of constants that a balance or a meter shows


def find_recommendations(
    model: Model, points: Sequence[Sensitivity], measured: Sequence[str], others: Sequence[str], sensors: Sequence[str]
) -> list[Finding]:
    """What would determine more constants, the most effective first.

    ``others``: outputs of the model that are not measured; ``sensors``: states that have no output.
    """
    names = [q.name for q in model.free_parameters]
    present = next(iter(highest_ranks(points, measured).values()))
    if not present.weak.shape[1]:
        return []
    findings = []
    for code, added in ((IdentifiabilityCode.MEASURE_OUTPUT, others), (IdentifiabilityCode.ADD_SENSOR, sensors)):
        ranks = {o: next(iter(highest_ranks(points, [*measured, o]).values())) for o in added}
        best = max((r.rank for r in ranks.values()), default=present.rank)
        if best == present.rank:
            continue
        useful = [o for o in ranks if ranks[o].rank == best]
        then = find_closing_constants(model, names, ranks[useful[0]])
        findings.append(Finding(code, values={"signals": useful, "rank": best, "count": len(names), "then": then}))
    closing = find_closing_constants(model, names, present)
    return [*findings, Finding(IdentifiabilityCode.FIX_CONSTANTS, values=closing)]


# Relations between two constants that a remedy names.
MAX_RELATIONS = 3


def find_closing_constants(model: Model, names: Sequence[str], rank: ScaledDecomposition) -> dict[str, Any]:
    """Which constants to fix, and which relations would do as well; empty where nothing is missing.

    ``missing``: how many; ``constants``: where one is missing those of which any closes the gap, else a set that closes all of
    them; ``relations``: pairs of constants of one dimension, ``equal`` where they have the same value now.
    """
    null, missing = rank.null_basis, rank.weak.shape[1]
    if not missing:
        return {}
    easy = {q.name for q in model.free_parameters if model.roles.get(q.name) in EASILY_MEASURED}
    sets = find_closing_sets(null)
    if missing == 1:
        constants = [names[k] for (k,) in sorted(sets)]
    else:
        sets = sorted(sets, key=lambda s: -len(easy & {names[k] for k in s}))
        constants = [names[k] for k in sets[0]] if sets else []
    relations = find_closing_relations(model, names, null)
    equal = [relation for relation in relations if relation["equal"]]
    return {"missing": missing, "constants": constants, "relations": equal[:MAX_RELATIONS] or relations[:1]}


# Sets of constants to fix that are tried.
MAX_CLOSING_SETS = 5000


def find_closing_sets(null: np.ndarray) -> list[tuple[int, ...]]:
    """Sets of as many constants as there are open directions that, once known, close them all."""
    n, k = null.shape
    sets: list[tuple[int, ...]] = []
    for subset in itertools.islice(itertools.combinations(range(n), k), MAX_CLOSING_SETS):
        if decompose_columns(null[list(subset)], DIRECTION_RANK, np.ones(k)).rank == k:
            sets.append(subset)
    return sets


def find_closing_relations(model: Model, names: Sequence[str], null: np.ndarray) -> list[dict[str, Any]]:
    """Relations such as ``Kf = Kv`` between constants of one dimension that would close a direction, equal ones first."""
    units = {q.name: q.unit for q in model.free_parameters}
    relations = []
    for (j, one), (k, other) in itertools.combinations(enumerate(names), 2):
        unit = parse_unit(units[one])
        if (
            not unit.dimensions
            or unit != parse_unit(units[other])
            or np.abs(null[j] - null[k]).max() < DIRECTION_CUTOFF
        ):
            continue
        equal = bool(np.isclose(model.parameter(one).value, model.parameter(other).value))
        relations.append({"constants": [one, other], "equal": equal})
    return sorted(relations, key=lambda relation: not relation["equal"])
