"""The curve in the place of an effect that the catalogue does not have, and what is proposed then. Rigs simulated without greybox."""

from types import SimpleNamespace

import numpy as np
import pytest

import greybox as gb
from greybox.base.values import with_code
from greybox.discovery import surrogate
from greybox.discovery.curve_shape import Parity, ShapeKind
from greybox.discovery.disturbance_sites import list_disturbance_sites
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.localisation import localise_residual
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.proposals import propose_next_steps, propose_noise_check
from greybox.discovery.surrogate import find_missing_sites
from greybox.discovery.surrogate_effects import make_power_effect
from greybox.estimation.findings import EstimationCode
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder
from tests.support.hidden_rigs import AT_REST, plain_model, simulate_records
from tests.support.stand_in import find_stand_in

POLICY = DiscoveryPolicy()
COGGING = {"cogging": {"F": -4.0, "pitch": 0.01}}


def fit_surrogate(rig, effects, noise, rows):
    """The plain fit, what it leaves unexplained, the curve in its place, and the validation record."""
    train, test = simulate_records(rig, effects, tuple(noise.values()), rows=rows)
    base = gb.fit(plain_model(rig), train, validation=test, noise=noise, options=AT_REST)
    problem = DiscoveryProblem(plain_model(rig), (train,), noise, (), AT_REST)
    location = localise_residual(problem.baseline)
    return base, location, find_stand_in(problem, test), test


@pytest.mark.rest
def test_a_force_that_repeats_with_the_position_has_its_period():
    base, location, surrogate, test = fit_surrogate(pneumatic_cylinder, COGGING, {"s": 2e-4}, rows=400)
    assert location.likeliest[0] == "balance force"
    assert location.dependences[0].variable == "s"
    assert location.dependences[0].period == pytest.approx(0.01, rel=0.02)
    pitch = surrogate.fit.parameters["pitch"]
    assert abs(pitch.value - 0.01) < min(4 * pitch.std, 1e-4)
    assert surrogate.explained_fraction > 0.95
    assert np.abs(surrogate.curve).max() == pytest.approx(4.0, rel=0.05)
    assert surrogate.shape.kind is ShapeKind.PERIODIC
    assert surrogate.site == "balance force"
    assert 3.0 < surrogate.amplitude < 5.0
    codes = {f.code for f in propose_next_steps(base, location, surrogate, (test,), POLICY)}
    assert DiscoveryCode.SUSPECT_PERIODIC_PART in codes
    assert DiscoveryCode.MEASURE_MORE not in codes  # enough is known without other sensors


@pytest.mark.slow
def test_a_stop_has_the_position_where_it_begins():
    _, _, surrogate, _ = fit_surrogate(
        micro_actuator, {"end_stop": {"gap": 4e-5, "kc": 6000.0}}, {"x": 2e-7, "i": 5e-3}, rows=600
    )
    assert surrogate.variable == "x"
    assert surrogate.explained_fraction > 0.9
    assert surrogate.shape.kind is ShapeKind.FLAT_MIDDLE
    assert surrogate.shape.position == pytest.approx(4e-5, rel=0.1)


@pytest.mark.slow
def test_a_dead_zone_seen_through_a_resonance_is_found_at_the_input():
    """The localisation by a slowly varying signal has it elsewhere: a curve where curves are usual is refitted with the model."""
    _, location, surrogate, _ = fit_surrogate(micro_actuator, {"input_dead_zone": {"d": 0.3}}, {"x": 2e-7}, rows=400)
    assert (surrogate.site, surrogate.variable) == ("input u", "u")
    assert surrogate.explained_fraction > 0.9
    assert surrogate.shape.parity is Parity.ODD
    assert find_missing_sites(location, surrogate) == location.likeliest  # the input is one of these
    elsewhere = SimpleNamespace(likeliest=("sensor of x",))
    assert find_missing_sites(elsewhere, surrogate) == ("input u",)
    assert find_missing_sites(elsewhere, None) == ("sensor of x",)


