"""Residual tests against scipy and statsmodels, their false alarms, what they find; scores beside each other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2, jarque_bera, kstest

from greybox.base.errors import DataError
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import AutoRegression
from greybox.estimation.fit import fit
from greybox.estimation.options import FitOptions
from greybox.estimation.residuals import (
    LaggedInput,
    correlate_with_inputs,
    input_independence_test,
    ljung_box_test,
    normality_test,
    residual_tests,
    run_residual_tests,
)
from greybox.estimation.residuals import ResidualTestKind as Kind
from greybox.estimation.score import score
from models.micro_actuator import micro_actuator
from tests.oracles.independent import linear_record, multisine
from tests.support.first_order import rooney_biegler

TRUTH = micro_actuator.fix("M", "Ra")
LEVEL = {"x": 2e-7, "i": 5e-3}


def record(seed, rho=0.0, rows=1500):
    rng = np.random.default_rng([seed, 2])
    clean = linear_record(TRUTH, multisine(rng, rows, 2.5e-4, 5, 800, 3.0), 2.5e-4)

    def noise():
        return lfilter([1.0], [1.0, -rho], rng.normal(size=rows + 300) * np.sqrt(1 - rho**2))[300:]

    return replace(clean, outputs={n: y + LEVEL[n] * noise() for n, y in clean.outputs.items()})


def test_whiteness_is_that_of_statsmodels():
    diagnostic = pytest.importorskip("statsmodels.stats.diagnostic")
    series = lfilter([1.0], [1.0, -0.2], np.random.default_rng(1).normal(size=400))
    table = diagnostic.acorr_ljungbox(series, lags=[5, 10, 20])
    for lags, row in table.iterrows():
        assert ljung_box_test(series, lags) == pytest.approx((row.lb_stat, row.lb_pvalue), rel=1e-9)


def test_normality_is_that_of_scipy_and_skips_gaps():
    series = np.random.default_rng(2).standard_t(4, size=500)
    expected = jarque_bera(series)
    assert normality_test(np.insert(series, 100, np.nan)) == pytest.approx((expected.statistic, expected.pvalue))


def test_input_independence_is_the_textbook_statistic_for_white_noise():
    rng = np.random.default_rng(3)
    r, signal = rng.normal(size=300), rng.normal(size=300)
    signal -= signal.mean()
    u = np.column_stack([np.concatenate([np.zeros(k), signal[: 300 - k]]) for k in range(5)])
    lagged = LaggedInput.of(signal + 7.0, 4)
    assert np.concatenate([lagged[:130], lagged[130:300]]) == pytest.approx(u, abs=1e-14)
    figure, p = input_independence_test(*correlate_with_inputs([r], [u], AutoRegression())[:2])
    c = u.T @ r
    expected = c @ np.linalg.inv(u.T @ u * np.mean(r**2)) @ c
    assert figure == pytest.approx(expected, rel=1e-9)
    assert p == pytest.approx(chi2.sf(expected, 5), rel=1e-9)


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_input_independence_has_its_size_under_coloured_noise(rho):
    """Its p-values are uniform; without the colour nearly every AR(1) 0.9 residual with a slow input would raise an alarm."""
    rng = np.random.default_rng(4)
    u = LaggedInput.of(lfilter([1.0], [1.0, -0.95], rng.normal(size=800)), 10)
    p, blind = [], []
    for _ in range(300):
        r = lfilter([1.0], [1.0, -rho], rng.normal(size=1000))[200:]
        p.append(
            input_independence_test(*correlate_with_inputs([r], [u], AutoRegression((rho,) if rho else ()))[:2])[1]
        )
        blind.append(input_independence_test(*correlate_with_inputs([r], [u], AutoRegression())[:2])[1])
    assert kstest(p, "uniform").pvalue > 0.01
    assert rho == 0 or np.mean(np.array(blind) < 0.01) > 0.3


def controlled(seed, controller, rows=1500):
    """Innovations of a plant with a walking disturbance, and the input that a controller or nobody made of its readings."""
    rng = np.random.default_rng(seed)
    e, u, y = rng.normal(size=rows), np.zeros(rows), np.zeros(rows)
    for k in range(1, rows):
        y[k] = 0.9 * y[k - 1] + 0.3 * u[k - 1] + e[k]
        u[k] = controller(y, k, rng)
    return e, u


LOOPS = {
    "proportional, this row": (lambda y, k, rng: -0.8 * y[k], True),
    "relay, this row": (lambda y, k, rng: -2.0 * np.sign(y[k]), True),
    "integral with dither, this row": (lambda y, k, rng: -0.2 * y[: k + 1].sum() + rng.normal(), True),
    "proportional, the row before": (lambda y, k, rng: -0.8 * y[k - 1] + 0.1 * rng.normal(), False),
    "open, steps": (lambda y, k, rng: float((k // 40) % 2), False),
    "open, noise": (lambda y, k, rng: rng.normal(), False),
}


@pytest.mark.parametrize("name", LOOPS)
def test_a_controller_that_answers_the_same_row_is_told_from_a_lack_of_the_model(name):
    controller, answers = LOOPS[name]
    found = {True: [], False: []}
    for seed in range(20):
        e, u = controlled(seed, controller)
        tests = run_residual_tests("y", [e], {"u": [u]}, later=["u"])
        for test in tests:
            if test.input == "u":
                found[test.kind is Kind.SAME_ROW].append(test.alarm)
    assert np.mean(found[False]) <= 0.05
    assert np.mean(found[True]) == 1.0 if answers else np.mean(found[True]) <= 0.05


def test_a_missing_lag_is_no_answer_to_the_same_row():
    rng = np.random.default_rng(8)
    u = np.repeat(rng.uniform(-1, 1, 500), 4)
    lacking = lfilter([0.0, 0.5], [1.0, -0.8], u) + 0.1 * rng.normal(size=2000)
    by_kind = {t.kind: t for t in run_residual_tests("y", [lacking], {"u": [u]}, later=["u"])}
    assert by_kind[Kind.INPUT_INDEPENDENCE].alarm and not by_kind[Kind.SAME_ROW].alarm


@pytest.mark.slow
def test_false_alarms_on_white_noise_are_one_in_a_hundred():
    rng = np.random.default_rng(5)
    alarms = {}
    for _ in range(1000):
        u = multisine(rng, 600, 1.0, 0.01, 0.3, 1.0, lines=20)
        for test in run_residual_tests("y", [rng.normal(size=600)], {"u": [u]}):
            alarms.setdefault((test.kind, test.lags), []).append(test.alarm)
    rates = {name: np.mean(found) for name, found in alarms.items()}
    assert set(rates) == {
        *((Kind.WHITENESS, lags) for lags in (5, 10, 20)),
        (Kind.INPUT_INDEPENDENCE, 20),
        *((kind, 0) for kind in (Kind.NORMALITY, Kind.EQUAL_VARIANCE, Kind.EQUAL_MEAN)),
    }
    # Jarque and Bera's statistic has heavier tails than chi-square at this length.
    assert all(0.002 <= rate <= (0.03 if kind is Kind.NORMALITY else 0.02) for (kind, _), rate in rates.items()), rates
    assert 0.006 < np.mean(list(rates.values())) < 0.016, rates


@pytest.mark.rest
def test_the_right_model_raises_few_alarms_whatever_the_colour():
    kinds = [kind for kind in Kind if kind is not Kind.WHITENESS]
    assert any(kind is Kind.SAME_ROW for kind in kinds)
    alarms, whiteness = [], {0.0: [], 0.9: []}
    for seed in range(7):
        for rho in (0.0, 0.9):
            found = residual_tests(fit(TRUTH, record(seed, rho)))
            alarms += [found.of(output, kind).alarm for output in ("x", "i") for kind in kinds]
            whiteness[rho] += [found.of(output, Kind.WHITENESS, lags=10).alarm for output in ("x", "i")]
    assert np.mean(alarms) < 0.05
    assert np.mean(whiteness[0.0]) < 0.15 and np.all(whiteness[0.9])


def test_a_wrong_model_follows_its_input():
    wrong = fit(TRUTH.fix(Ra=8.5), record(1))
    found = residual_tests(wrong)
    assert found.of("i", Kind.INPUT_INDEPENDENCE, input="u").alarm
    with pytest.raises(KeyError, match="no test 'whiteness' of output 'y'"):
        found.of("y", Kind.WHITENESS)
    assert set(found.alarms) <= set(found.tests)


def test_outliers_bursts_and_drift_are_each_told():
    rng = np.random.default_rng(6)
    plain = rng.normal(size=2000)
    outliers = np.where(rng.random(2000) < 0.01, 8.0, plain)
    burst = plain * np.where(np.arange(2000) > 1500, 3.0, 1.0)
    drift = plain + np.linspace(-1, 1, 2000)

    def alarms(series):
        return {t.kind for t in run_residual_tests("y", [series], {}) if t.alarm}

    assert alarms(plain) == set()
    assert Kind.NORMALITY in alarms(outliers) and Kind.EQUAL_MEAN not in alarms(outliers)
    assert Kind.EQUAL_VARIANCE in alarms(burst)
    assert alarms(drift) & {Kind.EQUAL_MEAN, Kind.WHITENESS}


def test_gaps_and_several_records_go_through():
    rng = np.random.default_rng(7)
    one, two = record(1), record(2)
    gappy = replace(one, outputs={n: np.where(rng.random(one.rows) < 0.2, np.nan, y) for n, y in one.outputs.items()})
    found = residual_tests(fit(TRUTH, [gappy, two]))
    assert all(np.isfinite(t.statistic) and 0 <= t.p_value <= 1 for t in found.tests)
    assert len(found.alarms) <= 1


def test_known_colour_is_whitened_before_the_tests():
    rng = np.random.default_rng(8)
    data = record(3, 0.9)
    silent = {n: s * lfilter([1.0], [1.0, -0.9], rng.normal(size=3000) * np.sqrt(0.19))[500:] for n, s in LEVEL.items()}
    quiet = replace(data, time=2.5e-4 * np.arange(2500), inputs={"u": np.zeros(2500)}, outputs=silent)
    found = residual_tests(fit(TRUTH, data, quiet=quiet))
    assert found.whitened == ("x", "i")
    assert not found.of("x", Kind.WHITENESS, lags=5).alarm


@pytest.mark.slow
def test_predictions_beat_the_free_run_by_what_the_colour_allows():
    found = fit(TRUTH, record(1, 0.9, 20000))
    table = score(found, steps=(1, 5, 50))
    for output in ("x", "i"):
        outcome = table.outputs[output]
        assert outcome.rmse == found.misfit[output].rmse
        for ahead, rmse in outcome.ahead.items():
            assert rmse / outcome.rmse == pytest.approx(np.sqrt(1 - 0.81**ahead), rel=0.06)


@pytest.mark.rest
def test_scores_of_other_records_use_the_predictor_of_the_fit():
    found = fit(TRUTH, record(1, 0.9))
    other = score(found, record(2, 0.9), steps=(1,), skip=50).outputs["x"]
    assert other.ahead[1] / other.rmse == pytest.approx(np.sqrt(0.19), rel=0.15)
    white = score(found, record(2, 0.0), steps=(1,), skip=50).outputs["x"]
    assert white.ahead[1] > white.rmse, "a predictor for slow noise does harm on white noise, and the score shows it"
    with pytest.raises(DataError, match="steps ahead: 0; give whole numbers from 1"):
        score(found, steps=(0,))


def test_a_test_that_too_few_values_allow_is_not_made():
    """Its statistic of zero would pass."""
    time = np.arange(7.0)
    record = Experiment("six values", time, {"u": 0 * time}, {"y": np.r_[0.0, 8.3, 10.3, 19.0, 16.0, 15.6, 19.8]})
    tests = residual_tests(fit(rooney_biegler(), record, options=FitOptions(at_rest=True)))
    assert tests.tests == ()
    kinds = {kind for kind in Kind if kind not in ("input_independence", "same_row")}  # the input does not move
    assert {output: set(missing) for output, missing in tests.not_made.items()} == {"y": kinds}
    assert (
        " ".join(str(tests).split())
        == "not tested: y has too few values for whiteness, normality, equal variance, equal mean"
    )
