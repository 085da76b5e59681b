"""The bounded step against an enumeration of all active sets and against SciPy; cut-offs, damping, and what is not finite."""

from itertools import product

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from greybox.estimation.optim.quadratic_model import QuadraticModel


def random_problem(seed):
    """Jacobian, residual and distances to bounds; columns of very different size, some dependent, some bounds touched already."""
    draw = np.random.default_rng(seed)
    n = int(draw.integers(1, 6))
    jacobian = draw.standard_normal((8, n)) * 10.0 ** draw.integers(-4, 5, n)
    if n > 1 and seed % 3 == 0:
        jacobian[:, -1] = jacobian[:, 0] * draw.uniform(-2, 2)
    if n > 2 and seed % 5 == 0:
        jacobian[:, 1] = 0.0
    residual = draw.standard_normal(8)
    reach = 1 / np.where(np.linalg.norm(jacobian, axis=0) > 0, np.linalg.norm(jacobian, axis=0), 1.0)
    low, high = -reach * draw.exponential(0.5, n), reach * draw.exponential(0.5, n)
    low[draw.random(n) < 0.2], high[draw.random(n) < 0.2] = 0.0, 0.0
    low[draw.random(n) < 0.2], high[draw.random(n) < 0.2] = -np.inf, np.inf
    return jacobian, residual, low, high


def squares(jacobian, residual):
    return QuadraticModel(float(residual @ residual), 2 * jacobian.T @ residual, 2 * jacobian.T @ jacobian)


def least_by_enumeration(model, low, high):
    """Least value of the model over every way of holding unknowns at their bounds."""
    n, values = len(low), []
    for held in product((None, 0, 1), repeat=n):
        at = [None if h is None else (low, high)[h][k] for k, h in enumerate(held)]
        if any(a is not None and not np.isfinite(a) for a in at):
            continue
        step = np.array([0.0 if a is None else a for a in at])
        free = np.array([a is None for a in at])
        if free.any():
            scale = np.sqrt(np.maximum(np.diag(model.hessian)[free], 1e-300))
            slope = (model.gradient + model.hessian @ step)[free] / scale
            matrix = model.hessian[np.ix_(free, free)] / np.outer(scale, scale)
            step[free] = -np.linalg.pinv(matrix, rcond=1e-10, hermitian=True) @ slope / scale
        if np.all(step >= low - 1e-9 * np.abs(low)) and np.all(step <= high + 1e-9 * np.abs(high)):
            values.append(model.decrease_along(step))
    return max(values)


@pytest.mark.parametrize("make", [squares, QuadraticModel.from_residuals])
@pytest.mark.parametrize("seed", range(60))
def test_the_bounded_step_is_the_minimum_within_bounds(make, seed):
    jacobian, residual, low, high = random_problem(seed)
    model = make(jacobian, residual)
    step = model.bounded_step(low, high)
    assert np.all(step >= low) and np.all(step <= high)
    assert model.predicted_decrease(low, high) == model.decrease_along(step)
    assert model.decrease_along(step) == pytest.approx(least_by_enumeration(model, low, high), rel=1e-8, abs=1e-9)
    inside = low < high
    scale = model.scale[inside]
    bounds = low[inside] * scale, high[inside] * scale
    if inside.any():
        scipy_step = lsq_linear(jacobian[:, inside] / scale, -residual, bounds, method="bvls", tol=1e-14)
        cost = float(np.sum((residual + jacobian @ step) ** 2))
        assert cost <= 2 * scipy_step.cost * (1 + 1e-9)
        assert model.cost - model.decrease_along(step) == pytest.approx(cost, rel=1e-9)


@pytest.mark.parametrize("make", [squares, QuadraticModel.from_residuals])
@pytest.mark.parametrize("seed", range(20))
def test_damping_is_added_to_the_scaled_diagonal(make, seed):
    jacobian, residual, low, high = random_problem(seed)
    model, damping = make(jacobian, residual), 0.3
    damped = QuadraticModel(0.0, model.gradient, model.hessian + damping * np.diag(model.scale**2))
    step = model.bounded_step(low, high, damping)
    assert damped.decrease_along(step) == pytest.approx(least_by_enumeration(damped, low, high), rel=1e-8, abs=1e-9)


