"""Priors: against the analytic posterior of a linear regression, and what the result says of them."""

import numpy as np
import pytest
from scipy.linalg import expm

from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State, effect, fit, load_fit
from greybox.base.errors import ModelError
from greybox.estimation.findings import EstimationCode
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.uncertainty import bootstrap, profile
from greybox.show import text
from models.micro_actuator import micro_actuator
from tests.oracles.independent import linear_record, multisine
from tests.support.findings import find
from tests.support.linear_regression import LINE, NOISE, REST, regression

LEVEL = {"x": 2e-7, "i": 5e-3}


def actuator(seed=1):
    truth = micro_actuator.fix("M", "Ra")
    u = multisine(np.random.default_rng(seed), 1200, 2.5e-4, 5, 800, 3.0)
    return linear_record(truth, u, 2.5e-4, noise=LEVEL, seed=seed)


def posterior(design, y, mean, std):
    """Mean and covariance of a normal posterior; infinite ``std`` is no prior."""
    weight = np.where(np.isfinite(std), 1 / np.asarray(std) ** 2, 0.0)
    covariance = np.linalg.inv(design.T @ design / NOISE**2 + np.diag(weight))
    return covariance @ (design.T @ y / NOISE**2 + weight * mean), covariance


@pytest.mark.parametrize("louder", [0.8, 1.3])
def test_mean_covariance_and_cost_are_those_of_bayesian_regression(louder):
    data, design, y = regression(louder=louder)
    mean, std = np.array([1.0, 0.0, 0.5]), np.array([0.05, np.inf, 0.1])
    known = LINE.prior(a=(1.0, 0.05), c=(0.5, 0.1))
    assert known.values["a"] == 1.0, "a fit starts at the mean"
    found = fit(known, data, noise={"y": NOISE}, options=REST)
    values, covariance = posterior(design, y, mean, std)
    assert [found.parameters[n].value for n in "abc"] == pytest.approx(values, rel=1e-9)
    scatter = np.sum((y - design @ values) ** 2) / NOISE**2
    assert found.solver.cost == pytest.approx(
        scatter + ((values[0] - 1) / 0.05) ** 2 + ((values[2] - 0.5) / 0.1) ** 2, rel=1e-9
    )
    excess = scatter / (40 - 3)
    assert (excess > 1) == (louder > 1)
    if louder < 1:
        assert found.uncertainty.covariance == pytest.approx(covariance, rel=1e-6), "the posterior covariance"
    else:  # the residual exceeds the stated noise: the data count for less, the priors for what they say
        middle = excess * design.T @ design / NOISE**2 + np.diag(np.where(np.isfinite(std), 1 / std**2, 0.0))
        assert found.uncertainty.covariance == pytest.approx(covariance @ middle @ covariance, rel=1e-6)


def test_a_prior_is_one_more_measurement():
    """The same numbers from a record with a row that measures `a` alone."""
    data, design, y = regression()
    found = fit(LINE.prior(a=(1.0, 0.05)), data, noise={"y": NOISE}, options=REST)
    values, _ = posterior(design, y, [1.0, 0, 0], [0.05, np.inf, np.inf])
    more, given = np.vstack([design / NOISE, [1 / 0.05, 0, 0]]), np.append(y / NOISE, 1.0 / 0.05)
    assert np.linalg.lstsq(more, given, rcond=None)[0] == pytest.approx(values)
    assert [found.parameters[n].value for n in "abc"] == pytest.approx(values, rel=1e-9)


def test_agreement_with_the_data_is_judged_by_what_they_say_alone():
    data, design, y = regression(louder=0.8)
    found = fit(LINE.prior(a=(1.5, 0.05), b=(-0.4, 0.02)), data, noise={"y": NOISE}, options=REST)
    values, covariance = posterior(design, y, [1.5, -0.4, 0], [0.05, 0.02, np.inf])
    alone, spread = posterior(design, y, [0, -0.4, 0], [np.inf, 0.02, np.inf])
    check = found.constraints.priors["a"]
    assert check.shift == pytest.approx((values[0] - 1.5) / 0.05, rel=1e-6)
    assert check.conflict == pytest.approx((alone[0] - 1.5) / np.hypot(0.05, np.sqrt(spread[0, 0])), rel=1e-5)
    assert check.variance_reduction == pytest.approx(1 - covariance[0, 0] / 0.05**2, rel=1e-5)
    assert abs(check.conflict) > 3 > abs(found.constraints.priors["b"].conflict)
    assert find(found.findings, EstimationCode.PRIOR_CONFLICT).subject == "a"


