"""Intervals of constants that may change places and nearly agree, against refits and linear algebra by SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq, least_squares
from scipy.signal import lsim

from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State, fit
from greybox.estimation.covariance import compute_quantile
from greybox.estimation.findings import EstimationCode
from greybox.estimation.identifiability.practical import recommend_after_fit
from greybox.estimation.identifiability.sensitivity import IdentifiabilityCode
from tests.support.exchange_plants import NOISE, TIME, two_lags, two_lags_record, two_lags_step
from tests.support.findings import codes, find

REST = FitOptions(at_rest=True)
MIDDLE, NEAR, APART = (0.15, 0.15), (0.16, 0.14), (0.4, 0.05)


def lags_fit(taus, seed, **options):
    record = two_lags_record(*taus, seed)
    return fit(two_lags(), record, noise={"w": NOISE}, options=FitOptions(at_rest=True, **options)), record.outputs["w"]


def profile_by_scipy(y, value):
    """Least squares over the noise with one lag held."""

    def errors(z):
        return (y - two_lags_step(z[0], value, z[1])) / NOISE

    starts = ([245.0, 0.3 - value if value < 0.3 else 0.1], [245.0, 0.15])
    return min(2 * least_squares(errors, z, x_scale=[100.0, 0.1], xtol=1e-12, ftol=1e-12).cost for z in starts)


@pytest.mark.parametrize(("taus", "seed"), [(MIDDLE, 2), (MIDDLE, 3), (NEAR, 2), (NEAR, 3)])
def test_lags_that_nearly_agree_have_the_interval_of_their_profile(taus, seed):
    found, y = lags_fit(taus, seed)
    assert EstimationCode.DIRECTION_UNDETERMINED not in codes(found.findings) and not recommend_after_fit(found)
    said = find(found.findings, IdentifiabilityCode.EXCHANGEABLE)
    assert said.values["exchanged"] == ["tau1", "tau2"]
    least = found.solver.cost
    threshold = compute_quantile(np.inf) ** 2 * max(least / (len(TIME) - 3), 1.0)
    for name in ("tau1", "tau2"):
        low, high = found.parameters[name].interval
        assert low < taus[0] < high and low < taus[1] < high
        for end in (low, high):
            assert profile_by_scipy(y, end) - least == pytest.approx(threshold, rel=0.06)
        assert found.parameters[name].std == pytest.approx((high - low) / 2 / compute_quantile(np.inf), rel=0.01)


@pytest.mark.parametrize("seed", [2, 3])
def test_their_sum_and_the_gain_are_as_well_known_as_beside_the_square_of_their_difference(seed):
    """In gain, sum and squared difference the problem is regular, also where the lags are equal."""
    found, _ = lags_fit(MIDDLE, seed)
    k = found.parameters["k"].value
    (both,) = find(found.findings, IdentifiabilityCode.EXCHANGEABLE).values["sums"]
    total = both["value"]

    def run(z):
        half = np.sqrt(abs(z[2])) / 2
        return two_lags_step(z[0], z[1] / 2 + half, z[1] / 2 - half)

    # Not at the double root itself, where a difference quotient along the square would have one side.
    at, steps = np.array([k, total, 2.5e-4]), np.array([1e-3, 1e-6, 1e-6])
    slopes = np.column_stack([(run(at + s) - run(at - s)) / (2 * s.max()) for s in np.diag(steps)]) / NOISE
    inflation = np.sqrt(max(found.solver.cost / (len(TIME) - 3), 1.0))
    std = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes))) * inflation
    assert both["std"] == pytest.approx(std[1], rel=0.05)
    assert found.parameters["k"].std == pytest.approx(std[0], rel=0.05)
    assert both["constants"] == ["tau1", "tau2"] and abs(total - 0.3) < 3 * std[1]


def test_lags_far_apart_keep_the_interval_of_their_curvature():
    found, _ = lags_fit(APART, 1)
    plain, _ = lags_fit(APART, 1, exchange=False)
    assert found.parameters == plain.parameters
    assert find(found.findings, IdentifiabilityCode.OTHER_ANSWER).values["exchanged"] == ["tau1", "tau2"]
    assert IdentifiabilityCode.EXCHANGEABLE not in codes(found.findings)


def test_at_a_moderate_distance_the_interval_holds_one_valley():
    """Twins whose valleys a ridge parts: each interval is that of the profile up to the ridge, and holds one of the two."""
    found, y = lags_fit((0.175, 0.125), 3)
    said = find(found.findings, IdentifiabilityCode.EXCHANGEABLE)
    assert said is not None and not said.values["equal"]
    slow, fast = sorted((found.parameters[n] for n in ("tau1", "tau2")), key=lambda e: -e.value)
    assert fast.interval[1] < slow.interval[0]
    threshold = compute_quantile(np.inf) ** 2 * max(found.solver.cost / (len(TIME) - 3), 1.0)
    low = brentq(lambda v: profile_by_scipy(y, v) - found.solver.cost - threshold, 0.151, slow.value - 1e-3)
    assert slow.interval[0] == pytest.approx(low, abs=2e-4)


@pytest.mark.rest
def test_of_three_equal_lags_none_is_to_be_fixed():
    """Beside the optimum of one the other two are equal still; their profiles determine them all the same."""
    three = Model(
        "three",
        [State(name, "V") for name in "abc"],
        [Input("u", "V")],
        [Output("c", "V")],
        [Parameter(f"t{k}", "s", 0.1 * k, (1e-3, 100.0)) for k in (1, 2, 3)],
        lambda x, u, p: [
            Balance("first", "V", p.t1, "a", drive=u.u, decay=-x.a),
            Balance("second", "V", p.t2, "b", drive=x.a, decay=-x.b),
            Balance("third", "V", p.t3, "c", drive=x.b, decay=-x.c),
        ],
    )
    rng = np.random.default_rng(4)
    time, u = 0.05 * np.arange(400), np.repeat(rng.uniform(-1, 1, 20), 20)
    _, y, _ = lsim(([1.0], np.poly([-1 / 0.3] * 3) * 0.3**3), u, time, interp=False)
    record = Experiment("run", time, {"u": u}, {"c": y + 0.01 * rng.normal(size=400)}, "zero")
    found = fit(three, record, noise={"c": 0.01}, options=REST)
    assert EstimationCode.DIRECTION_UNDETERMINED not in codes(found.findings)
    assert set(find(found.findings, IdentifiabilityCode.EXCHANGEABLE).values["exchanged"]) == {"t1", "t2", "t3"}
    for name in ("t1", "t2", "t3"):
        low, high = found.parameters[name].interval
        assert low < 0.3 < high < 2 * low
