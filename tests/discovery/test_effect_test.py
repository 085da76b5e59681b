"""Effects added and removed by hand, and fits from where a refit ended. The rig is simulated without greybox."""

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Experiment, Input, Model, Output, Parameter, State
from greybox.discovery.effect_signal import find_own_variable
from greybox.discovery.effect_test import drop_effect, try_effect
from greybox.discovery.execution import RefitOutcome
from greybox.discovery.findings import DiscoveryRule
from greybox.discovery.holdout import validate_candidate
from greybox.discovery.localisation import localise_residual
from greybox.discovery.problem import DiscoveryProblem
from greybox.estimation.options import FitOptions
from models.micro_actuator import micro_actuator
from tests.support.hidden_rigs import AT_REST, plain_model, simulate_records

NOISE = {"x": 2e-7, "i": 5e-3}


def fit_plain(effects):
    train, test = simulate_records(micro_actuator, effects, tuple(NOISE.values()), rows=1200)
    return gb.fit(plain_model(micro_actuator), train, noise=NOISE, options=AT_REST), test


@pytest.mark.rest
def test_an_effect_is_tried_kept_and_missed_when_it_is_dropped():
    fit, test = fit_plain({"coulomb_friction": {"Fc": 0.05}})
    tried = try_effect(fit, "coulomb_friction", validation=test, nominal=plain_model(micro_actuator))
    assert tried.is_needed
    assert {check.rule: check.passed for check in tried.checks} == {
        DiscoveryRule.CRITERION_GAIN: True,
        DiscoveryRule.EXPLAINED_EXCESS: True,
    }
    assert tried.larger.parameters["Fc"].value == pytest.approx(0.05, rel=0.02)
    assert tried.holdout["x"].explained_fraction > 0.95
    assert not localise_residual(tried.larger).is_missing
    assert tried.model is tried.larger.model
    dropped = drop_effect(tried.larger, "coulomb_friction")
    assert dropped.is_needed
    assert dropped.smaller.misfit["x"].rmse == pytest.approx(fit.misfit["x"].rmse, rel=0.05)


@pytest.mark.rest
def test_an_effect_that_is_not_there_is_not_kept():
    fit, test = fit_plain({})
    tried = try_effect(fit, "cubic_stiffness", validation=test)
    assert not tried.is_needed
    assert not tried.checks[0].passed
    assert tried.model.effects == ()


def test_a_candidate_is_validated_from_the_initial_states_that_it_ended_with():
    """A sign that the record cannot show: the fit stays on the side of the candidate, and the declared start is not used."""
    squared = Model(
        "squared",
        states=[State("x", "m", 1.0, (-5.0, 5.0))],
        inputs=[Input("u", "m/s")],
        outputs=[Output("y", "m**2", lambda x, u, p: x.x**2)],
        parameters=[Parameter("k", "1/s", 2.0, (0.1, 10.0), source="a test")],
        balances=lambda x, u, p: [Balance("rate", "m/s", 1, "x", decay=-p.k * x.x, drive=u.u)],
    )
    t = np.arange(120) * 0.01
    y = (2.0 * np.exp(-3 * t)) ** 2
    record = Experiment.from_arrays(t, {"u": 0 * t}, {"y": y}, allow_constant_input=True)
    problem = DiscoveryProblem(squared, (record,), {"y": 1e-3}, (), FitOptions())
    candidate = problem.restore(squared, RefitOutcome({"k": 2.9}, ((-1.9,),)))
    fit = validate_candidate(problem, candidate, ())
    assert fit.traces[0].initial_state["x"] == pytest.approx(-2.0, rel=1e-6)
    assert fit.parameters["k"].value == pytest.approx(3.0, rel=1e-6)
    baseline = validate_candidate(problem, problem.baseline, ())
    assert baseline.traces[0].initial_state["x"] == pytest.approx(2.0, rel=1e-6)


@pytest.mark.crossed(3)
@pytest.mark.parametrize(
    ("name", "variable"),
    [("cubic_stiffness", "x"), ("cubic_damping", "v"), ("coulomb_friction", "v"), ("viscoelastic_creep", "")],
)
def test_an_effect_has_the_variable_of_which_it_adds_a_function(name, variable):
    record = simulate_records(micro_actuator, {}, tuple(NOISE.values()), rows=600)[0]
    problem = DiscoveryProblem(plain_model(micro_actuator), (record,), NOISE, (), AT_REST)
    candidate = problem.baseline
    model = candidate.model + gb.effect(name)
    amplitude = model.bound_effects[-1].model_names[gb.effect(name).amplitudes[0]]
    values = {**model.values, amplitude: 1.0}
    states = ((0.0,) * len(model.system.state_names),)
    extended = problem.restore(model, RefitOutcome(values, states))
    assert find_own_variable(extended, name) == variable
