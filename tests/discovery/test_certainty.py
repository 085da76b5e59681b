"""From the measures of an effect's evidence to a probability, a grade and a verdict. Nothing is simulated."""

import math
from dataclasses import replace

import pytest

from greybox.discovery.certainty import CERTAINTY_WEIGHTS, Grade, grade_effect, probability_of, to_features
from greybox.discovery.conclusion import list_tied_sets, weigh_evidence
from greybox.discovery.decision import Conclusion, Verdict
from greybox.discovery.evidence import EffectEvidence
from greybox.discovery.findings import DiscoveryRule
from greybox.discovery.policy import CertaintyPolicy

POLICY = CertaintyPolicy()
# An effect that takes 99 % of the error, whose rival is far behind, beside which a curve gains nothing, and that leaves noise.
CLEAR = {
    "share": 0.99,
    "loss": 9999.0,
    "loss_t": 40.0,
    "rival_loss": 30.0,
    "rival_t": 25.0,
    "curve_loss": 0.01,
    "curve_t": 1.0,
    "curve_gain": 0.003,
    "rival_parameters": 0.0,
    "remainder": 0.01,
    "structure": 0.0,
    "change": 0.01,
    "start": 1.0,
    "effects": 1.0,
    "undetermined": 0.0,
}


def probability(**changes):
    return probability_of(to_features(CLEAR | changes), POLICY)


def grade(has_equal=False, **changes):
    features = to_features(CLEAR | changes)
    return grade_effect(probability_of(features, POLICY), features, has_equal)


def test_a_memory_that_the_records_do_not_show_is_not_established():
    assert grade(static_loss=5.0, static_t=12.0) is Grade.ESTABLISHED
    assert grade(static_loss=0.01, static_t=0.5) is not Grade.ESTABLISHED


def test_a_free_curve_counts_where_it_comes_near():
    assert grade(free_loss=2.0) is Grade.ESTABLISHED
    assert probability(free_loss=2.0) > probability(free_loss=0.05)
    assert grade(curve_loss=-0.3, curve_t=-1.0) is Grade.ESTABLISHED  # by chance


def test_a_curve_that_the_validation_records_refute_does_not_count():
    assert grade(curve_gain=0.06, loss=9.0, curve_loss=5.0, curve_t=9.0) is Grade.ESTABLISHED


@pytest.mark.parametrize("change", [{"start": 0.0}, {"change": 1.5}], ids=["another start", "the halves"])
def test_what_is_not_found_again_is_not_established(change):
    assert grade(**change) is not Grade.ESTABLISHED


def test_a_clear_effect_is_established():
    assert probability() > 0.95
    assert grade() is Grade.ESTABLISHED


@pytest.mark.parametrize(
    "change",
    [
        {"rival_loss": 0.01, "rival_t": 0.5},
        {"curve_loss": -0.9, "curve_t": -20.0},
        {"structure": 0.98},
        {"change": 1.0},
        {"curve_loss": math.nan, "curve_t": math.nan},
        {"static_loss": -0.01, "static_t": -2.0},
    ],
    ids=[
        *("a rival does as well", "a curve does better", "more than noise is left", "it moves", "its form is untested"),
        "a curve without memory does as well",
    ],
)
def test_whatever_speaks_against_an_effect_lowers_its_probability(change):
    assert probability(**change) < probability()


@pytest.mark.parametrize(
    "change",
    [
        {"rival_t": 2.9},
        {"curve_loss": -0.9999, "loss": 3.0},
        {"remainder": 0.7},
        {"share": 0.01},
        {"undetermined": 1.0},
        {"structure": 0.9, "loss": 5.0},
        {"structure": 0.9, "loss": 50.0, "curve_loss": math.nan, "curve_t": math.nan},
        {"curve_loss": -0.3, "curve_t": -3.3, "loss": 9.0},
        {"curve_gain": 0.06, "loss": 9.0},
        {"free_loss": 0.01},
        {"free_loss": -0.3},
    ],
    ids=[
        "rival within chance",
        "curve takes as much",
        "left over its variable",
        "takes nothing",
        "not determined",
        "much is left",
        "form untested and more than noise left",
        "a curve beside it takes a tenth more",
        "a curve beside it takes much of the records it was fitted to",
        "a free curve in its place does as well",
        "a free curve in its place does better",
    ],
)
def test_no_probability_establishes_an_effect_against_a_single_test(change):
    replace(POLICY, intercept=20.0)
    features = to_features(CLEAR | change)
    assert grade_effect(0.999, features, False) is Grade.PROBABLE


