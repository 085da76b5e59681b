"""Golden texts of residual tests and scores."""

import pytest

from greybox.data.noise.noise_model import AutoRegression
from greybox.estimation.errors import OutputScore
from greybox.estimation.residuals import ResidualTest, ResidualTestKind, ResidualTests
from greybox.estimation.score import Scores
from greybox.show.sentences.estimation import name_test

GOLDEN = {
    (ResidualTestKind.WHITENESS, False): ("whiteness, 5 lags", "no correlation over 5 samples"),
    (ResidualTestKind.WHITENESS, True): (
        "whiteness, 5 lags",
        "correlated over 5 samples (AR(1), correlation 0.9 from sample to sample)",
    ),
    (ResidualTestKind.INPUT_INDEPENDENCE, False): ("independence of u", "independent of the input u"),
    (ResidualTestKind.INPUT_INDEPENDENCE, True): (
        "independence of u",
        "correlated with the input u: the model lacks part of its effect",
    ),
    (ResidualTestKind.SAME_ROW, False): ("u in the same row", "the input u does not answer the reading of its own row"),
    (ResidualTestKind.SAME_ROW, True): (
        "u in the same row",
        "correlated with the input u in the same row, which the model gives no path: a controller answers the reading (the loop is"
        " closed), or a direct path is missing",
    ),
    (ResidualTestKind.NORMALITY, False): ("normality", "normally distributed"),
    (ResidualTestKind.NORMALITY, True): (
        "normality",
        "not normal: look for outliers, quantisation or two regimes",
    ),
    (ResidualTestKind.EQUAL_VARIANCE, False): ("equal variance", "equally large throughout"),
    (ResidualTestKind.EQUAL_VARIANCE, True): ("equal variance", "larger in some parts of the record than in others"),
    (ResidualTestKind.EQUAL_MEAN, False): ("equal mean", "no drift"),
    (ResidualTestKind.EQUAL_MEAN, True): ("equal mean", "its mean drifts, or an offset changes"),
}


@pytest.mark.parametrize("alarm", [False, True])
@pytest.mark.parametrize("kind", ResidualTestKind)
def test_each_test_has_its_name_and_its_sentence(kind, alarm):
    test = ResidualTest("x", kind, 12.345, 0.004, alarm, 5, "u", AutoRegression((0.9,)))
    assert (name_test(test), str(test)) == GOLDEN[kind, alarm]


def test_tests_are_printed_as_a_table():
    tests = ResidualTests((ResidualTest("x", ResidualTestKind.NORMALITY, 12.345, 0.0021, True),), ("x",))
    assert str(tests).splitlines() == [
        "  output  test       statistic  p",
        "  x       normality  12.35      0.0021  not normal: look for outliers,",
        "                                        quantisation or two regimes",
        "",
        "the residual of x was whitened with the noise model before the tests",
    ]


def test_scores_are_printed_as_a_table():
    scores = Scores({"x": OutputScore(2e-6, 99.0, 100, "m", {1: 1e-6, 10: 1.5e-6}, 3e-4, "a filter")})
    assert str(scores).splitlines() == [
        "  rmse  free run  1 step ahead  10 steps ahead  movement  unit",
        "  x     2e-06     1e-06         1.5e-06         0.0003    m",
        "",
        "corrected by: a filter",
    ]
