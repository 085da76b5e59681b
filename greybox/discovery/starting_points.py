"""Where the refit of a candidate begins: what decides success is not the statistics but these points.

The plain model has swallowed the missing effect into its own constants (dry friction has become damping), so a candidate
starts from the fitted constants and from the ones the user came with; at a small amplitude and at a large one; at every shape
of its grid; and a child effect from its fitted parent as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

from greybox.discovery.problem import CandidateFit, StartValues
from greybox.effects import Scales
from greybox.model import Effect, Model

# Amplitudes tried, as multiples of the effect's probe (which is about a hundredth of the balance it enters).
LADDER = (1.0, 10.0)


def generate_starting_points(
    model: Model, effect: Effect, parent: CandidateFit, plain: Model, scales: Scales, ladder: Sequence[float] = LADDER
) -> Iterator[StartValues]:
    """Start values for ``model``, which is ``parent.model + effect``: constants, amplitude (on a ``ladder``) and shape."""
    names = next(b.model_names for b in model.bound_effects if b.effect.name == effect.name)
    nominal = {**parent.model.values, **plain.values}
    origins = [parent.model.values] + ([nominal] if nominal != parent.model.values else [])
    sizes = _probe(effect, scales)
    for shape, rung in product(_shapes(effect, scales), ladder if sizes else (1.0,)):
        probe = {name: value * rung for name, value in sizes.items()}
        own = {names[name]: _inside(model, names[name], value) for name, value in {**shape, **probe}.items()}
        for origin in origins:
            yield {**origin, **own}


def generate_child_starting_points(
    model: Model, child: Effect, parent: CandidateFit, parent_effect: Effect, scales: Scales
) -> Iterator[StartValues]:
    """Start values for ``model``, in which ``child`` stands in the place of its fitted parent effect."""
    if child.from_parent is None:
        return
    fitted = next(b.model_names for b in parent.model.bound_effects if b.effect.name == parent_effect.name)
    own = next(b.model_names for b in model.bound_effects if b.effect.name == child.name)
    values = {name: parent.model.values[there] for name, there in fitted.items() if there in parent.model.values}
    kept = {
        name: value
        for name, value in parent.model.values.items()
        if name in model.values and name not in fitted.values()
    }
    for start in child.from_parent(values, scales):
        yield {**kept, **{own[name]: _inside(model, own[name], value) for name, value in start.items()}}


def count_shapes(effect: Effect, scales: Scales) -> int:
    """How many combinations of shape values an effect is begun with."""
    return len(_shapes(effect, scales))


def _shapes(effect: Effect, scales: Scales) -> Sequence[Mapping[str, float]]:
    """Every combination of the effect's shape values; one empty one where it has no shape."""
    grid = effect.grid(scales) if effect.grid else {}
    return [dict(zip(grid, values, strict=True)) for values in product(*grid.values())]


def _probe(effect: Effect, scales: Scales) -> Mapping[str, float]:
    return effect.probe(scales) if effect.probe else {}


def _inside(model: Model, name: str, value: float) -> float:
    low, high = model.parameter(name).bounds
    return min(max(value, low), high)