@pytest.mark.rest
def test_a_validation_record_that_reaches_beyond_the_estimation_records_is_reported():
    base, location, surrogate, test = fit_surrogate(pneumatic_cylinder, COGGING, {"s": 2e-4}, rows=300)
    far = gb.Experiment("far", test.time, test.inputs, {"s": 3 * test.outputs["s"]})
    proposals = propose_next_steps(base, location, surrogate, (far,), POLICY)
    (beyond,) = with_code(proposals, EstimationCode.VALIDATION_BEYOND_RANGE)
    assert beyond.subject == "s"
    assert beyond.values["most"] > beyond.values["high"]
    same = base.traces[0].experiment
    without_curve = propose_next_steps(base, location, None, (same,), POLICY)
    (more,) = with_code(without_curve, DiscoveryCode.MEASURE_MORE)
    assert more.values["outputs"] == ["p_a", "p_b"]
    # The signal is a function of the position: to trace it shows the cause, and a memory is none.
    (trace,) = with_code(without_curve, DiscoveryCode.TRACE_CURVE)
    assert trace.subject == "s"
    assert not with_code(without_curve, DiscoveryCode.SUSPECT_MEMORY)
    beside = propose_next_steps(base, location, None, (same,), POLICY, "coulomb_friction")
    assert beside[0].code == DiscoveryCode.CONTINUE_WITH_LOOK_ALIKE
    assert beside[0].subject == "coulomb_friction"
    assert not with_code(beside, DiscoveryCode.TRACE_CURVE)


def test_an_estimated_noise_is_doubted_where_nothing_seems_missing():
    train, _ = simulate_records(pneumatic_cylinder, {}, (2e-4,), rows=300)
    model = plain_model(pneumatic_cylinder)
    (doubt,) = propose_noise_check(gb.fit(model, train, options=AT_REST))
    assert doubt.code == DiscoveryCode.CHECK_NOISE
    assert doubt.values["outputs"] == ["s"]
    assert propose_noise_check(gb.fit(model, train, noise={"s": 2e-4}, options=AT_REST)) == ()


@pytest.mark.parametrize("power", [0.3, 0.5, 2.0])
def test_a_power_starts_as_the_signal_shows_it(power):
    v = np.random.default_rng(2).normal(0.0, 0.1, 400)
    signal = -4.0 * np.sign(v) * np.abs(v) ** power + 7.0 * v  # the model has the straight part
    dependence = SimpleNamespace(variable="v", unit="m/s", shape=SimpleNamespace(parity=Parity.ODD))
    site = next(s for s in list_disturbance_sites(micro_actuator, ["x"]) if s.name == "force")
    effect = make_power_effect(site, dependence, v, signal)
    start, size = effect.probe(None), effect.parameters[0].value
    assert effect.parameters[-1].value == power
    assert start["height"] == pytest.approx(-4.0 * size**power, rel=0.02)
    named = {q.name: q.value for q in effect.parameters} | start
    added = effect.terms({"v": 0.05}, None, SimpleNamespace(**named))
    assert added == pytest.approx(-4.0 * 0.05**power, rel=0.02)


def test_a_curve_that_the_table_has_behind_the_look_alike_is_not_finished(monkeypatch):
    """Finishing it took six times as long as the search, and nobody saw it."""
    sums = {"plain": SimpleNamespace(judged_rms=np.array([20.0])), "curve": SimpleNamespace(judged_rms=np.array([6.0]))}
    search = SimpleNamespace(
        baseline="plain", table=SimpleNamespace(sums=sums.get), policy=DiscoveryPolicy(), places={"curve": None}
    )
    monkeypatch.setattr(surrogate, "add_free_forms", lambda *_: None)
    monkeypatch.setattr(surrogate, "_find_best", lambda *_: "curve")
    nearest = SimpleNamespace(effects=("coulomb_friction",))
    answer = SimpleNamespace(search=search, candidate=nearest, plain=None, explained_fraction=0.95)
    assert surrogate.fit_stand_in(answer) is None