def test_a_curve_that_takes_a_little_beside_a_large_effect_is_no_other_form():
    assert grade(curve_loss=-0.3, curve_t=-12.0, curve_gain=0.2, loss=500.0) is Grade.ESTABLISHED


def test_what_another_effect_equals_is_probable_at_most():
    assert grade(has_equal=True) is Grade.PROBABLE


def test_a_model_that_cannot_be_run_without_the_effect_overflows_nothing():
    features = to_features(CLEAR | {"loss": 1e300, "loss_t": 1e300, "rival_loss": 1e300, "rival_t": 1e300})
    assert all(math.isfinite(value) and abs(value) <= 1 for value in features.values())
    assert 0 < probability_of(features, replace(POLICY, intercept=1e9)) <= 1


def test_every_feature_has_a_weight():
    assert set(to_features(CLEAR)) == set(CERTAINTY_WEIGHTS)


def evidence(name, given):
    values = {Grade.ESTABLISHED: 0.97, Grade.PROBABLE: 0.7, Grade.STAND_IN: 0.2}
    interval = (0.9, 0.95)
    return EffectEvidence(
        name, values[given], given, "x", "m", 2.0, 1.0, 0.5, interval, "", math.nan, (), 0.0, True, True, {}
    )


def tied(name, *alike, **changes):
    measures = CLEAR | changes
    return replace(evidence(name, Grade.PROBABLE), alike=alike, measures=measures, probability=probability(**changes))


@pytest.mark.parametrize(
    ("effects", "verdict", "sets"),
    [
        ([tied("a", "b")], Verdict.AMBIGUOUS, [("b",)]),
        ([evidence("c", Grade.ESTABLISHED), tied("a", "b", "d")], Verdict.AMBIGUOUS, [("c", "b"), ("c", "d")]),
        ([tied("a", "b", change=1.5)], Verdict.UNKNOWN, [("b",)]),  # more than its equal speaks against it
        ([tied("a", "b", "fitted_curve")], Verdict.UNKNOWN, [("b",)]),  # so may be something else
        ([tied("a")], Verdict.UNKNOWN, []),
    ],
)
def test_effects_that_only_an_equal_keeps_from_certainty_are_ambiguous(effects, verdict, sets):
    assert weigh_evidence(Conclusion(Verdict.NAMED, ()), effects).verdict is verdict
    assert weigh_evidence(Conclusion(Verdict.UNKNOWN, ()), effects[-1:]).verdict is Verdict.UNKNOWN
    assert list_tied_sets(effects) == sets


SURE, LIKELY, DOUBTFUL = Grade.ESTABLISHED, Grade.PROBABLE, Grade.STAND_IN


@pytest.mark.parametrize(
    ("before", "grades", "after"),
    [
        (Verdict.NAMED, [SURE], Verdict.NAMED),
        (Verdict.NAMED, [SURE, SURE], Verdict.NAMED),
        (Verdict.NAMED, [SURE, LIKELY], Verdict.PARTLY),
        (Verdict.NAMED, [LIKELY], Verdict.UNKNOWN),
        (Verdict.NAMED, [], Verdict.UNKNOWN),  # no evidence could be gathered
        (Verdict.UNKNOWN, [SURE, DOUBTFUL], Verdict.PARTLY),
        (Verdict.UNKNOWN, [DOUBTFUL], Verdict.UNKNOWN),
        (Verdict.AMBIGUOUS, [LIKELY], Verdict.AMBIGUOUS),
        (Verdict.AMBIGUOUS, [LIKELY, DOUBTFUL], Verdict.UNKNOWN),  # what only stands in is not lacked
        (Verdict.AMBIGUOUS, [SURE, DOUBTFUL], Verdict.PARTLY),
        (Verdict.COMPLETE, [], Verdict.COMPLETE),
    ],
)
def test_a_name_is_certain_only_where_it_is_established(before, grades, after):
    each = [evidence(f"effect_{k}", given) for k, given in enumerate(grades)]
    conclusion = weigh_evidence(Conclusion(before, ()), each)
    assert conclusion.verdict is after
    outcomes = [check.passed for check in conclusion.checks if check.rule == DiscoveryRule.ESTABLISHED]
    assert outcomes == [given is SURE for given in grades]
