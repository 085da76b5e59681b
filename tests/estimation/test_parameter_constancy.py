"""When parameters of parts of the data count as different: as far apart as chance seldom leaves any of those that are compared."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from greybox import Balance, Experiment, FitOptions, Model, Output, Parameter, State
from greybox.data.noise.noise_model import AutoRegression
from greybox.estimation.parameter_constancy import CONSTANCY_FALSE_ALARM_RATE, find_parameter_shifts
from greybox.estimation.sandwich import ResidualColour
from greybox.estimation.transcription.preparation import prepare_problem

ROWS = 100


def shift(count: int, deviations: float) -> list[float]:
    """Deviations of what is found of ``count`` constants of which one is so many deviations apart in the halves of a record.

    Each constant is the mean of an output of its own: a half tells it with the variance 2 / N.
    """
    names = [f"c{k}" for k in range(count)]
    model = Model(
        "means",
        [State(name, "m", 1.0) for name in names],
        [],
        [Output(name, "m") for name in names],
        [Parameter(f"r_{name}", "m/s", 10.0, (-1e3, 1e3)) for name in names],
        lambda x, u, p: [Balance(name, "m/s", 1, name, rate=p[f"r_{name}"]) for name in names],
    )
    record = Experiment("r", np.arange(float(ROWS)), {}, {name: np.ones(ROWS) for name in names})
    options = FitOptions(at_rest=True)
    variables = prepare_problem(model, record, dict.fromkeys(names, 1.0), options).variables
    residuals, slopes = np.zeros((ROWS, count)), np.zeros((ROWS, count, count))
    residuals[:, 0] = np.repeat([0.5, -0.5], ROWS // 2) * deviations * np.sqrt(2 * 2 / ROWS)
    slopes[:, range(count), range(count)] = 1.0
    colour = ResidualColour((AutoRegression(),) * count, (1.0,) * count, (ROWS,) * count)
    found = find_parameter_shifts(variables, [(residuals, slopes)], colour, [np.ones((ROWS, count))], ["r"])
    return [one.deviations for one in found]


@pytest.mark.parametrize("count", [1, 12])
def test_three_deviations_or_as_many_as_chance_seldom_leaves_among_all_comparisons(count):
    # Of one comparison chance leaves 2.58 deviations in one of a hundred fits, of 12 of them 3.34.
    least = max(3.0, norm.isf(CONSTANCY_FALSE_ALARM_RATE / count / 2))
    assert shift(count, least - 0.1) == []
    assert shift(count, least + 0.1) == [pytest.approx(least + 0.1)]
