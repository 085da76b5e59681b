"""IPOPT as it is used here: kinds of ends, bounds, kinks, failures, and one solver for one search after another."""

import signal
import threading
from itertools import pairwise

import numpy as np
import pytest

from greybox.estimation.optim import ipopt as ipopt_dense
from greybox.estimation.optim.gauss_newton import run_gauss_newton
from greybox.estimation.optim.methods import MinimisationMethod, minimise
from greybox.estimation.optim.minimisation import (
    DEFAULT_POLICY,
    GaussNewtonPolicy,
    Minimisation,
    MinimisationPolicy,
    Termination,
    TerminationStatus,
)
from greybox.estimation.optim.quadratic_model import QuadraticModel


def bowl(z, target=3.0):
    """``sum of (z - target)^2`` with its derivatives."""
    return QuadraticModel(float(((z - target) ** 2).sum()), 2 * (z - target), 2 * np.eye(len(z)))


def curved(z):
    """Rosenbrock's valley as residuals (10 (b - a^2), 1 - a), Gauss-Newton Hessian."""
    r = np.array([10 * (z[1] - z[0] ** 2), 1 - z[0]])
    jacobian = np.array([[-20 * z[0], 10.0], [-1.0, 0.0]])
    return QuadraticModel(float(r @ r), 2 * jacobian.T @ r, 2 * jacobian.T @ jacobian)


def kinked(z):
    """A fold along a = b: the slope on either side leads across, and the Hessian knows nothing of it."""
    a, b = z
    cost = float(1 + 10 * abs(a - b) + (a - 1) ** 2 + (b - 1) ** 2)
    fold = 10 * np.sign(a - b)
    return QuadraticModel(cost, np.array([fold + 2 * (a - 1), -fold + 2 * (b - 1)]), 2 * np.eye(2))


def free(n):
    return np.full(n, -np.inf), np.full(n, np.inf)


def test_rosenbrocks_valley_is_minimised():
    result = minimise(curved, np.array([-1.2, 1.0]), *free(2))
    assert result.status is TerminationStatus.CONVERGED
    assert result.z == pytest.approx([1, 1], abs=1e-6)
    assert result.value.cost == result.cost < 1e-12


def test_a_variable_ends_exactly_at_its_bound():
    result = minimise(bowl, np.zeros(2), np.array([-5.0, -5.0]), np.array([1.0, 9.0]))
    assert result.status is TerminationStatus.CONVERGED
    assert result.z[0] <= 1.0 and result.z == pytest.approx([1, 3], abs=1e-4)


def test_an_infinite_cost_shortens_the_step():
    def wall(z):
        return QuadraticModel(np.inf, 0 * z, np.zeros((1, 1))) if z[0] > 3.5 else bowl(z)

    result = minimise(lambda z: wall(z), np.array([-40.0]), *free(1))
    assert result.z == pytest.approx([3], abs=1e-6)
    lost = minimise(lambda z: wall(z), np.array([4.0]), *free(1))
    assert lost.status is TerminationStatus.NO_START and lost.value is None


def test_a_known_value_at_the_start_is_not_computed_again():
    asked = []
    minimise(lambda z: asked.append(z.copy()) or bowl(z), np.zeros(2), *free(2), value_at_start=bowl(np.zeros(2)))
    assert asked and not any(np.array_equal(z, np.zeros(2)) for z in asked)


def test_each_point_is_computed_once():
    asked = []
    result = minimise(lambda z: asked.append(z.tobytes()) or curved(z), np.array([-1.2, 1.0]), *free(2))
    assert len(asked) == result.evaluations
    assert all(a != b for a, b in pairwise(asked))


def test_the_termination_test_ends_the_search():
    ended = minimise(
        curved,
        np.array([-1.2, 1.0]),
        *free(2),
        termination_test=lambda z, v: TerminationStatus.ACCEPTABLE if v.cost < 1 else None,
    )
    assert ended.status is TerminationStatus.ACCEPTABLE and 0 < ended.cost < 1
    at_once = minimise(
        curved, np.array([-1.2, 1.0]), *free(2), termination_test=lambda z, v: TerminationStatus.CONVERGED
    )
    assert at_once.iterations == 0 and at_once.evaluations == 1


