"""The decision vector: its named parts, and noise levels among the unknowns."""

from dataclasses import replace

import numpy as np
import pytest

from greybox.estimation.options import FitOptions
from greybox.estimation.transcription.decision_vector import DecisionVector, NoiseLevels
from greybox.estimation.transcription.preparation import prepare_problem
from models.micro_actuator import micro_actuator
from tests.oracles.independent import linear_record


@pytest.fixture(scope="module")
def variables() -> DecisionVector:
    """Two records of the actuator with estimated initial states, and the noise of the current among the unknowns."""
    model = micro_actuator.fix("M", "Ra")
    records = [linear_record(model, np.sin(np.arange(60) * rate), 2.5e-4) for rate in (0.1, 0.3)]
    problem = prepare_problem(
        model,
        records,
        {"x": 1e-7, "i": 1e-3},
        FitOptions(),
    )
    noise = NoiseLevels(problem.noise.std, np.array([False, True]), 1e-4 * problem.noise.std, 25.0)
    return replace(problem.variables, noise=noise)


def test_parts_of_a_point_are_views_and_cover_it(variables):
    z = variables.here
    parts = variables.split(z)
    for part in parts:
        part += 1
    assert (z == 1).all()
    assert parts.initial_states.shape == (2, 3)
    assert len(parts.parameters) == len(variables.names)
    assert len(parts.noise_levels) == 1
    assert variables.size == len(variables.labels) == len(variables.bounds()[0])
    assert variables.labels[-1] == "noise of i"


def test_columns_of_an_experiment_are_its_parts(variables):
    z = np.arange(float(variables.size))
    parts = variables.split(z)
    expected = np.concatenate([parts.parameters, parts.initial_states[1], parts.noise_levels])
    np.testing.assert_array_equal(z[variables.columns(1)], expected)


def test_recentring_moves_parameters_initial_states_and_noise_to_the_point(variables):
    z = np.full(variables.size, 0.1)
    moved = variables.recentre(z)
    np.testing.assert_allclose(moved.constants(moved.here), variables.constants(z))
    np.testing.assert_allclose(moved.noise_levels(moved.here), variables.noise_levels(z))
    np.testing.assert_allclose(moved.noise.level / variables.noise.level, [1.0, np.exp(0.1)])
    states = [v.compute_initial_state(at, v.parameters(at, 1), 1)[0] for v, at in ((moved, moved.here), (variables, z))]
    np.testing.assert_allclose(*states)


def test_initial_states_are_placed_where_they_belong(variables):
    states = np.array([[1e-5, 0.1, 0.2], [2e-5, 0.3, 0.4]])
    z = variables.place_initial_states(variables.here, states)
    for e in (0, 1):
        np.testing.assert_allclose(variables.compute_initial_state(z, variables.parameters(z, e), e)[0], states[e])
