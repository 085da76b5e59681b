"""Which further effects are worth a refit: those whose predicted cost is lowest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from greybox.discovery.failures import SearchStage
from greybox.discovery.policy import SearchBudget
from greybox.discovery.problem import CandidateFit, DiscoveryProblem, StartValues
from greybox.discovery.starting_points import generate_starting_points
from greybox.effects import Scales
from greybox.model import Effect


def rank_extensions(
    problem: DiscoveryProblem,
    selected: CandidateFit,
    effects: Sequence[Effect],
    scales: Scales,
    budget: SearchBudget,
    most: int,
) -> list[Effect]:
    """The ``most`` effects whose addition to ``selected`` predicts the lowest cost, best first; none that cannot be simulated.

    All are predicted nearly absent, the better ones from the usual amplitudes too.
    """
    predicted = {
        e.name: predict_extension(problem, selected, e, scales, (budget.near_zero_amplitude,)) for e in effects
    }
    possible = sorted((e for e in effects if np.isfinite(predicted[e.name])), key=lambda e: predicted[e.name])
    for e in possible[: 2 * most]:
        larger = predict_extension(problem, selected, e, scales, budget.amplitude_grid)
        predicted[e.name] = min(predicted[e.name], larger)
    return sorted(possible, key=lambda e: predicted[e.name])[:most]


def predict_extension(
    problem: DiscoveryProblem, selected: CandidateFit, effect: Effect, scales: Scales, amplitudes: Sequence[float]
) -> float:
    """The lowest cost that one step predicts for ``selected`` with one effect more, from these amplitudes of it."""

    def predict() -> float:
        model = selected.model + effect
        starts = generate_starting_points(model, effect, selected, selected.model, scales, amplitudes)
        return problem.predict_cost(model, starts, selected)

    return problem.failures.attempt(SearchStage.SCREENING, (*selected.effects, effect.name), predict, np.inf)


def list_extension_starts(
    selected: CandidateFit, effect: Effect, scales: Scales, budget: SearchBudget
) -> list[StartValues]:
    """Where the refit with a further effect starts: with nothing of it, and at the usual amplitudes and shapes."""
    model = selected.model + effect
    amplitudes = budget.amplitude_grid
    return [model.values, *generate_starting_points(model, effect, selected, selected.model, scales, amplitudes)]