def test_a_prior_that_the_data_contradict_is_not_said_to_say_all_however_much_the_misfit_widens_the_interval():
    data, _, _ = regression(louder=3)
    found = fit(LINE.prior(a=(2.0, 0.05)), data, noise={"y": NOISE}, options=REST)
    check = found.constraints.priors["a"]
    assert check.variance_reduction == 0.0 and check.conflict < -4
    codes = [finding.code for finding in found.findings]
    assert EstimationCode.PRIOR_CONFLICT in codes and EstimationCode.HELD_BY_PRIOR not in codes


def test_the_factor_between_data_and_prior_is_that_of_the_regression_without_it():
    data, design, y = regression(louder=0.8)
    found = fit(LINE.prior(a=(1.5, 0.05), b=(-0.4, 0.02)), data, noise={"y": NOISE}, options=REST)
    alone, spread = posterior(design, y, [0, -0.4, 0], [np.inf, 0.02, np.inf])
    check = found.constraints.priors["a"]
    assert check.factor == pytest.approx(alone[0] / 1.5, rel=1e-6)
    assert check.factor_std == pytest.approx(np.sqrt(spread[0, 0]) / 1.5, rel=1e-5)
    conflict = find(found.findings, EstimationCode.PRIOR_CONFLICT)
    assert conflict.values["factor"] == check.factor and f"{alone[0] / 1.5:.2f}" in str(conflict)


def test_a_held_value_that_the_records_contradict_is_said_with_its_factor(tmp_path):
    data, design, y = regression(louder=0.8)
    held = LINE.prior(a=(1.5, 0.05)).fix("a")
    found = fit(held, data, noise={"y": NOISE}, options=REST)
    alone = np.linalg.lstsq(design, y, rcond=None)[0]
    check = found.constraints.priors["a"]
    assert found.parameters["a"].fixed and found.parameters["a"].value == 1.5 and check.shift == 0
    assert check.factor == pytest.approx(alone[0] / 1.5, rel=1e-6)
    assert find(found.findings, EstimationCode.PRIOR_CONFLICT).subject == "a"
    assert "data over prior" in text(found, details=True)
    again = load_fit(found.save(tmp_path / "fit.json"), LINE)
    assert again.constraints.priors == found.constraints.priors and again.parameters["a"].fixed
    agreeing = fit(LINE.prior(a=(1.2, 0.05)).fix("a"), data, noise={"y": NOISE}, options=REST)
    assert not [f for f in agreeing.findings if f.code == EstimationCode.PRIOR_CONFLICT]


# A weighed mass on a measured spring and damper, pushed with a force that its sensor reads 1.2 times too large.
WEIGHED = {"M": (0.5, 0.01), "K": (8.0, 0.16)}


def pushed(gain, **values):
    """Position of the mass by the exact step response of its matrix, the force as its sensor shows it."""
    truth = {"M": 0.5, "K": 8.0, "B": 0.4, **values}
    generator, dt = np.random.default_rng(4), 0.02
    shown = np.repeat(generator.normal(size=60), 10)
    a = np.array([[0, 1], [-truth["K"] / truth["M"], -truth["B"] / truth["M"]]])
    whole = expm(dt * np.block([[a, np.array([[0.0], [1 / truth["M"]]])], [np.zeros((1, 3))]]))
    x, path = np.zeros(2), []
    for force in shown / gain:
        path.append(x[0])
        x = whole[:2, :2] @ x + whole[:2, 2] * force
    position = np.array(path) + 1e-3 * generator.normal(size=len(path))
    return Experiment("pushed", dt * np.arange(len(path)), {"F": shown}, {"x": position})


def on_spring():
    return Model(
        "mass",
        states=[State("x", "m", role="displacement"), State("v", "m/s", role="velocity")],
        inputs=[Input("F", "N", role="drive")],
        outputs=[Output("x", "m")],
        parameters=[
            Parameter("M", "kg", 0.5, (1e-3, 1e3)),
            Parameter("K", "N/m", 8.0, (1e-2, 1e6)),
            Parameter("B", "N*s/m", 0.4, (1e-4, 1e3)),
        ],
        balances=lambda x, u, p: [
            Balance("motion", "m/s", 1, "x", v=x.v),
            Balance("force", "N", p.M, "v", drive=u.F, spring=-p.K * x.x, damper=-p.B * x.v),
        ],
    )


