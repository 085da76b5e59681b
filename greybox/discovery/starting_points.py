"""Where the refit of a candidate starts: what decides success is not the statistics but these points.

The plain model has swallowed the missing effect into its own parameters (dry friction has become damping), so a candidate
starts from the fitted values and from the ones that the user gave; at a small amplitude and at a large one; at every shape
of its grid; and a child effect from its fitted parent as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from greybox.discovery.problem import CandidateFit, StartValues
from greybox.effects import Scales, measure_scales
from greybox.model import Effect, Model


def estimate_scales(candidate: CandidateFit) -> Scales:
    """Peaks and times of a fitted model on its first record."""
    _, states = candidate.problem.shooting(candidate.variables).simulate(candidate.variables.here)[0]
    record = candidate.problem.records[0]
    return measure_scales(candidate.model, states, record.u, float(np.median(record.h)))


def generate_starting_points(
    model: Model, effect: Effect, parent: CandidateFit, plain: Model, scales: Scales, amplitudes: Sequence[float]
) -> Iterator[StartValues]:
    """Start values for ``model``, which is ``parent.model + effect``.

    Parameters
    ----------
    model, effect, parent
        The model with the effect, and the fit of the model without it.
    plain
        The model whose start values are a second origin.
    scales
        Peaks and times of the records.
    amplitudes
        Amplitudes of the effect, in multiples of its probe.
    """
    names = next(b.model_names for b in model.bound_effects if b.effect.name == effect.name)
    nominal = {**parent.model.values, **plain.values}
    origins = [parent.model.values] + ([nominal] if nominal != parent.model.values else [])
    probe = effect.probe(scales) if effect.probe else {}
    for shape, amplitude in product(_shapes(effect, scales), amplitudes if probe else (1.0,)):
        values = {**shape, **{name: value * amplitude for name, value in probe.items()}}
        effect_values = {names[name]: _within_bounds(model, names[name], value) for name, value in values.items()}
        for origin in origins:
            yield {**origin, **effect_values}


def generate_child_starting_points(
    model: Model, child: Effect, parent: CandidateFit, parent_effect: Effect, scales: Scales
) -> Iterator[StartValues]:
    """Start values for ``model``, in which ``child`` replaces its fitted parent effect."""
    if child.from_parent is None:
        return
    parent_names = next(b.model_names for b in parent.model.bound_effects if b.effect.name == parent_effect.name)
    child_names = next(b.model_names for b in model.bound_effects if b.effect.name == child.name)
    fitted = {
        name: parent.model.values[in_model]
        for name, in_model in parent_names.items()
        if in_model in parent.model.values
    }
    kept = {
        name: value
        for name, value in parent.model.values.items()
        if name in model.values and name not in parent_names.values()
    }
    for start in child.from_parent(fitted, scales):
        values = {child_names[name]: _within_bounds(model, child_names[name], value) for name, value in start.items()}
        yield {**kept, **values}


def count_shapes(effect: Effect, scales: Scales) -> int:
    """How many combinations of shape values an effect starts from."""
    return len(_shapes(effect, scales))


def _shapes(effect: Effect, scales: Scales) -> Sequence[Mapping[str, float]]:
    """Every combination of the effect's shape values; one empty one where it has no shape."""
    grid = effect.grid(scales) if effect.grid else {}
    return [dict(zip(grid, values, strict=True)) for values in product(*grid.values())]


def _within_bounds(model: Model, name: str, value: float) -> float:
    low, high = model.parameter(name).bounds
    return min(max(value, low), high)
