"""What would close a gap in identifiability: another sensor, a constant that is known, or a relation between two of them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.findings import Finding
from greybox.identifiability.findings import IdentifiabilityCode
from greybox.identifiability.policy import IDENTIFIABILITY_POLICY, IdentifiabilityPolicy
from greybox.identifiability.sensitivity import Sensitivity, SensitivityRank, highest_ranks
from greybox.linear_algebra import DIRECTION_RANK, decompose_columns
from greybox.model import Model
from greybox.numerics import DIRECTION_CUTOFF
from greybox.units import parse_unit

EASILY_MEASURED = ("mass", "resistance", "inductance")  # roles of constants that a balance or a meter shows


def find_recommendations(
    model: Model,
    points: Sequence[Sensitivity],
    measured: Sequence[str],
    others: Sequence[str],
    sensors: Sequence[str],
    policy: IdentifiabilityPolicy = IDENTIFIABILITY_POLICY,
) -> list[Finding]:
    """What would determine more constants, the most effective first.

    ``others``: outputs of the model that are not measured; ``sensors``: states that have no output.
    """
    names = [q.name for q in model.free_parameters]
    present = highest_ranks(points, measured)[0]
    if not present.null.shape[1]:
        return []
    findings = []
    for code, added in ((IdentifiabilityCode.MEASURE_OUTPUT, others), (IdentifiabilityCode.ADD_SENSOR, sensors)):
        ranks = {o: highest_ranks(points, [*measured, o])[0] for o in added}
        best = max((r.rank for r in ranks.values()), default=present.rank)
        if best == present.rank:
            continue
        useful = [o for o in ranks if ranks[o].rank == best]
        then = find_closing_constants(model, names, ranks[useful[0]], policy)
        findings.append(Finding(code, values={"signals": useful, "rank": best, "count": len(names), "then": then}))
    closing = find_closing_constants(model, names, present, policy)
    return [*findings, Finding(IdentifiabilityCode.FIX_CONSTANTS, values=closing)]


def find_closing_constants(
    model: Model, names: Sequence[str], rank: SensitivityRank, policy: IdentifiabilityPolicy = IDENTIFIABILITY_POLICY
) -> dict[str, Any]:
    """Which constants to fix, and which relations would do as well; empty where nothing is missing.

    ``missing``: how many; ``constants``: where one is missing those of which any closes the gap, else a set that closes all of
    them; ``relations``: pairs of constants of one dimension, ``equal`` where they have the same value now.
    """
    missing = rank.null.shape[1]
    if not missing:
        return {}
    easy = {q.name for q in model.free_parameters if q.role in EASILY_MEASURED}
    sets = find_closing_sets(rank.null, policy)
    if missing == 1:
        constants = [names[k] for (k,) in sorted(sets)]
    else:
        sets = sorted(sets, key=lambda s: -len(easy & {names[k] for k in s}))
        constants = [names[k] for k in sets[0]] if sets else []
    relations = find_closing_relations(model, names, rank.null)
    equal = [relation for relation in relations if relation["equal"]]
    return {"missing": missing, "constants": constants, "relations": equal[: policy.max_relations] or relations[:1]}


def find_closing_sets(
    null: np.ndarray, policy: IdentifiabilityPolicy = IDENTIFIABILITY_POLICY
) -> list[tuple[int, ...]]:
    """Sets of as many constants as there are open directions that, once known, close them all."""
    n, k = null.shape
    sets: list[tuple[int, ...]] = []
    for subset in itertools.islice(itertools.combinations(range(n), k), policy.max_closing_sets):
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
