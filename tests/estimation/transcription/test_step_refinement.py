"""The one loop that makes the integration step smaller: a search and a judge in, the path of steps out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.options import FitOptions, StepRefinementPolicy
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.problem import EstimationProblem, Solution
from greybox.estimation.transcription.shooting_cost import Evaluation
from greybox.estimation.transcription.single_shooting import (
    MISFIT_SHARE,
    STEP_REFINEMENT_NOISE_SHARE,
    is_too_coarse,
    refine_step,
    solve_with_refined_steps,
)
from tests.oracles.independent import solved_record
from tests.support.oscillator import oscillator

POLICY = StepRefinementPolicy(halvings=3)


@pytest.fixture(scope="module")
def problem() -> EstimationProblem:
    model = oscillator("duffing", 0.3, 4.0, 6.0, 2.0)
    data = solved_record(model, np.sin(np.arange(60) * 0.3), np.arange(60) * 0.1, [0.3, 0.0])
    return prepare_problem(model, data, {"x": 1e-3}, FitOptions(method="rk4", substeps=1))


def solved(problem, status=TerminationStatus.CONVERGED):
    evaluation = problem.shooting().evaluate(problem.variables.here)
    return Solution(problem, problem.variables, evaluation, status, "", 2, 3, 0.5, (0.5, 1.0), np.zeros(1))


def follow(problem, too_coarse, status=TerminationStatus.CONVERGED):
    """The substeps that were solved with, where those of ``too_coarse`` have to be halved; and the solution."""
    steps = []

    def solve(problem):
        steps.append(problem.step.substeps)
        return solved(problem, status)

    def refine(solution):
        n = solution.problem.step.substeps
        return (solution.problem.halve_step() if n in too_coarse else None), np.array([1.0 / n])

    return steps, solve_with_refined_steps(problem, solve, refine, POLICY)


@pytest.mark.parametrize(
    ("too_coarse", "expected"),
    [((), [1]), ((1,), [1, 2]), ((1, 2), [1, 2, 4]), ((1, 2, 4, 8, 16), [1, 2, 4, 8])],
)
def test_the_step_is_halved_until_it_is_fine_or_the_policy_ends_it(problem, too_coarse, expected):
    steps, solution = follow(problem, too_coarse)
    assert steps == expected
    assert solution.problem.step.substeps == expected[-1]
    assert solution.integration_error == 1.0 / expected[-1]


def test_the_work_of_all_steps_adds_up_and_the_shares_are_those_of_the_first(problem):
    _, solution = follow(problem, (1, 2))
    assert (solution.iterations, solution.evaluations, solution.seconds) == (6, 9, 1.5)
    assert solution.shares == (0.5, 1.0)


@pytest.mark.parametrize("status", [TerminationStatus.INTERRUPTED, TerminationStatus.NO_START])
def test_where_there_is_nothing_to_go_on_from_no_step_is_judged(problem, status):
    steps, solution = follow(problem, (1, 2), status)
    assert steps == [1]
    assert solution.integration_error == 0.0


def test_a_coarse_step_is_told_by_half_of_it(problem):
    finer, error = refine_step(solved(problem), FitOptions())
    assert error > 1e-6
    assert finer is not None
    assert finer.step.substeps >= 2


def test_a_step_is_made_no_finer_than_the_policy_allows(problem):
    policy = FitOptions().policy
    limited = replace(policy, step_refinement=replace(policy.step_refinement, max_substeps=1))
    finer, error = refine_step(solved(problem), FitOptions(policy=limited))
    assert finer is None
    assert error > 1e-6


def test_steps_that_were_asked_for_are_judged_and_kept(problem):
    finer, error = refine_step(solved(problem), FitOptions(substeps=1))
    assert finer is None
    assert error > 1e-6


def test_an_exact_step_has_no_error(problem):
    exact = replace(problem, step=replace(problem.step, per_interval=True))
    assert refine_step(solved(problem), FitOptions())[0] is not None
    finer, error = refine_step(replace(solved(problem), problem=exact), FitOptions())
    assert finer is None
    assert error == 0.0


@pytest.mark.parametrize(
    ("ratio", "allowed"),
    [(0.01, STEP_REFINEMENT_NOISE_SHARE * 0.01), (1.0, STEP_REFINEMENT_NOISE_SHARE), (100.0, MISFIT_SHARE * 100.0)],
)
def test_an_error_matters_beside_the_noise_or_a_misfit_far_above_or_below_it(ratio, allowed):
    rows = 5000
    record = SimpleNamespace(h=np.ones(rows), y=np.random.default_rng(0).normal(size=(rows, 1)))
    problem = SimpleNamespace(
        step=SimpleNamespace(substeps=1, adaptive=None), records=[record], noise=SimpleNamespace(std=np.ones(1))
    )
    squares, counts = np.array([ratio**2 * rows]), np.array([rows])
    evaluation = Evaluation(float(squares[0]), np.zeros(1), np.eye(1), squares, counts)
    errors = [np.array([share * allowed]) for share in (0.99, 1.01)]
    assert [is_too_coarse(error, problem, evaluation) for error in errors] == [False, True]
