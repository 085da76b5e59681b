"""Profiles say what shape they have; a region of two constants is followed along its length."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import f as fisher

import greybox as gb
from greybox import Balance, Experiment, Model, Output, Parameter, State
from greybox.base.errors import DataError, ModelError
from greybox.estimation.profile_pairs import ProfilePair, load_profile_pair, profile_pair
from greybox.estimation.profiles import Profile, ProfileShape, load_profile, profile
from tests.estimation.test_intervals import TIMES, VALUES, saturation_fit
from tests.support.published_plants import REST, SATURATION
from tests.support.result_schema import strict_offences
from tests.support.semibatch import TRUTH, published_record, semibatch

TIME = np.linspace(0.0, 3.0, 40)


def decay(rate, *parameters: Parameter) -> Model:
    """y' = -rate(p) y, y(0) = 1."""
    return Model(
        "decay",
        [State("y", "1", 1.0)],
        [],
        [Output("y", "1")],
        [*parameters],
        lambda x, u, p: [Balance("loss", "1", 1, "y", loss=-rate(p) * x.y)],
    )


def decay_fit(model: Model, noise: float = 0.01) -> gb.Fit:
    y = np.exp(-TIME) + noise * np.random.default_rng(1).standard_normal(len(TIME))
    return gb.fit(model, Experiment("decay", TIME, {}, {"y": y}), noise={"y": noise}, options=REST)


def test_a_constant_that_the_records_determine_is_bounded():
    seen = profile(saturation_fit(), "b")
    assert seen.shape is ProfileShape.BOUNDED and seen.valley is None
    # Published: the profile of a saturating curve is not the parabola of its curvature (Rooney and Biegler 2001).
    assert seen.is_better and seen.disagreement > 0.1
    assert (seen.partner, seen.correlation < -0.8) == ("a", True)
    assert "use the profile" in str(seen)


def test_a_nearly_linear_one_agrees_with_the_covariance():
    seen = profile(decay_fit(decay(lambda p: p.k, Parameter("k", "1", 0.8, (0.01, 10.0)))), "k")
    assert seen.shape is ProfileShape.BOUNDED and seen.disagreement < 0.1 and not seen.is_better
    assert str(seen).splitlines()[1:] == ["  bounded on both sides"]


def test_one_limit_is_one_sided():
    data = Experiment("early", np.linspace(0, 0.2, 30), {}, {"y": 2.0 * np.linspace(0, 0.2, 30)})
    noisy = replace(data, outputs={"y": data.outputs["y"] + 0.02 * np.random.default_rng(1).normal(size=30)})
    seen = profile(gb.fit(SATURATION, noisy, noise={"y": 0.02}, options=REST), "a")
    assert seen.shape is ProfileShape.ONE_SIDED and seen.open_sides == (False, True)
    assert "the records set no upper limit" in str(seen)


def test_a_constant_that_another_can_replace_is_flat():
    one, other = (Parameter(name, "1", 1.2, (0.5, 2.0)) for name in ("a", "b"))
    seen = profile(decay_fit(decay(lambda p: p.a * p.b, one, other)), "a")
    assert seen.shape is ProfileShape.FLAT and "no limit on either side" in str(seen)


def test_two_valleys_are_told():
    seen = profile(decay_fit(decay(lambda p: (p.q - 1) ** 2, Parameter("q", "1", 1.8, (-3.0, 5.0))), 0.3), "q")
    # The rate is (q - 1)^2 = 1 at 2 and at 0.
    assert seen.shape is ProfileShape.TWO_VALLEYS
    value, rise = seen.valley
    assert value == pytest.approx(0.0, abs=0.5) and 0 <= rise < seen.threshold
    assert "the cost has fallen again" in str(seen)


