"""What would close the gap: another sensor, a constant that is known, or a relation between two of them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from greybox.identifiability.sensitivity import Sensitivity, SensitivityRank, highest_ranks
from greybox.model import Model
from greybox.units import parse_unit

MOST_SETS = 5000  # of constants to fix that are tried
MOST_NAMED = 3
EASY = ("mass", "resistance", "inductance")  # what a balance or a meter shows


def find_recommendations(
    model: Model, points: Sequence[Sensitivity], measured: Sequence[str], others: Sequence[str], sensors: Sequence[str]
) -> list[str]:
    """Sentences, the most telling first. ``others``: outputs of the model that are not measured; ``sensors``: states
    that have no output."""
    names = [q.name for q in model.free_parameters]
    now = highest_ranks(points, measured)[0]
    if not now.null.shape[1]:
        return []
    found = []
    for added in (others, sensors):
        gains = {o: highest_ranks(points, [*measured, o])[0] for o in added}
        best_gain = max((r.rank for r in gains.values()), default=now.rank)
        if best_gain == now.rank:
            continue
        useful = [o for o in gains if gains[o].rank == best_gain]
        which = f"measure {_or(useful)} as well" if added is others else f"add a sensor for {_or(useful)}"
        rest = describe_closing_constants(model, names, gains[useful[0]])
        left = f"; then {rest}" if rest else ""
        found.append(f"{which}: {best_gain} of {len(names)} determined{left}")
    return [*found, describe_closing_constants(model, names, now)]


def describe_closing_constants(model: Model, names: Sequence[str], now: SensitivityRank) -> str:
    """Which constants to fix, and which relation would do as well; "" where nothing is missing."""
    missing = now.null.shape[1]
    if not missing:
        return ""
    easy = {q.name for q in model.free_parameters if q.role in EASY}
    sets = sorted(find_closing_sets(now.null), key=lambda s: -len(easy & {names[k] for k in s}))
    if missing == 1:
        sets = sorted(sets)
        text = f"fix one of {', '.join(names[k] for (k,) in sets)}" if len(sets) > 1 else f"fix {names[sets[0][0]]}"
    else:
        text = (
            f"fix {missing} constants, such as {_list([names[k] for k in sets[0]])}"
            if sets
            else f"fix {missing} constants"
        )
    tied = find_closing_relations(model, names, now.null)
    tied = [relation for relation in tied if "given" not in relation][:MOST_NAMED] or tied[:1]
    if not tied:
        return text
    does = "does as well" if missing == 1 else "would close one of the gaps"
    return f"{text}; knowing that {' or '.join(tied)} {does}"


def find_closing_sets(null: np.ndarray) -> list[tuple[int, ...]]:
    """Sets of as many constants as there are open directions that, once known, close them all."""
    n, k = null.shape
    found: list[tuple[int, ...]] = []
    for subset in itertools.islice(itertools.combinations(range(n), k), MOST_SETS):
        least = np.linalg.svd(null[list(subset)], compute_uv=False)[-1]
        if least > 1e-6:
            found.append(subset)
    return found


def find_closing_relations(model: Model, names: Sequence[str], null: np.ndarray) -> list[str]:
    """Relations ``Kf = Kv`` between constants of one dimension that would close a direction."""
    units = {q.name: q.unit for q in model.free_parameters}
    found = []
    for (j, one), (k, other) in itertools.combinations(enumerate(names), 2):
        unit = parse_unit(units[one])
        if not unit.dimensions or unit != parse_unit(units[other]) or np.abs(null[j] - null[k]).max() < 1e-6:
            continue
        equal = np.isclose(model.parameter(one).value, model.parameter(other).value)
        found.append(f"{one} = {other}" if equal else f"{one}/{other} is a given number")
    return sorted(found, key=lambda text: "given" in text)


def _or(names: Sequence[str]) -> str:
    return " or ".join(names)


def _list(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]
