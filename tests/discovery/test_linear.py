"""What effects add along a run, to first order, against the difference of two whole runs; and what the screen promises of it."""

import numpy as np
import pytest

import greybox as gb
from greybox.discovery.candidates import estimate_scales, list_candidates
from greybox.discovery.execution import FailureLog
from greybox.discovery.holdout import HoldoutScores, ValidationSet
from greybox.discovery.linear import LinearRun
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.table import linearise_set
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder

ROWS = 400


def record(model, seed, values):
    """A run of a model over held steps, at rest before."""
    rng = np.random.default_rng(seed)
    step = {"micro_actuator": 2.5e-4, "pneumatic_cylinder": 0.01}[model.name]
    time, u = step * np.arange(ROWS), np.repeat(rng.uniform(-1, 1, ROWS // 20), 20)
    given = {model.inputs[0].name: u}
    run = gb.simulate(model.start(**values), {"time": time, **given}, substeps=32)
    return gb.Experiment(f"run {seed}", time, given, {o.name: run.outputs[o.name] for o in model.outputs})


def linear_run(model):
    """A model along a record of its own."""
    records = [record(model, seed, {}) for seed in (1, 2)]
    noise = {o.name: 1e-3 * float(np.ptp(records[0].outputs[o.name])) for o in model.outputs}
    problem = DiscoveryProblem(model, (records[0],), noise, (), gb.FitOptions(at_rest=True))
    slopes = linearise_set(HoldoutScores(problem, ValidationSet((records[1],))), problem.baseline, 24)
    return LinearRun(slopes), records[0], problem


@pytest.fixture(scope="module")
def actuator():
    return linear_run(micro_actuator)


@pytest.fixture(scope="module")
def cylinder():
    return linear_run(pneumatic_cylinder)


@pytest.mark.parametrize(
    ("rig", "name", "values", "close"),
    [
        ("actuator", "cubic_stiffness", {"K3": 1e8}, 0.02),  # a force
        ("actuator", "coulomb_friction", {"Fc": 1e-4}, 0.05),  # one that has no slope
        ("actuator", "viscoelastic_creep", {"K1": 50.0, "tau1": 0.02}, 0.1),  # with a state of its own
        ("actuator", "input_saturation", {"u_max": 0.9}, 0.1),  # at the input
        ("actuator", "sensor_lag", {"tau_s": 5e-5}, 0.1),  # at a sensor, with a state
        ("actuator", "transport_delay", {"delay": 5e-4}, 0.02),  # of two rows
        ("cylinder", "valve_lag", {"tau_v": 2e-3}, 0.3),  # stiff beside the sampling
        ("cylinder", "backlash", {}, 0.1),  # set after each step
    ],
)
def test_a_small_effect_adds_what_the_difference_of_two_runs_shows(rig, name, values, close, request):
    run, experiment, problem = request.getfixturevalue(rig)
    fitted = run.candidate.model
    effect = gb.effect(name)
    model = fitted + effect
    names = model.names_of(name)
    if not values:
        values = effect.probe(estimate_scales(problem.baseline))
    inner = {names[n]: v for n, v in values.items()}
    given = {"time": experiment.time, **experiment.inputs}
    with_it, without = (gb.simulate(m, given, substeps=32).outputs for m in (model.start(**inner), fitted))
    (added,) = run.predict(effect, inner)
    for j, output in enumerate(model.outputs):
        difference = with_it[output.name] - without[output.name]
        size = np.sqrt(np.mean(difference**2))
        # What is no larger than rounding in an output that the effect hardly reaches says nothing.
        if size > 1e-6 * np.ptp(without[output.name]):
            assert np.sqrt(np.mean((added[:, j] - difference) ** 2)) / size < close, output.name


def test_the_effect_that_is_missing_promises_most():
    hidden = micro_actuator + gb.effect("cubic_stiffness")
    records = [record(hidden, seed, {"K3": 1e10}) for seed in (3, 4)]
    noise = {"x": 2e-7, "i": 5e-3}
    problem = DiscoveryProblem(micro_actuator, (records[0],), noise, (), gb.FitOptions(at_rest=True))
    scales = estimate_scales(problem.baseline)
    listed = list_candidates(micro_actuator, scales, FailureLog())
    slopes = linearise_set(HoldoutScores(problem, ValidationSet((records[1],))), problem.baseline, 24)
    promises = LinearRun(slopes).screen(listed.effects, scales, problem.failures)
    first = promises[0]
    assert first.effect.name == "cubic_stiffness"
    # Its amplitude stands at the value that the step asks for, near the true one.
    assert first.starts[0]["K3"] == pytest.approx(1e10, rel=0.3)
    assert not problem.failures.entries
    # Of an effect that can only take one sign no other is proposed.
    assert all(p.starts[0]["Fc"] >= 0 for p in promises if p.effect.name == "coulomb_friction")
