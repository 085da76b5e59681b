"""A run that breaks is reported with the balance, the term, the time and the states."""

import casadi as ca
import numpy as np

from greybox.estimation.problem import prepare_problem
from greybox.estimation.simulation_failure import describe_simulation_failure
from greybox.model import Balance, Model
from greybox.model.signals import Input, Output, Parameter, State
from tests.estimation.test_fit import explosive
from tests.oracles.independent import experiment


def tank(start=1.0, output=None, bounds=(-np.inf, np.inf)):
    """Level that is drained by a pump, with Torricelli's outflow: the root of a negative level once it is empty."""
    return Model(
        "tank", [State("level", "m", start, bounds)], [Input("pump", "m/s")], [Output("level", "m", output)],
        [Parameter("k", "m**0.5/s", 0.1, (1e-3, 1.0)), Parameter("edge", "m", 0.9, fixed=True)],
        lambda x, u, p: [Balance("volume", "m/s", 1, "level", pump=-u.pump, outflow=-p.k * ca.sqrt(x.level))],
    )  # fmt: skip


def told(model, rows=200):
    time = np.arange(rows) * 0.1
    data = experiment(model, time, np.full((rows, 1), 0.1), np.ones((rows, 1)))
    problem = prepare_problem(model, data, {"level": 0.1}, at_rest=True, method="rk4", substeps=1)
    failed = problem.shooting(problem.variables).evaluate(np.zeros(problem.variables.size)).failed
    return describe_simulation_failure(problem, problem.variables, *failed), failed


def test_the_term_that_is_not_a_number_is_named_with_time_and_state():
    text, (_, sample) = told(tank())
    assert "in the balance 'volume' the term 'outflow'" in text and "sqrt" in text and "is nan m/s" in text
    assert f"t = {(sample - 1) * 0.1:.6g} s" in text
    assert "level = -" in text and "pump = 0.1 m/s" in text


def test_a_start_that_is_impossible_is_found_in_the_first_row():
    text, _ = told(tank(start=-1.0))
    assert "t = 0 s (row 1)" in text and "'outflow'" in text and "level = -1 m" in text


def test_an_output_that_is_not_a_number_is_named():
    text, _ = told(tank(output=lambda x, u, p: ca.sqrt((x.level - p.edge) * x.level)))
    assert "the output 'level' (sqrt" in text and "is nan m" in text


def test_states_that_run_away_are_named():
    model = explosive()
    data = experiment(model, np.arange(100) * 0.1, np.ones((100, 1)), np.ones((100, 1)))
    problem = prepare_problem(model, data, {"x": 0.1}, at_rest=True, method="rk4", substeps=1)
    failed = problem.shooting(problem.variables).evaluate(np.zeros(problem.variables.size)).failed
    text = describe_simulation_failure(problem, problem.variables, *failed)
    assert "experiment 1 fails at t =" in text and ("run away" in text or "'square'" in text)


def test_a_sensitivity_alone_that_is_not_finite_is_told_apart():
    model = tank()
    data = experiment(model, np.arange(20) * 0.01, np.zeros((20, 1)), np.ones((20, 1)))
    problem = prepare_problem(model, data, {"level": 0.1}, at_rest=True, method="rk4", substeps=1)
    assert "its slope along the constants is not finite" in describe_simulation_failure(
        problem, problem.variables, 0, 20
    )
