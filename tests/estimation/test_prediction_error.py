"""Fits with process noise against statsmodels, their limits and notes, the smoother's bands, and predictions ahead."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize

import greybox as gb
from greybox import FitOptions, fit
from greybox.base.errors import ModelError
from greybox.estimation.findings import EstimationCode
from greybox.estimation.optimum import restore_objective
from greybox.estimation.prediction_error import compute_largest_intensities
from greybox.estimation.result import load_fit
from greybox.simulation.filtering.kalman_filter import KalmanFilter
from models.cascaded_tanks import cascaded_tanks
from tests.support.filters import check_slopes, filter_of, tank, tank_record
from tests.support.findings import codes, find
from tests.support.pushed_mass import INTENSITY, LEVEL, MASS, PERIOD, discrete, record, states, three

PUSHED = MASS.with_process_noise("v")


@cache
def pushed_fit():
    return fit(PUSHED, record(3, intensity=INTENSITY, x0=[1.0, -0.5]))


def statsmodels_filter(data, B, K, intensity, std, start, kind="kalman_filter.KalmanFilter"):
    """The filter of statsmodels, in matrices that scipy made; the first states are known one interval before the record."""
    module, name = kind.split(".")
    model = getattr(pytest.importorskip(f"statsmodels.tsa.statespace.{module}"), name)(2, 2, tolerance=0)
    model.bind(np.column_stack([data.outputs[n] for n in LEVEL]))
    phi, gain, noise = discrete(B=B, K=K, intensity=intensity)
    model["design"], model["obs_cov"], model["selection"] = np.eye(2), np.diag(std) ** 2, np.eye(2)
    model["transition"], model["state_cov"] = phi, noise
    model["state_intercept"] = gain[:, None] * data.inputs["u"]
    model.initialize_known(np.asarray(start, float), noise)
    return model


def theirs(data, logarithms, start):
    B, K, intensity, *std = np.exp(logarithms)
    return statsmodels_filter(data, B, K, intensity, std, start).loglike()


def test_the_most_likely_constants_are_those_of_statsmodels():
    data, found = record(3, intensity=INTENSITY, x0=[1.0, -0.5]), pushed_fit()
    names = ("B", "K", "noise_v")
    values = [*(found.parameters[n].value for n in names), *(found.noise.std[n] for n in LEVEL)]
    start = [found.traces[0].initial_state[n] for n in LEVEL]
    at = np.append(np.log(values), start)
    assert theirs(data, at[:5], start) == pytest.approx(found.prediction.log_likelihood, rel=1e-8)
    scale = np.append(np.full(5, 0.05), [0.01, 0.02])

    def cost(step):
        p = at + scale * step
        return -theirs(data, p[:5], p[5:])

    best = minimize(cost, np.array([1.0, -1, 1, -1, 1, -1, 1]), method="BFGS", options={"gtol": 1e-3})
    assert -best.fun <= found.prediction.log_likelihood + 1e-6
    assert best.x == pytest.approx(np.zeros(7), abs=0.02)
    # The covariance: the inverse of the curvature of their likelihood, by central differences of it.
    curvature, e = np.empty((7, 7)), np.eye(7) * 0.1
    for i, j in zip(*np.tril_indices(7), strict=True):
        ends = [cost(a * e[i] + b * e[j]) * a * b for a in (1, -1) for b in (1, -1)]
        curvature[i, j] = curvature[j, i] = sum(ends) / 0.04
    spread = np.sqrt(np.diag(np.linalg.inv(curvature))) * scale
    for k, n in enumerate(names):
        assert found.parameters[n].std / found.parameters[n].value == pytest.approx(spread[k], rel=0.02)
    assert found.uncertainty.kind == "observed_information"
    # What is restored of a result has all of its unknowns: an intensity that is not zero is one.
    assert set(names) <= set(restore_objective(found).variables.names)


def test_an_intensity_that_pushes_two_states_explains_the_movement_of_either_at_most():
    """A walk of intensity q moves by q sqrt(h) in a row; here 2 q and 5 q push."""
    parameters = [gb.Parameter("q", "m/s^0.5", 1.0, (0.0, 1e3)), gb.Parameter("k", "1/s", 1.0)]
    model = gb.Model(
        "two",
        states=[gb.State(n, "m", noise=lambda p, f=f: f * p.q) for n, f in (("a", 2.0), ("b", 5.0))],
        inputs=[],
        outputs=[gb.Output("a", "m")],
        parameters=parameters,
        balances=lambda x, u, p: [gb.Balance(n, "m/s", 1, n, decay=-p.k * x[n]) for n in "ab"],
    )
    assert compute_largest_intensities(model, np.array([6.0, 20.0])) == {"q": pytest.approx(3.0)}
    assert compute_largest_intensities(model, np.array([6.0, 10.0])) == {"q": pytest.approx(2.0)}


def test_states_and_bands_are_those_of_statsmodels_smoother():
    data = record(4, intensity=INTENSITY)
    known = MASS.with_process_noise(v=INTENSITY)
    found = gb.smooth(known, data, noise=LEVEL, options=FitOptions(at_rest=True))
    smoother = statsmodels_filter(
        data, 0.4, 4.0, INTENSITY, list(LEVEL.values()), [0, 0], "kalman_smoother.KalmanSmoother"
    )
    smoother.initialize_known(np.zeros(2), np.zeros((2, 2)))
    expected = smoother.smooth()
    for k, name in enumerate(LEVEL):
        spread = np.sqrt(expected.smoothed_state_cov[k, k])
        assert found.mean[name] == pytest.approx(expected.smoothed_state[k], abs=1e-8)
        assert found.std[name] == pytest.approx(spread, rel=1e-6, abs=1e-9)
        low, high = found.band(name)
        assert (low + high) / 2 == pytest.approx(found.mean[name]) and high - low == pytest.approx(
            2 * 1.959964 * spread
        )
    assert found.log_likelihood == pytest.approx(expected.llf, rel=1e-8)
    with pytest.raises(ModelError, match="no state 'w'"):
        found.band("w")
    with pytest.raises(ModelError, match="level 95 of a band; give a probability between 0 and 1"):
        found.band("x", 95)


def test_bands_hold_the_true_states_with_gaps_and_an_unknown_beginning():
    rng = np.random.default_rng(5)
    inside = {n: [] for n in LEVEL}
    known = MASS.with_process_noise(v=INTENSITY)
    for k in range(4):
        u = np.repeat(rng.choice([-2.0, 2.0], 60), 5)
        true = states(u, rng.normal(size=2), rng)
        y = {n: true[:, j] + LEVEL[n] * rng.normal(size=300) for j, n in enumerate(LEVEL)}
        y["v"][50:150] = np.nan
        data = gb.Experiment(f"day {k}", PERIOD * np.arange(300), {"u": u}, y)
        found = gb.smooth(known, data, noise=LEVEL)
        for j, n in enumerate(LEVEL):
            low, high = found.band(n)
            inside[n].append((low <= true[:, j]) & (true[:, j] <= high))
    for n, share in inside.items():
        assert 0.92 < np.mean(share) < 0.98, n
    assert "innovation of x" in str(found)


def test_where_nothing_pushes_it_is_the_free_run_fit():
    data = three()
    free, found = fit(MASS, data, noise=LEVEL), fit(PUSHED, data, noise=LEVEL)
    assert found.prediction.process_noise == {"v": 0.0}
    for n in "BK":
        assert found.parameters[n].value == pytest.approx(free.parameters[n].value, rel=1e-6)
        assert found.parameters[n].std == pytest.approx(free.parameters[n].std, rel=0.05)
    for one, other in zip(found.traces, free.traces, strict=True):
        assert one.initial_state == pytest.approx(other.initial_state, abs=1e-4)
    count = sum(m.samples for m in free.misfit.values())
    constant = sum(free.misfit[n].samples * 2 * np.log(s) for n, s in LEVEL.items()) + count * np.log(2 * np.pi)
    assert -2 * found.prediction.log_likelihood == pytest.approx(free.solver.cost + constant, rel=1e-9)
    low, high = found.parameters["noise_v"].interval
    assert low == 0 and 0 < high < 0.02
    assert EstimationCode.PROCESS_NOISE_ZERO in codes(found.findings)


@pytest.mark.parametrize("seed", range(4))
def test_what_does_not_push_is_found_not_to_whatever_the_noise(seed):
    """Also with the noise of the sensors estimated, where an intensity of next to nothing leaves the likelihood flat."""
    found = fit(PUSHED, record(seed + 20, rows=150))
    assert found.success, found.solver.status_message
    assert found.prediction.process_noise["v"] < 0.02 and found.parameters["noise_v"].interval[1] < 0.05


def test_what_pushes_is_told_with_its_size():
    found = pushed_fit()
    low, high = found.parameters["noise_v"].interval
    assert low < INTENSITY < high and found.prediction.process_noise["v"] == found.parameters["noise_v"].value
    values = find(found.findings, EstimationCode.PROCESS_NOISE_SIGNIFICANT).values
    assert values["states"] == ["v"] and values["balances"] == ["force"]
    assert found.prediction.one_step["v"].rmse < 0.7 * found.misfit["v"].rmse
    # The force in N that the intensity stands for: M q / sqrt(h).
    size = found.prediction.process_noise["v"] / np.sqrt(PERIOD)
    assert values["sizes"] == [{"size": pytest.approx(size), "unit": "N"}] and values["period"] == pytest.approx(0.1)


def test_innovations_that_are_correlated_are_said_with_what_they_cost():
    found = fit(MASS.with_process_noise(v=INTENSITY), record(3, intensity=INTENSITY, rho=0.8))
    correlated = find(found.findings, EstimationCode.INNOVATIONS_CORRELATED)
    assert correlated.values == {"inflation": pytest.approx(np.nanmax(list(found.uncertainty.inflation.values())))}


def test_the_likelihood_stays_bounded_where_a_sensor_could_be_perfect():
    """With a first state that meets the first row exactly the noise of one sensor could shrink to nothing at no cost."""
    cost = restore_objective(pushed_fit())
    noise = cost.variables.noise
    levels = [replace(noise, level=noise.level * np.array([1.0, share])) for share in (1.0, 1e-2, 1e-4, 1e-6)]
    likely = [cost.at(replace(cost.variables, noise=level)).cost() for level in levels]
    assert np.all(np.diff(likely) > -1e-6), likely


@pytest.mark.parametrize("kind", ["linear", "nonlinear"])
def test_slopes_hold_where_the_first_states_are_unknown(kind):
    model, data = (tank_record(rows=40)) if kind == "nonlinear" else (PUSHED, record(1, rows=60, intensity=INTENSITY))
    kalman, rows, _ = filter_of(model, data)
    unknown = KalmanFilter.of(model.system, kalman.step, known_start=False)
    pn = np.array([0.05, 0.003, 0.005, 1e-3]) if kind == "nonlinear" else np.array([1.0, 0.4, 4.0, 0.3, 0.01, 0.02])
    x0 = np.array([0.4]) if kind == "nonlinear" else np.array([0.2, -0.3])
    assert unknown.run(rows, pn, x0).covariance[0].max() > 0 == kalman.run(rows, pn, x0).covariance[0].max()
    check_slopes(unknown, rows, pn, x0)


def test_the_extended_filter_finds_a_leak_and_a_gust():
    model, data = tank_record(rows=150, seed=4)
    found = fit(tank().start(c=0.07), data)
    assert found.success and not found.solver.strategy.values["exact"]
    for name, truth in (("c", 0.05), ("gust", 0.003)):
        assert abs(found.parameters[name].value - truth) < 4 * found.parameters[name].std
    assert model.name == found.model.name


def test_a_prediction_is_the_filters_and_its_error_grows_to_the_free_runs():
    found = pushed_fit()
    other = record(5, intensity=INTENSITY, x0=[0.5, 0.5])
    ready = gb.estimation.predictor(found)
    errors = []
    for steps in (1, 5, 200):
        y = ready.predict(other, steps)["v"]
        errors.append(np.sqrt(np.mean((other.outputs["v"] - y)[steps:] ** 2)))
    free = np.sqrt(np.mean((other.outputs["v"] - ready.simulate(other)["v"]) ** 2))
    assert errors[0] < errors[1] < 1.1 * free and errors[0] < 0.7 * free
    assert gb.predict(found, other, steps=5)["v"] == pytest.approx(ready.predict(other, 5)["v"])
    with pytest.raises(gb.errors.DataError, match="steps ahead: 0; give a whole number from 1"):
        ready.predict(other, 0)
    with pytest.raises(ModelError, match="has no state 'w'"):
        ready.predict(other, 1, initial={"w": 0.0})


def test_a_prior_is_weighed_beside_process_noise():
    """As sure as the data by themselves, one standard deviation off: half way, and surer by the root of two."""
    plain = pushed_fit()
    k = plain.parameters["K"]
    found = fit(PUSHED.prior(K=(k.value + k.std, k.std)), record(3, intensity=INTENSITY, x0=[1.0, -0.5]))
    held, check = found.parameters["K"], found.constraints.priors["K"]
    assert held.value == pytest.approx(k.value + k.std / 2, abs=0.02 * k.std)
    assert held.std == pytest.approx(k.std / np.sqrt(2), rel=0.02)
    assert check.variance_reduction == pytest.approx(0.5, abs=0.02) and check.conflict == pytest.approx(
        -np.sqrt(0.5), rel=0.03
    )


def test_it_is_saved_and_read_back(tmp_path):
    found = pushed_fit()
    again = load_fit(found.save(tmp_path / "fit.json"), MASS)
    assert (
        again.prediction.process_noise == found.prediction.process_noise
        and again.prediction.log_likelihood == found.prediction.log_likelihood
    )
    assert again.prediction == found.prediction
    assert restore_objective(again).cost() == pytest.approx(-2 * found.prediction.log_likelihood, rel=1e-12)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (
            lambda: fit(PUSHED, record(1), options=FitOptions(loss="huber")),
            "is that of normal noise; leave out the loss",
        ),
        (lambda: fit(PUSHED, record(1), colour="residual"), "process noise makes the innovations white"),
        (lambda: fit(PUSHED, record(1), options=FitOptions(transcription="multiple")), "one-step predictions"),
        (lambda: MASS.with_process_noise("w"), "has no state 'w'"),
        (lambda: MASS.with_process_noise(v=-1.0), "-1 m/s\\^1.5 is not an intensity; give a finite value of 0 or more"),
        (lambda: MASS.with_process_noise("v", v=1.0), "either estimated or known; name the state once"),
        (lambda: gb.smooth(42, record(1)), "42 is neither a model nor a fit"),
        (lambda: gb.predict(cascaded_tanks, record(1)), "experiment 'day 1'"),
    ],
)
def test_what_has_no_meaning_is_refused_in_words(ask, message):
    with pytest.raises((ModelError, gb.errors.DataError), match=message):
        ask()
