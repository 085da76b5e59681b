"""Detection: the record that would show the smallest amount of each effect that could still hide.

Each effect is put into the model nearly absent. The standard deviation of its amplitude, all other constants free, times a detection
ratio is the smallest amount that would be seen. The value is minus the mean logarithm of these amounts, over the effects and over
what is not known of the constants.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.effects import Scales, applicable_effects, effect, measure_scales, tailor_to_record
from greybox.errors import DataError, GreyboxError, ModelError
from greybox.experiment_design.goals import Run, Slopes, add_earlier, information_of
from greybox.experiment_design.plant import PlantScenario, draw_plants, make_plant
from greybox.experiment_design.problem import DesignProblem
from greybox.model import Effect, Model
from greybox.numerics import TINY


@dataclass(frozen=True)
class HiddenEffect:
    """An effect that may hide: the model with a little of it, and the amplitude that tells how much."""

    name: str
    model: Model
    amplitude: str
    unit: str


@dataclass(frozen=True, eq=False)
class Detection:
    """The goal of showing small amounts of effects.

    Parameters
    ----------
    plants
        For each effect the model with a little of it, at several sets of constants.
    positions
        For each plant the position of the amplitude among its constants.
    prior_spread
        What is known of constants without data.
    least_prior
        Share of that information that the amplitude has: an effect that no record shows has a large amount, not an infinite one.
    ratio
        Standard deviations of an amplitude that are seen.
    """

    plants: Sequence[PlantScenario]
    positions: Sequence[int]
    prior_spread: float
    least_prior: float
    ratio: float

    def value(self, runs: Sequence[Run], scale: float = 1.0) -> float:
        """Minus the mean logarithm of the standard deviations of the amplitudes."""
        if not all(run.finite for run in runs):
            return -np.inf
        stds = [self.amplitude_std(k, run, scale) for k, run in enumerate(runs)]
        return float(-np.mean(np.log(np.maximum(stds, TINY))))

    def amplitude_std(self, number: int, run: Run | None, scale: float = 1.0) -> float:
        """Scaled standard deviation of the amplitude of plant ``number`` after ``run``; None: from the earlier records alone."""
        plant, k = self.plants[number], self.positions[number]
        information = np.zeros((plant.count, plant.count)) if run is None else information_of(run, scale)
        return float(np.sqrt(np.linalg.inv(self._total(plant, information, k))[k, k]))

    def slopes(self, runs: Sequence[Run], scale: float = 1.0) -> list[Slopes]:
        """Slopes along each run."""
        result = []
        for plant, run, k in zip(self.plants, runs, self.positions, strict=True):
            column = np.linalg.inv(self._total(plant, information_of(run, scale), k))[:, k]
            along = 0.5 * np.outer(column, column) / max(column[k], TINY) / len(self.plants)
            result.append((np.zeros(run.outputs.shape), 2 * scale * (np.nan_to_num(run.slopes) @ along)))
        return result

    def _total(self, plant: PlantScenario, information: np.ndarray, k: int) -> np.ndarray:
        """Information with what is known before; of the amplitude itself nothing is."""
        total = add_earlier(plant, information, self.prior_spread)
        total[k, k] -= (1 - self.least_prior) / self.prior_spread**2
        return total


def list_hidden_effects(
    question: DesignProblem, reference: PlantScenario, inputs: Mapping[str, np.ndarray]
) -> list[HiddenEffect]:
    """The effects that may hide in the model, made ready by the size of things in a run over ``inputs``.

    Raises
    ------
    DataError, ModelError
        For an effect that has no place in the model, and where none has one.
    """
    _, states = reference.simulate(inputs)
    u = np.column_stack([inputs[i.name] for i in question.model.inputs])
    scales = measure_scales(question.model, states, u, question.sampling_time)
    named = list(question.effects)
    entries = [effect(name) for name in named] if named else applicable_effects(question.model)
    hidden, refused = [], {}
    for entry in entries:
        try:
            ready = _nearly_absent(question.model, tailor_to_record(entry, scales), scales, question)
        except GreyboxError as error:
            refused[entry.name] = str(error)
            continue
        if ready is not None:
            hidden.append(ready)
    if named and refused:
        raise ModelError(next(iter(refused.values())))
    if not hidden:
        raise DataError(
            f"{question.model.title}: no effect of the catalogue has a place in it; give roles to its signals, or name effects"
        )
    return hidden


def _nearly_absent(model: Model, entry: Effect, scales: Scales, question: DesignProblem) -> HiddenEffect | None:
    """``model`` with a little of an effect; None where it is present already or its amount is no number of its own."""
    if entry.name in {e.name for e in model.effects}:
        return None
    extended = model + entry
    bound = extended.bound_effects[-1]
    probe = entry.probe(scales) if entry.probe else {}
    grid = entry.grid(scales) if entry.grid else {}
    values = {bound.model_names[n]: v[len(v) // 2] for n, v in grid.items()}
    values |= {bound.model_names[n]: question.policy.goal.detection_probe * v for n, v in probe.items()}
    for name, value in values.items():
        low, high = extended.parameter(name).bounds
        extended = extended.start(**{name: min(max(value, low), high)})
    amplitudes = [bound.model_names[n] for n in entry.amplitudes]
    free = [q.name for q in extended.free_parameters]
    shown = [n for n in amplitudes if n in free]
    if not shown:
        return None
    return HiddenEffect(entry.name, extended, shown[0], extended.parameter(shown[0]).unit)


def make_detection(
    question: DesignProblem, hidden: Sequence[HiddenEffect], draws: int, step: float | None = None
) -> Detection:
    """The goal of ``question`` with so many ``draws`` of the constants of each model."""
    goal = question.policy.goal
    plants: list[PlantScenario] = []
    positions: list[int] = []
    for k, each in enumerate(hidden):
        plant = make_plant(replace(question, models=(each.model,), constants=()), each.model, k, step)
        position = plant.variables.names.index(each.amplitude)
        # Of the amount nothing is known; it stays small in every draw.
        held = plant.earlier.copy()
        held[position, position] += goal.held_amplitude
        drawn = draw_plants(replace(plant, earlier=held), question, draws)
        plants += [plant, *(replace(p, earlier=plant.earlier) for p in drawn)]
        positions += [position] * (1 + len(drawn))
    return Detection(plants, positions, goal.prior_spread, goal.least_prior, goal.detection_ratio)