def test_weighed_constants_that_are_off_alike_point_to_a_gain_which_then_takes_the_difference():
    data, noise = pushed(1.2), {"x": 1e-3}
    found = fit(on_spring().prior(**WEIGHED), data, noise=noise)
    for name in WEIGHED:
        check = found.constraints.priors[name]
        assert check.conflict > 2.6 and abs(check.factor - 1.2) < 3 * check.factor_std + 0.02
    alike = find(found.findings, EstimationCode.PRIORS_OFF_ALIKE)
    assert alike.values["parameters"] == ["M", "K"] and alike.values["factor"] == pytest.approx(1.2, rel=0.01)
    assert "input_gain" in str(alike)
    freed = fit(on_spring().prior(**WEIGHED) + effect("input_gain"), data, noise=noise)
    assert abs(freed.parameters["g"].value - (1 / 1.2 - 1)) < 2 * freed.parameters["g"].std
    for name, (mean, _) in WEIGHED.items():
        low, high = freed.parameters[name].interval
        assert low < mean < high and not abs(freed.constraints.priors[name].conflict or 0) > 2.6
    assert not [f for f in freed.findings if f.code in (EstimationCode.PRIOR_CONFLICT, EstimationCode.PRIORS_OFF_ALIKE)]


def test_weighed_constants_that_are_off_by_different_factors_point_to_no_gain():
    found = fit(on_spring().prior(**WEIGHED), pushed(1.0, M=0.6, K=8.8), noise={"x": 1e-3})
    codes = [f.code for f in found.findings]
    assert codes.count(EstimationCode.PRIOR_CONFLICT) == 2 and EstimationCode.PRIORS_OFF_ALIKE not in codes


@pytest.mark.parametrize(
    ("factor", "units"), [(1 / 9.80665, "kilogram-force and newton"), (100.0, "a power of ten"), (7.0, None)]
)
def test_a_factor_of_a_unit_is_named(factor, units):
    mean = 0.5 * factor
    found = fit(on_spring().prior(M=(mean, 0.05 * mean)), pushed(1.0), noise={"x": 1e-3})
    conflict = find(found.findings, EstimationCode.PRIOR_CONFLICT)
    assert conflict.values["factor"] == pytest.approx(1 / factor, rel=0.02) and conflict.values.get("units") == units
    assert units is None or units in str(conflict)


@pytest.mark.rest
def test_conflicts_are_standard_normal_where_both_are_right():
    conflicts = []
    for seed in range(40):
        data, _, _ = regression(seed=seed + 10)
        drawn = 1.2 + 0.05 * np.random.default_rng([seed, 8]).normal()
        conflicts.append(
            fit(LINE.prior(a=(drawn, 0.05)), data, noise={"y": NOISE}, options=REST).constraints.priors["a"].conflict
        )
    assert np.sqrt(np.mean(np.square(conflicts))) == pytest.approx(1.0, abs=0.2)


def test_a_weighed_mass_closes_the_scale_of_the_actuator():
    data = actuator()
    free = micro_actuator.fix("Ra")
    blind = fit(free, data, noise=LEVEL)
    assert blind.parameters["M"].interval is None
    found = fit(free.prior(M=(0.0101, 0.0001)), data, noise=LEVEL)
    m, k = found.parameters["M"], found.parameters["K"]
    assert m.value == pytest.approx(0.0101, rel=1e-6) and m.std == pytest.approx(0.0001, rel=1e-3)
    # K/M is told by the data: K is as uncertain as M.
    assert k.std / k.value == pytest.approx(m.std / m.value, rel=0.01)
    assert abs(k.value - 5895.5) < 3 * k.std
    check = found.constraints.priors["M"]
    assert check.conflict is None and check.variance_reduction < 1e-3 and abs(check.shift) < 1e-3
    assert find(found.findings, EstimationCode.HELD_BY_PRIOR).values["parameters"] == ["M"]
    assert "variance reduction" in text(found, 120, details=True) and "prior 0.0101 +- 0.0001" in str(
        free.prior(M=(0.0101, 0.0001))
    )


def test_curvature_profile_and_bootstrap_agree():
    data = actuator(2)
    plain = fit(micro_actuator.fix("M", "Ra"), data, noise=LEVEL)
    std = plain.parameters["La"].std
    found = fit(micro_actuator.fix("M", "Ra").prior(La=(5.05e-4, std)), data, noise=LEVEL)
    stated = found.parameters["La"]
    assert stated.std == pytest.approx(std / np.sqrt(2), rel=0.03)
    width = stated.interval[1] - stated.interval[0]
    assert profile(found, "La").interval == pytest.approx(stated.interval, abs=0.05 * width)
    again = bootstrap(found, np.random.default_rng(1), replicates=800)
    assert again.std["La"] == pytest.approx(stated.std, rel=0.12)


