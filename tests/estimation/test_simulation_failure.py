"""A run that breaks is reported with the balance, the term, the time and the states."""

import casadi as ca
import numpy as np

from greybox.estimation.findings import EstimationCode, locate_simulation_failure
from greybox.estimation.options import FitOptions
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.model.balance import Balance
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State
from tests.oracles.independent import experiment
from tests.support.explosive import explosive


def tank(start=1.0, output=None, bounds=(-np.inf, np.inf)):
    """Level that is drained by a pump, with Torricelli's outflow: the root of a negative level once it is empty."""
    return Model(
        "tank",
        [State("level", "m", start, bounds)],
        [Input("pump", "m/s")],
        [Output("level", "m", output)],
        [Parameter("k", "m**0.5/s", 0.1, (1e-3, 1.0)), Parameter("edge", "m", 0.9, fixed=True)],
        lambda x, u, p: [Balance("volume", "m/s", 1, "level", pump=-u.pump, outflow=-p.k * ca.sqrt(x.level))],
    )


def failure_of(model, rows=200):
    """What failed in a run of ``model``, and where its evaluation failed."""
    time = np.arange(rows) * 0.1
    data = experiment(model, time, np.full((rows, 1), 0.1), np.ones((rows, 1)))
    problem = prepare_problem(model, data, {"level": 0.1}, FitOptions(at_rest=True, method="rk4", substeps=1))
    failed = problem.shooting().evaluate(problem.variables.here).failed
    return locate_simulation_failure(problem, problem.variables, *failed), failed


def point(failure):
    return {q["name"]: float(q["value"]) for q in failure.values["point"]}


def test_the_term_that_is_not_a_number_is_named_with_time_and_state():
    failure, (_, sample) = failure_of(tank())
    values = failure.values
    assert (failure.code, failure.subject) == (EstimationCode.TERM_NOT_FINITE, "outflow")
    assert (values["kind"], values["balance"], values["value"]) == ("term", "volume", "nan")
    assert "sqrt" in values["formula"] and values["time"] == (sample - 1) * 0.1
    assert point(failure)["level"] < 0 and point(failure)["pump"] == 0.1


def test_an_impossible_start_is_found_in_the_first_row():
    failure, _ = failure_of(tank(start=-1.0))
    assert (failure.values["time"], failure.values["row"], failure.subject) == (0.0, 1, "outflow")
    assert point(failure)["level"] == -1.0


def test_an_output_that_is_not_a_number_is_named():
    failure, _ = failure_of(tank(output=lambda x, u, p: ca.sqrt((x.level - p.edge) * x.level)))
    assert (failure.values["kind"], failure.subject, failure.values["value"]) == ("output", "level", "nan")


def test_states_that_diverge_are_named():
    model = explosive()
    data = experiment(model, np.arange(100) * 0.1, np.ones((100, 1)), np.ones((100, 1)))
    problem = prepare_problem(model, data, {"x": 0.1}, FitOptions(at_rest=True, method="rk4", substeps=1))
    failed = problem.shooting().evaluate(problem.variables.here).failed
    failure = locate_simulation_failure(problem, problem.variables, *failed)
    assert failure.values["experiment"] == 1
    assert failure.code == EstimationCode.STATES_DIVERGE or failure.subject == "square"


def test_a_sensitivity_alone_that_is_not_finite_is_a_finding_of_its_own():
    model = tank()
    data = experiment(model, np.arange(20) * 0.01, np.zeros((20, 1)), np.ones((20, 1)))
    problem = prepare_problem(model, data, {"level": 0.1}, FitOptions(at_rest=True, method="rk4", substeps=1))
    failure = locate_simulation_failure(problem, problem.variables, 0, 20)
    assert failure.code == EstimationCode.SENSITIVITY_NOT_FINITE and failure.values["experiment"] == 1
