"""The noise model and the solution agree with one another at the end of the loop."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

from greybox import Balance, FitOptions, Model, Output, Parameter, State, fit
from greybox.base.errors import ModelError
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import NoiseSource
from greybox.estimation.noise_loop import estimate_by_simulation_error, update_noise
from greybox.estimation.options import EstimationPolicy
from greybox.estimation.transcription.preparation import prepare_problem
from tests.estimation.test_robust_estimation import LEVEL, TRUTH, record, spoiled
from tests.support.published_plants import REST, SATURATION, TIMES, VALUES
from tests.support.pushed_mass import MASS


def few_samples():
    """Six samples show their noise in nothing but the residual."""
    data = Experiment("published", np.append(0.0, TIMES), {}, {"y": np.append(np.nan, VALUES)})
    return prepare_problem(SATURATION, data, None, REST)


@pytest.mark.parametrize(
    ("loss", "rho", "colour"),
    [("squares", 0.0, "known"), ("squares", 0.7, "residual"), ("student", 0.0, "known"), ("huber", 0.7, "residual")],
)
def test_the_noise_stands_still_at_the_end(loss, rho, colour):
    options = FitOptions(loss=loss)
    data = record(1, rho)
    problem = prepare_problem(TRUTH, spoiled(data) if options.robust else data, LEVEL, options)
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
    problem = prepare_problem(TRUTH, spoiled(record(1)), LEVEL, options)
    whole = estimate_by_simulation_error(problem, options)
    once = replace(options, policy=EstimationPolicy(noise_rounds=0))
    first = estimate_by_simulation_error(problem, once)
    assert first.problem.loss is None
    assert whole.evaluations > first.evaluations and whole.iterations >= first.iterations


def test_the_last_steps_leave_nothing_to_gain():
    options = FitOptions()
    solution = estimate_by_simulation_error(prepare_problem(TRUTH, record(2), LEVEL, options), options)
    decrease = solution.evaluation.predicted_decrease(*solution.variables.bounds())
    assert decrease <= 1e-12 * solution.evaluation.cost / solution.evaluation.count + 1e-13 * solution.evaluation.cost


def test_outputs_with_common_noise_are_weighed_alike_at_the_level_of_all_residuals():
    # y1 follows the model, y2 scatters ten times as far: the plain sum of squares says the constants and the one level.
    generator = np.random.default_rng(0)
    t = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0])
    y1, y2 = np.exp(-t) + 0.001 * generator.normal(size=7), np.exp(-t) + 0.01 * generator.normal(size=7)
    model = Model(
        "decay",
        states=[State("y", "1", 1.0)],
        inputs=[],
        outputs=[Output(name, "1", lambda x, u, p: x.y) for name in ("y1", "y2")],
        parameters=[Parameter("k", "1", 0.8, (0.01, 10.0))],
        balances=lambda x, u, p: [Balance("decay", "1", 1, "y", decay=-p.k * x.y)],
    )
    found = fit(
        model, Experiment("decay", t, {}, {"y1": y1, "y2": y2}), options=FitOptions(at_rest=True, common_noise=True)
    )
    least = least_squares(lambda k: np.concatenate([np.exp(-k * t) - y1, np.exp(-k * t) - y2]), 0.8, xtol=1e-14)
    assert found.parameters["k"].value == pytest.approx(least.x[0], rel=1e-6)
    level = np.sqrt(2 * least.cost / (14 - 1))
    assert found.noise.std["y1"] == found.noise.std["y2"] == pytest.approx(level, rel=1e-3)
    std = level / np.sqrt(2 * np.sum((t * np.exp(-least.x[0] * t)) ** 2))
    assert found.parameters["k"].std == pytest.approx(std, rel=1e-3)


def test_levels_that_are_named_are_those_of_the_largest_likelihood():
    """Two outputs share one level, a third has its own: against the likelihood as SciPy finds it."""
    t, generator = np.linspace(0, 4, 25), np.random.default_rng(1)

    def runs(a, b, k):
        s = 1 - np.exp(-k * t)
        return a * s, b * s**2, a * b * s

    seen = [y + std * generator.normal(size=25) for y, std in zip(runs(2.0, 3.0, 0.7), (0.05, 0.05, 0.4), strict=True)]
    model = Model(
        "rise",
        states=[State("s", "1", 0.0)],
        inputs=[],
        outputs=[
            Output("y1", "1", lambda x, u, p: p.a * x.s),
            Output("y2", "1", lambda x, u, p: p.b * x.s**2),
            Output("y3", "1", lambda x, u, p: p.a * p.b * x.s),
        ],
        parameters=[Parameter(n, "1/s" if n == "k" else "1", 1.5, (0.01, 100.0)) for n in "abk"],
        balances=lambda x, u, p: [Balance("s", "1/s", 1, "s", rise=p.k * (1 - x.s))],
    )
    record = Experiment("rise", t, {}, dict(zip(("y1", "y2", "y3"), seen, strict=True)))
    found = fit(model, record, noise={"y1": "n", "y2": "n", "y3": "w"}, options=FitOptions(at_rest=True))

    def minus_log_likelihood(z):
        *constants, small, large = np.exp(z)
        pairs = zip(seen, runs(*constants), (small, small, large), strict=True)
        return sum(np.sum((y - run) ** 2) / (2 * s**2) + len(y) * np.log(s) for y, run, s in pairs)

    likely = np.exp(minimize(minus_log_likelihood, np.log([2, 3, 0.7, 0.05, 0.4]), tol=1e-12).x)
    assert [found.parameters[n].value for n in "abk"] == pytest.approx(likely[:3], rel=1e-5)
    # Each level is that of the likelihood but for the constants' share of the readings.
    unbiased = np.sqrt(75 / 72)
    assert [found.noise.std[n] for n in ("y1", "y2", "y3")] == pytest.approx(likely[[3, 3, 4]] * unbiased, rel=1e-3)
    # The curvature of the likelihood along the logarithm of a level of n readings is 2 n.
    assert found.noise.log_std["y1"] == pytest.approx(1 / np.sqrt(2 * 48), rel=1e-9)
    low, high = found.noise.interval("y1")
    assert low < 0.05 < high


def test_a_level_needs_a_name_or_a_number():
    with pytest.raises(ModelError, match="neither a number nor the name of a level"):
        prepare_problem(TRUTH, record(2), {"x": "1 mm"}, FitOptions())


def test_common_noise_of_a_length_and_a_current_is_refused():
    record = Experiment(
        "rig", np.arange(50.0), {"u": np.sin(np.arange(50.0))}, {"x": np.arange(50.0), "v": np.ones(50)}
    )
    with pytest.raises(
        ModelError, match="common noise: x in m, v in m/s; outputs have one noise in common only in one unit"
    ):
        prepare_problem(MASS, record, None, FitOptions(common_noise=True))
