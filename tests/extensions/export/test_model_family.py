"""Linear models with their uncertainty: draws respect covariance and bounds, bounds hold, the worst case is the worst."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.signal import cont2discrete, dlsim

import greybox as gb
from greybox.data.signals import multisine
from greybox.estimation.linear.exported_model import ExportFinding, to_plant
from greybox.estimation.linear.model_family import make_parameter_distribution
from greybox.simulation.simulate import simulate_twin
from models.micro_actuator import micro_actuator

NOISE = {"x": 2e-6, "i": 5e-2}


@pytest.fixture(scope="module")
def fit():
    t = np.arange(2000) * 2.5e-4
    u = multisine(t, 5, 800, 2, np.random.default_rng(0))
    record = simulate_twin(micro_actuator, {"u": u}, 2.5e-4, NOISE, seed=1)
    return gb.fit(micro_actuator.fix("M", "Ra"), record, noise=NOISE)


def test_draws_have_the_covariance_of_the_fit(fit):
    distribution, rng = make_parameter_distribution(to_plant(fit)), np.random.default_rng(0)
    draws = np.array([distribution.draw(rng)[distribution.indices] for _ in range(4000)])
    expected = np.sqrt(np.diag(fit.uncertainty.covariance))
    np.testing.assert_allclose(draws.std(axis=0), expected, rtol=0.1)
    found = np.corrcoef(draws.T)
    np.testing.assert_allclose(found, fit.uncertainty.covariance / np.outer(expected, expected), atol=0.08)


def test_draws_respect_the_bounds(fit):
    low = fit.model.values["B"] * 0.999
    narrow = replace(fit, model=fit.model.bound(B=(low, 1.0)))
    values = gb.export.sample_family(narrow, number=40).parameters[:, list(fit.model.values).index("B")]
    assert values.min() >= low
    assert values.max() > fit.model.values["B"]


def test_the_same_seed_draws_the_same_family(fit):
    one, two, other = (gb.export.sample_family(fit, number=3, seed=s) for s in (5, 5, 6))
    np.testing.assert_array_equal(one.parameters, two.parameters)
    assert not np.array_equal(one.parameters, other.parameters)


def test_pole_bounds_are_those_of_linear_propagation(fit):
    family = gb.export.sample_family(fit, number=200)
    slow = family.poles[:, 0]
    slope = []
    for name in fit.uncertainty.free:
        step = 1e-5 * fit.model.values[name]
        moved = [gb.linearise(fit.model.start(**{name: fit.model.values[name] + s * step})).poles[0] for s in (1, -1)]
        slope.append((moved[0] - moved[1]) / (2 * step))
    expected = np.sqrt(np.real(slope) @ fit.uncertainty.covariance @ np.real(slope))
    assert slow.real.std() == pytest.approx(expected, rel=0.15)


def test_pole_bounds_hold_their_share(fit):
    family = gb.export.sample_family(fit, number=60)
    real, imag = family.pole_bounds(0.9)
    for k, pole in enumerate(family.nominal.poles):
        inside = (family.poles[:, k].real >= real[k, 0]) & (family.poles[:, k].real <= real[k, 1])
        assert 0.85 <= inside.mean() <= 0.95 and real[k, 0] < pole.real < real[k, 1]
        assert imag[k, 0] <= abs(pole.imag) <= imag[k, 1]


def test_a_fit_as_mat_gives_scipy_the_response_of_the_fit(fit, tmp_path):
    found = loadmat(gb.export.write_linear(fit, tmp_path / "plant.mat", "mat"))
    t = 2.5e-4 * np.arange(300)
    u = np.sign(np.sin(300 * t))
    held = cont2discrete(tuple(found[name] for name in "ABCD"), t[1], "zoh")
    _, y, _ = dlsim(held, u)
    run = gb.simulate(fit.model, {"time": t, "u": u})
    for j, values in enumerate(run.outputs.values()):
        np.testing.assert_allclose(y[:, j], values, rtol=0, atol=1e-11 * np.abs(values).max())
    names = [str(entry[0][0]) for entry in found["covariance_names"]]
    np.testing.assert_array_equal(found["covariance_values"], fit.uncertainty.covariance)
    assert names == list(fit.uncertainty.free)


def test_frequency_bounds_contain_the_nominal_and_most_members(fit):
    family, w = gb.export.sample_family(fit, number=60), np.geomspace(10, 1e4, 25)
    low, high = family.bounds(w, 0.9)
    nominal = np.abs(family.nominal.frequency_response(w))
    assert np.all((low <= nominal) & (nominal <= high))
    size = np.abs(family.frequency_response(w))
    inside = ((size >= low) & (size <= high)).mean(axis=0)
    assert inside.min() >= 0.85
    radius = family.relative_error(w)
    home = family.nominal.frequency_response(w)
    away = np.abs(family.frequency_response(w) / home - 1)
    np.testing.assert_allclose(radius, away.max(axis=0), rtol=1e-9)


def test_the_worst_case_of_a_linear_criterion_is_the_edge_of_the_ellipsoid(fit):
    family = gb.export.sample_family(fit, number=20)
    worst = family.worst(lambda model: model.parameters["K"], level=0.95)
    at = family.distribution.names.index("K")
    reach = np.linalg.norm(family.distribution.root[at]) * np.sqrt(11.070497693516351)  # chi-square, 5 degrees, 95 %
    assert worst.nominal == fit.model.values["K"]
    assert worst.value == pytest.approx(worst.nominal + reach, rel=1e-6)
    members = max(member.parameters["K"] for member in family.members)
    assert worst.value > members * (1 - 1e-3)


def test_a_constant_without_covariance_stays_where_it_is(fit):
    covariance = fit.uncertainty.covariance.copy()
    k = fit.uncertainty.free.index("La")
    covariance[k], covariance[:, k] = np.nan, np.nan
    family = gb.export.sample_family(
        replace(fit, uncertainty=replace(fit.uncertainty, covariance=covariance)), number=5
    )
    column = list(fit.model.values).index("La")
    assert np.all(family.parameters[:, column] == fit.model.values["La"])
    (finding,) = family.findings
    assert finding.code == ExportFinding.PARAMETERS_NOT_DRAWN and finding.values["parameters"] == ["La"]


def test_the_family_prints_its_spread(fit):
    text = str(gb.export.sample_family(fit, number=20))
    assert "20 models drawn from the covariance of B, K, Kf, Kv, La (seed 0)" in text
    assert "gain u -> x" in text
    assert re.search(r"response u -> x up to 1\d\d\d\.?\d* rad/s: within \d\.?\d* % of the nominal one", text)


def test_a_minimal_family_has_the_same_states_throughout(fit, tmp_path):
    idle = (fit.model + gb.effect("winding_heating")).start(Rth=0.1)  # heat goes with the square of the current
    family = gb.export.sample_family(replace(fit, model=idle), number=4, dt=2.5e-4, delay=1e-4, minimal=True)
    assert {m.state_names for m in (family.nominal, *family.members)} == {("x", "v", "i", "u_1")}
    path = gb.export.write_linear(replace(fit, model=idle), tmp_path / "p", "numpy", samples=3, minimal=True)
    assert np.load(path)["family_A"].shape == (3, 3, 3)


def test_what_cannot_be_drawn_is_refused(fit):
    with pytest.raises(gb.errors.ModelError, match="is not a fit: it has no covariance"):
        gb.export.sample_family(micro_actuator)
    with pytest.raises(gb.errors.ModelError, match="a family of 1: give at least 2"):
        gb.export.sample_family(fit, number=1)
    with pytest.raises(gb.errors.ModelError, match="no fitted parameter has a covariance"):
        gb.export.sample_family(
            replace(
                fit, uncertainty=replace(fit.uncertainty, covariance=np.full_like(fit.uncertainty.covariance, np.nan))
            )
        )


def test_a_failed_fit_is_said(fit):
    failed = replace(fit, solver=replace(fit.solver, success=False, status="iteration_limit"))
    finding = gb.linearise(failed).findings[0]
    assert finding.code == ExportFinding.FIT_FAILED
    assert finding.values["status"] == "iteration_limit"
