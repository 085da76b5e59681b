"""Where a search for the constants of an effect begins: what decides its success is not the statistics but these points.

Amplitudes of the catalogue are neutral: an effect just added changes nothing, and there the cost of many has no slope (a dry friction of
zero, a dead zone of no width). So a search begins at a small amplitude and at a large one, and at every shape of the effect's grid.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

from greybox.model.effect import Effect
from greybox.model.effects.scales import Scales
from greybox.model.model import Model

# Amplitudes at which a refit starts, in multiples of the effect's probe (about a hundredth of the balance it enters).
AMPLITUDE_GRID: tuple[float, ...] = (1.0, 10.0)
# Starting points that are searched from, the most promising first ...
FEW_SHAPES_STARTS = 2
# ... of an effect with so many shapes more of them, as its cost has many minima ...
FEW_SHAPES = 4
MANY_SHAPES_STARTS = 5
# ... and above so many all of them: a step from afar predicts nothing for a sharp resonance.
MANY_SHAPES = 15


def list_effect_values(
    model: Model, effect: Effect, scales: Scales, amplitudes: Sequence[float] = AMPLITUDE_GRID
) -> Iterator[dict[str, float]]:
    """Values of the constants of one effect of ``model`` at which a search for them begins.

    Parameters
    ----------
    model
        The model with the effect.
    effect
        The effect.
    scales
        Peaks and times of the records, for the model without it.
    amplitudes
        In multiples of the effect's probe.

    Yields
    ------
    dict
        Constant, by its name in the model -> value in its unit, within its bounds.
    """
    names = model.names_of(effect.name)
    probe = effect.probe(scales) if effect.probe else {}
    for shape, amplitude in product(list_shapes(effect, scales), amplitudes if probe else (1.0,)):
        values = {**shape, **{name: value * amplitude for name, value in probe.items()}}
        yield {names[name]: within_bounds(model, names[name], value) for name, value in values.items()}


def list_shapes(effect: Effect, scales: Scales) -> Sequence[Mapping[str, float]]:
    """Every combination of the effect's shape values; one empty one where it has no shape."""
    grid = effect.grid(scales) if effect.grid else {}
    return [dict(zip(grid, values, strict=True)) for values in product(*grid.values())]


def count_shapes(effect: Effect, scales: Scales) -> int:
    """How many combinations of shape values an effect starts from."""
    return len(list_shapes(effect, scales))


def count_starts(effect: Effect, scales: Scales) -> int:
    """From how many of its starting points, the most promising first, a fit with an effect is searched."""
    shapes = count_shapes(effect, scales)
    if shapes > MANY_SHAPES:
        return shapes
    return MANY_SHAPES_STARTS if shapes >= FEW_SHAPES else FEW_SHAPES_STARTS


def within_bounds(model: Model, name: str, value: float) -> float:
    """``value`` of a constant, or the bound that it exceeds."""
    low, high = model.parameter(name).bounds
    return min(max(value, low), high)


def is_neutral(model: Model, effect: Effect) -> bool:
    """Whether an effect that a fit may change changes nothing as it stands: its amplitudes are zero, or at their neutral values.

    An effect that replaces a law has no neutral value; it begins where it stands.
    """
    names = model.names_of(effect.name)
    values, free = model.values, {q.name for q in model.free_parameters}
    amplitudes = [name for name in effect.amplitudes if names[name] in values]
    absent = all(values[names[name]] == effect.neutral.get(name, 0.0) for name in amplitudes)
    return bool(amplitudes) and absent and any(names[name] in free for name in amplitudes)