def test_the_gradient_holds_with_priors():
    known = micro_actuator.fix("Ra").prior(M=(0.0101, 0.0001), La=(4e-4, 1e-5))
    problem = prepare_problem(known, actuator(), LEVEL, FitOptions())
    shooting, n = problem.shooting(), problem.variables.size
    z = 0.01 * np.random.default_rng(1).normal(size=n)
    here = shooting.evaluate(z)
    slopes = [(shooting.evaluate(z + e).cost - shooting.evaluate(z - e).cost) / 2e-6 for e in 1e-6 * np.eye(n)]
    np.testing.assert_allclose(here.gradient, slopes, rtol=2e-4, atol=1e-6 * np.abs(here.gradient).max())
    assert here.cost > here.squares.sum()


@pytest.mark.rest
@pytest.mark.parametrize(
    "transcription", ["multiple", pytest.param("collocation-radau", marks=pytest.mark.slow), "arcs"]
)
def test_other_transcriptions_weigh_priors_too(transcription):
    known = micro_actuator.fix("M", "Ra").prior(La=(5.2e-4, 2e-6))
    data = linear_record(known, multisine(np.random.default_rng(1), 150, 2.5e-4, 5, 800, 3.0), 2.5e-4, noise=LEVEL)
    options = FitOptions(transcription=transcription, arc_length=0.02 if transcription == "arcs" else 0.0)
    free, found = fit(known, data, noise=LEVEL), fit(known, data, noise=LEVEL, options=options)
    unweighed = fit(known.prior(La=None), data, noise=LEVEL, options=options)
    assert found.success
    if transcription != "arcs":
        assert found.parameters["La"].value == pytest.approx(free.parameters["La"].value, rel=2e-4)
    assert abs(found.constraints.priors["La"].shift) < abs(unweighed.parameters["La"].value - 5.2e-4) / 2e-6
    assert found.parameters["La"].std < min(2e-6, unweighed.parameters["La"].std)


def test_a_prior_survives_saving(tmp_path):
    known = micro_actuator.fix("Ra").prior(M=(0.0101, 0.0001))
    found = fit(known, actuator(), noise=LEVEL)
    again = load_fit(found.save(tmp_path / "fit.json"), micro_actuator)
    assert again.constraints.priors == found.constraints.priors and again.model.parameter("M").prior == (0.0101, 0.0001)
    assert profile(again, "M").interval == profile(found, "M").interval


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.prior(M=0.01), r"parameter 'M': prior 0.01; give \(mean, standard deviation\), two numbers"),
        (lambda m: m.prior(M=(0.01, 0.0)), r"parameter 'M': prior 0.01 \+- 0 kg: .* a standard deviation above zero"),
        (lambda m: m.prior(M=(2.0, 0.1)), r"parameter 'M': 2 kg lies outside its bounds"),
        (lambda m: m.prior(Mm=(2.0, 0.1)), r"has no parameter 'Mm'; did you mean 'M'"),
        (lambda m: m.prior(Kv=(1.0, 0.1)), r"parameter 'Kv' is tied, Kv = Kf: set Kf instead"),
        (
            lambda m: Parameter("a", "m", 1.0, (0.0, 2.0), prior=(3.0, 1.0)),
            r"prior mean 3 m lies outside its bounds \[0, 2\] m",
        ),
        (lambda m: Parameter("a", "m", 1.0, prior=0.1), r"'a': prior 0.1: give the mean and the standard deviation"),
    ],
)
def test_priors_that_cannot_be_are_refused_in_words(change, message):
    with pytest.raises(ModelError, match=message):
        change(micro_actuator.tie(Kv="Kf"))


@pytest.mark.parametrize("seed", [5, 6])
def test_a_constant_that_free_first_states_take_the_place_of_keeps_the_spread_of_its_prior(seed):
    """An offset of the reading of an integrator: in a coloured residual the rounding of its scores passed for a variance of either sign."""
    offset = Model(
        "integrator",
        [State("x", "m")],
        [Input("u", "m/s")],
        [Output("y", "m", lambda x, u, p: x.x + p.b)],
        [Parameter("k", "1", 1.0), Parameter("b", "m", 0.0, prior=(0.0, 1e6))],
        lambda x, u, p: [Balance("way", "m/s", 1, "x", speed=p.k * u.u)],
    )
    rng = np.random.default_rng(seed)
    time, u = np.arange(400) * 0.01, np.repeat(rng.normal(size=40), 10)
    way = 1e3 + 2 * np.concatenate([[0], np.cumsum(u)[:-1] * 0.01])
    drift = 0.01 * np.convolve(rng.normal(size=449), np.ones(50) / 50, "valid")
    found = fit(offset, Experiment("a", time, {"u": u}, {"y": way + drift}), noise={"y": 1e-4})
    assert found.parameters["b"].std == pytest.approx(1e6, rel=1e-6)
    assert found.parameters["k"].value == pytest.approx(2.0, abs=5 * found.parameters["k"].std)
