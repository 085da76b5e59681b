"""The best linear approximation against what a cubic system has by formula (Pintelon and Schoukens, section 3.4.4)."""

from __future__ import annotations

import numpy as np
import pytest

from greybox.base.errors import DataError
from greybox.comparison.frequency.best_linear_approximation import (
    estimate_best_linear_approximation,
    find_rows_of_period,
)
from greybox.data.experiment import Experiment

ROWS, PERIODS, STEP, AMPLITUDE = 1024, 6, 1e-3, 0.1
ODD = np.arange(1, 200, 2)


def realisations(count, cubic=0.0, square=0.0, noise=0.05, lines=ODD, seed=1):
    """``y = u + square u^2 + cubic u^3 + noise`` for random-phase multisines of equal amplitudes."""
    rng = np.random.default_rng(seed)
    records = []
    for m in range(count):
        k = np.arange(ROWS)
        phases = rng.uniform(0, 2 * np.pi, len(lines))
        one = sum(AMPLITUDE * np.cos(2 * np.pi * line * k / ROWS + p) for line, p in zip(lines, phases, strict=True))
        u = np.tile(one, PERIODS + 1)
        y = u + square * u**2 + cubic * u**3 + noise * rng.standard_normal(len(u))
        records.append(Experiment(f"r{m}", STEP * np.arange(len(u)), {"u": u}, {"y": y}))
    return records


def test_the_gain_of_a_cubic_is_the_formulas():
    cubic = 0.3
    result = estimate_best_linear_approximation(realisations(8, cubic))
    variance = len(ODD) * AMPLITUDE**2 / 2
    exact = 1 + 3 * cubic * variance * (1 - 1 / (2 * len(ODD)))
    spread = np.sqrt(np.mean(result.total_variance) / len(ODD))
    assert abs(np.mean(result.response) - exact) < 4 * spread
    assert result.is_linear is False
    # What the cube adds beyond its part that is linear: 6 sigma^6 alpha^2 in all, on the odd lines up to three times the highest.
    line_power = np.mean(result.distortion_variance) * AMPLITUDE**2 / 2
    assert line_power * len(ODD) < 6 * variance**3 * cubic**2 < 4 * line_power * len(ODD)


def test_the_variance_of_the_noise_is_the_noises():
    result = estimate_best_linear_approximation(realisations(4))
    exact = 4 * 0.05**2 / ROWS / AMPLITUDE**2 / (PERIODS * 4)
    assert np.mean(result.noise_variance) == pytest.approx(exact, rel=0.1)
    assert np.mean(result.total_variance) == pytest.approx(exact, rel=0.15)
    assert result.is_linear is True
    np.testing.assert_allclose(result.frequency, ODD / (ROWS * STEP))


def test_lines_that_are_left_out_show_even_and_odd_distortion_in_one_realisation():
    sparse = ODD[::2]
    for cubic, square, even, odd in ((0.0, 0.0, False, False), (0.3, 0.0, False, True), (0.0, 0.3, True, False)):
        result = estimate_best_linear_approximation(realisations(1, cubic, square, lines=sparse))
        failed = {str(c.rule): not c.passed for c in result.checks}
        assert failed == {"even_lines_are_noise": even, "odd_lines_are_noise": odd}
        assert result.total_variance is None


def test_false_alarms_are_rare():
    alarms = [estimate_best_linear_approximation(realisations(3, seed=s)).is_linear is False for s in range(40)]
    assert sum(alarms) <= 1


def test_the_period_is_found_where_the_measured_input_is_noisy():
    record = realisations(1)[0]
    noisy = record.inputs["u"] + 2e-3 * np.random.default_rng(0).standard_normal(record.rows)
    assert find_rows_of_period(Experiment("r", record.time, {"u": noisy}, dict(record.outputs)), "u") == ROWS
    with pytest.raises(DataError, match="does not repeat"):
        find_rows_of_period(Experiment("r", record.time, {"u": np.sqrt(record.time)}, dict(record.outputs)), "u")


def test_what_is_too_short_is_refused():
    record = realisations(1)[0].window(0, 2 * ROWS)
    with pytest.raises(DataError, match="1 whole periods of 1024 rows"):
        estimate_best_linear_approximation(record, period=ROWS)


def test_it_becomes_a_record_to_fit():
    response = estimate_best_linear_approximation(realisations(4)).to_frequency_response(STEP)
    assert response.points == len(ODD) and response.variance is not None and response.sampling_time == STEP
