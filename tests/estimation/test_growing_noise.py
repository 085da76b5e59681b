"""Noise that grows with the signal: told or estimated, against regressions that share no code with the library."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import curve_fit, minimize

import greybox as gb
from greybox import Experiment, GrowingNoise
from greybox.base.errors import DataError, ModelError
from greybox.extensions.changes.result import ChangeVerdict
from tests.support.decay import decay
from tests.support.result_schema import strict_offences

OPTIONS = gb.FitOptions(at_rest=True)
TIME = np.linspace(0.0, 5.0, 100)
TRUTH = {"A": 5.0, "k": 0.8}


def curve(t: np.ndarray, a: float, k: float) -> np.ndarray:
    return a * np.exp(-k * t)


def record(seed: int, floor: float = 0.02, share: float = 0.1, *, k: float = 0.8, a: float = 5.0) -> Experiment:
    run, e = curve(TIME, a, k), np.random.default_rng(seed).standard_normal(len(TIME))
    return Experiment(f"run {seed}", TIME, {}, {"y": run + (floor + share * run) * e})


def factor_record(seed: int, std: float = 0.3) -> Experiment:
    e = np.random.default_rng(seed).standard_normal(len(TIME))
    return Experiment(f"run {seed}", TIME, {}, {"y": curve(TIME, 5.0, 0.8) * np.exp(std * e)})


def fit(data: Experiment, noise: GrowingNoise | None, **more) -> gb.Fit:
    return gb.fit(decay(), data, noise={"y": noise} if noise else None, options=OPTIONS, **more)


def test_constants_are_those_of_reweighted_least_squares_by_scipy() -> None:
    data = record(1)
    result = fit(data, GrowingNoise(0.02, 0.1))
    values = np.array([3.0, 0.5])
    for _ in range(20):
        std = 0.02 + 0.1 * curve(TIME, *values)
        values, covariance = curve_fit(curve, TIME, data.outputs["y"], values, std, absolute_sigma=True)
    for name, value, std in zip(("A", "k"), values, np.sqrt(np.diag(covariance)), strict=True):
        # The weights are those of a run that is within two per cent of the noise of the last one.
        assert result.parameters[name].value == pytest.approx(value, abs=0.02 * std)
        assert result.parameters[name].std == pytest.approx(std, rel=0.02)
    assert result.noise.sources["y"] == "given" and result.noise.growth["y"].is_told


def test_estimated_parts_are_the_most_likely_ones() -> None:
    data = record(2)
    result = fit(data, GrowingNoise())
    found, run = result.noise.growth["y"], result.traces[0].simulated["y"]
    squares = (data.outputs["y"] - run) ** 2 * 100 / 98

    def likelihood(parts: np.ndarray) -> float:
        s = np.exp(parts[0]) + np.exp(parts[1]) * np.abs(run)
        return float(np.mean(squares / s**2 + 2 * np.log(s)))

    best = minimize(likelihood, np.log([0.05, 0.05]), method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-12})
    assert found.estimated == ("floor", "share")
    assert (found.floor, found.share) == pytest.approx(np.exp(best.x), rel=0.03)
    assert result.misfit["y"].noise_ratio == pytest.approx(1.0, abs=0.03)


@pytest.mark.rest
@pytest.mark.parametrize(
    ("told", "unknown"),
    [
        (GrowingNoise(floor=0.02), "share"),
        *(
            pytest.param(*c, marks=pytest.mark.slow)
            for c in ((GrowingNoise(share=0.1), "floor"), (GrowingNoise(0.0), "share"))
        ),
    ],
)
def test_what_is_told_stays_and_the_rest_is_estimated(told: GrowingNoise, unknown: str) -> None:
    floor = told.floor if told.floor is not None else 0.02
    found = [fit(record(seed, floor), told).noise.growth["y"] for seed in range(20)]
    assert all(noise.estimated == (unknown,) for noise in found)
    truth = {"floor": floor, "share": 0.1}
    assert np.mean([getattr(noise, unknown) for noise in found]) == pytest.approx(truth[unknown], rel=0.15)
    assert all(getattr(n, p) == getattr(told, p) for n in found for p in truth if p != unknown)


def test_a_logarithmic_output_is_the_regression_of_logarithms() -> None:
    data = factor_record(3)
    result = fit(data, GrowingNoise(logarithmic=True))
    line, covariance = np.polyfit(TIME, np.log(data.outputs["y"]), 1, cov=True)
    assert result.parameters["k"].value == pytest.approx(-line[0], rel=1e-6)
    assert result.parameters["k"].std == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-5)
    assert np.log(result.parameters["A"].value) == pytest.approx(line[1], rel=1e-6)
    rest = np.log(data.outputs["y"]) - np.polyval(line, TIME)
    assert result.noise.growth["y"].share == pytest.approx(rest.std(ddof=2), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "noise"),
    [
        (record, GrowingNoise()),
        (record, GrowingNoise(0.02, 0.1)),
        (lambda seed: record(seed, 0.0), GrowingNoise(floor=0.0)),
        (factor_record, GrowingNoise(logarithmic=True)),
    ],
    ids=["estimated", "told", "relative", "logarithmic"],
)
def test_intervals_cover_the_truth(make, noise: GrowingNoise) -> None:
    """Two hundred records; an interval that covers 95 % covers 93 to 97 % of four hundred constants (two standard errors)."""
    inside = 0
    for seed in range(500, 700):
        constants = fit(make(seed), noise).parameters
        inside += sum(constants[n].interval[0] < truth < constants[n].interval[1] for n, truth in TRUTH.items())
    assert 0.93 <= inside / 400 <= 0.97


def test_of_one_noise_for_all_rows_intervals_fall_short_and_a_test_says_why() -> None:
    data = record(4)
    plain, weighed = gb.residual_tests(fit(data, None)), gb.residual_tests(fit(data, GrowingNoise()))
    assert "equal_variance" in [t.kind for t in plain.alarms]
    assert not weighed.alarms


def test_a_profile_and_a_bootstrap_weigh_rows_as_the_fit_does() -> None:
    result = fit(record(5), GrowingNoise())
    stated = result.parameters["k"].interval
    width = stated[1] - stated[0]
    assert gb.uncertainty.profile(result, "k").interval == pytest.approx(stated, abs=0.05 * width)
    drawn = gb.uncertainty.bootstrap(result, np.random.default_rng(1), replicates=500)
    assert drawn.std["k"] == pytest.approx(result.parameters["k"].std, rel=0.2)


def test_a_profile_of_noise_told_row_by_row_weighs_the_rows() -> None:
    std = 0.02 + 0.1 * curve(TIME, 5.0, 0.8)
    result = gb.fit(decay(), replace(record(6), noise={"y": std}), options=OPTIONS)
    stated = result.parameters["k"].interval
    assert gb.uncertainty.profile(result, "k").interval == pytest.approx(stated, abs=0.05 * (stated[1] - stated[0]))
    assert result.misfit["y"].noise_ratio == pytest.approx(1.0, abs=0.2)


def test_a_record_with_larger_signals_is_judged_by_its_own_noise() -> None:
    result = fit(record(7), GrowingNoise(), validation=record(8, a=5.0))
    assert result.validation.misfit["y"].noise_ratio == pytest.approx(1.0, abs=0.25)
    larger = replace(record(9, a=50.0), conditions={"A": 50.0})
    judged = gb.validate(result.model, larger, noise=result.noise.given, options=OPTIONS)
    assert judged.misfit["y"].noise_ratio == pytest.approx(1.0, abs=0.25)
    assert judged.misfit["y"].rmse > 5 * result.misfit["y"].rmse


def test_outliers_are_kept_out_of_rows_that_are_weighed() -> None:
    data = record(10)
    y = data.outputs["y"].copy()
    y[[20, 60]] += 3.0
    robust = gb.fit(
        decay(),
        data.with_outputs({"y": y}),
        noise={"y": GrowingNoise(0.02, 0.1)},
        options=replace(OPTIONS, loss="huber"),
    )
    assert robust.parameters["k"].value == pytest.approx(0.8, abs=4 * robust.parameters["k"].std)
    assert robust.robust.outliers["y"] == pytest.approx(0.02, abs=0.06)


def test_a_saved_fit_is_read_back_with_its_noise(tmp_path) -> None:
    result = fit(record(11), GrowingNoise())
    path = result.save(tmp_path / "fit.json")
    again = gb.load_fit(path, decay())
    assert again.noise.growth == result.noise.growth and str(again.noise) == str(result.noise)
    assert strict_offences(json.loads(path.read_text()), gb.Fit) == []
    assert gb.uncertainty.profile(again, "k").interval == gb.uncertainty.profile(result, "k").interval


@pytest.mark.rest
def test_a_change_is_named_and_a_repeat_is_none() -> None:
    reference = fit(record(12), GrowingNoise())
    same = [gb.detect_changes(reference, record(100 + k), search_effects=False).verdict for k in range(10)]
    assert same.count(ChangeVerdict.CHANGED) <= 1
    found = gb.detect_changes(reference, record(13, k=0.9), search_effects=False)
    assert found.verdict is ChangeVerdict.CHANGED and "k" in found.moved
    assert found.today.noise.growth["y"].share == pytest.approx(0.1, rel=0.4)


@pytest.mark.parametrize(
    ("noise", "text"),
    [
        (GrowingNoise(0.02, 0.1), "0.02 g + 10 % of the reading (given)"),
        (GrowingNoise(0.0, 0.1), "10 % of the reading (given)"),
        (GrowingNoise(share=0.1, logarithmic=True), "0.1 in log(y) (given)"),
    ],
)
def test_the_noise_is_said_in_one_line(noise: GrowingNoise, text: str) -> None:
    data = factor_record(14, 0.1) if noise.logarithmic else record(14)
    assert str(fit(data, noise).noise) == text


def test_what_is_no_noise_is_refused() -> None:
    with pytest.raises(ModelError, match="both zero"):
        GrowingNoise(0.0, 0.0)
    with pytest.raises(ModelError, match=r"share is -0\.1"):
        GrowingNoise(share=-0.1)
    with pytest.raises(ModelError, match=r"a floor of 0\.1 with a logarithmic output"):
        GrowingNoise(floor=0.1, logarithmic=True)
    y = record(15).outputs["y"].copy()
    y[2] = -1.0
    with pytest.raises(DataError, match=r"y is -1 in row 3; its noise is that of log\(y\)"):
        fit(record(15).with_outputs({"y": y}), GrowingNoise(logarithmic=True))
    with pytest.raises(ModelError, match="noise that grows with the signal: a fit with process noise"):
        gb.fit(decay().with_process_noise("y"), record(16), noise={"y": GrowingNoise()}, options=OPTIONS)
    with pytest.raises(ModelError, match="noise of y grows with the signal; a search takes"):
        gb.discover(decay(), record(17), validation=record(18), noise={"y": GrowingNoise()})
