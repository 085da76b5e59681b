"""The rules of decision alone: costs and errors in, decision and checks out. Nothing is simulated."""

import math

import pytest

from greybox.data.noise.noise_model import AutoRegression
from greybox.discovery.decision import (
    judge_effect,
    judge_holdout,
    judge_residual,
    judge_rest,
    judge_test,
    judge_validation_only,
    visible_rms_limit,
)
from greybox.discovery.findings import DiscoveryRule as Rule
from greybox.discovery.holdout import HoldoutError
from greybox.discovery.policy import SelectionPolicy
from greybox.discovery.problem import clean_cost_limit, noise_cost_limit
from tests.support.fake_candidates import COUNT, candidate

POLICY = SelectionPolicy()
NOISE = noise_cost_limit(COUNT)  # cost per sample; four standard deviations above one
CLEAN = clean_cost_limit(COUNT)
LIMITS = {"x": 1.1, "i": 1.2}


def outcomes(checks):
    return {str(check.rule): check.passed for check in checks}


def test_limits_shrink_with_the_number_of_samples_and_grow_with_the_colour():
    assert noise_cost_limit(800) == pytest.approx(1 + 4 * math.sqrt(2 / 800))
    assert clean_cost_limit(COUNT) == pytest.approx(NOISE + 0.05)
    white = visible_rms_limit(5000, AutoRegression())
    assert white == pytest.approx(1.05 + 4 / math.sqrt(10000))
    assert visible_rms_limit(5000, AutoRegression((0.9,))) > white


@pytest.mark.parametrize(
    ("plain", "larger", "accepted", "rules"),
    [
        (9000.0, 1000.0, True, {"criterion_gain": True, "explained_excess": True}),
        # The gain must pay for the constant: ln(1000) = 6.9 and 20 more.
        (1100.0, 1075.0, False, {"criterion_gain": False, "explained_excess": True}),
        # A clear gain that explains less than a tenth of the excess is a look-alike.
        (9000.0, 8300.0, False, {"criterion_gain": True, "explained_excess": False}),
        (9000.0, 8200.0, True, {"criterion_gain": True, "explained_excess": True}),
    ],
)
def test_a_first_effect_must_gain_and_explain_a_tenth(plain, larger, accepted, rules):
    baseline = candidate(plain)
    decision = judge_effect(baseline, baseline, candidate(larger, "friction"), POLICY)
    assert (decision.passed, outcomes(decision.checks)) == (accepted, rules)
    assert {check.subject for check in decision.checks} == {"friction"}


@pytest.mark.parametrize(
    ("plain", "smaller", "larger", "accepted", "reason"),
    [
        (9000.0, 2000.0, 1900.0, True, Rule.EXPLAINED_EXCESS),  # a hundredth of 8000 is 80
        (9000.0, 2000.0, 1930.0, False, None),
        # Beside a strong effect a weak one counts where only noise is left.
        (1e6, 1000 * NOISE + 40, 1000 * NOISE - 1, True, Rule.ONLY_NOISE_LEFT),
        (1e6, 1000 * NOISE + 80, 1000 * NOISE + 1, False, None),
        (1e6, 1000 * NOISE - 1, 900.0, False, None),  # there was only noise before
    ],
)
def test_a_further_effect_explains_a_hundredth_or_leaves_only_noise(plain, smaller, larger, accepted, reason):
    decision = judge_effect(candidate(plain), candidate(smaller, "a"), candidate(larger, "a", "b"), POLICY)
    assert decision.passed is accepted
    passed = {rule for rule, ok in outcomes(decision.checks).items() if ok} - {Rule.CRITERION_GAIN}
    assert passed == (set() if reason is None else {reason})
    assert {check.subject for check in decision.checks} == {"b"}


@pytest.mark.parametrize(
    ("plain", "cost", "clean"),
    [
        (9000.0, 1000 * CLEAN - 1, True),
        (9000.0, 1000 * CLEAN + 1, False),
        (1e6, 1500.0, True),  # 500 of 999000 is less than 0.3 %
        (1e6, 1700.0, False),  # more than 1.6 a sample is visible whatever the share
        (1e5, 1500.0, False),
    ],
)
def test_a_residual_is_clean_near_the_noise_or_as_a_small_share(plain, cost, clean):
    assert judge_residual(candidate(plain), candidate(cost, "a")).passed is clean


