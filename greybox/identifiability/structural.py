"""`analyse_structural_identifiability`: what a model's outputs could tell at best, whatever the record, before anything is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from greybox.errors import ModelError, nearest
from greybox.identifiability.determined_combinations import find_determined_combinations, free_parameter_indices
from greybox.identifiability.free_run_sensitivity import compute_free_run_sensitivities
from greybox.identifiability.generic_experiment import draw_constants
from greybox.identifiability.open_directions import OpenDirection, find_open_directions
from greybox.identifiability.recommendations import find_recommendations
from greybox.identifiability.sensitivity import Sensitivity, SensitivityRank, highest_ranks
from greybox.identifiability.transfer_function_sensitivity import compute_transfer_function_sensitivity
from greybox.model import Model
from greybox.model.signals import Output

POINTS = 3


@dataclass(frozen=True)
class StructuralIdentifiability:
    """What rich data on ``outputs`` determine of the free constants of a model, near generic values of these.

    ``rank``: how many combinations are determined, of ``count`` free constants; equal numbers mean that each is (locally:
    there may be a second solution far off). ``directions``: what stays open, one `OpenDirection` each. ``determined``:
    independent combinations that are determined, as formulas (all of the rank where the model is linear and not too large).
    ``remedies``: sentences on what would close the gap. ``gap``: ratio of the singular values on both sides of the rank;
    ``certain`` is false where no clear gap was found, and the rank may then be too low.
    """

    model: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    constants: tuple[str, ...]
    at_rest: bool
    rank: int
    count: int
    directions: tuple[OpenDirection, ...]
    determined: tuple[str, ...]
    remedies: tuple[str, ...]
    gap: float
    certain: bool
    method: str

    @property
    def complete(self) -> bool:
        """Whether every free constant is determined."""
        return self.rank == self.count

    @property
    def verdict(self) -> str:
        """The finding in one sentence."""
        where = (
            f"from {', '.join(self.inputs)} to {', '.join(self.outputs)}"
            if self.inputs
            else f"from {', '.join(self.outputs)}"
        )
        if not self.count:
            return "no constant is free: nothing to determine"
        doubt = "" if self.certain else "; the numbers show no clear gap, so this cannot be told for sure"
        if self.complete:
            return f"{where} all {self.count} free constants can be determined{doubt}"
        said = f"{self.rank} combination{'s' * (self.rank != 1)} of the {self.count} free constants can be determined"
        missing = self.count - self.rank
        return f"{where} {said}, {missing} direction{'s' * (missing != 1)} stay{'s' * (missing == 1)} open{doubt}"

    def __str__(self) -> str:
        lines = [self.verdict]
        if not self.complete:
            missing = self.rank - len(self.determined)
            more = [f"{missing} more that {'is' if missing == 1 else 'are'} no such formula"] if missing else []
            lines += [f"  determined  {', '.join([*self.determined, *more])}"] if self.rank else []
            lines += [f"  open        {direction}{_seen(direction)}" for direction in self.directions]
            lines += [f"  remedy      {remedy}" for remedy in self.remedies]
        return "\n".join(lines)


def analyse_structural_identifiability(
    model: Model, outputs: Sequence[str] | None = None, seed: int = 0, *, at_rest: bool = False
) -> StructuralIdentifiability:
    """Structural identifiability of the free constants of ``model`` from its inputs and the measured ``outputs``.

    ``outputs``: names of those that are measured, None for all. ``at_rest``: the record begins in the declared state,
    otherwise in an unknown one. ``seed`` chooses the random points.

    The rank is that of the slopes of the outputs along the logarithms of the constants and the initial states, at three
    random points: of the transfer functions and free responses for a linear model, of free runs with a random input for
    any other (square roots, sines, friction ...). What it says holds for almost all values of the constants, not for
    special ones, and for a rich input: see `analyse_practical_identifiability` for a given record.

    Raises ModelError for an unknown output, DataError for a nonlinear model that overflows at every point.
    """
    known = [o.name for o in model.outputs]
    strange = [name for name in outputs or () if name not in known]
    if strange:
        raise ModelError(f"model {model.title!r} has no output {strange[0]!r}; {nearest(strange[0], known)}")
    if outputs is not None and not outputs:
        raise ModelError(f"model {model.title!r}: no output is measured; name at least one of {', '.join(known)}")
    measured = [name for name in known if outputs is None or name in outputs]
    names = tuple(q.name for q in model.free_parameters)
    common = model.title, tuple(i.name for i in model.inputs), tuple(measured), names, at_rest
    if not names:
        return StructuralIdentifiability(*common, 0, 0, (), (), (), np.inf, True, "")
    sensors = find_unmeasured_states(model)
    points, at, method = _points(add_sensors(model, sensors), seed, at_rest)
    ranks = highest_ranks(points, measured)
    where = [at[r.point] for r in ranks]
    others = [name for name in known if name not in measured]
    open_ = find_open_directions(ranks, names)
    return StructuralIdentifiability(
        *common, ranks[0].rank, len(names),
        tuple(replace(d, seen_by=_seen_by(d, names, points, measured, others)) for d in open_),
        tuple(c.text for c in find_determined_combinations(model, ranks, where)) if open_ else names,
        tuple(find_recommendations(model, points, measured, others, sensors)),
        min(r.gap for r in ranks), ranks[0].certain, method,
    )  # fmt: skip


def find_unmeasured_states(model: Model) -> list[str]:
    """States of the plant that are not an output: where another sensor could sit."""
    taken = {i.name for i in model.inputs} | {o.name for o in model.outputs}
    system = model.system
    read = [
        k for k in range(len(model.states)) if any(ca.is_equal(y, system.x[k]) for y in ca.vertsplit(system.outputs))
    ]
    return [s.name for k, s in enumerate(model.states) if s.name not in taken and k not in read]


def add_sensors(model: Model, states: Sequence[str]) -> Model:
    """``model`` with an output for each of these states."""
    if not states:
        return model
    units = {s.name: s.unit for s in model.states}
    return replace(model, outputs=[*model.outputs, *(Output(name, units[name]) for name in states)])


def _points(model: Model, seed: int, at_rest: bool) -> tuple[list[Sensitivity], list[np.ndarray], str]:
    """Sensitivities at random points, the constants there, and how they were computed."""
    if not model.system.linear:
        found = compute_free_run_sensitivities(model, at_rest, seed, POINTS)
        return [s for s, _ in found], [p for _, p in found], "free runs with a random input"
    which = free_parameter_indices(model)
    points, at = [], []
    for k in range(POINTS):
        generator = np.random.default_rng((seed, k))
        p = draw_constants(model, generator)
        points.append(compute_transfer_function_sensitivity(model.system, p, which, p[which], at_rest, generator))
        at.append(p)
    return points, at, "transfer functions and free responses"


def _seen_by(
    direction: OpenDirection,
    names: Sequence[str],
    points: Sequence[Sensitivity],
    measured: Sequence[str],
    others: Sequence[str],
) -> tuple[str, ...]:
    """The outputs that would show a change along the direction."""
    v = np.array([direction.weights.get(name, 0.0) for name in names])
    return tuple(o for o in others if _shown(v, highest_ranks(points, [*measured, o])[0]))


def _shown(v: np.ndarray, rank: SensitivityRank) -> bool:
    left = v - rank.null @ (rank.null.T @ v)
    return bool(np.linalg.norm(left) > 1e-6 * np.linalg.norm(v))


def _seen(direction: OpenDirection) -> str:
    """What would close one direction."""
    if len(direction.names) == 1:
        return f": fix it{_measure(direction)}"
    return f": fix one of them{_measure(direction)}"


def _measure(direction: OpenDirection) -> str:
    return f", or measure {' or '.join(direction.seen_by)}" if direction.seen_by else ""
