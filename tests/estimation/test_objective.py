"""Simulation error and prediction error are two objectives over one decision vector: their derivatives, rows and steps."""

import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from greybox import FitOptions, fit
from greybox.data.noise.noise_model import AutoRegression
from greybox.estimation.findings import compute_lag_one_correlation
from greybox.estimation.objective import (
    PredictionErrorObjective,
    SimulationErrorObjective,
    hold_parameters,
    refine_minimum,
    search_minimum,
)
from greybox.estimation.optimum import restore_objective
from greybox.estimation.transcription.preparation import prepare_problem
from tests.support.pushed_mass import INTENSITY, LEVEL, MASS, record

KINDS = {"simulation": SimulationErrorObjective, "prediction": PredictionErrorObjective}


@cache
def optimum(kind):
    """The objective of a fit with gaps, a prior and estimated first states, at its optimum."""
    data = record(3, intensity=INTENSITY if kind == "prediction" else 0.0, x0=[1.0, -0.5])
    x = data.outputs["x"].copy()
    x[20:30] = np.nan
    model = MASS.with_process_noise("v") if kind == "prediction" else MASS
    noise = None if kind == "prediction" else LEVEL
    return restore_objective(fit(model.prior(B=(0.5, 0.1)), data.with_outputs({**data.outputs, "x": x}), noise=noise))


@pytest.mark.parametrize("kind", KINDS)
def test_the_gradient_is_that_of_the_cost(kind):
    objective = optimum(kind)
    assert isinstance(objective, KINDS[kind])
    size = objective.variables.size
    z = 0.05 * np.cos(np.arange(size))
    gradient, e = objective.evaluate(z).gradient, 1e-5
    for k, axis in enumerate(np.eye(size)):
        rise = objective.evaluate(z + e * axis).cost - objective.evaluate(z - e * axis).cost
        assert gradient[k] == pytest.approx(rise / (2 * e), rel=1e-5, abs=1e-4 * np.abs(gradient).max())


@pytest.mark.parametrize("kind", KINDS)
def test_the_rows_add_up_to_the_quadratic_model(kind):
    objective = optimum(kind)
    v, residuals = objective.variables, objective.linearise()
    evaluation = objective.evaluate(v.here)
    _, slope, curvature = v.penalty(v.here)
    rest = v.size - len(v.which)
    score = sum(s.sum(axis=0) for s in residuals.scores)
    np.testing.assert_allclose(2 * score + np.pad(slope, (0, rest)), evaluation.gradient, atol=1e-6)
    information = residuals.compute_information(v) + np.diag(np.pad(curvature / 2, (0, rest)))
    np.testing.assert_allclose(information, evaluation.hessian / 2, rtol=1e-9, atol=1e-9 * np.abs(information).max())


@pytest.mark.parametrize("kind", KINDS)
def test_the_noise_levels_are_one_more_slice(kind):
    variables = optimum(kind).variables
    estimated = 2 if kind == "prediction" else 0
    assert len(variables.split(variables.here).noise_levels) == estimated


@pytest.mark.parametrize("kind", KINDS)
def test_half_the_step_is_nearer_to_the_exact_one(kind):
    data = record(3, intensity=INTENSITY, x0=[1.0, -0.5])
    model = MASS.with_process_noise(v=INTENSITY) if kind == "prediction" else MASS
    costs = {}
    for method, substeps in (("exact", 0), ("rk4", 1)):
        options = FitOptions(method=method, substeps=substeps)
        problem = prepare_problem(model, data, LEVEL, options)
        simulation = kind == "simulation"
        objective = SimulationErrorObjective(problem) if simulation else PredictionErrorObjective.of(problem)
        here = objective.variables.here
        costs[method] = objective.evaluate(here).cost
        costs["halves"] = objective.halve_step().evaluate(here).cost
    assert abs(costs["halves"] - costs["exact"]) < 0.2 * abs(costs["rk4"] - costs["exact"])


@pytest.mark.parametrize("kind", KINDS)
def test_a_few_steps_nearby_find_what_a_search_finds(kind):
    objective, options = optimum(kind), FitOptions()
    held = hold_parameters(objective, {"K": 1.02 * objective.variables.model.values["K"]})
    assert held.variables.size == objective.variables.size - 1
    near, far = refine_minimum(held, options), search_minimum(held, options)
    assert near.status.success and far.status.success
    assert near.evaluation.cost == pytest.approx(far.evaluation.cost, abs=1e-4)
    assert near.evaluation.cost > objective.evaluate(objective.variables.here).cost


def test_slopes_whose_squares_overflow_are_a_point_that_cannot_be_reached(monkeypatch):
    """Warnings are errors: a trial point far off is left, as one where the run itself overflows."""
    objective = optimum("prediction")
    (slopes,) = objective.slopes(objective.variables.here)
    steep = replace(slopes, dlog_variance=1e200 * slopes.dlog_variance)
    monkeypatch.setattr(PredictionErrorObjective, "slopes", lambda *_: [steep])
    evaluation = objective.evaluate(objective.variables.here)
    assert evaluation.cost == np.inf and evaluation.failed == (0, 0)


@pytest.mark.skipif(sys.implementation.name != "cpython", reason="counts references")
def test_the_errors_of_a_long_record_are_given_back_while_they_are_whitened(monkeypatch):
    """A name that is left for them keeps them in memory beside the whitened ones, three times the size of a record."""
    problem = prepare_problem(MASS, record(3), LEVEL, FitOptions())
    shooting = problem.shooting()
    references = []
    monkeypatch.setattr(
        type(shooting), "reweigh", lambda _, errors: references.extend(map(sys.getrefcount, errors[0])) or errors
    )
    runs, _ = shooting.linearise(problem.variables.here)
    assert references == [2, 2]  # the list's and the argument's
    assert runs[0][0] == pytest.approx(shooting.simulate(problem.variables.here)[0][0], abs=1e-12)


@pytest.mark.parametrize("rows", [1, 7, 100_000])
def test_the_correlation_of_neighbours_is_the_same_however_many_rows_are_looked_at_together(monkeypatch, rows):
    monkeypatch.setattr("greybox.estimation.findings.ROWS_AT_A_TIME", rows)
    data = record(3, rows=100)
    x = data.outputs["x"].copy()
    x[[0, 20, 21, 99]] = np.nan
    traces = fit(MASS, data.with_outputs({**data.outputs, "x": x}), noise=LEVEL).traces
    r = traces[0].residual("x")
    expected = np.nansum(r[1:] * r[:-1]) / np.nansum(r**2)
    assert compute_lag_one_correlation(traces, "x") == pytest.approx(expected, rel=1e-12)


def test_a_long_record_is_whitened_in_its_place_to_the_same_numbers(monkeypatch):
    data = record(3)
    x = data.outputs["x"].copy()
    x[20:30] = np.nan
    colour = {name: AutoRegression((0.6, -0.2)) for name in LEVEL}
    problem = prepare_problem(MASS, data.with_outputs({**data.outputs, "x": x}), LEVEL, FitOptions())
    problem = replace(problem, noise=replace(problem.noise, colour=tuple(colour.values())))
    usual = problem.shooting().residuals(problem.variables.here)
    monkeypatch.setattr("greybox.estimation.transcription.shooting_cost.NUMBERS_AT_A_TIME", 10)
    for computed, expected in zip(problem.shooting().residuals(problem.variables.here)[0], usual[0], strict=True):
        assert np.array_equal(computed, expected, equal_nan=True)
        assert np.isnan(expected).any() and not np.isnan(expected).all()