@pytest.mark.parametrize(
    ("before", "after", "passed", "reason"),
    [
        (1.04, 1.04, True, None),  # no gap to explain
        (10.0, 1.5, True, Rule.HOLDOUT_EXPLAINED),
        (10.0, 2.0, False, None),  # 89 %, and above what noise explains
        (1.5, 1.09, True, Rule.HOLDOUT_NOISE),  # 82 %, and within the noise
        (1.15, 1.09, False, Rule.HOLDOUT_NOISE),  # within the noise, but explains only 40 %
        (2.0, 2.5, False, None),
        (2.0, math.nan, False, None),  # it ran away
    ],
)
def test_the_gap_on_validation_records_must_be_explained(before, after, passed, reason):
    decision = judge_holdout({"x": HoldoutError(before, after, 1.0, "m")}, LIMITS, POLICY)
    assert decision.passed is passed
    result = outcomes(decision.checks)
    assert result[Rule.HOLDOUT_GAP] is (before > 1.05)
    if reason is not None:
        assert result[reason]


@pytest.mark.parametrize(
    ("before", "after", "passed"),
    [
        (1.09, 1.09, True),
        (129.0, 129.0, False),  # the plain model was complete, and here it is not
        (10.0, 1.5, True),  # nine tenths of the gap
        (10.0, 2.5, False),
        (math.inf, math.inf, False),
    ],
)
def test_test_records_contradict_that_only_noise_is_left(before, after, passed):
    quiet = HoldoutError(1.0, 1.0, 1.0, "A")
    decision = judge_test({"x": HoldoutError(before, after, 1.0, "m"), "i": quiet}, LIMITS, POLICY)
    assert decision.passed is passed
    assert [(c.subject, c.passed) for c in decision.checks] == [("x", passed), ("i", True)]


def test_the_output_that_is_missed_most_decides():
    errors = {"x": HoldoutError(2.0, 1.9, 1.0, "m"), "i": HoldoutError(5.0, 0.51, 0.5, "A")}
    decision = judge_holdout(errors, LIMITS, POLICY)
    assert decision.passed
    assert {check.subject for check in decision.checks} == {"i"}


@pytest.mark.parametrize(
    ("cost", "before", "shows"),
    [
        (1000.0, 1.5, True),
        (1000.0, 1.09, False),  # noise may leave that much
        (4000.0, 2.5, False),  # twice the noise where it was fitted: 1.5 more is not twice as much
        (4000.0, 3.1, True),
    ],
)
def test_a_misfit_may_show_on_the_validation_records_only(cost, before, shows):
    errors = {"x": HoldoutError(before, before, 1.0, "m")}
    assert judge_validation_only(candidate(cost), errors, LIMITS).passed is shows


NO_GAP, EXPLAINED, LEFT = (HoldoutError(*error, 1.0, "m") for error in ((1.0, 1.0), (10.0, 1.1), (10.0, 5.0)))


@pytest.mark.parametrize(
    ("plain", "selected", "error", "autocorrelation", "passed"),
    [
        (1000.0, (), NO_GAP, 0.0, True),
        (2000.0, (), NO_GAP, 0.0, False),  # something is left, and no effect explains it
        (1000.0, (), LEFT, 0.0, False),  # it shows on the validation records only
        (9000.0, (1010.0, "a"), EXPLAINED, 0.0, True),
        (9000.0, (2000.0, "a"), EXPLAINED, 0.0, False),  # not clean
        (9000.0, (1010.0, "a"), EXPLAINED, 0.04, False),  # the residual has structure
        (9000.0, (1000 * 0.00017**2, "a"), EXPLAINED, 0.9, True),  # exact data: what is left is the integrator's
        (9000.0, (1010.0, "a"), LEFT, 0.0, False),  # not on other records
    ],
)
def test_only_noise_is_left_if_everything_agrees(plain, selected, error, autocorrelation, passed):
    baseline = candidate(plain)
    final = candidate(selected[0], *selected[1:]) if selected else baseline
    decision = judge_rest(baseline, final, {"x": error}, LIMITS, autocorrelation, POLICY)
    assert decision.passed is passed
    assert decision.checks


def test_a_stricter_policy_is_followed():
    baseline, larger = candidate(9000.0), candidate(1000.0, "friction")
    assert judge_effect(baseline, baseline, larger, POLICY)
    assert not judge_effect(baseline, baseline, larger, SelectionPolicy(criterion_gain=1e4))
    errors = {"x": HoldoutError(10.0, 1.5, 1.0, "m")}
    assert not judge_holdout(errors, LIMITS, SelectionPolicy(holdout_share=0.99))
