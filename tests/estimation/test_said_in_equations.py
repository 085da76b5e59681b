"""What has no option of its own is said in the equations: time, a prior on a logarithm, a constant that a condition names, replicates."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from greybox import Balance, Experiment, FitOptions, Model, Output, Parameter, State, fit

REST = FitOptions(at_rest=True)
TIME = np.linspace(0, 3, 25)
STD = 0.1


def decay(rate=lambda p: p.k, more=(), outputs=("y",)):
    """An amount of 5 g that decays."""
    return Model(
        "decay",
        [State("y", "g", lambda p: p.A)],
        [],
        [Output(name, "g", lambda x, u, p: x.y) for name in outputs],
        [Parameter("A", "g", 3.0, (1e-3, 100.0)), Parameter("k", "1/s", 0.5, (1e-3, 10.0)), *more],
        lambda x, u, p: [Balance("rate", "g/s", 1, "y", loss=-rate(p) * x.y)],
    )


def readings(k, seed, std=STD):
    return 5 * np.exp(-k * TIME) + std * np.random.default_rng(seed).normal(size=len(TIME))


def test_time_is_a_state_whose_rate_is_one():
    """``y' = -k y / (1 + t / T)``: against least squares over SciPy's runs."""
    model = Model(
        "ageing",
        [State("y", "1", 1.0), State("t", "s", 0.0)],
        [],
        [Output("y", "1")],
        [Parameter("k", "1/s", 0.5, (1e-3, 10.0)), Parameter("T", "s", 2.0, (0.01, 100.0))],
        lambda x, u, p: [
            Balance("decay", "1/s", 1, "y", loss=-p.k * x.y / (1 + x.t / p.T)),
            Balance("clock", "1", 1, "t", passing=1.0),
        ],
    )

    def run(k, T):
        return solve_ivp(lambda t, y: -k * y / (1 + t / T), (0, 3), [1.0], "LSODA", TIME, rtol=1e-10, atol=1e-12).y[0]

    y = run(0.7, 3.0) + 0.01 * np.random.default_rng(0).normal(size=len(TIME))
    found = fit(model, Experiment("ageing", TIME, {}, {"y": y}), noise={"y": 0.01}, options=REST)
    least = least_squares(lambda z: (run(*np.exp(z)) - y) / 0.01, np.log([0.5, 2.0]))
    assert [found.parameters[n].value for n in ("k", "T")] == pytest.approx(np.exp(least.x), rel=1e-3)


def test_a_prior_on_a_logarithm_is_one_of_an_exponent():
    """``k = k0 e^l`` with ``l`` about 0: known within a factor."""
    y = readings(0.8, 3)
    more = [Parameter("l", "1", 0.0, (-10.0, 10.0)), Parameter("k0", "1/s", 0.5, fixed=True)]
    model = decay().tie(new=more, k="k0*exp(l)").prior(l=(0.0, 0.05))
    found = fit(model, Experiment("decay", TIME, {}, {"y": y}), noise={"y": STD}, options=REST)

    def errors(z):
        return np.append((y - np.exp(z[0] - np.exp(z[1]) * TIME)) / STD, (z[1] - np.log(0.5)) / 0.05)

    least = least_squares(errors, np.log([5, 0.5]))
    assert found.parameters["A"].value == pytest.approx(np.exp(least.x[0]), rel=1e-4)
    assert found.constraints.tied["k"].value == pytest.approx(np.exp(least.x[1]), rel=1e-4)


def test_a_condition_names_a_constant_by_weights():
    """Three records, of which the first and the last are of one batch: two rates, as separate least squares have them."""
    more = [Parameter("k2", "1/s", 0.5, (1e-3, 10.0)), Parameter("second", "1", 0.0, (0.0, 1.0), fixed=True)]
    model = decay(lambda p: (1 - p.second) * p.k + p.second * p.k2, more)
    runs = [readings(k, seed) for seed, k in enumerate((0.8, 1.5, 0.8))]
    records = [
        Experiment(f"run {e}", TIME, {}, {"y": y}, conditions={"second": float(e == 1)}) for e, y in enumerate(runs)
    ]
    found = fit(model, records, noise={"y": STD}, options=REST)

    def errors(z):
        rates = np.exp(z)[[1, 2, 1]]
        return np.concatenate([(np.exp(z[0] - k * TIME) - y) / STD for k, y in zip(rates, runs, strict=True)])

    least = least_squares(errors, np.log([5, 0.8, 1.5]))
    assert [found.parameters[n].value for n in ("A", "k", "k2")] == pytest.approx(np.exp(least.x), rel=1e-5)


def test_readings_at_one_time_are_outputs_with_one_noise():
    """Two at a time, the second of which is missing in places: one level, told by all of them."""
    first, second = readings(0.8, 0), readings(0.8, 1)
    second[::3] = np.nan
    record = Experiment("twice", TIME, {}, {"y": first, "again": second})
    found = fit(decay(outputs=("y", "again")), record, noise={"y": "n", "again": "n"}, options=REST)

    def errors(z):
        run = np.exp(z[0] - np.exp(z[1]) * TIME)
        return np.concatenate([run - first, (run - second)[np.isfinite(second)]])

    least = least_squares(errors, np.log([5, 0.8]))
    count = len(least.fun)
    assert [found.parameters[n].value for n in ("A", "k")] == pytest.approx(np.exp(least.x), rel=1e-5)
    assert found.noise.std["y"] == pytest.approx(np.sqrt(2 * least.cost / (count - 2)), rel=1e-3)
