"""An input is improved with its limits exact: the cost has the gradient that it says, and what comes out keeps what it may use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import greybox as gb
from greybox.data.signals import SignalLimit
from greybox.extensions.design.goals import make_precision
from greybox.extensions.design.inputs import LimitKeeper, Multisine, fit_into_limits, play
from greybox.extensions.design.plant import list_plants
from greybox.extensions.design.problem import DesignPolicy, DesignProblem
from greybox.extensions.design.refinement import InputRefinement, refine
from tests.support.oscillator import oscillator

POLICY = DesignPolicy()
PLANT = oscillator("rig", 1.0, 25.0, 500.0, 1.0)
LIMITS = {"u": SignalLimit(-2, 2, rate=20.0), "x": SignalLimit(-0.1, 0.15), "v": SignalLimit(-1, 1)}


def question(hold: str = "zero", **shares: float) -> DesignProblem:
    policy = replace(POLICY, iterations=40, refined_scenarios=2)
    rest = gb.FitOptions(at_rest=True)
    return DesignProblem(
        (PLANT,), LIMITS, 8.0, 0.05, {"x": 1e-3}, options=rest, policy=policy, shares=shares, hold=hold
    )


def keeper_of(asked: DesignProblem) -> LimitKeeper:
    return LimitKeeper(asked, *list_plants(asked))


@pytest.mark.parametrize("hold", ["zero", "first"])
def test_the_cost_has_the_gradient_of_its_differences_before_and_after_a_round(hold: str) -> None:
    asked = question(hold, x=0.7, u=0.9)
    plants, draws = list_plants(asked)
    program = InputRefinement(asked, make_precision(asked, 2), [(plants[0], *draws[0])], 1.0)
    levels = np.random.default_rng(3).uniform(-1, 1, asked.rows)
    for _ in range(2):
        _, gradient = program(levels)
        for k in (9, 41, asked.rows - 30):
            step = 1e-5 * (np.arange(asked.rows) == k)
            slope = (program(levels + step)[0] - program(levels - step)[0]) / 2e-5
            assert gradient[k] == pytest.approx(slope, rel=1e-4, abs=1e-6)
        program.end_round(levels[None], 1.0)
    assert {key[0] for key in program.multipliers} == {"rate", 0}


def test_the_last_round_keeps_the_share_of_each_limit_without_being_scaled_down() -> None:
    asked = question(x=0.8, u=0.5)
    keeper = keeper_of(asked)
    shape = {"u": Multisine((0.5, 1.5, 3.0), (1.0, 1.0, 1.0), (0.0, 1.0, 2.0))}
    _, inputs, _ = fit_into_limits(keeper, shape)
    goal = make_precision(asked, 4)

    def value(u: dict[str, np.ndarray]) -> float:
        return goal.value([plant.run(u) for plant in goal.plants])

    last = refine(asked, keeper, lambda draws, step: make_precision(asked, draws, step), shape, inputs)[-1]
    played = play(asked, last, 1.0)
    load, _ = keeper.load(keeper.predict(played))
    assert 0.9 < load < 1.05
    assert np.abs(played["u"]).max() <= 0.5 * 2 * (1 + 1e-9)
    assert value(fit_into_limits(keeper, last)[1]) > value(inputs) + 0.1
