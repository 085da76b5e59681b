"""When a search ends: the predicted decrease in units of the variance, bounds, and gains that fade."""

import numpy as np
import pytest

from greybox.estimation.optim.minimisation import Termination, TerminationPolicy, TerminationStatus
from greybox.estimation.optim.quadratic_model import QuadraticModel


def parabola(distance, cost=200.0):
    """A cost that is ``distance^2`` above its minimum, along one unknown."""
    return QuadraticModel(cost, np.array([2 * distance]), np.array([[2.0]]))


def test_a_search_converges_at_a_share_of_the_variance():
    end = Termination(TerminationPolicy(negligible_decrease=1e-4), count=100)  # the variance is 2
    assert end.test(np.zeros(1), parabola(np.sqrt(2.1e-4))) is None
    assert end.test(np.zeros(1), parabola(np.sqrt(1.9e-4))) is TerminationStatus.CONVERGED


def test_a_likelihood_is_in_units_of_its_own():
    end = Termination(TerminationPolicy(negligible_decrease=1e-4))
    assert end.test(np.zeros(1), parabola(np.sqrt(1.1e-4))) is None
    assert end.test(np.zeros(1), parabola(np.sqrt(0.9e-4), cost=-1e6)) is TerminationStatus.CONVERGED


def test_data_without_noise_end_at_rounding_errors():
    end = Termination(TerminationPolicy(perfect_noise_ratio=1e-7), count=100)
    assert end.test(np.zeros(1), parabola(1e-7, cost=1e-16)) is TerminationStatus.CONVERGED


@pytest.mark.parametrize("gap", [0.0, 1e-7])
def test_what_a_bound_cuts_off_is_nothing_to_gain(gap):
    end = Termination(low=np.array([-1.0]), high=np.array([5.0]), count=100)
    assert end.test(np.array([-1.0 + gap]), parabola(3.0)) is TerminationStatus.CONVERGED
    assert end.test(np.array([0.0]), parabola(3.0)) is None


def test_a_search_that_gains_nothing_any_more_is_acceptable():
    end = Termination(TerminationPolicy(patience=3, little_gain=1e-3), count=100)
    costs = [400.0, 300.0, 200.0, 199.99, 199.98]
    assert [end.test(np.zeros(1), parabola(1.0, cost)) for cost in costs] == [None] * 5
    assert end.test(np.zeros(1), parabola(1.0, 199.97)) is TerminationStatus.ACCEPTABLE
    likelihood = Termination(TerminationPolicy(patience=1, little_gain=1e-2))
    assert likelihood.test(np.zeros(1), parabola(1.0, 1e6)) is None
    assert likelihood.test(np.zeros(1), parabola(1.0, 1e6 - 1)) is None
    assert likelihood.test(np.zeros(1), parabola(1.0, 1e6 - 1.001)) is TerminationStatus.ACCEPTABLE


def test_a_curvature_that_overflows_does_not_end_a_search():
    assert Termination(count=10).test(np.zeros(1), QuadraticModel(1.0, np.ones(1), np.full((1, 1), np.inf))) is None
