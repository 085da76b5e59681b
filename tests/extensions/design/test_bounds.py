"""No input passes the bound of the study, and the bound comes close where the best input is known."""

from __future__ import annotations

import numpy as np

import greybox as gb
from fits.studies.design_bounds import bound_precision
from greybox.data.signals import SignalLimit
from greybox.extensions.design.goals import make_precision
from greybox.extensions.design.plant import make_plant
from greybox.extensions.design.problem import DesignProblem
from tests.support.first_order import first_order


def test_no_input_passes_the_bound_and_the_designed_one_comes_near() -> None:
    limits = {"u": SignalLimit(-1, 1), "y": SignalLimit(-5, 5)}
    model = first_order(2.0, 0.5)
    asked = DesignProblem((model,), limits, 8.0, 0.1, {"y": 0.01}, options=gb.FitOptions(at_rest=True))
    plant, goal = make_plant(asked, model), make_precision(asked, 0)
    bound = bound_precision(asked, plant)
    generator = np.random.default_rng(1)
    for hold in (1, 4, 8):
        u = np.repeat(generator.choice([-1.0, 1.0], 80 // hold), hold)
        assert goal.value([plant.run({"u": u})]) < bound
    wave = np.sign(np.sin(2 * np.pi * np.arange(80) * 0.1 / 3.5))  # about 1 / (sqrt(3) lag) rad/s
    assert goal.value([plant.run({"u": wave})]) > bound - 0.35
    tight = DesignProblem(
        (model,), limits | {"y": SignalLimit(-0.5, 0.5)}, 8.0, 0.1, {"y": 0.01}, options=asked.options
    )
    assert bound_precision(tight, plant) < bound - 0.5
