"""How large the noise is and what colour it has: by every source, against numpy, scipy and dense matrices."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.signal import lfilter
from scipy.stats import f as variance_ratio

from greybox.base.errors import DataError, ModelError
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import AutoRegression, BoundDirection, NoiseSource, fit_autoregression, join_series
from greybox.data.noise.noise_sources import estimate_noise
from greybox.data.noise.repeats import LOUD_CHANCE, _leave_out_moving, deviations_from_mean, find_repetition
from greybox.data.noise.spectrum import estimate_noise_from_differences
from greybox.estimation.fit import fit
from greybox.estimation.options import FitOptions
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.shooting_cost import WhitenedShooting
from models.micro_actuator import micro_actuator
from tests.oracles.independent import linear_record, multisine

TRUTH = micro_actuator.fix("M", "Ra")
LEVEL = {"x": 2e-7, "i": 5e-3}
PERIOD = 2.5e-4


def coloured(rng, rows, rho):
    """AR(1) noise of unit variance."""
    return lfilter([1.0], [1.0, -rho], rng.normal(size=rows + 300) * np.sqrt(1 - rho**2))[300:]


def noisy(record, rng, rho=0.0):
    return replace(record, outputs={n: y + LEVEL[n] * coloured(rng, len(y), rho) for n, y in record.outputs.items()})


def clean_record(rows=1500, seed=1):
    return linear_record(TRUTH, multisine(np.random.default_rng(seed), rows, PERIOD, 5, 800, 3.0), PERIOD)


def quiet_record(rng, rho, rows=1500):
    time = PERIOD * np.arange(rows)
    return Experiment(
        "quiet", time, {"u": np.zeros(rows)}, {n: 1e-5 + s * coloured(rng, rows, rho) for n, s in LEVEL.items()}
    )


def test_burg_finds_a_known_autoregression_and_its_order():
    rng = np.random.default_rng(1)
    series = lfilter([1.0], [1.0, -1.5, 0.7], rng.normal(size=20000))
    found = fit_autoregression(series)
    assert found.order == 2
    assert found.coefficients == pytest.approx([1.5, -0.7], abs=0.02)
    assert found.innovation_variance * series.var() == pytest.approx(1.0, rel=0.03)
    orders = [fit_autoregression(rng.normal(size=500)).order for _ in range(100)]
    assert np.mean(np.array(orders) > 0) < 0.08


def test_gaps_and_several_series_do_not_disturb_it():
    rng = np.random.default_rng(2)
    series = coloured(rng, 20000, 0.8)
    gappy = np.where(rng.random(20000) < 0.2, np.nan, series)
    found = fit_autoregression(join_series([gappy[:7000], gappy[7000:]]))
    assert found.autocorrelation(2)[1] == pytest.approx(0.8, abs=0.02)


@pytest.mark.parametrize("reflection", [(), (0.9,), (0.8, -0.5, 0.3)])
def test_whitening_is_the_inverse_cholesky_factor_on_every_stretch(reflection):
    rng = np.random.default_rng(3)
    model = AutoRegression(reflection)
    values = rng.normal(size=(60, 2))
    values[20] = values[21] = np.nan
    values[24] = np.nan
    white = model.whiten(values)
    for part in (slice(0, 20), slice(22, 24), slice(25, 60)):
        rows = part.stop - part.start
        factor = cholesky(toeplitz(model.autocorrelation(rows)), lower=True)
        assert white[part] == pytest.approx(solve_triangular(factor, values[part], lower=True), abs=1e-12)
    assert np.isnan(white[[20, 21, 24]]).all()


@pytest.mark.parametrize("rows", [3, 16, 100])
def test_a_series_is_whitened_in_place_and_a_block_at_a_time(monkeypatch, rows):
    values = np.random.default_rng(3).normal(size=(60, 2))
    values[[20, 21, 24]] = np.nan
    model = AutoRegression((0.8, -0.5, 0.3))
    white = model.whiten(values)
    monkeypatch.setattr("greybox.data.noise.noise_model.ROWS_AT_A_TIME", rows)
    assert np.array_equal(model.whiten(values), white, equal_nan=True)
    assert model.whiten(values, overwrite_input=True) is values
    assert np.array_equal(values, white, equal_nan=True)


def test_correlations_and_forecasts_are_those_of_the_process():
    model = AutoRegression((0.9,))
    assert model.autocorrelation(5) == pytest.approx(0.9 ** np.arange(5))
    series = coloured(np.random.default_rng(4), 50000, 0.9)
    for ahead in (1, 5):
        error = series - model.predict(series, ahead)
        assert error[10:].std() == pytest.approx(np.sqrt(1 - 0.81**ahead), rel=0.02)
    assert AutoRegression().predict(series, 3) == pytest.approx(np.zeros(50000))


@pytest.mark.parametrize("rows", [7, 64])
def test_forecasts_are_the_same_however_many_rows_are_looked_at_together(monkeypatch, rows):
    """Of a first-order process a forecast is a power of the coefficient times the last reading."""
    monkeypatch.setattr("greybox.data.noise.noise_model.ROWS_AT_A_TIME", rows)
    series = coloured(np.random.default_rng(4), 200, 0.9)
    for ahead in (1, 5):
        forecast = AutoRegression((0.9,)).predict(series, ahead)
        assert forecast[ahead:] == pytest.approx(0.9**ahead * series[:-ahead])


@pytest.mark.parametrize("reflection", [(0.9,), (0.8, -0.5, 0.3), (0.99, 0.99, 0.99), (0.999, -0.7, 0.2, 0.1, 0.5)])
@pytest.mark.parametrize("rows", [7, 64, 10_000])
def test_correlations_are_the_same_however_many_lags_are_looked_at_together(monkeypatch, reflection, rows):
    monkeypatch.setattr("greybox.data.noise.noise_model.ROWS_AT_A_TIME", rows)
    model = AutoRegression(reflection)
    for count in (1, 2, 6, 7, 8, 15, 500):
        expected = list(model.autocorrelation(model.order + 1))
        while len(expected) < count:  # Yule and Walker
            expected.append(float(model.coefficients @ expected[: -model.order - 1 : -1]))
        assert model.autocorrelation(count) == pytest.approx(np.array(expected[:count]), abs=1e-12)


def test_correlations_of_a_long_record_take_little_memory():
    tracemalloc.start()
    try:
        correlations = AutoRegression((0.9, 0.1, -0.2, 0.1, 0.5)).autocorrelation(1_000_000)
        assert tracemalloc.get_traced_memory()[1] < 2.5 * correlations.nbytes
    finally:
        tracemalloc.stop()


def test_noise_comes_from_the_most_trustworthy_source():
    rng = np.random.default_rng(5)
    one, two = (noisy(clean_record(), rng, 0.9) for _ in range(2))
    quiet = quiet_record(rng, 0.9)
    told = estimate_noise(TRUTH, [one, two], {"x": 3e-7}, quiet)
    assert told.sources == {"x": NoiseSource.GIVEN, "i": NoiseSource.QUIET_RECORD} and told.known
    assert told.std[0] == 3e-7 and told.std[1] == pytest.approx(LEVEL["i"], rel=0.2)
    assert [a.autocorrelation(2)[1] for a in told.colour] == pytest.approx([0.9, 0.9], abs=0.05)
    repeated = estimate_noise(TRUTH, [one, two], {})
    assert set(repeated.sources.values()) == {NoiseSource.REPEATED_EXPERIMENTS} and not repeated.known
    assert repeated.std == pytest.approx([LEVEL["x"], LEVEL["i"]], rel=0.2)
    assert [a.autocorrelation(2)[1] for a in repeated.colour] == pytest.approx([0.9, 0.9], abs=0.05)
    alone = estimate_noise(TRUTH, [one], {})
    assert set(alone.sources.values()) == {NoiseSource.SPECTRUM}
    assert [alone.bound(name).direction for name in ("x", "i")] == [BoundDirection.AT_MOST] * 2
    assert all(LEVEL[n] * 0.95 < alone.bound(n).ceiling < 3 * LEVEL[n] and alone.bound(n).floor is None for n in LEVEL)


def test_periods_of_the_input_tell_level_and_colour():
    rng = np.random.default_rng(6)
    once = multisine(rng, 500, PERIOD, 10, 600, 3.0)
    record = noisy(linear_record(TRUTH, np.tile(once, 4), PERIOD), rng, 0.7)
    told = estimate_noise(TRUTH, [record], {})
    assert set(told.sources.values()) == {NoiseSource.REPEATED_PERIODS}
    assert told.std == pytest.approx([LEVEL["x"], LEVEL["i"]], rel=0.15)
    assert [a.autocorrelation(2)[1] for a in told.colour] == pytest.approx([0.7, 0.7], abs=0.06)
    assert find_repetition(np.tile(once, 4)[:, None]) == 500
    assert find_repetition(once[:, None]) is None and find_repetition(np.ones((100, 1))) is None


@pytest.mark.parametrize("held", [1, 7])
@pytest.mark.parametrize("rows", [1600, 1777])
@pytest.mark.parametrize("period", [21, 300, 800, 801, None])
def test_the_period_of_a_long_record_is_that_of_a_short_one(monkeypatch, period, rows, held):
    """The sieve of long records gives what the Fourier transform gives: also where the input is at rest for most of the time."""
    rng = np.random.default_rng(rows + held)
    once = np.repeat(rng.integers(0, 2, size=(period or rows) // held + 1), held)[: period or rows].astype(float)
    once[: len(once) // 3] = 0.0
    inputs = np.stack([np.resize(once, rows), np.resize(np.roll(once, 5), rows)], axis=1)
    expected = find_repetition(inputs)
    monkeypatch.setattr("greybox.data.noise.repeats.NUMBERS_AT_A_TIME", 1000)
    monkeypatch.setattr("greybox.data.noise.repeats.ROWS_AT_A_TIME", 100)
    assert find_repetition(inputs) == expected
    assert expected == (period if period and 2 * period <= rows and np.ptp(once) else expected)
    inputs[-1, 0] += 0.5  # the last row breaks it
    assert find_repetition(inputs) is None


def test_deviations_leave_out_how_the_repeats_began():
    rng = np.random.default_rng(7)
    decay = np.exp(-np.arange(1000) / 50)
    found = deviations_from_mean([rng.normal(size=1000), 20 * decay + rng.normal(size=1000)])
    assert len(found[0]) == 500
    assert np.std(np.concatenate(found)) == pytest.approx(1.0, rel=0.1)


def test_differences_tell_white_noise():
    rng = np.random.default_rng(8)
    slow = np.sin(np.arange(5000) / 40)
    assert estimate_noise_from_differences(slow + 0.01 * rng.normal(size=5000)) == pytest.approx(0.01, rel=0.05)


def test_a_gap_in_time_is_no_noise():
    record = noisy(clean_record(), np.random.default_rng(8))
    kept = np.delete(np.arange(record.rows), slice(400, 470))
    cut = Experiment(
        "cut", record.time[kept], *({n: v[kept] for n, v in s.items()} for s in (record.inputs, record.outputs))
    )
    whole, broken = (estimate_noise(TRUTH, [r], {}) for r in (record, cut))
    assert broken.sources == whole.sources
    assert broken.std == pytest.approx(whole.std, rel=0.1)


def test_a_handful_of_samples_takes_the_noise_from_the_residual():
    record = noisy(clean_record(), np.random.default_rng(9))
    sparse = replace(
        record, outputs={n: np.where(np.arange(1500) % 100 == 7, y, np.nan) for n, y in record.outputs.items()}
    )
    found = fit(TRUTH, sparse, options=FitOptions(at_rest=True))
    assert set(found.noise.sources.values()) == {NoiseSource.RESIDUAL}
    assert all(0.7 < m.noise_ratio < 1.1 for m in found.misfit.values())


def test_the_whitened_cost_is_the_dense_generalised_least_squares_cost():
    rng = np.random.default_rng(10)
    record = noisy(clean_record(200), rng, 0.9)
    gap = {n: np.where((np.arange(200) > 80) & (np.arange(200) < 90), np.nan, y) for n, y in record.outputs.items()}
    problem = prepare_problem(
        TRUTH,
        replace(record, outputs=gap),
        LEVEL,
        FitOptions(),
        quiet=quiet_record(rng, 0.9),
    )
    shooting = problem.shooting()
    assert isinstance(shooting, WhitenedShooting)
    z = problem.variables.here
    value = shooting.evaluate(z)
    plain = prepare_problem(TRUTH, replace(record, outputs=gap), LEVEL, FitOptions()).shooting(problem.variables)
    ((r, jacobian),) = plain.residuals(z)
    cost, gradient, hessian = 0.0, 0.0, 0.0
    for j, colour in enumerate(problem.noise.colour):
        for part in (slice(0, 81), slice(90, 200)):
            inverse = np.linalg.inv(toeplitz(colour.autocorrelation(part.stop - part.start)))
            e, slopes = r[part, j], jacobian[part, j]
            cost, gradient, hessian = (
                cost + e @ inverse @ e,
                gradient + 2 * slopes.T @ inverse @ e,
                hessian + 2 * slopes.T @ inverse @ slopes,
            )
    assert value.cost == pytest.approx(cost, rel=1e-9)
    assert value.gradient == pytest.approx(gradient, rel=1e-7, abs=1e-9 * np.abs(gradient).max())
    assert value.hessian == pytest.approx(hessian, rel=1e-7, abs=1e-9 * np.abs(hessian).max())
    part = problem.shooting(problem.variables, 0.25).evaluate(z)
    assert part.count == 100 and part.cost < value.cost


def test_known_colour_is_used_and_leaves_a_white_residual():
    rng = np.random.default_rng(11)
    record = noisy(clean_record(), rng, 0.9)
    found = fit(TRUTH, record, quiet=quiet_record(rng, 0.9))
    assert found.success and found.uncertainty.kind == "gauss_newton"
    assert all(len(k) >= 1 for k in found.noise.colour.values())
    assert all(0.8 < m.noise_ratio < 1.25 for m in found.misfit.values())
    ignored = fit(TRUTH, record, quiet=quiet_record(rng, 0.9), colour="white")
    assert ignored.uncertainty.kind == "sandwich"
    from_residual = fit(TRUTH, record, colour="residual")
    assert from_residual.uncertainty.kind == "gauss_newton"
    for q in TRUTH.free_parameters:
        for each in (found, ignored, from_residual):
            assert abs(each.parameters[q.name].value - q.value) < 4 * each.parameters[q.name].std, q.name


def test_a_moving_or_incomplete_quiet_record_and_an_unknown_colour_are_refused():
    record = noisy(clean_record(), np.random.default_rng(12))
    with pytest.raises(
        DataError, match=r"input 'u' moves by .* V in the estimation records; give a record with the input at rest"
    ):
        fit(TRUTH, record, quiet=record)
    with pytest.raises(DataError, match="quiet record 'q' has no input 'u'"):
        fit(TRUTH, record, quiet=Experiment("q", record.time, {"w": 0 * record.time}, {"x": record.outputs["x"]}))
    with pytest.raises(ModelError, match="unknown colour 'pink'"):
        fit(TRUTH, record, colour="pink")


def test_a_quiet_record_of_another_pace_tells_the_level_but_not_the_colour():
    rng = np.random.default_rng(13)
    quiet = quiet_record(rng, 0.9)
    slower = replace(quiet, time=2 * quiet.time)
    told = estimate_noise(TRUTH, [noisy(clean_record(), rng)], {}, slower)
    assert set(told.sources.values()) == {NoiseSource.QUIET_RECORD} and not told.coloured


def test_a_piece_is_louder_by_more_than_chance_where_its_colour_is_allowed_for():
    """Mean squares of an AR(1) with coefficient r vary as those of n (1 - r^2) / (1 + r^2) independent samples (Bartlett)."""
    rng, r, rows, count = np.random.default_rng(1), 0.6, 400, 8
    pieces = [lfilter([1.0], [1.0, -r], rng.normal(size=rows + 100))[100:] for _ in range(count)]
    pieces = [piece - piece.mean() for piece in pieces]
    rest = (count - 1) * (rows - 1)
    square = sum(float(piece @ piece) for piece in pieces[1:]) / rest
    white, coloured = (
        variance_ratio.isf(LOUD_CHANCE / count, (rows - 1) / c, rest / c) for c in (1.0, (1 + r**2) / (1 - r**2))
    )

    def count_kept(ratio):
        first = pieces[0] * np.sqrt(ratio * square * (rows - 1) / float(pieces[0] @ pieces[0]))
        return len(_leave_out_moving([first, *pieces[1:]], 0.0))

    assert count_kept((white + coloured) / 2) == count and count_kept(1.05 * coloured) == count - 1