@pytest.mark.rest
def test_profiles_of_the_semibatch_reactor_cover_the_constants_behind_its_record():
    """Published: intervals by the covariance miss them, since a frequency factor and its activation energy are nearly collinear."""
    result = gb.fit(semibatch(), published_record(), options=REST)
    seen = {name: profile(result, name) for name in TRUTH}
    for name, truth in TRUTH.items():
        assert seen[name].interval[0] <= truth <= seen[name].interval[1], name
    low, high = result.parameters["k2"].interval
    assert not low <= TRUTH["k2"] <= high and seen["k2"].is_better
    assert seen["k1"].partner == "E1" and seen["k1"].correlation > 0.999
    assert seen["k1"].shape is ProfileShape.ONE_SIDED
    assert "k1 and E1 are nearly collinear" in str(seen["k1"])
    assert "use the profile" in str(seen["k2"])
    # The interval that misses does so since E2 ends at its bound and counts as known there: with it free it is 220 times as wide.
    assert (seen["k2"].partner, seen["k2"].partner_at_bound) == ("E2", True) and seen["k2"].correlation > 0.999
    assert "takes E2 for known, as it is at its bound" in str(seen["k2"])
    assert (seen["E2"].partner, seen["E2"].partner_at_bound) == ("k2", False)
    region = profile_pair(result, "k1", "E1")
    assert region.narrowing > 20 and "the region is thin" in str(region)
    k = int(np.searchsorted(region.values, TRUTH["k1"]))
    assert region.lower[k - 1] < TRUTH["E1"] < region.upper[k]


def test_the_region_of_two_constants_is_that_of_the_sum_of_squares():
    """Of two constants in all there is nothing else to estimate: the edge is where the sum has risen to Fisher's point."""
    region = profile_pair(saturation_fit(), "b", "a")

    def squares(a: float, b: float) -> float:
        return float(np.sum((VALUES - a * (1 - np.exp(-b * TIMES))) ** 2))

    least = squares(*region.best[::-1])
    # Beale's region: S <= S_min (1 + p / (n - p) F).
    limit = least * (1 + 2 / 4 * fisher.ppf(0.95, 2, 4))
    assert region.threshold == pytest.approx(2 * fisher.ppf(0.95, 2, 4))
    for b, ridge, lower, upper in list(zip(region.values, region.ridge, region.lower, region.upper, strict=True))[1:-1]:
        assert ridge == pytest.approx(
            minimize_scalar(squares, bounds=(1, 100), args=(b,), method="bounded").x, rel=1e-3
        )
        for end in (lower, upper):
            assert end == 100.0 or squares(end, b) == pytest.approx(limit, rel=0.03)


def test_a_known_constant_narrows_another_as_in_an_ellipse():
    """Of two normal variables with correlation rho one is known ``1 / sqrt(1 - rho^2)`` times as closely beside the other."""
    rho, edge = 0.8, 2.448
    one = np.linspace(-edge, edge, 41)
    half = np.sqrt((1 - rho**2) * (edge**2 - one**2).clip(0))
    rise, ends = one**2, (rho * one - half, rho * one + half)
    region = ProfilePair("a", "b", ("1", "1"), (0.0, 0.0), one, rise, rho * one, *ends, edge**2, (False, False), rho)
    assert region.shape is ProfileShape.BOUNDED
    # The highest point of the ellipse lies between two of these values of the first.
    assert region.narrowing == pytest.approx(1 / 0.6, rel=1e-3)


def test_files_hold_the_shape_and_are_read_back(tmp_path):
    one, two = profile(saturation_fit(), "b"), profile_pair(saturation_fit(), "b", "a")
    for value, kind, load in ((one, Profile, load_profile), (two, ProfilePair, load_profile_pair)):
        path = value.save(tmp_path / "x.json")
        data = json.loads(path.read_text())
        assert strict_offences(data, kind) == [] and data["shape"] == str(value.shape)
        assert str(load(path)) == str(value)
    data = json.loads(path.read_text()) | {"ridge": [1.0]}
    path.write_text(json.dumps(data))
    with pytest.raises(DataError, match="not of one length"):
        load_profile_pair(path)


def test_a_pair_that_is_none_is_refused():
    with pytest.raises(ModelError, match="'M': not a fitted parameter"):
        profile_pair(saturation_fit(), "a", "M")
    with pytest.raises(ModelError, match="'a' and itself"):
        profile_pair(saturation_fit(), "a", "a")