# The cost is 1 at its lowest, and 36 at the start. The last radius of the sampling is a millionth of the cost, a step of 0.001: across the
# fold, where the cost climbs by 10, the end is known to 0.01.
AT_THE_FOLD = pytest.approx(1.0, abs=0.01)


def test_a_search_converges_at_a_kink_with_few_evaluations():
    result = minimise(kinked, np.array([2.0, -1.0]), *free(2))
    assert result.status is TerminationStatus.KINK and result.status.success
    assert result.cost == AT_THE_FOLD
    assert result.evaluations < 100
    quick = minimise(kinked, np.array([2.0, -1.0]), *free(2), thorough=False)
    assert quick.status is TerminationStatus.STUCK and quick.evaluations < result.evaluations


def test_a_search_that_stands_while_its_slopes_promise_most_of_the_cost_is_no_success():
    # The lowest point of 1 + |z| with slopes that belong to another function: the quadratic model falls by all of the cost.
    def misleading(z):
        return QuadraticModel(1 + np.abs(z).sum(), np.full(2, 2.0), 4 * np.eye(2))

    result = minimise(misleading, np.zeros(2), *free(2))
    assert result.status is TerminationStatus.STUCK and not result.status.success


@pytest.mark.parametrize(
    "error", [RuntimeError("Maximum number of iterations reached."), np.linalg.LinAlgError("Matrix is singular.")]
)
def test_a_kink_is_left_downhill_where_the_active_set_of_scipy_does_not_end(monkeypatch, error):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("scipy.optimize.nnls", fail)
    result = minimise(kinked, np.array([2.0, -1.0]), *free(2))
    assert result.status is TerminationStatus.KINK and result.cost == AT_THE_FOLD


@pytest.mark.parametrize(
    "finished", [None, lambda z, value: TerminationStatus.CONVERGED if value.cost < 1e-9 else None]
)
def test_a_stalled_search_goes_on_by_damped_steps(finished):
    """Stalled at once, as behind a barrier that leads away from the optimum: where the gradient is right, no kink is reported."""
    at_once = MinimisationPolicy(max_shortenings=0)
    result = minimise(curved, np.array([-1.2, 1.0]), *free(2), termination_test=finished, policy=at_once)
    assert result.status is TerminationStatus.CONVERGED
    assert result.z == pytest.approx([1, 1], abs=1e-3 if finished else 1e-9)
    assert result.evaluations < 60
    held = minimise(bowl, np.zeros(2), np.array([-5.0, -5.0]), np.array([1.0, 9.0]), policy=at_once)
    assert held.z == pytest.approx([1, 3], abs=1e-9)


def test_an_exception_of_the_cost_is_raised_and_the_solver_stays_usable():
    def breaks(z):
        if z[0] > 1:
            raise ZeroDivisionError("a bug in the model")
        return bowl(z)

    with pytest.raises(ZeroDivisionError, match="a bug in the model"):
        minimise(breaks, np.zeros(3), *free(3))
    assert minimise(bowl, np.zeros(3), *free(3)).z == pytest.approx(np.full(3, 3.0))


def test_one_solver_serves_one_search_after_another(monkeypatch):
    made = []
    monkeypatch.setattr(ipopt_dense, "_idle", {})
    original = ipopt_dense._Solver.__init__
    monkeypatch.setattr(ipopt_dense._Solver, "__init__", lambda self, *a: made.append(a) or original(self, *a))
    for target in (1.0, 2.0, 5.0):
        assert minimise(lambda z, t=target: bowl(z, t), np.zeros(2), *free(2)).z == pytest.approx([target, target])
    assert len(made) == 1


