"""What is said of a constant on its bound: the limit that the records set, by linear algebra, or that they would have it beyond."""

from __future__ import annotations

import numpy as np
import pytest

from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State, fit
from greybox.estimation.findings import EstimationCode
from greybox.estimation.profiles import ProfileShape, profile
from tests.support.findings import codes, find

REST = FitOptions(at_rest=True)
NOISE, ROWS, QUANTILE = 0.01, 60, 1.959964
X = np.random.default_rng(3).uniform(0.0, 2.0, ROWS)
DESIGN = np.column_stack([X, X**2])


def line(curvature, *constants):
    """``y = a x + curvature(p) x^2``."""
    return Model(
        "line",
        [State("s", "1")],
        [Input("x", "1")],
        [Output("y", "1", lambda x, u, p: p.a * u.x + curvature(p) * u.x**2)],
        [Parameter("a", "1", 1.0, (-10.0, 10.0)), *constants],
        lambda x, u, p: [Balance("rest", "1/s", 1, "s", decay=-x.s * 1.0 / p.tau)],
    )


def record_with(curvature):
    """A record whose least squares give exactly this curvature, with its noise at right angles to the design."""
    noise = np.random.default_rng(7).normal(size=ROWS)
    noise -= DESIGN @ np.linalg.lstsq(DESIGN, noise, rcond=None)[0]
    noise *= NOISE * np.sqrt((ROWS - 2) / np.sum(noise**2)) * 0.9
    y = DESIGN @ [1.2, curvature] + noise
    return Experiment("line", 0.1 * np.arange(ROWS), {"x": X}, {"y": y})


STD = NOISE * float(np.sqrt(np.linalg.inv(DESIGN.T @ DESIGN)[1, 1]))
TAU = Parameter("tau", "s", 1.0, fixed=True)


def limit_of(best):
    """Where the squares have risen by the 95 % point over those at zero, with the least ones at ``best`` below zero."""
    return best + np.hypot(best, QUANTILE * STD)


@pytest.mark.parametrize("lower", [0.0, 1e-9, 1e-5])
@pytest.mark.parametrize("deviations", [0.3, 1.5])
def test_the_records_set_a_limit_to_a_constant_on_its_lower_bound(lower, deviations):
    best = -deviations * STD
    model = line(lambda p: p.b, Parameter("b", "1", 0.1, (lower, 5.0)), TAU)
    found = fit(model, record_with(best), noise={"y": NOISE}, options=REST)
    assert found.parameters["b"].at_bound and found.parameters["b"].std is None
    low, high = found.parameters["b"].interval
    assert (low, high) == (lower, pytest.approx(limit_of(best), rel=0.01))
    said = find(found.findings, EstimationCode.LIMITED_FROM_BOUND)
    assert (said.subject, said.values["limit"], said.values["is_upper"]) == ("b", high, True)
    assert EstimationCode.STOPPED_BY_BOUND not in codes(found.findings)
    seen = profile(found, "b")
    assert seen.shape is ProfileShape.ONE_SIDED and seen.interval == (lower, pytest.approx(high, rel=0.02))
    assert seen.disagreement < 0.1 and "the records set an upper limit" in str(seen)


def test_a_limit_from_an_upper_bound_is_a_lower_one():
    """In ``x^2 / c`` a curvature that is not there has ``c`` at its upper bound."""
    best = -0.5 * STD
    model = line(lambda p: 1 / p.c, Parameter("c", "1", 10.0, (0.1, 1e6)), TAU)
    found = fit(model, record_with(best), noise={"y": NOISE}, options=REST)
    low, high = found.parameters["c"].interval
    assert (low, high) == (pytest.approx(1 / limit_of(best), rel=0.01), 1e6)
    assert not find(found.findings, EstimationCode.LIMITED_FROM_BOUND).values["is_upper"]
    assert profile(found, "c").interval[0] == pytest.approx(low, rel=0.02)


def test_records_that_would_have_a_constant_beyond_its_bound_say_so():
    model = line(lambda p: p.b, Parameter("b", "1", 0.1, (0.0, 5.0)), TAU)
    found = fit(model, record_with(-4.0 * STD), noise={"y": NOISE}, options=REST)
    assert found.parameters["b"].at_bound and found.parameters["b"].interval is None
    assert find(found.findings, EstimationCode.STOPPED_BY_BOUND).values["parameters"] == ["b"]
    assert EstimationCode.LIMITED_FROM_BOUND not in codes(found.findings)


@pytest.mark.rest
def test_limits_hold_as_often_as_they_say():
    """A constant at zero lies on its bound in about half of its records; the limits hold zero but where it seems to be pulled beyond."""
    model = line(lambda p: p.b, Parameter("b", "1", 0.1, (0.0, 5.0)), TAU)
    rng, held, at_bound = np.random.default_rng(5), 0, 0
    for _ in range(40):
        y = DESIGN @ [1.2, 0.0] + NOISE * rng.normal(size=ROWS)
        record = Experiment("line", 0.1 * np.arange(ROWS), {"x": X}, {"y": y})
        found = fit(model.start(a=1.2, b=0.001), record, noise={"y": NOISE}, options=REST)
        at_bound += found.parameters["b"].at_bound
        interval = found.parameters["b"].interval
        held += interval is not None and interval[0] <= 0.0 <= interval[1]
    assert 12 <= at_bound <= 28 and held >= 36


def test_a_bound_that_nothing_reaches_before_is_visited():
    """Nine steps from a constant that is hardly told end far from its bound: the profile goes on to the bound itself."""
    model = line(lambda p: p.b / 1e6, Parameter("b", "1", 1e-3, (1e-3, 1e9)), TAU)
    found = fit(model, record_with(-0.2 * STD), noise={"y": NOISE}, options=REST)
    seen = profile(found, "b")
    assert seen.interval[1] == pytest.approx(1e6 * limit_of(-0.2 * STD), rel=0.02)
    assert seen.shape is ProfileShape.ONE_SIDED
    insensitive = line(lambda p: p.b / 1e12, Parameter("b", "1", 1e-3, (1e-3, 1e6)), TAU)
    flat = profile(fit(insensitive, record_with(0.0), noise={"y": NOISE}, options=REST), "b")
    assert flat.shape is ProfileShape.FLAT and flat.values.max() == 1e6
