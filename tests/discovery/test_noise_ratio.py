"""One measure of a misfit over the noise, whatever a search weighs its residuals with."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State
from greybox.discovery.holdout import validate_candidate
from greybox.discovery.localisation import localise_residual
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.residual_noise import estimate_residual_noise
from greybox.show.sentences.discovery import ratio_text

STEP, ROWS = 0.02, 1500


def plant():
    def balances(x, u, p):
        return [
            Balance("first", "V/s", 1, "y", decay=-p.a * x.y, drive=p.a * u.u),
            Balance("second", "V/s", 1, "z", decay=-p.b * x.z, drive=p.b * x.y),
        ]

    parameters = [Parameter("a", "1/s", 3.0, bounds=(0.1, 100.0)), Parameter("b", "1/s", 1.0, bounds=(0.1, 100.0))]
    states = [State("y", "V"), State("z", "V")]
    return Model("tanks", states, [Input("u", "V")], [Output("y", "V"), Output("z", "V")], parameters, balances)


def record(correlation, seed=1):
    """A run whose input works twice as strongly upward as downward, which the model does not have."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.normal(size=ROWS // 50), 50)
    state, rows = np.zeros(2), []
    for value in np.where(u > 0, 2 * u, u):
        rows.append(state)
        for _ in range(20):
            y, z = state
            state = state + STEP / 20 * np.array([4.0 * (value - y), 1.5 * (y - z)])
    noise = lfilter([np.sqrt(1 - correlation**2)], [1, -correlation], rng.normal(size=(ROWS, 2)), axis=0)
    y, z = (np.array(rows) + [0.01, 0.002] * noise).T
    return Experiment.from_arrays(STEP * np.arange(ROWS), inputs={"u": u}, outputs={"y": y, "z": z})


@pytest.mark.rest
@pytest.mark.parametrize("correlation", [pytest.param(0.0, marks=pytest.mark.slow), 0.8])
@pytest.mark.parametrize("noise", [{}, {"y": 0.01, "z": 0.002}])
def test_a_model_has_one_misfit_over_noise(noise, correlation):
    problem = DiscoveryProblem(plant(), (record(correlation),), noise, (), FitOptions())
    before = problem.baseline
    weighed = replace(problem, noise=estimate_residual_noise(before), model=before.model)
    after = weighed.baseline
    # The cost is another one: other levels, another colour.
    assert abs(after.per_sample / before.per_sample - 1) > 0.1
    for candidate, own in ((before, problem), (after, weighed)):
        errors = validate_candidate(own, candidate, ())
        bounds = {name: before.problem.noise.bound(name).level for name in errors.misfit}
        assert candidate.noise_ratio == pytest.approx(
            max(m.rmse / bounds[name] for name, m in errors.misfit.items()), rel=1e-3
        )
        assert localise_residual(candidate).misfit == candidate.noise_ratio
        assert candidate.is_noise_bounded is not bool(noise)
    # The model is the same but for what the weights move.
    assert after.noise_ratio == pytest.approx(before.noise_ratio, rel=0.2)


def test_a_bounded_noise_is_said_to_be_one():
    assert ratio_text(39.68, False) == "39.7 times the noise"
    assert ratio_text(39.68, True) == "at least 39.7 times the noise"