def test_concurrent_and_nested_searches_do_not_mix():
    results = {}

    def search(target):
        results[target] = minimise(lambda z: bowl(z, target), np.zeros(2), *free(2)).z

    threads = [threading.Thread(target=search, args=(float(t),)) for t in range(1, 5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(z == pytest.approx([t, t], abs=1e-6) for t, z in results.items())

    def outer(z):
        inner = minimise(lambda w: bowl(w, 7.0), np.zeros(2), *free(2)).z
        return bowl(z, inner[0])

    assert minimise(outer, np.zeros(2), *free(2)).z == pytest.approx([7, 7], abs=1e-5)


def near(limit):
    return lambda z, value: TerminationStatus.CONVERGED if value.cost < limit else None


def decay(z):
    """``exp(a - exp(b) t)`` against noisy samples of ``3 exp(-2 t)``."""
    t = np.linspace(0, 2, 50)
    y = 3 * np.exp(-2 * t) + 0.01 * np.random.default_rng(0).standard_normal(50)
    model = np.exp(z[0] - np.exp(z[1]) * t)
    r, jacobian = (model - y) / 0.01, np.column_stack([model, -np.exp(z[1]) * t * model]) / 0.01
    return QuadraticModel(float(r @ r), 2 * jacobian.T @ r, 2 * jacobian.T @ jacobian)


def test_ipopt_hands_over_where_the_quadratic_model_predicts_well():
    start, (low, high) = np.array([0.0, -1.0]), (np.full(2, -5.0), np.full(2, 5.0))

    def run(policy):
        end = Termination(low=low, high=high, count=50)
        return minimise(decay, start, low, high, termination_test=end.test, scale=1e4, policy=policy)

    result, ipopt = run(MinimisationPolicy()), run(MinimisationPolicy(hand_overs=0))
    assert result.solver == "IPOPT, then Gauss-Newton" and ipopt.solver == "IPOPT"
    assert result.status is ipopt.status is TerminationStatus.CONVERGED
    assert result.z == pytest.approx(ipopt.z, abs=1e-5) and np.exp(result.z) == pytest.approx([3, 2], rel=0.01)
    assert result.evaluations <= ipopt.evaluations
    assert 0 < result.iterations < result.evaluations


def test_a_near_start_needs_no_ipopt():
    def offset(z):
        value = curved(z)
        return QuadraticModel(value.cost + 100.0, value.gradient, value.hessian)

    result = minimise(offset, np.array([0.9, 0.8]), *free(2), termination_test=near(100 + 1e-12))
    assert result.solver == "Gauss-Newton" and result.iterations <= 3 and result.solver_status == ""


def test_without_a_termination_test_ipopt_goes_on_to_the_end():
    assert minimise(bowl, np.zeros(2), *free(2)).solver == "IPOPT"
    assert minimise(bowl, np.zeros(0), *free(0)).solver == ""


def test_gauss_newton_alone_within_bounds():
    low, high = np.array([-2.0, -2.0]), np.array([0.5, 2.0])
    result = minimise(curved, np.array([-1.2, 1.0]), low, high, method="gauss_newton")
    assert result.solver == "Gauss-Newton" and result.status is TerminationStatus.CONVERGED
    assert result.z == pytest.approx([0.5, 0.25], abs=1e-7)
    assert minimise(curved, np.array([-1.2, 1.0]), low, high, method="gauss_newton", iterations=2).status is (
        TerminationStatus.ITERATION_LIMIT
    )


def test_gauss_newton_alone_stays_among_allowed_points():
    visited = []

    def on_circle(z):
        return z / np.linalg.norm(z)

    result = minimise(
        lambda z: visited.append(z) or bowl(z, np.array([3.0, 4.0])),
        np.array([1.0, 0.0]),
        *free(2),
        method="gauss_newton",
        project=on_circle,
    )
    assert np.linalg.norm(visited, axis=1) == pytest.approx(np.ones(len(visited)))
    assert result.z == pytest.approx([0.6, 0.8], abs=1e-3)


def test_steps_that_gain_nothing_cost_no_derivatives():
    evaluated, tried = [], []
    result = minimise(
        lambda z: evaluated.append(z) or curved(z),
        np.array([-1.2, 1.0]),
        *free(2),
        method="gauss_newton",
        cost=lambda z: tried.append(z) or curved(z).cost,
    )
    assert result.z == pytest.approx([1, 1], abs=1e-6)
    assert len(evaluated) == result.evaluations == result.iterations + 1 < len(tried)


@pytest.mark.parametrize("method", list(MinimisationMethod))
def test_an_interrupt_in_the_last_iteration_is_heard(method):
    asked = []

    def objective(z):
        value = bowl(z)
        if value.cost < 1e-9 and not asked:
            asked.append(z)
            signal.raise_signal(signal.SIGINT)
        return value

    result = minimise(objective, np.zeros(2), *free(2), method=method)
    assert asked and result.z == pytest.approx([3, 3], abs=1e-4)
    assert result.status is TerminationStatus.INTERRUPTED


@pytest.mark.parametrize("method", list(MinimisationMethod))
def test_whoever_is_told_of_an_iteration_may_end_the_search_there(method):
    result = minimise(
        curved, np.array([-1.2, 1.0]), *free(2), method=method, progress=lambda iteration, _: iteration >= 2
    )
    assert result.status is TerminationStatus.INTERRUPTED
    assert result.iterations <= 4 and result.cost > 1e-3


def test_a_search_at_a_kink_ends_between_two_of_its_many_points():
    """Of forty unknowns a round of gradient sampling takes eighty points, each as dear as a run of the model."""

    def folded(z):
        evaluated.append(z)
        a, b = z[:2]
        slope = 2 * (z - 1)
        slope[:2] += 10 * np.sign(a - b) * np.array([1, -1])
        return QuadraticModel(float(1 + 10 * abs(a - b) + ((z - 1) ** 2).sum()), slope, 2 * np.eye(len(z)))

    evaluated, start = [], np.r_[2.0, -1.0, np.zeros(38)]
    assert minimise(folded, start, *free(40)).status is TerminationStatus.KINK
    # Half of the points of the first round of sampling are left out where the search is told to end there.
    enough = len(evaluated) // 3
    evaluated.clear()
    result = minimise(folded, start, *free(40), progress=lambda *_: len(evaluated) >= enough)
    assert result.status is TerminationStatus.INTERRUPTED
    assert enough <= len(evaluated) < enough + 10


def test_damped_steps_go_no_farther_than_they_reach():
    """A slope that dies away along a logarithm promises that a step without end gains what one of any length does."""
    tried = []

    def evaluate(z):
        tried.append(float(z[0]))
        residual, slope = np.array([0.1 + np.exp(-z[0])]), np.array([[-np.exp(-z[0])]])
        return QuadraticModel(float(residual @ residual), 2 * slope.T @ residual, 2 * slope.T @ slope)

    bound = np.full(1, np.inf)
    minimise(evaluate, np.zeros(1), -bound, bound, method="damped_first", reach=np.full(1, 2.0), iterations=3)
    steps = np.abs(np.diff(tried))
    assert steps.max() == pytest.approx(2.0)
    tried.clear()
    minimise(evaluate, np.zeros(1), -bound, bound, method="gauss_newton", iterations=3)
    assert np.abs(np.diff(tried)).max() > 2.0


def test_one_step_that_gains_little_among_others_is_no_kink():
    """Each step promises 50 of the cost; the second gains 1, and the others all."""
    costs = {0: 100.0, 10: 50.0, 20: 49.0, 30: 0.0}
    search = Minimisation(
        lambda z: QuadraticModel(costs[round(z[0])], np.array([-10.0]), np.eye(1)), 1.0, None, None, DEFAULT_POLICY
    )
    search(np.zeros(1))
    assert run_gauss_newton(search, *free(1), GaussNewtonPolicy(max_kink_steps=2), steps=3)
    assert (search.status, search.best_cost) == (TerminationStatus.ITERATION_LIMIT, 0.0)
