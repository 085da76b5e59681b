"""Operating conditions: what an experiment knows about itself replaces the model's constant there, and is not fitted."""

from dataclasses import replace

import numpy as np
import pytest

from greybox.base.errors import ModelError
from greybox.estimation.optim.ipopt import solve_sparse
from greybox.estimation.optim.methods import minimise
from greybox.estimation.options import FitOptions
from greybox.estimation.transcription.collocation import Collocation
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.multiple_shooting import MultipleShooting
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.segments import SegmentedProblem, cut_in_rows
from models.pneumatic_cylinder import pneumatic_cylinder
from tests.oracles.independent import linear_record, values

SUPPLIES = (7e5, 8e5)
TRUTH = pneumatic_cylinder.free("V_total")


def valve(rows):
    t = np.arange(rows) * 0.01
    return 1.25 * np.cos(0.4 * np.pi * t) + 2.0 * np.cos(1.6 * np.pi * t) + 0.5 * np.sign(np.sin(9.1 * t))


def record(supply, rows=300):
    """The cylinder at one supply pressure, both chambers resting at half of it."""
    data = linear_record(TRUTH.start(P_S=supply), valve(rows), 0.01, [0.0, 0.0, supply / 2, supply / 2])
    return replace(data, name=f"at {supply:g} Pa", conditions={"P_S": supply})


def laid_out(start, data, at_rest=True, conditions=None):
    """The problem of a fit under the conditions of its experiments (or under others)."""
    p = prepare_problem(start, data, {}, FitOptions(at_rest=at_rest))
    given = [e.conditions for e in data] if conditions is None else conditions
    return replace(p, variables=DecisionVector.of(start, p.variables.initial, given))


def fitted(p):
    shooting, zero = p.shooting(), p.variables.here
    first = shooting.evaluate(zero)
    outcome = minimise(shooting.evaluate, zero, *p.variables.bounds(), scale=first.cost, tolerance=1e-13)
    return p.variables.recentre(outcome.z), outcome.cost


def start(factor=1.4):
    return TRUTH.start(**{q.name: factor * q.value for q in TRUTH.free_parameters})


def test_records_at_two_supply_pressures_give_one_set_of_constants():
    data = [record(s) for s in SUPPLIES]
    found, cost = fitted(laid_out(start(), data))
    np.testing.assert_allclose(found.fixed, values(TRUTH), rtol=1e-7)
    blind, much = fitted(laid_out(start(), data, conditions=[{}, {}]))
    assert much > 1e6 * max(cost, 1.0)  # without the conditions no constants explain both records
    assert abs(blind.fixed[TRUTH.system.parameter_names.index("V_total")] / TRUTH.values["V_total"] - 1) > 1e-3


def test_states_at_rest_follow_the_conditions_of_their_experiment():
    p = laid_out(start(), [record(s, 20) for s in SUPPLIES])
    runs = p.shooting().simulate(p.variables.here)
    for e, ((_, x), supply) in enumerate(zip(runs, SUPPLIES, strict=True)):
        np.testing.assert_allclose(x[0, 2:], supply / 2)
        assert p.variables.parameters(p.variables.here, e)[TRUTH.system.parameter_names.index("P_S")] == supply
    assert (
        p.variables.fixed[TRUTH.system.parameter_names.index("P_S")] == TRUTH.values["P_S"]
    )  # the model keeps its own
    moved = p.variables.recentre(np.full(p.variables.size, 0.1))
    np.testing.assert_allclose(moved.initial.guess[:, 2], np.array(SUPPLIES) / 2)


def test_the_slopes_hold_under_conditions():
    p = laid_out(start(), [record(s, 60) for s in SUPPLIES], at_rest=False)
    shooting, n = p.shooting(), p.variables.size
    here = shooting.evaluate(np.zeros(n))
    slopes = [(shooting.evaluate(1e-4 * e).cost - shooting.evaluate(-1e-4 * e).cost) / 2e-4 for e in np.eye(n)]
    np.testing.assert_allclose(here.gradient, slopes, rtol=1e-5, atol=1e-7 * np.abs(here.gradient).max())


def test_a_condition_is_not_fitted_even_where_the_model_leaves_it_free():
    p = laid_out(start().free("P_S"), [record(s, 20) for s in SUPPLIES])
    assert "P_S" not in p.variables.names
    assert set(p.variables.names) == {q.name for q in TRUTH.free_parameters}


def test_an_experiment_without_a_condition_has_the_models_value():
    data = [record(7e5), replace(record(TRUTH.values["P_S"]), conditions={})]
    found, _ = fitted(laid_out(start(), data))
    np.testing.assert_allclose(found.fixed, values(TRUTH), rtol=1e-7)


@pytest.mark.rest
def test_every_transcription_knows_the_conditions():
    data = [record(s, 200) for s in SUPPLIES]
    p = laid_out(start(1.2), data, at_rest=True)
    truth = values(TRUTH)
    segmented = SegmentedProblem.of(p, cut_in_rows(p, 40))
    for continuity in (True, False):
        found = MultipleShooting(segmented, continuity=continuity).solve()
        assert found.status.success
        np.testing.assert_allclose(found.variables.fixed, truth, rtol=1e-7 if continuity else 1e-6)

    states = [x for _, x in segmented.simulate()]
    program = Collocation(p, states, scheme="legendre", elements=2)
    given = program.problem()
    exact = program.interpret(given["start"]).variables
    np.testing.assert_allclose(exact.fixed, p.variables.fixed)
    np.testing.assert_allclose(program.interpret(solve_sparse(**given).z).variables.fixed, truth, rtol=1e-6)


@pytest.mark.parametrize(
    ("conditions", "message"),
    [
        (
            [{"P_s": 7e5}, {}],
            r"experiment 1 of 2: condition 'P_s' is not a parameter of pneumatic_cylinder; did you mean .*'P_S'",
        ),
        (
            [{}, {"P_S": -7e5}],
            r"experiment 2 of 2, its conditions: parameter 'P_S': -700000 Pa lies outside its bounds",
        ),
        (
            [{"K2": 1e-9}, {}],
            r"condition 'K2' is free in the model but not given for experiment 2; give it for every .*, or fix it",
        ),
        ([{"P_s": 1.0}, {"P_S": 1.0}], r"condition 'P_s'.*; .*parameter 'P_S': 1 Pa lies outside"),
    ],
)
def test_conditions_that_do_not_fit_the_model_are_refused_in_words(conditions, message):
    data = [record(s, 20) for s in SUPPLIES]
    with pytest.raises(ModelError, match=message):
        laid_out(start(), data, conditions=conditions)
