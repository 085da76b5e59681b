"""A search over runs of a plant ends where noise hides what is left, whatever the number of rows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import curve_fit

from greybox import FitOptions, Output, Parameter
from greybox.data.experiment import Experiment
from greybox.estimation.transcription.plant_search import solve_plant
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.simulation.plant import as_model

TIME, NOISE = np.linspace(0.0, 10.0, 5000), 0.05


class Decay:
    """``y = exp(-k t)``: a program, as far as the search knows."""

    name = "decay"
    inputs = ()
    outputs = (Output("y", "1"),)

    def __init__(self, k):
        self.parameters = (Parameter("k", "1/s", k, (1e-3, 1e3)),)

    def simulate(self, record, values):
        return {"y": np.exp(-values["k"] * record.time)}


@pytest.mark.parametrize("off", [0.3, -0.5])
def test_a_start_within_a_deviation_of_the_optimum_is_not_taken_for_it(off):
    y = np.exp(-0.4 * TIME) + NOISE * np.random.default_rng(2).normal(size=len(TIME))
    (best,), ((variance,),) = curve_fit(lambda t, k: np.exp(-k * t), TIME, y, 0.4)
    deviation = np.sqrt(variance)
    record = Experiment("decay", TIME, {}, {"y": y})
    options = FitOptions(progressive=False)
    problem = prepare_problem(as_model(Decay(best + off * deviation)), record, {"y": NOISE}, options)
    found = solve_plant(problem, options)
    assert found.status.success
    # What is left to gain is a ten thousandth of the noise's variance: a hundredth of a deviation.
    assert found.variables.base[0] == pytest.approx(best, abs=0.02 * deviation)
