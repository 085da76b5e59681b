"""Errors of models held against each other, and what of an error is no noise, with errors that are given: nothing is simulated."""

from types import SimpleNamespace

import numpy as np
import pytest

from greybox.data.noise.noise_model import BoundDirection, NoiseBound, NoiseSource
from greybox.discovery.holdout import AdaptedRun, compare_errors, measure_structure

RNG = np.random.default_rng(1)
ERRORS = {"x": 1.0 + 0.1 * RNG.standard_normal(24) ** 2}


def test_a_loss_is_relative_to_what_the_model_leaves():
    loss, deviations = compare_errors(ERRORS, {"x": 4 * ERRORS["x"]})
    assert loss == pytest.approx(3.0)
    assert deviations > 1e6  # the same in every block


def test_chance_differences_are_no_loss():
    others = {"x": ERRORS["x"] * np.exp(0.05 * RNG.standard_normal(24))}
    loss, deviations = compare_errors(ERRORS, others)
    assert abs(loss) < 0.05 and abs(deviations) < 3


def test_rounding_is_no_difference():
    loss, deviations = compare_errors(ERRORS, {"x": ERRORS["x"] * (1 - 1e-15)})
    assert abs(loss) < 1e-12 and abs(deviations) < 1e-3


def test_a_model_that_cannot_be_run_loses_without_limit():
    assert compare_errors(ERRORS, {}) == (pytest.approx(1e100), np.inf)
    assert compare_errors(ERRORS, {"x": np.full(24, np.inf)}) == (pytest.approx(1e100), np.inf)


def structure_of(residual, bound, ratio=1.0, only_visible=True):
    residual = ratio * residual
    run = SimpleNamespace(
        misfit={"x": SimpleNamespace(noise_ratio=ratio, rmse=ratio, samples=len(residual))},
        traces=[SimpleNamespace(measured={"x": residual}, residual=lambda name: residual)],
    )
    scores = SimpleNamespace(
        run=lambda fit: run, adapt=lambda fit: AdaptedRun({"x": [residual]}), charge=lambda run: {"x": 0.0}
    )
    noise = SimpleNamespace(bound=lambda name: bound)
    fit = SimpleNamespace(problem=SimpleNamespace(noise=noise))
    return measure_structure(scores, fit, only_visible)


KNOWN = NoiseBound(1.0, BoundDirection.ABOUT, NoiseSource.GIVEN)
WHITE = RNG.standard_normal(2000)
COLOURED = np.convolve(RNG.standard_normal(2100), 0.8 ** np.arange(60), "full")[60:2060]
SLOW = np.sin(np.arange(2000) / 30) + 0.02 * RNG.standard_normal(2000)


def test_what_exceeds_known_noise_is_structure():
    assert structure_of(WHITE / WHITE.std(), KNOWN, 1.04) == 0.0
    assert structure_of(WHITE, KNOWN, 10.0) == pytest.approx(1.0, abs=0.01)


def test_the_level_of_a_short_record_of_noise_exceeds_its_own_by_chance():
    few = WHITE[:200] / WHITE[:200].std()
    assert structure_of(few, KNOWN, 1.1) == 0.0  # 1.1 is within three standard errors of 5 %
    assert structure_of(few, KNOWN, 1.1, only_visible=False) > 0.3
    assert structure_of(WHITE / WHITE.std(), KNOWN, 1.1) > 0.2


def test_the_level_of_coloured_noise_exceeds_its_own_by_more():
    """Of 2000 samples with a correlation of 0.8, 440 are independent: three standard errors of their level are 10 %."""
    assert structure_of(COLOURED / COLOURED.std(), KNOWN, 1.09) == 0.0
    assert structure_of(COLOURED / COLOURED.std(), KNOWN, 1.2) > 0.3
    beside = WHITE + 0.6 * SLOW  # white noise beside what is missing has no such colour
    assert structure_of(beside / beside.std(), KNOWN, 1.09) > 0.2


def test_noise_of_one_time_constant_is_no_structure_where_nobody_knows_the_noise():
    assert structure_of(WHITE, None) < 0.1
    assert structure_of(COLOURED, None) < 0.2
    assert structure_of(SLOW, None) > 0.9


def test_without_a_run_all_of_the_error_counts_as_no_noise():
    scores = SimpleNamespace(run=lambda fit: None, adapt=lambda fit: None)
    assert measure_structure(scores, None, only_visible=True) == 1.0