def test_the_step_does_not_depend_on_the_units_of_the_unknowns():
    jacobian, residual, low, high = random_problem(1)
    units = np.logspace(-9, 9, jacobian.shape[1])
    step = squares(jacobian, residual).bounded_step(low, high)
    assert squares(jacobian * units, residual).bounded_step(low / units, high / units) * units == pytest.approx(step)


def test_directions_without_curvature_stay_where_they_are():
    jacobian = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0]])  # only the sum of the first two acts, the third not at all
    model = squares(jacobian, np.array([-1.0, -2.0]))
    everywhere = np.full(3, np.inf)
    assert model.bounded_step(-everywhere, everywhere) == pytest.approx([0.5, 0.5, 0.0])
    held = model.bounded_step(-everywhere, np.array([0.2, np.inf, np.inf]))
    assert held == pytest.approx([0.2, 0.8, 0.0])
    assert model.principal_axes()[1] == pytest.approx([2.0])


def test_bounds_that_were_hit_on_the_way_are_released():
    """Strongly coupled unknowns: bounds that the way to the minimum hits are often none that the minimum lies on."""
    hessian = np.array([[1.0, 0.9, 0.5], [0.9, 1.0, 0.8], [0.5, 0.8, 1.0]])
    released = 0
    for seed in range(100):
        gradient = np.random.default_rng(seed).standard_normal(3)
        model, low, high = QuadraticModel(0.0, gradient, hessian), np.full(3, -0.4), np.full(3, 0.4)
        step, free = model.bounded_step(low, high), -np.linalg.solve(hessian, gradient)
        slope = gradient + hessian @ step
        assert np.all(slope[(step > low) & (step < high)] == pytest.approx(0, abs=1e-9))
        assert np.all(slope[step <= low] > 0) and np.all(slope[step >= high] < 0)
        released += bool(np.any((np.abs(free) > 0.4) & (np.abs(step) < 0.4)))
    assert released > 10


def test_a_triangular_factor_keeps_the_digits_that_the_product_loses():
    """Columns that differ by 1e-7: the product of the matrix with itself no longer shows that they do."""
    draw = np.random.default_rng(0)
    common = draw.standard_normal(50)
    jacobian = np.column_stack([common, common + 1e-7 * draw.standard_normal(50)])
    truth = np.array([1.0, -2.0])
    everywhere = np.full(2, np.inf)
    step = QuadraticModel.from_residuals(jacobian, -jacobian @ truth).bounded_step(-everywhere, everywhere)
    assert step == pytest.approx(truth, rel=1e-6)
    assert squares(jacobian, -jacobian @ truth).bounded_step(-everywhere, everywhere) != pytest.approx(truth, rel=1e-2)


@pytest.mark.parametrize("bad", [np.inf, np.nan])
def test_sensitivities_that_overflow_promise_everything_and_show_no_direction(bad):
    model = QuadraticModel(1.0, np.ones(2), np.array([[bad, 0.0], [0.0, 1.0]]))
    assert model.predicted_decrease(-np.ones(2), np.ones(2)) == np.inf == model.predicted_decrease()
    assert not model.bounded_step(-np.ones(2), np.ones(2)).any() and not model.is_finite


def test_huge_and_tiny_curvatures_do_not_overflow():
    model = QuadraticModel(1.0, np.array([1e150, 1e-150]), np.diag([1e300, 1e-290]))
    assert model.predicted_decrease() == pytest.approx(0.5 + 0.5e-10)


def test_a_model_without_unknowns_has_an_empty_step():
    model = QuadraticModel(2.0, np.zeros(0), np.zeros((0, 0)))
    assert model.bounded_step(np.zeros(0), np.zeros(0)).shape == (0,) and model.predicted_decrease() == 0.0
