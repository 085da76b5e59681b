"""The noise model and the solution agree with one another at the end of the loop."""

from dataclasses import replace

import numpy as np
import pytest

from greybox import FitOptions
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import NoiseSource
from greybox.estimation.noise_loop import estimate_by_simulation_error, update_noise
from greybox.estimation.options import prepare_estimation
from greybox.estimation.policy import EstimationPolicy, NoiseLoopPolicy
from tests.estimation.test_robust_estimation import LEVEL, TRUTH, record, spoiled
from tests.support.published_plants import REST, SATURATION, TIMES, VALUES


def few_samples():
    """Six samples show their noise in nothing but the residual."""
    data = Experiment("published", np.append(0.0, TIMES), {}, {"y": np.append(np.nan, VALUES)})
    return prepare_estimation(SATURATION, data, None, REST)


@pytest.mark.parametrize(
    ("loss", "rho", "colour"),
    [("squares", 0.0, "known"), ("squares", 0.7, "residual"), ("student", 0.0, "known"), ("huber", 0.7, "residual")],
)
def test_the_noise_stands_still_at_the_end(loss, rho, colour):
    options = FitOptions(loss=loss)
    data = record(1, rho)
    problem = prepare_estimation(TRUTH, spoiled(data) if options.robust else data, LEVEL, options)
    solution = estimate_by_simulation_error(problem, options, colour)
    assert solution.status.success
    assert update_noise(solution, options, colour) is None
    assert solution.problem.noise.coloured == (rho > 0)
    assert (solution.problem.loss is None) == (loss == "squares")


def test_an_untold_level_is_that_of_the_residual():
    problem = few_samples()
    assert problem.noise.sources["y"] is NoiseSource.RESIDUAL
    solution = estimate_by_simulation_error(problem, REST)
    assert update_noise(solution, REST) is None
    y = solution.simulate()[0][0][1:, 0]
    size = np.sqrt(np.sum((VALUES - y) ** 2) / (len(VALUES) - 2))
    assert solution.problem.noise.std[0] == pytest.approx(size, rel=1e-5)


def test_the_work_of_all_rounds_counts():
    options = FitOptions(loss="huber")
    problem = prepare_estimation(TRUTH, spoiled(record(1)), LEVEL, options)
    whole = estimate_by_simulation_error(problem, options)
    once = replace(options, policy=EstimationPolicy(noise_loop=NoiseLoopPolicy(rounds=0)))
    first = estimate_by_simulation_error(problem, once)
    assert first.problem.loss is None
    assert whole.evaluations > first.evaluations and whole.iterations >= first.iterations


def test_the_last_steps_leave_nothing_to_gain():
    options = FitOptions()
    solution = estimate_by_simulation_error(prepare_estimation(TRUTH, record(2), LEVEL, options), options)
    decrease = solution.evaluation.predicted_decrease(*solution.variables.bounds())
    assert decrease <= 1e-12 * solution.evaluation.cost / solution.evaluation.count + 1e-13 * solution.evaluation.cost
